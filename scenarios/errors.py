"""The errors a user can meet, each with one clear message, and pydantic's findings in such words.

They live in the lowest layer because scenario files, plug-ins and results folders all raise them."""

from __future__ import annotations

import reprlib
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, get_args

if TYPE_CHECKING:  # the command line asks for the errors alone
    from pydantic import BaseModel, ValidationError
    from pydantic.fields import FieldInfo

TAGS = ("kind", "form", "motion")
"""Keys that say which of several tables one is."""


class InputError(Exception):
    """Bad input: the message names the file, the field and what is allowed. The command line exits with 2."""


class Infeasible(Exception):
    """A design problem has no (trustworthy) solution. Every run of the estimator gets a row with status `infeasible`.

    The message says at which parameters, which constraint family, and what to try."""


class Interrupted(Exception):
    """Ctrl-C during the work: the message says what is kept and how to go on. The command line exits with 130."""


class Unsupported(Infeasible):
    """An estimator cannot work with this design model: the message says what it needs and the model lacks."""


def describe(error: ValidationError, model: type[BaseModel], prefix: str = "",
             table: Mapping[str, Any] | None = None) -> list[str]:
    """The errors of validating a `model` as lines `dotted.path: message (got ..)`, an unknown key with those allowed.

    table: what was validated, for paths as its file has them."""
    lines = []
    for item in error.errors():
        path = ".".join([*([prefix] if prefix else []), *_keys(item["loc"], table)])
        got = item["input"]
        message = {"missing": "missing", "extra_forbidden": "unknown key"}.get(item["type"], item["msg"])
        message = message.removeprefix("Value error, ")
        told = item["type"] == "missing" or isinstance(got, dict) or (isinstance(got, str) and got in message)
        shown = "" if told else f" (got {reprlib.repr(got)})"
        allowed = f"; allowed: {_allowed(model, item['loc'])}" if item["type"] == "extra_forbidden" else ""
        lines.append((f"{path}: " if path else "") + message + shown + allowed)
    return lines


def _keys(loc: tuple[int | str, ...], table: Any) -> Iterator[str]:
    """The keys of an error's place, without what pydantic adds for one of several allowed types or kinds of table."""
    for part in loc:
        if isinstance(table, dict):
            if part in [table.get(key) for key in TAGS] and part not in table:
                continue
            table = table.get(part)
        elif isinstance(table, list) and isinstance(part, int):
            table = table[part] if part < len(table) else None
            if isinstance(table, dict):
                part = table.get("name", table.get("kind", part))
        elif table is not None and isinstance(part, str):
            continue
        else:
            table = None
        yield str(part)


def _allowed(model: type[BaseModel], loc: tuple[int | str, ...]) -> str:
    """The keys of the table in which `loc` lies."""
    tables = [model]
    for part in loc[:-1]:
        fields = [table.model_fields[str(part)] for table in tables if part in table.model_fields]
        inside = [inner for field in fields for inner in _models(field.annotation)]
        chosen = [table for table in tables if part in (
            table.__name__, *(kind for key in TAGS for kind in _kinds(table.model_fields.get(key))))]
        tables = inside or chosen or tables
    return ", ".join(dict.fromkeys(field.alias or key for table in tables
                                   for key, field in table.model_fields.items())) or "none"


def _models(annotation: Any) -> list[type[BaseModel]]:
    """The tables in a type such as `dict[str, A | B]`."""
    from pydantic import BaseModel

    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for inner in get_args(annotation) for model in _models(inner)]


def _kinds(field: FieldInfo | None) -> tuple[Any, ...]:
    return get_args(field.annotation) if field else ()
