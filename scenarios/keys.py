"""The keys of scenario files as a list: what each says, its unit, what is allowed. From the schema, which says it once.

`railstate show NAME --keys` prints it; `railstate schema` is the same for editors."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any, Literal, NamedTuple, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from .errors import TAGS


class Key(NamedTuple):
    """path: dotted, NAME standing for names of one's own. of: the kind of its table, where there are several. default:
    as JSON, `required` where there is none."""

    path: str
    of: str
    what: str
    unit: str
    default: str
    numeric: bool


def keys_of(model: type[BaseModel], path: str = "", of: str = "") -> Iterator[Key]:
    """The keys of a table and of the tables in it, in their order."""
    for name, field in model.model_fields.items():
        inner = f"{path}.{field.alias or name}" if path else field.alias or name
        extra = field.json_schema_extra
        yield Key(inner, of, field.description or "", str(extra.get("unit", "")) if isinstance(extra, dict) else "",
                  _default(field), _numeric(field.annotation))
        tables = list(_tables(field.annotation, inner))
        for table, place in tables:
            yield from keys_of(table, place, of if len(tables) == 1 else _kind(table) or of)


def _tables(annotation: Any, path: str) -> Iterator[tuple[type[BaseModel], str]]:
    """The tables in a type, with their places: those of a mapping under NAME, those of a list as [[path]]."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation, path
        return
    place = f"{path}.NAME" if get_origin(annotation) is dict else path
    for part in get_args(annotation):
        yield from _tables(part, place)


def _kind(table: type[BaseModel]) -> str:
    for tag in TAGS:
        if tag in table.model_fields:
            return ", ".join(map(str, get_args(table.model_fields[tag].annotation)))
    return ""


def _numeric(annotation: Any) -> bool:
    """Whether a type has numbers in it, in no table of its own."""
    if annotation in (int, float):
        return True
    if get_origin(annotation) is Literal or (isinstance(annotation, type) and issubclass(annotation, BaseModel)):
        return False
    parts = get_args(annotation)
    return any(_numeric(part) for part in (parts[1:] if get_origin(annotation) is dict else parts))


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True, validated_data={})
    return json.dumps(value.model_dump() if isinstance(value, BaseModel) else value, default=str)
