"""Finding estimators: built-ins and plug-ins through the same entry points, and classes in loose files (`--plugin`).

Names are the entry point's; a loose file's estimator is named after the file, or after its class where it holds
several."""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import re
import sys
from functools import cache
from pathlib import Path

from ..scenarios.errors import InputError
from ..scenarios.registry import load_group
from ..scenarios.source import LOOSE
from .interface import Estimator, first_edition

_loose: dict[str, type[Estimator]] = {}


@cache
def _registered() -> dict[str, type[Estimator]]:
    found = load_group("railstate.estimators")
    return {name: found[name] for name in sorted(found)}


def estimators() -> dict[str, type[Estimator]]:
    """All estimators by plug-in name."""
    return {**_registered(), **_loose}


def estimator_class(name: str, where: str) -> type[Estimator]:
    """The class of a plug-in name. Raises InputError naming those there are."""
    known = estimators()
    if name not in known:
        raise InputError(f"{where}: there is no estimator \"{name}\"; installed: {', '.join(known)}")
    old = first_edition(known[name])
    if old:
        raise InputError(f"{where}: {old}")
    return known[name]


def load_file(path: str) -> dict[str, type[Estimator]]:
    """Register the estimator classes of a loose file. Raises InputError if it does not import or holds none."""
    file = Path(path).resolve()
    if not file.is_file():
        raise InputError(f"{path}: no such file; --plugin takes a Python file with an Estimator class")
    # by content too: what was changed in the meantime is another module
    digest = hashlib.sha256(str(file).encode() + file.read_bytes()).hexdigest()
    module_name = f"{LOOSE}{digest[:12]}"
    module = sys.modules.get(module_name)
    if module is None:
        spec = importlib.util.spec_from_file_location(module_name, file)
        if spec is None or spec.loader is None:
            raise InputError(f"{path}: not a Python file")
        module = importlib.util.module_from_spec(spec)
        sys.modules[module_name] = module
        try:
            spec.loader.exec_module(module)
        except Exception as error:
            del sys.modules[module_name]
            raise InputError(f"{path}: does not import: {type(error).__name__}: {error}") from error
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
    found = dict(zip(names, classes, strict=True))
    taken = [name for name in found if name in _registered()]
    if taken:
        raise InputError(f"{path}: an estimator named {taken[0]} is installed already; rename the "
                         f"{'file' if len(classes) == 1 else 'class'}")
    _loose.update(found)
    return found
