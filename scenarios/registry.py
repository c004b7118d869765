"""Finding settings and scenario files: built-ins and plug-ins through the same entry points.

A plug-in that does not import costs a warning with its reason, nothing else."""

from __future__ import annotations

import os
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from functools import cache
from importlib.metadata import Distribution, EntryPoint, entry_points
from pathlib import Path
from typing import Any, NoReturn

from pydantic import ValidationError

from .errors import InputError, describe
from .setting import Setting

SUITE, GROUP = "railstate", "railstate.scenarios"


def load_group(group: str) -> dict[str, Any]:
    """All objects registered under an entry-point group, by name, the suite's own first; those that fail to import are
    warned about, also those that want to end the process."""
    found: dict[str, Any] = {}
    for point in sorted(entry_points(group=group), key=lambda point: (not _own(point), point.name)):
        sent: list[int] = []
        try:
            with nullcontext() if _own(point) else _no_exit(sent):
                found.setdefault(point.name, point.load())
        except BaseException as error:  # SystemExit too: an import does not end the command
            if isinstance(error, KeyboardInterrupt) and (sent or _own(point)):
                raise
            warnings.warn(f"plug-in {point.name} ({point.value}) is left out: {type(error).__name__}: {error}",
                          stacklevel=2)
    return found


@cache
def own_points(group: str) -> dict[str, EntryPoint]:
    """The suite's own entry points of a group by name, sorted; nothing is imported before `load`."""
    return {point.name: point for point in sorted(entry_points(group=group)) if _own(point)}


def distribution(point: EntryPoint) -> str:
    """The name of the package that an entry point is of."""
    return _name(point.dist) if point.dist is not None else "a package without a name"


@cache
def _name(found: Distribution) -> str:
    return found.name  # read from its metadata each time


def _own(point: EntryPoint) -> bool:
    return distribution(point) == SUITE


@contextmanager
def _no_exit(sent: list[int]) -> Iterator[None]:
    """`os._exit` raises SystemExit meanwhile; `sent` gets the signals that interrupt, which tells those from a
    KeyboardInterrupt that somebody raised."""
    before, usual, main = os._exit, signal.default_int_handler, threading.current_thread() is threading.main_thread()
    numbers = [number for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
               if main and signal.getsignal(number) is usual]

    def leave(status: int) -> NoReturn:
        raise SystemExit(status)

    def interrupt(number: int, frame: Any) -> NoReturn:
        sent.append(number)
        raise KeyboardInterrupt

    os._exit = leave
    for number in numbers:
        signal.signal(number, interrupt)
    try:
        yield
    finally:
        os._exit = before
        for number in numbers:
            signal.signal(number, usual)


@cache
def settings() -> dict[str, type[Setting[Any]]]:
    """Plant kind -> setting class. What is none, or is of a kind that there is, is warned about."""
    found: dict[str, type[Setting[Any]]] = {}
    for name, setting in load_group(GROUP).items():
        kind = getattr(setting, "kind", None)
        if not (isinstance(setting, type) and issubclass(setting, Setting) and isinstance(kind, str)):
            warnings.warn(f"plug-in {name} is left out: no subclass of {Setting.__module__}.Setting", stacklevel=2)
        elif kind in found:
            warnings.warn(f"plug-in {name} is left out: there is a setting of kind {kind} already", stacklevel=2)
        else:
            found[kind] = setting
    return found


@cache
def scenario_files() -> dict[str, Path]:
    """Built-in and plugged-in scenario name -> its TOML file. A file's stem is its scenario's name."""
    files: dict[str, Path] = {}
    for setting in settings().values():
        folder = Path(str(sys.modules[setting.__module__].__file__)).parent
        files.update({Path(file).stem: folder / file for file in setting.files})
    return dict(sorted(files.items()))


def setting_for(kind: str, where: str) -> type[Setting[Any]]:
    """The setting class of a plant kind. Raises InputError naming the kinds there are."""
    if kind in own_points(GROUP):  # their names are their kinds
        return own_points(GROUP)[kind].load()
    if kind not in settings():
        raise InputError(f"{where}: plant.kind = \"{kind}\" is unknown; allowed: {', '.join(sorted(settings()))}")
    return settings()[kind]


def setting_of(table: Mapping[str, Any], where: str) -> Setting[Any]:
    """The setting of a variant's resolved table. Raises InputError for a table that is none."""
    plant = table.get("plant")
    kind = setting_for(str(plant.get("kind")) if isinstance(plant, Mapping) else "", where)
    try:
        return kind(kind.Config.model_validate(dict(table)))
    except ValidationError as error:
        raise InputError("\n".join(describe(error, kind.Config, where))) from None
