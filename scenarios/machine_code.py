"""numba's decorators, with the machine code of each module kept in a folder named by all that it was compiled from.

numba looks only at the file that holds a function; code compiled from an older helper in another file must not run. An
edit has those modules compiled anew that import what was edited, and no others. What one process is compiling another
waits for, and loads."""

from __future__ import annotations

import gc
import hashlib
import os
import re
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from shutil import rmtree
from time import monotonic, sleep
from typing import Any

from numba import cfunc as numba_cfunc
from numba import njit as numba_njit
from numba.core import config as numba_config
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, Flags
from numba.core.registry import CPUDispatcher

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

config: Any = numba_config
SUITE = Path(__file__).resolve().parent.parent
FOLDER = "railstate"
KEPT = 8
"""How many folders of other versions of a module are left in their place."""
PATIENCE = 120.0
"""Seconds to wait for what another process compiles."""
_IMPORT = re.compile(r"^from (\.+)([\w.]*) import (\([^)]*\)|.*)", re.MULTILINE)


_DEFAULTS = {name: option.default for name, option in Flags.options.items()}
Flags.values = lambda self: {**_DEFAULTS, **self._values}  # pyright: ignore
"""As numba's own, which asks for each option by itself, at every look for a function that a kernel calls."""


class _Part(JITCodeLibrary):
    """A kernel that is optimised and turned into machine code in each of its callers, and nowhere else."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True

    def serialize_using_object_code(self) -> Any:
        return self.serialize_using_bitcode()


class _Parts(Compiler):
    def compile_extra(self, func: Any) -> Any:
        state = self.state
        state.flags.no_compile = True
        state.library = _Part(state.targetctx.codegen(), func.__qualname__)
        made = super().compile_extra(func)._replace(entry_point=[].append)  # a name for it: callable, like no other
        state.targetctx.insert_user_function(made.entry_point, made.fndesc, [made.library])
        return made


class _Kernel(CPUDispatcher):
    def compile(self, sig: Any) -> Any:
        """Nothing is collected meanwhile: the collector would go through all that is being made, again and again."""
        collects = gc.isenabled()
        gc.disable()
        try:
            return super().compile(sig)
        finally:
            if collects:
                gc.enable()


class _Inner(_Kernel):
    def __call__(self, *_: Any, **__: Any) -> Any:
        raise TypeError(f"{self.py_func.__name__} is called from compiled code alone")


def njit(inner: bool = False, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """numba's njit. inner: called from other kernels alone, as a part of which it is compiled, not for itself too, and
    seen whole by the optimiser."""
    flags: Any = {"no_cfunc_wrapper": True, **options}
    if inner:
        flags |= {"no_cpython_wrapper": True, "pipeline_class": _Parts}

    def decorate(function: Callable[..., Any]) -> Any:
        where = folder(Path(function.__code__.co_filename))
        with _kept_in(where):
            dispatcher: Any = numba_njit(**flags)(function)
        dispatcher.__class__ = _Inner if inner else _Kernel
        if where is not None:
            dispatcher._cache = _Shared(dispatcher._cache, where / function.__name__)
        return dispatcher

    return decorate


def cfunc(*signature: Any, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """numba's cfunc, which compiles as it decorates."""
    def decorate(function: Callable[..., Any]) -> Any:
        where = folder(Path(function.__code__.co_filename))
        with _kept_in(where), _Lock(where / function.__name__ if where else None):
            return numba_cfunc(*signature, **options)(function)

    return decorate


class _Lock:
    """Held by one process at a time for a kernel. Where that cannot be had, or takes too long, nobody waits."""

    def __init__(self, kernel: Path | None) -> None:
        self._kernel, self._file = kernel, -1

    def __enter__(self) -> None:
        if fcntl is None or self._kernel is None or self._file >= 0:
            return
        until = monotonic() + PATIENCE
        with suppress(OSError):
            self._file = os.open(f"{self._kernel}.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            while monotonic() < until:
                try:
                    fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    return
                except BlockingIOError:
                    sleep(0.02)

    def __exit__(self, *_: object) -> None:
        if self._file >= 0:
            os.close(self._file)
            self._file = -1


class _Shared:
    """A kernel's cache in numba's form, which one process at a time fills: who finds nothing in it compiles, and saves
    what came out; the others wait for that. Kernels call each other in no circle, so no two wait for each other."""

    def __init__(self, cache: Any, kernel: Path) -> None:
        self._cache, self._lock = cache, _Lock(kernel)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._cache, name)

    def load_overload(self, signature: Any, target: Any) -> Any:
        """The machine code for a signature; None: to be compiled."""
        found = self._cache.load_overload(signature, target)
        if found is None:
            self._lock.__enter__()
            found = self._cache.load_overload(signature, target)
            if found is not None:
                self._lock.__exit__()
            else:
                _tell()
        return found

    def save_overload(self, signature: Any, data: Any) -> None:
        """Keep what was compiled."""
        try:
            self._cache.save_overload(signature, data)
        finally:
            self._lock.__exit__()


TELL = "RAILSTATE_TELL"


@contextmanager
def told(text: str) -> Iterator[None]:
    """Who compiles first meanwhile, this process or one that it starts, says so on standard error, where a file is the
    right to speak."""
    with tempfile.TemporaryDirectory() as room:
        token = Path(room) / "token"
        token.write_text(text, encoding="utf-8")
        os.environ[TELL] = str(token)
        try:
            yield
        finally:
            del os.environ[TELL]


def _tell() -> None:
    token = os.environ.get(TELL)
    if token:
        with suppress(OSError):
            text = Path(token).read_text(encoding="utf-8")
            os.unlink(token)
            print(f"\r\x1b[2K{text}", file=sys.stderr, flush=True)


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


def closure(module: Path) -> list[Path]:
    """A module and all that it imports from its own package or from packages beside it."""
    taken, seen = [module], {module}
    for path in taken:
        new = [found for found in _imported(path) if found not in seen]
        taken += new
        seen.update(new)
    return taken


def key(module: Path) -> str:
    """A hash of a module's closure."""
    return _hash(word for path in sorted(closure(module)) for word in (path.parent.name, path.name, _text(path)))


def _hash(words: Iterable[str]) -> str:
    return hashlib.sha256("\0".join(words).encode()).hexdigest()[:16]


@cache
def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


@cache
def _imported(path: Path) -> tuple[Path, ...]:
    """The files that the relative imports at the top of a module mean, this one left out, which holds no kernel."""
    found: dict[str, None] = {}
    for dots, name, names in _IMPORT.findall(_text(path)):
        module = os.path.join(path.parents[len(dots) - 1], *filter(None, name.split(".")))  # many: texts, not paths
        for each in [module, *(os.path.join(module, word) for word in re.findall(r"\w+", names))]:
            found |= {f"{each}.py": None, os.path.join(each, "__init__.py"): None}
    return tuple(Path(file) for file in found if file != __file__ and os.path.isfile(file))


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
