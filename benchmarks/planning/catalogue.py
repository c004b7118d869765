"""What a command knows of estimators: names, claims, parameters, as plain data.

The suite's own say it here; what is a stranger's is asked in a process of its own, where alone it is imported."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from ...estimators.interface import Estimator
from ...estimators.registry import GIVEN, estimator_class, estimators, installed, load_file
from ...scenarios.errors import InputError, describe
from ...scenarios.source import source_hash
from ..isolation.process import IMPORT, Ended, Isolation, clean, isolation


@dataclass(frozen=True)
class Described:
    """An estimator in words. parameters: a line each for `railstate show`. hash: of a plug-in's source. file: the loose
    file it comes from ("": installed)."""

    name: str
    summary: str
    family: str
    source: str
    about: str
    needs: tuple[str, ...]
    claims: tuple[str, ...]
    oracle: bool
    smoother: bool
    parameters: tuple[dict[str, str], ...] = ()
    hash: str = ""
    file: str = ""

    @property
    def given(self) -> bool:
        """Whether it was given in Python, by value, and so is nowhere but in the process that gave it."""
        return self.file.endswith(GIVEN)


def said(name: str, cls: type[Estimator]) -> dict[str, Any]:
    """What a class says of itself: the fields of `Described`."""
    def names(value: Any) -> tuple[str, ...]:
        return (clean(value),) if isinstance(value, str) else tuple(map(clean, value))

    parameters = tuple(
        {"parameter": key, "default": "required" if item.is_required() else json.dumps(item.default, default=str),
         "type": str(item.annotation).replace("typing.", "").removeprefix("<class '").removesuffix("'>"),
         "about": item.description or ""} for key, item in cls.Parameters.model_fields.items())
    return asdict(Described(name, clean(cls.summary), clean(cls.family, 60), clean(cls.source),
                            clean(cls.__doc__ or "", 20_000), names(cls.needs), names(cls.claims), bool(cls.oracle),
                            cls.lag != 0, parameters))


def said_by_file(path: str) -> list[dict[str, Any]]:
    """What the classes of a loose file say of themselves. The hash of one that was given by value is that of its pickle
    and, where it lies in a module, of that too."""
    found = [_said_apart(name, cls) for name, cls in load_file(path).items()]
    if path.endswith(GIVEN):
        for one in found:
            one["hash"] = hashlib.sha256(Path(path).read_bytes() + one["hash"].encode()).hexdigest()[:16]
    return found


def said_by_installed(name: str) -> list[dict[str, Any]]:
    """What an installed plug-in says of itself."""
    return [_said_apart(name, estimator_class(name, "plug-in"))]


def _said_apart(name: str, cls: type[Estimator]) -> dict[str, Any]:
    return {**said(name, cls), "hash": source_hash(cls.__module__)}


def checked_parameters(name: str, given: Mapping[str, Any], where: str, folder: str) -> dict[str, Any]:
    """An estimator's parameters as plain data, what a file (named from `folder` on) holds in place of its name. Raises
    InputError naming the field and what is allowed."""
    cls = estimator_class(name, where)
    try:
        found = cls.Parameters.model_validate(dict(given), context={"folder": Path(folder)})
        return found.model_dump(mode="json", exclude_unset=True)
    except ValidationError as error:
        raise InputError("\n".join(describe(error, cls.Parameters, where))) from None


class Catalogue:
    """The estimators of a command: the suite's own, installed plug-ins, and those of loose files.

    Raises InputError for a file that does not import or holds no estimator, and for two of one name."""

    def __init__(self, files: Sequence[str] = ()) -> None:
        self._known: dict[str, Described] = {}
        self.loose: list[str] = []
        """Names of the estimators of loose files."""
        self.files = list(dict.fromkeys(map(os.path.realpath, files)))
        for file in self.files:
            path = next(path for path in files if os.path.realpath(path) == file)
            what = Path(path).stem if path.endswith(GIVEN) else path
            for found in self._ask(what, said_by_file, file):
                if found.name in self.loose:
                    raise InputError(f"{path}: an estimator named {found.name} is in {self._known[found.name].file} "
                                     "too; rename one")
                self.loose.append(found.name)
                self._known[found.name] = found

    def names(self) -> list[str]:
        """All estimators there are."""
        return [*sorted((*estimators(), *installed())), *self.loose]

    def own(self, name: str) -> bool:
        """Whether an estimator is the suite's own."""
        return name in estimators()

    def __getitem__(self, name: str) -> Described:
        """Raises InputError for one that there is not, or that does not import."""
        if name not in self._known:
            if name in estimators():
                self._known[name] = Described(**said(name, estimators()[name]))
            elif name in installed():
                self._known[name] = self._ask(name, said_by_installed, name)[0]
            else:
                raise InputError(f"there is no estimator \"{name}\"; installed: {', '.join(self.names())}")
        return self._known[name]

    def source(self, name: str) -> str:
        """Hash of an estimator's source."""
        return source_hash(estimators()[name].__module__) if self.own(name) else self[name].hash

    def parameters(self, name: str, given: Mapping[str, Any], where: str, folder: Path = Path()) -> dict[str, Any]:
        """See `checked_parameters`."""
        if name in estimators():
            return checked_parameters(name, given, where, str(folder))
        file = self[name].file
        several = bool(file) and sum(item.file == file for item in self._known.values()) > 1
        # many classes of one file check theirs in the process that described them
        owner = file if several else _owner(name, file)
        with isolation(owner, IMPORT, first=partial(_load, file or name, bool(file))) as process:
            found = process.call(checked_parameters, name, dict(given), where, str(folder.resolve()))
        if isinstance(found, Ended) or not isinstance(found, dict):
            reason = found.reason if isinstance(found, Ended) else "they are no table"
            raise InputError(f"{where}: {name} cannot check them: {reason}")
        return found

    @contextmanager
    def process(self, name: str, timeout: float, memory: int = 0) -> Iterator[Isolation]:
        """The isolated process of a plug-in, which runs nothing else."""
        found = self[name]
        with plugin_process(name, found.file, timeout, memory) as process:
            yield process

    def _ask(self, what: str, function: Callable[..., Any], argument: str) -> list[Described]:
        with isolation(argument, IMPORT) as process:
            found = process.call(function, argument)
            if isinstance(found, Ended):
                raise InputError(f"{what}: cannot be imported: {found.reason}")
            try:
                described = _DESCRIBED.validate_python(found)
            except ValidationError:
                raise InputError(f"{what}: its description is not of the form that estimators have") from None
            if len(described) == 1:  # kept for the one estimator it holds
                process.owner = _owner(described[0].name, argument if function is said_by_file else "")
        return [Described(**{**asdict(item), "file": argument if function is said_by_file else ""})
                for item in described]


_DESCRIBED = TypeAdapter(list[Described])


@contextmanager
def plugin_process(name: str, file: str, timeout: float, memory: int = 0) -> Iterator[Isolation]:
    """A process that has imported a plug-in (from a loose file, or "": installed) and runs nothing else."""
    first = partial(_load, file or name, bool(file))
    with isolation(_owner(name, file), timeout, memory, first) as process:
        yield process


def _owner(name: str, file: str) -> str:
    return f"{name} of {file}"


def _load(what: str, loose: bool) -> None:
    if loose:
        load_file(what)
    else:
        estimator_class(what, "plug-in")
