"""numba's decorators, with the machine code of each module kept in a folder named by all that it was compiled from.

numba looks only at the file that holds a function; code compiled from an older helper in another file must not run. An
edit has those modules compiled anew that import what was edited, and no others."""

from __future__ import annotations

import hashlib
import os
import re
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from shutil import rmtree
from typing import Any

from numba import cfunc as numba_cfunc
from numba import njit as numba_njit
from numba.core import config as numba_config

config: Any = numba_config
SUITE = Path(__file__).resolve().parent.parent
FOLDER = "railstate"
KEPT = 8
"""How many folders of other versions of a module are left in their place."""
_IMPORT = re.compile(r"^from (\.+)([\w.]*) import (\([^)]*\)|.*)", re.MULTILINE)


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """numba's njit."""
    return lambda function: _decorated(function, numba_njit(**options))


def cfunc(*signature: Any, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """numba's cfunc."""
    return lambda function: _decorated(function, numba_cfunc(*signature, **options))


def _decorated(function: Callable[..., Any], decorator: Callable[..., Any]) -> Any:
    with _kept_in(folder(Path(function.__code__.co_filename))):
        return decorator(function)


@contextmanager
def _kept_in(where: Path | None) -> Iterator[None]:
    """What is decorated meanwhile keeps its machine code there: numba asks for the place when it decorates."""
    before, config.CACHE_DIR = config.CACHE_DIR, str(where or "")
    try:
        yield
    finally:
        config.CACHE_DIR = before


@cache
def folder(module: Path) -> Path | None:
    """The folder of a module's machine code, in the first place that can be written: what NUMBA_CACHE_DIR says, the
    user's cache, a temporary folder. None: nowhere."""
    stem = ".".join(module.relative_to(SUITE).with_suffix("").parts) if module.is_relative_to(SUITE) else module.stem
    return place(stem, key(module))


def key(*modules: Path) -> str:
    """A hash of modules and of all that they import from their own package or from packages beside it."""
    taken = list(modules)
    for path in taken:
        taken += [found for found in _imported(path) if found not in taken]
    return _hash(word for path in sorted(taken) for word in (path.parent.name, path.name, _text(path)))


def _hash(words: Iterable[str]) -> str:
    return hashlib.sha256("\0".join(words).encode()).hexdigest()[:16]


@cache
def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


@cache
def _imported(path: Path) -> tuple[Path, ...]:
    """The files that the relative imports at the top of a module mean, this one left out, which holds no kernel."""
    found: list[Path] = []
    for dots, name, names in _IMPORT.findall(_text(path)):
        module = path.parents[len(dots) - 1].joinpath(*filter(None, name.split(".")))
        for each in [module, *(module / word for word in re.findall(r"\w+", names))]:
            found += [each.with_suffix(".py"), each / "__init__.py"]
    return tuple(file for file in dict.fromkeys(found) if file != Path(__file__) and file.is_file())


def place(stem: str, version: str) -> Path | None:
    """The folder of a version of what is called so."""
    for place in _places():
        made = place / FOLDER / f"{stem}-{version}"
        with suppress(OSError):
            new = not made.is_dir()
            made.mkdir(parents=True, exist_ok=True, mode=0o700)
            os.utime(made)
            if os.access(made, os.W_OK | os.X_OK):
                if new:
                    _clear(made, stem)
                return made
    return None


def _places() -> Iterator[Path]:
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        if os.environ.get(name):
            yield Path(os.environ[name])
    with suppress(RuntimeError):  # nobody's home
        yield Path.home() / ".cache"
    yield Path(tempfile.gettempdir()) / f"{FOLDER}-{os.getuid() if hasattr(os, 'getuid') else 'cache'}"


def _clear(own: Path, stem: str) -> None:
    """Remove the folders of other versions but the KEPT ones used last."""
    with suppress(OSError):
        others = [path for path in own.parent.iterdir() if path.name.rpartition("-")[0] == stem and path != own]
        for path in sorted(others, key=lambda path: path.stat().st_mtime, reverse=True)[KEPT:]:
            rmtree(path, ignore_errors=True)


_suite = [path for name in ("scenarios", "estimators", "benchmarks") for path in sorted((SUITE / name).rglob("*.py"))]
_stamps = [(path, path.stat()) for path in _suite]
# a plug-in's own kernels may use any of the suite's
config.CACHE_DIR = str(place("plug-ins", _hash(f"{path} {at.st_size} {at.st_mtime_ns}" for path, at in _stamps)) or "")
