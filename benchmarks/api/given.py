"""Estimators as Python gives them: names, classes, objects and functions, turned into entries of [estimators].

What is not the suite's own goes by value, as a pickle, into processes of its own, like any plug-in: it needs no module,
no entry point and no `__main__` guard."""

from __future__ import annotations

import atexit
import copy
import hashlib
import inspect
import re
import shutil
import tempfile
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from ...estimators.adapters import PerRunStep
from ...estimators.interface import Estimator, first_edition
from ...estimators.registry import GIVEN, estimators, installed
from ...scenarios.errors import InputError

LABEL = r"[A-Za-z0-9][A-Za-z0-9_-]*"
EXPECTED = ("a label or a name, a class over railstate.Estimator, an object of one, a function make(model) that "
            "returns step(y, u), or a table such as {\"plugin\": \"ekf\", \"knowledge\": {\"sigma_w\": 0.1}}")


class Given(NamedTuple):
    """only: the labels in their order. entries: tables of [estimators] by label, for what the scenario does not list.
    files: pickles of what is not the suite's own."""

    only: tuple[str, ...]
    entries: dict[str, dict[str, Any]]
    files: tuple[str, ...]


def taken(estimators: str | type | Iterable[Any] | Mapping[str, Any] | None) -> Given:
    """What is meant by estimators: one of what `EXPECTED` names, several, or a mapping of labels to them; None: the
    scenario's own. Raises InputError."""
    if estimators is None:
        return Given((), {}, ())
    if isinstance(estimators, Mapping):
        pairs: list[tuple[str | None, Any]] = list(estimators.items())
    elif isinstance(estimators, str) or not isinstance(estimators, Iterable):
        pairs = [(None, estimators)]
    else:
        pairs = [(None, one) for one in estimators]
    only: list[str] = []
    entries: dict[str, dict[str, Any]] = {}
    files: list[str] = []
    for label, thing in pairs:
        name, entry, file = _one(label, thing)
        if name in only:
            raise InputError(f"estimators: two are called {name}; give a mapping of labels: {{\"LABEL\": ..}}")
        only.append(name)
        if entry is not None:
            entries[name] = entry
        files += [file] if file else []
    if not only:
        raise InputError(f"estimators: none is given; expected {EXPECTED}, or several of them")
    return Given(tuple(only), entries, tuple(files))


def _one(label: str | None, thing: Any) -> tuple[str, dict[str, Any] | None, str]:
    """Label, entry (None: the scenario's, or an installed one's own) and file of one of what is given."""
    if isinstance(thing, str):
        return (thing, None, "") if label in (None, thing) else (_checked(label), {"plugin": thing}, "")
    if isinstance(thing, Mapping):
        if label is None:
            raise InputError("estimators: a table needs a label: {\"LABEL\": {\"plugin\": ..}}")
        return _checked(label), dict(thing), ""
    parameters: dict[str, Any] = {}
    if isinstance(thing, Estimator):
        parameters = thing.parameters.model_dump(mode="json", exclude_unset=True)
        cls = type(thing)
    elif inspect.isclass(thing) and issubclass(thing, Estimator):
        cls = thing
    elif inspect.isroutine(thing) and (label or thing.__name__ != "<lambda>"):
        cls = _stepping(thing)
    else:
        raise InputError(f"estimators: {label or ''}{': ' if label else ''}got {thing!r:.80}; expected {EXPECTED}")
    own = next((name for name, known in estimators().items() if known is cls), "")
    label = _checked(label or own or re.sub(r"(?<=[a-z0-9])(?=[A-Z])|_", "-", cls.__name__).strip("-").lower())
    if own:
        return label, {"plugin": own, "parameters": parameters}, ""
    if label in estimators() or label in installed():
        raise InputError(f"estimators: an estimator named {label} is installed already; rename the class, or give "
                         "{\"LABEL\": ..}")
    old = first_edition(cls)
    if old or inspect.isabstract(cls):
        raise InputError(f"estimators: {label}: {old or 'lacks ' + ', '.join(sorted(cls.__abstractmethods__))}")
    plain = not isinstance(thing, Estimator) or vars(thing).keys() == {"parameters"}
    return label, {"plugin": label, "parameters": parameters}, _pickled(label, cls if plain else _begun(thing))  # pyright: ignore[reportArgumentType]


def _checked(label: Any) -> str:
    if not isinstance(label, str) or not re.fullmatch(LABEL, label):
        raise InputError(f"estimators: {label!r} is no label; allowed: letters, digits, and _ - inside")
    return label


@cache
def _stepping(make: Callable[[Any], Any]) -> type[Estimator]:
    """A function make(model) -> step(y, u) as a class: the same one each time, so that its rows are found again."""
    return type(make.__name__, (PerRunStep,), {
        "make": lambda self, model: make(model), "__doc__": make.__doc__, "__module__": make.__module__})


def _begun(thing: Estimator) -> type[Estimator]:
    """A class whose objects begin as this one does."""
    state = vars(thing)

    def begin(self: Estimator, parameters: Any = None) -> None:
        vars(self).update(copy.deepcopy(state))

    cls = type(thing)
    return type(cls.__name__, (cls,), {"__init__": begin, "__doc__": cls.__doc__, "__module__": cls.__module__,
                                       "__qualname__": f"{cls.__qualname__}.begun"})


@cache
def _place() -> Path:
    """Where pickles lie as long as this process lives."""
    folder = Path(tempfile.mkdtemp(prefix="railstate-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def _pickled(label: str, cls: type[Estimator]) -> str:
    """The path of the pickle of a class. Raises InputError where it cannot be pickled."""
    import cloudpickle

    try:
        content = cloudpickle.dumps(cls)
    except Exception as error:
        raise InputError(f"estimators: {label}: cannot be pickled: {type(error).__name__}: {error}; it must not hold "
                         "open files, locks or the like") from None
    path = _place() / hashlib.sha256(content).hexdigest()[:16] / f"{label}{GIVEN}"
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(content)
    return str(path)
