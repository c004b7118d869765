"""Where compiled machine code is kept: a folder named by the content of all that it was compiled from.

numba looks only at the file that holds a function; code compiled from an older helper in another file must not run."""

from __future__ import annotations

import hashlib
import os
import re
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from shutil import rmtree

PREFIX = "railstate-"
KEPT = 8
"""How many folders of other versions are left in their place."""
_IMPORT = re.compile(r"^from (\.+)([\w.]*) import (\([^)]*\)|.*)", re.MULTILINE)


def key(*packages: Path) -> str:
    """The folder's name: a hash of every module below the packages that names numba, and of all that these import."""
    text = {path: path.read_text(encoding="utf-8") for package in packages for path in sorted(package.rglob("*.py"))}
    taken = [path for path, code in text.items() if "numba" in code]
    for path in taken:
        taken += [found for found in dict.fromkeys(_imported(path, text[path])) if found in text and found not in taken]
    found = hashlib.sha256()
    for path in sorted(taken):
        found.update("\0".join([path.parent.name, path.name, text[path], ""]).encode())
    return PREFIX + found.hexdigest()[:16]


def _imported(path: Path, code: str) -> Iterator[Path]:
    """Files that the relative imports at the top of a module may mean."""
    for dots, name, names in _IMPORT.findall(code):
        module = path.parents[len(dots) - 1].joinpath(*filter(None, name.split(".")))
        for each in [module, *(module / word for word in re.findall(r"\w+", names))]:
            yield each.with_suffix(".py")
            yield each / "__init__.py"


def use(name: str) -> Path | None:
    """Make numba keep its machine code in a folder of this name, in the first place that can be written: what
    NUMBA_CACHE_DIR says, the user's cache, a temporary folder. None: nowhere."""
    for place in _places():
        folder = place / name
        try:
            folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            os.utime(folder)
        except OSError:
            continue
        if not os.access(folder, os.W_OK | os.X_OK):
            continue
        os.environ["NUMBA_CACHE_DIR"] = str(folder)
        if "numba" in sys.modules:
            sys.modules["numba"].config.CACHE_DIR = str(folder)
        _clear(place, folder)
        return folder
    return None


def _places() -> Iterator[Path]:
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given:  # perhaps by a parent process that did the same
        yield Path(given).parent if Path(given).name.startswith(PREFIX) else Path(given)
    if os.environ.get("XDG_CACHE_HOME"):
        yield Path(os.environ["XDG_CACHE_HOME"]) / "railstate"
    with suppress(RuntimeError):  # nobody's home
        yield Path.home() / ".cache" / "railstate"
    yield Path(tempfile.gettempdir()) / f"{PREFIX}{os.getuid() if hasattr(os, 'getuid') else 'cache'}"


def _clear(place: Path, own: Path) -> None:
    """Remove the folders of other versions but the KEPT ones used last."""
    with suppress(OSError):
        others = [path for path in place.iterdir() if path.name.startswith(PREFIX) and path != own and path.is_dir()]
        for path in sorted(others, key=lambda path: path.stat().st_mtime, reverse=True)[KEPT:]:
            rmtree(path, ignore_errors=True)
