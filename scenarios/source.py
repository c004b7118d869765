"""What the code of a module means, with every module it imports: the part of a row's key that an edit changes.

Comments, docstrings and layout change nothing; an edit in one family leaves the hashes of the others as they were."""

from __future__ import annotations

import ast
import hashlib
import importlib.machinery
import importlib.util
import sys
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

OWN = "railstate"
LOOSE = "railstate_plugin_"
"""What names of modules of loose files begin with."""
_LIBRARIES = {"site-packages", "dist-packages"}
"""Names of folders of installed libraries, whose versions the manifest has."""
_DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


class _Content(NamedTuple):
    """What a file means, and the modules that its import statements name."""

    digest: bytes
    imports: tuple[str, ...]


def source_hash(*modules: str) -> str:
    """Hash of modules and of all they import that is no installed library: of railstate, of the package they lie in
    (all its files, data too), of loose files beside them. Import statements count wherever they stand but under
    `TYPE_CHECKING`; what is found at run time by name is a hash of its own (settings, estimators, scenarios)."""
    digest = hashlib.sha256()
    for name, content in sorted(_closure(modules).items()):
        digest.update(f"{name}\0".encode() + content)
    return digest.hexdigest()[:16]


def _closure(modules: tuple[str, ...]) -> dict[str, bytes]:
    """What is hashed of the modules and data files that `source_hash` covers, by their names."""
    found: dict[str, bytes] = {}
    homes = {name.partition(".")[0] for name in modules}
    waiting = list(modules)
    for home in homes - {OWN}:
        for name, path in _package(home):
            if path.suffix == ".py":
                waiting.append(name)
            else:
                found[name] = _bytes(path)
    beside = [str(path.parent) for name in homes if name.startswith(LOOSE) and (path := _file(name))]
    seen: set[str] = set()
    while waiting:
        name = waiting.pop()
        if name in seen or name == OWN:  # the door, which computes nothing
            continue
        seen.add(name)
        top = name.partition(".")[0]
        path = _file(name, beside) if top in {*homes, OWN} or _is_loose(top, tuple(beside)) else None
        if path is None:
            continue
        known = path.name if name.startswith(LOOSE) else name  # a loose file may lie anywhere
        if path.suffix != ".py":
            found[known] = _bytes(path)
            continue
        content = _read(name, path, path.stat().st_mtime_ns)
        found[known] = content.digest
        waiting += content.imports
        if top == OWN:  # tables of numbers beside a setting
            found.update({f"{name.rpartition('.')[0]}/{table.name}": _bytes(table)
                          for table in path.parent.glob("*.csv")})
    return found


def _bytes(path: Path) -> bytes:
    return hashlib.sha256(path.read_bytes()).digest()


def _file(name: str, beside: Sequence[str] = ()) -> Path | None:
    """The file of a module, loaded or not; None for what has none (built in, a name in a module). beside: folders in
    which modules are looked for that are on no path."""
    module = sys.modules.get(name)
    if module is not None:
        file = getattr(module, "__file__", None)
        return Path(file) if file else None
    above = name.rpartition(".")[0]
    find = importlib.machinery.PathFinder.find_spec
    try:
        spec = importlib.util.find_spec(name) if above == OWN else find(name, _folders(above, beside)) if above else (
            None if name in sys.stdlib_module_names else importlib.util.find_spec(name) or find(name, beside))
    except (ImportError, ValueError, KeyError):
        return None
    return Path(spec.origin) if spec and spec.has_location and spec.origin else None


def _folders(package: str, beside: Sequence[str]) -> list[str]:
    """Where a package's modules lie, whether it is loaded or not."""
    module = sys.modules.get(package)
    if module is not None:
        return list(getattr(module, "__path__", []))
    file = _file(package, beside)
    return [str(file.parent)] if file and file.name == "__init__.py" else []


@cache
def _is_loose(top: str, beside: tuple[str, ...]) -> bool:
    """Whether a package or module belongs to no installed library."""
    path = None if top in (*sys.stdlib_module_names, "__main__", "__mp_main__") else _file(top, beside)
    return path is not None and not _LIBRARIES.intersection(path.resolve().parts)


def _package(home: str) -> Iterator[tuple[str, Path]]:
    """The files of a package, hidden and compiled ones left out: (name, file)."""
    module = sys.modules.get(home)
    for place in getattr(module, "__path__", []):
        root = Path(place)
        for path in sorted(root.rglob("*")):
            inside = path.relative_to(root)
            if not path.is_file() or any(part.startswith((".", "__pycache__")) for part in inside.parts):
                continue
            if path.suffix == ".py":
                parts = inside.with_suffix("").parts
                yield ".".join((home, *(parts[:-1] if parts[-1] == "__init__" else parts))), path
            else:
                yield f"{home}/{inside.as_posix()}", path


@cache
def _read(name: str, path: Path, changed: int) -> _Content:
    """A module's meaning and imports; by its bytes where it cannot be parsed. changed: time of the last change."""
    data = path.read_bytes()
    try:
        tree = ast.parse(data)
    except (SyntaxError, ValueError, RecursionError):
        return _Content(hashlib.sha256(data).digest(), ())
    base = name if path.name == "__init__.py" else name.rpartition(".")[0]
    imports = dict.fromkeys(each for found in _imported(tree.body, base) for each in _with_parents(found))
    words: list[str] = []
    _say(tree, words)
    return _Content(hashlib.sha256("\0".join(words).encode("utf-8", "backslashreplace")).digest(), tuple(imports))


def _say(node: ast.AST, words: list[str]) -> None:
    """A tree in words that say neither where it stands nor what documents it; fields that are empty are left out, so
    that versions of Python agree that know more fields."""
    words.append(f"({type(node).__name__}")
    for name in node._fields:
        value = getattr(node, name, None)
        if value is None or value == [] or name in ("ctx", "kind", "type_comment"):
            continue
        words.append(name)
        if name == "body" and isinstance(node, _DOCUMENTED) and _is_text(value[0]):
            value = value[1:]
        for item in value if isinstance(value, list) else [value]:
            if isinstance(item, ast.AST):
                _say(item, words)
            else:
                words.append(repr(item))
    words.append(")")


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _imported(statements: Sequence[ast.AST], base: str) -> Iterator[str]:
    """Absolute names of what statements import, and those inside them, `from a import b` as a and a.b. base: the
    package of their module."""
    for node in statements:
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            yield from _imported(node.orelse, base)
        elif isinstance(node, ast.Import):
            yield from (item.name for item in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = base.split(".")[:len(base.split(".")) - node.level + 1] if node.level else []
            package = ".".join([*above, *([node.module] if node.module else [])])
            yield package
            yield from (f"{package}.{item.name}" for item in node.names)
        else:
            inside = (getattr(node, part, None) for part in ("body", "orelse", "finalbody", "handlers", "cases"))
            yield from (name for part in inside if isinstance(part, list) for name in _imported(part, base))


def _with_parents(name: str) -> Iterator[str]:
    """A module and the packages it lies in, whose __init__ runs as well."""
    parts = name.split(".")
    yield from (".".join(parts[:n]) for n in range(1, len(parts) + 1))
