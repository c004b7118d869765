"""Estimators' entries as nested tables: one dotted key set, and the entry written as a scenario file has it.

`tune` changes entries key by key, and its result goes into a file by hand."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

from ...scenarios.errors import InputError


def put(table: dict[str, Any], key: str, value: Any, base: Mapping[str, Any]) -> None:
    """Set one dotted key, `sigma_v.1` the second element of a list; base: where lists come from that the table does not
    name itself. Raises InputError."""
    _put(table, key, value, base, key)


def _put(table: dict[str, Any], key: str, value: Any, base: Mapping[str, Any], whole: str) -> None:
    head, _, rest = key.partition(".")
    if not rest:
        table[head] = value
        return
    inner, under = table.get(head), base.get(head)
    known = inner if inner is not None else under
    if re.fullmatch(r"\d+", rest):
        if not isinstance(known, list):
            raise InputError(f"--over {whole}: {head} is no list here of which one element could be searched; give it "
                             f"first: --set estimators.LABEL.{whole.rpartition('.')[0]}=[..]")
        if int(rest) >= len(known):
            raise InputError(f"--over {whole}: there are {len(known)} elements, counted from 0")
        table[head] = [*known[:int(rest)], value, *known[int(rest) + 1:]]
        return
    if inner is not None and not isinstance(inner, Mapping):
        raise InputError(f"--over {whole}: {head} is no table")
    table[head] = dict(inner or {})
    _put(table[head], rest, value, under if isinstance(under, Mapping) else {}, whole)


def toml(label: str, entry: Mapping[str, Any], origin: str) -> str:
    """The entry as lines of a scenario file, its origin with it."""
    lines = ["[origin]", f"{plain(f'estimators.{label}')} = {plain(origin)}", "", f"[estimators.{label}]"]
    return "\n".join([*lines, *(f"{key} = {plain(value)}" for key, value in entry.items()), ""])


def plain(value: Any) -> str:
    """A value as TOML has it on one line."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key if re.fullmatch(r'[A-Za-z0-9_-]+', key) else plain(key)} = {plain(item)}"
                                for key, item in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(plain, value)) + "]"
    return json.dumps(value, ensure_ascii=False)
