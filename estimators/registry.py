"""Finding estimators: the suite's own, and plug-ins: entry points of other packages, and loose files (`--plugin`).

What is not the suite's own is imported only where it is asked for, which is a process of its own; the command knows the
names of installed plug-ins without. A loose file's estimator is named after the file, or after its class where it holds
several."""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import os
import pickle
import re
import sys
import warnings
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.machinery import SourceFileLoader
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import CodeType

from ..scenarios.errors import InputError
from ..scenarios.registry import SUITE, distribution, own_points
from ..scenarios.schema import LABEL
from ..scenarios.source import LOOSE
from .interface import Estimator, first_edition

GROUP = "railstate.estimators"
GIVEN = ".pickle"
"""How files end that hold a class which was given in Python, by value; it is called as the file is."""
_loose: dict[str, type[Estimator]] = {}


class _Suite(Mapping[str, type[Estimator]]):
    def __getitem__(self, name: str) -> type[Estimator]:
        return own_points(GROUP)[name].load()

    def __contains__(self, name: object) -> bool:  # Mapping's own would import it
        return name in own_points(GROUP)

    def __iter__(self) -> Iterator[str]:
        return iter(own_points(GROUP))

    def __len__(self) -> int:
        return len(own_points(GROUP))


@cache
def estimators() -> Mapping[str, type[Estimator]]:
    """The suite's own estimators by name, each imported when it is asked for."""
    return _Suite()


@cache
def installed() -> dict[str, EntryPoint]:
    """The plug-ins of other packages by name, not imported. Those of a name that is taken are warned about."""
    found: dict[str, EntryPoint] = {}
    twice: set[str] = set()
    for point in sorted(entry_points(group=GROUP)):
        if distribution(point) == SUITE:
            continue
        if point.name in estimators() or not re.fullmatch(LABEL, point.name):
            why = "the suite has an estimator of this name" if point.name in estimators() else "no name for estimators"
            warnings.warn(f"plug-in {point.name!r} of {distribution(point)} is left out: {why}", stacklevel=2)
        elif point.name in found:
            twice.add(point.name)
            warnings.warn(f"plug-in {point.name} is left out: {distribution(found[point.name])} and "
                          f"{distribution(point)} both have one of this name", stacklevel=2)
        else:
            found[point.name] = point
    return {name: point for name, point in found.items() if name not in twice}


def estimator_class(name: str, where: str) -> type[Estimator]:
    """The class of a name; that of an installed plug-in is imported here. Raises InputError naming those there are."""
    if name in estimators():
        return estimators()[name]
    if name in _loose:
        return _loose[name]
    if name not in installed():
        known = ", ".join((*estimators(), *installed()))
        raise InputError(f"{where}: there is no estimator \"{name}\"; installed: {known}")
    point = installed()[name]
    try:
        cls = point.load()
    except BaseException as error:
        raise InputError(f"plug-in {name} ({point.value}): {_unfit(error)}") from None
    if not (inspect.isclass(cls) and issubclass(cls, Estimator)):
        raise InputError(f"plug-in {name} ({point.value}): is no subclass of {Estimator.__module__}.Estimator")
    old = first_edition(cls)
    if old:
        raise InputError(f"{where}: {old}")
    return cls


def _unfit(error: BaseException) -> str:
    return f"does not import: {type(error).__name__}: {error}"


class _AsItIs(SourceFileLoader):
    """Compiles a file each time: bytecode kept beside it would be taken for an edit of the same second and length."""

    def get_code(self, fullname: str) -> CodeType:
        return self.source_to_code(self.get_data(self.path), self.path)


def load_file(path: str) -> dict[str, type[Estimator]]:
    """Register the estimator classes of a loose file. Raises InputError if it does not import or holds none."""
    if not os.path.isfile(path):  # also of names that no file can have
        raise InputError(f"{path}: no such file; --plugin takes a Python file with an Estimator class")
    file = Path(os.path.realpath(path))
    if file.suffix == GIVEN:
        return _load_given(file)
    # by content too: what was changed in the meantime is another module
    digest = hashlib.sha256(str(file).encode() + file.read_bytes()).hexdigest()
    module_name = f"{LOOSE}{digest[:12]}"
    module = sys.modules.get(module_name)
    if module is None:
        spec = importlib.util.spec_from_file_location(module_name, file)
        if spec is not None and isinstance(spec.loader, SourceFileLoader):
            spec.loader = _AsItIs(module_name, str(file))
        if spec is None or spec.loader is None:
            raise InputError(f"{path}: not a Python file")
        module = importlib.util.module_from_spec(spec)
        sys.modules[module_name] = module
        if str(file.parent) not in sys.path:  # last: what lies beside it is found, and hides nothing
            sys.path.append(str(file.parent))
        try:
            spec.loader.exec_module(module)
        except BaseException as error:
            sys.modules.pop(module_name, None)
            raise InputError(f"{path}: {_unfit(error)}") from None
    classes = [value for value in vars(module).values()
               if inspect.isclass(value) and issubclass(value, Estimator) and value.__module__ == module_name
               and not inspect.isabstract(value)]
    if not classes:
        raise InputError(f"{path}: holds no subclass of railstate.estimators.interface.Estimator")
    for cls in classes:
        old = first_edition(cls)
        if old:
            raise InputError(f"{path}: {old}")
    names = [file.stem.replace("_", "-")] if len(classes) == 1 else [
        re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", item.__name__).lower() for item in classes]
    wrong = [name for name in names if not re.fullmatch(LABEL, name) or names.count(name) > 1]
    if wrong:
        raise InputError(f"{path}: {wrong[0]!r} is no name for an estimator, or that of two; rename the "
                         f"{'file' if len(classes) == 1 else 'class'}: letters, digits, and .-_ inside")
    found = dict(zip(names, classes, strict=True))
    taken = [name for name in found if name in estimators() or name in installed()]
    if taken:
        raise InputError(f"{path}: an estimator named {taken[0]} is installed already; rename the "
                         f"{'file' if len(classes) == 1 else 'class'}")
    _loose.update(found)
    return found


def _load_given(file: Path) -> dict[str, type[Estimator]]:
    try:
        found = {file.stem: pickle.loads(file.read_bytes())}
    except BaseException as error:
        raise InputError(f"{file.stem}: cannot be handed to a process of its own: {type(error).__name__}: {error}"
                         ) from None
    _loose.update(found)
    return found
