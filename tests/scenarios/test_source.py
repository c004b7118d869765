"""What the code of a module means and imports, statement by statement, and which files stand for a module."""

from __future__ import annotations

import ast
import sys
from pathlib import Path
from types import ModuleType

import pytest
from railstate.scenarios import source

IMPORTS = '''
import a.b, c as d
from . import e
from .f import g, h as i
from ..j import k
from m.n import o
if TYPE_CHECKING:
    import hidden
else:
    import p
if sys.version_info > (3, 11):
    import q
elif typing.TYPE_CHECKING:
    import hidden
else:
    import r
try:
    import s
except ImportError:
    import t
else:
    import u
finally:
    import v
def function():
    import w
    for x in range(3):
        with open(x):
            import y
class Class:
    import z
match 1:
    case 1:
        import one
while True:
    import two
else:
    import three
'''
FOUND = ["a.b", "c", "top.mid", "top.mid.e", "top.mid.f", "top.mid.f.g", "top.mid.f.h", "top.j", "top.j.k", "m.n",
         "m.n.o", "p", "q", "r", "s", "u", "v", "t", "w", "y", "z", "one", "two", "three"]


def test_every_import_counts_but_those_for_types() -> None:
    assert list(source._imported(ast.parse(IMPORTS).body, "top.mid")) == FOUND
    assert list(source._with_parents("a.b.c")) == ["a", "a.b", "a.b.c"] and list(source._with_parents("a")) == ["a"]


def meaning(text: str) -> list[str]:
    words = list[str]()
    source._say(ast.parse(text), words)
    return words


@pytest.mark.parametrize(("one", "other", "same"), [
    ("x = 1", "x = (1)  # why", True), ("x = 1", "x = 2", False), ("x = 1", "x = 1.0", False),
    ("x = 1", "x = True", False), ("x = 1", "y = 1", False),
    ('"""Doc."""\nx = 1', "x = 1", True), ('x = 1\n"text"', "x = 1", False),
    ('def f():\n    "doc"\n    return 1', "def f():\n    return 1", True),
    ('async def f():\n    "doc"\n    return 1', 'async def f():\n    "other"\n    return 1', True),
    ('class A:\n    "doc"\n    x = 1', 'class A:\n    x = 1', True), ('if x:\n    "doc"', 'if x:\n    "other"', False),
    ("f(a, b=1)", "f(a, c=1)", False), ("f(a)", "f(*a)", False), ("x = 'a'", 'x = "a"', True),
    ("x = u'a'", "x = 'a'", True),
    ("x: int", "x: str", False), ("[a, b]", "[b, a]", False), ("a if b else c", "c if b else a", False),
    ("def f(a, /, b): ...", "def f(a, b): ...", False), ("x += 1", "x -= 1", False)])
def test_what_changes_a_meaning(one: str, other: str, same: bool) -> None:
    assert (meaning(one) == meaning(other)) == same


def test_a_file_is_read_anew_where_it_has_changed(tmp_path: Path) -> None:
    path, package = tmp_path / "one.py", tmp_path / "__init__.py"
    path.write_text("from . import two\n")
    package.write_text("from . import two\n")
    broken = tmp_path / "broken.py"
    broken.write_text("def\n")
    assert source._read("top.one", path, 1).imports == ("top", "top.two")
    assert source._read("top.mid", package, 1).imports == ("top", "top.mid", "top.mid.two")
    first = source._read("top.broken", broken, 1)
    broken.write_text("deff\n")
    assert first.imports == () and source._read("top.broken", broken, 1) == first
    assert source._read("top.broken", broken, 2).digest != first.digest


def test_the_file_of_a_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Loaded or not, in a package or beside a loose file; none for what is built in, or a name in a module."""
    (tmp_path / "pack" / "deep").mkdir(parents=True)
    for name in ("pack/__init__.py", "pack/one.py", "pack/deep/__init__.py", "pack/deep/two.py", "beside.py"):
        (tmp_path / name).write_text("X = 1\n")
    near = [str(tmp_path)]
    for name, found in (("beside", "beside.py"), ("pack", "pack/__init__.py"), ("pack.one", "pack/one.py"),
                        ("pack.deep.two", "pack/deep/two.py"), ("pack.none", None), ("pack.one.X", None),
                        ("pack.none.two", None), ("builtins", None), ("nowhere", None)):
        assert source._file(name, near) == (tmp_path / found if found else None), name
    assert source._file("beside") is None
    assert source._file("railstate.scenarios.units") == Path(source.__file__).parent / "units.py"
    loaded = ModuleType("loaded")
    monkeypatch.setitem(sys.modules, "loaded", loaded)
    assert source._file("loaded") is None
    loaded.__file__ = "elsewhere.py"
    assert source._file("loaded") == Path("elsewhere.py")
    assert source._is_loose("beside", tuple(near)) and not source._is_loose("json", tuple(near))
    assert not source._is_loose("numpy", tuple(near)) and not source._is_loose("nowhere", tuple(near))


def test_all_files_of_a_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home = ModuleType("home")
    home.__path__ = [str(tmp_path)]
    monkeypatch.setitem(sys.modules, "home", home)
    names = ("__init__.py", "one.py", "deep/__init__.py", "deep/two.py", "deep/table.csv", ".hidden/three.py",
             "__pycache__/four.pyc", "deep/.five.py", "six.txt")
    for name in names:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("")
    assert {name: str(path.relative_to(tmp_path)) for name, path in source._package("home")} == {
        "home": "__init__.py", "home.one": "one.py", "home.deep": "deep/__init__.py", "home.deep.two": "deep/two.py",
        "home/deep/table.csv": "deep/table.csv", "home/six.txt": "six.txt"}
    assert list(source._package("nowhere_at_all")) == []
