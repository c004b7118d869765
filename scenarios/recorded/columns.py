"""From named texts to numbers in SI units: which column a role means, its unit, and what its cells say.

One file has one decimal sign; a column that mixes them, or cannot be told from thousands, is refused."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from ..arrays import Array
from ..units import ACCELERATIONS, ANGLES, LENGTHS, SHARES, SPEEDS, TIMES
from .readers import Table

ROLES: dict[str, dict[str, float]] = {
    "time": TIMES, "position": LENGTHS, "speed": SPEEDS, "odometer": LENGTHS, "acceleration": ACCELERATIONS,
    "control": SHARES, "latitude": ANGLES, "longitude": ANGLES, "position_sd": LENGTHS, "speed_sd": SPEEDS,
    "odometer_sd": LENGTHS, "reference_position": LENGTHS, "reference_speed": SPEEDS, "wheel-a": LENGTHS,
    "wheel-b": LENGTHS, "balise": LENGTHS, "balise_sd": LENGTHS}
"""What a column can be, and the units it may have."""
PLAIN = ("latitude", "longitude")
"""Roles whose columns need no unit: degrees."""
NONE = frozenset(("", "na", "n/a", "nan", "null", "none", "#n/a", "<na>", "nat", "#na", "-nan"))
"""Texts, in small letters, that stand for a missing value."""
NUMBER = re.compile(r"[-+]?(\d+([.,]\d*)?|[.,]\d+)(e[-+]?\d+)?")


@dataclass(frozen=True)
class Column:
    """A column that a role means: its name in the file, its unit as written ("" for none) and the factor to SI (NaN for
    none)."""

    name: str
    unit: str = ""
    factor: float = float("nan")


@dataclass(frozen=True)
class Cells:
    """Rules for cells: missing, further texts or numbers that stand for no value; the decimal sign of the file."""

    missing: frozenset[str] = field(default_factory=frozenset)
    absent: tuple[float, ...] = ()
    decimal: str = "."


def find_column(table: Table, role: str, text: str) -> Column:
    """The column that `text` (`name_unit`, `name [unit]`, `name (unit)`) means for a role; with a minus before it its
    sign is turned. Raises ValueError."""
    units = ROLES[role]
    if text.startswith("-") and text not in table.names:
        if role in (*PLAIN, "time") or role.endswith("_sd"):
            raise ValueError(f"map.{role}: a minus turns places, speeds and accelerations, not \"{text[1:]}\"")
        turned = find_column(table, role, text[1:])
        return Column(turned.name, turned.unit, -turned.factor)
    name, unit = _named(table, role, text)
    if not unit:
        unit = table.units.get(name, "") or unit_in(name, units)
        if unit and unit not in units:
            raise ValueError(f"map.{role}: {table.path} gives the unit of \"{name}\" as {unit}; allowed: "
                             f"{', '.join(units)}: write \"{name} [{next(iter(units))}]\" to overrule it")
    if unit and unit not in units:
        raise ValueError(f"map.{role}: the unit of \"{text}\" is unknown; allowed: {', '.join(units)}")
    return Column(name, unit, units[unit]) if unit else Column(name)


def need_unit(role: str, column: Column, text: str) -> float:
    """The factor of a column to SI. Raises ValueError where its name has no unit and its role needs one."""
    if column.unit:
        return column.factor
    if role in PLAIN:
        return 1.0
    units = ROLES[role]
    raise ValueError(f"map.{role}: the unit of \"{text}\" is unknown; end the column's name in a unit (_"
                     f"{', _'.join(u for u in units if '/' not in u)}) or write \"{column.name} [{next(iter(units))}]\""
                     f"; allowed: {', '.join(units)}")


def unit_in(name: str, units: Collection[str]) -> str:
    """The unit at the end of a column's name: `v_kmh`, `v [km/h]`, `v (km/h)`, `v in km/h`; "" for none."""
    bracketed = _bracketed(name)
    found = bracketed[1] if bracketed else re.split(r"_|\sin\s", name)[-1].strip()
    return found if found in units and found != name else ""


def _bracketed(text: str) -> tuple[str, str] | None:
    found = re.fullmatch(r"(.*\S)\s*(?:\[([^\[\]]+)\]|\(([^()]+)\))", text)
    return (found[1], (found[2] or found[3]).strip()) if found else None


def _named(table: Table, role: str, text: str) -> tuple[str, str]:
    """(the column's name, the unit where `text` says one beside it)."""
    if text in table.names:
        return text, ""
    bracketed = _bracketed(text)
    if bracketed and bracketed[0] in table.names:
        return bracketed
    bare = [name for name in table.names if (_bracketed(name) or ("",))[0] == text]
    if len(bare) == 1:
        return bare[0], ""
    missing = bracketed[0] if bracketed else text
    raise ValueError(f"map.{role}: {table.path} has no column \"{missing}\"; it has {', '.join(table.names)}")


def decimal_sign(table: Table, names: Iterable[str]) -> str:
    """The decimal sign of these columns: "." or ",". Raises ValueError where cells have both, or commas may be
    thousands."""
    points: tuple[str, str] | None = None
    commas: tuple[str, str] | None = None
    sure = False
    for name in names:
        column = table.columns[name]
        if not is_text(column):
            continue
        if not pc.any(pc.match_substring(column, ",")).as_py():
            point = pc.match_substring(column, ".")
            if points is None and pc.any(point).as_py():
                points = name, _first(column, point)
            continue
        numeric = pc.match_substring_regex(column, r"^\s*[-+]?\d*[.,]\d")
        comma = pc.and_(numeric, pc.match_substring(column, ","))
        point = pc.and_(numeric, pc.match_substring(column, "."))
        both = pc.and_(comma, point)
        if pc.any(both).as_py():
            raise ValueError(f"{table.path}: column \"{name}\" has {_first(column, both)} with comma and point: "
                             "numbers without a separator of thousands are needed")
        if pc.any(point).as_py():
            points = points or (name, _first(column, point))
        if pc.any(comma).as_py():
            commas = commas or (name, _first(column, comma))
            thousands = pc.match_substring_regex(column, r"^\s*[-+]?[1-9]\d{0,2}(,\d{3})+\s*$")
            sure = sure or not pc.all(pc.or_(pc.invert(comma), thousands)).as_py()
    if points and commas:
        raise ValueError(f"{table.path}: column \"{commas[0]}\" has {commas[1]} and column \"{points[0]}\" has "
                         f"{points[1]}: one file, one decimal sign")
    if commas and not sure:
        raise ValueError(f"{table.path}: column \"{commas[0]}\" has {commas[1]}: decimal comma or thousands cannot be "
                         "told: write it without thousands, or with a point")
    return "," if commas else "."


def numbers(table: Table, name: str, cells: Cells) -> Array:
    """A column as numbers (N,), NaN where a value is missing. Raises ValueError, naming the first cell that is none."""
    column = table.columns[name]
    kind = column.type
    if pa.types.is_boolean(kind) or pa.types.is_temporal(kind):
        raise ValueError(f"{table.path}: column \"{name}\" holds {kind}: numbers are needed, times as seconds")
    quick = _quick(column) if is_text(column) and cells.decimal == "." and not cells.missing else None
    if quick is not None:
        found = quick
        odd = np.flatnonzero(np.isinf(found))
    elif is_text(column):
        written = pc.utf8_trim_whitespace(column)
        if cells.decimal == ",":
            written = pc.replace_substring(written, ",", ".")
        none = pc.is_in(pc.utf8_lower(written), value_set=pa.array(sorted(NONE | cells.missing), pa.string()))
        written = pc.if_else(none, None, written)
        written = pc.replace_substring_regex(written, r"^\+(\d|\.\d)", r"\1")
        try:
            values = pc.cast(written, pa.float64())
        except pa.ArrowInvalid:
            proper = pc.match_substring_regex(written, r"^-?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?$")
            row = int(np.flatnonzero(~pc.fill_null(proper, True).to_numpy(zero_copy_only=False).astype(bool))[0])
            raise ValueError(f"{table.path}: column \"{name}\" is not numeric: row {row + 1} has "
                             f"{column[row].as_py()!r}") from None
        found = values.to_numpy()
        odd = np.flatnonzero(np.isinf(found) | (np.isnan(found) & values.is_valid().to_numpy()))
    else:
        try:
            found = np.array(pc.cast(column, pa.float64(), safe=False).to_numpy(), dtype=float)
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
            raise ValueError(f"{table.path}: column \"{name}\" holds {kind}: numbers are needed") from None
        odd = np.flatnonzero(np.isinf(found))
    if len(odd):
        raise ValueError(f"{table.path}: column \"{name}\" is not numeric: row {odd[0] + 1} has "
                         f"{column[int(odd[0])].as_py()!r}")
    found = np.array(found, dtype=float)
    for value in cells.absent:
        found[found == value] = np.nan
    return found


def _quick(column: pa.ChunkedArray) -> Array | None:
    """A column of texts as numbers, if each is a plain number or nothing at all; else None, for the thorough way."""
    try:
        return np.array(pc.cast(pc.if_else(pc.equal(column, ""), None, column), pa.float64()).to_numpy(), dtype=float)
    except pa.ArrowInvalid:
        return None


def classed(table: Table, name: str, classes: Mapping[str, float]) -> Array | None:
    """A column of classes as the standard deviations (N,) that they stand for, NaN for no reading; None where a cell is
    none of the classes and the column holds numbers. Raises ValueError naming the classes not told."""
    column = pc.utf8_trim_whitespace(pc.cast(table.columns[name], pa.string()))
    words = [word for word in pc.unique(column).to_pylist() if word is not None and word.lower() not in NONE]
    unknown = [word for word in words if word not in classes]
    if unknown:
        if not set(words) & set(classes) and all(_number(word) for word in words):
            return None
        raise ValueError(f"plant.quality: {table.path} has {', '.join(unknown[:6])} in \"{name}\" without a standard "
                         f"deviation: quality = {{ {unknown[0]} = 3.0, .. }}, or \"missing\"")
    places = pc.index_in(column, value_set=pa.array(list(classes), pa.string()))
    values = np.array([*classes.values(), np.nan])
    return values[pc.fill_null(places, len(classes)).to_numpy()]


def is_numeric(table: Table, name: str) -> bool:
    """Whether a column holds numbers, by its type or by its first hundred cells that are not missing."""
    column = table.columns[name]
    if not is_text(column):
        return pa.types.is_integer(column.type) or pa.types.is_floating(column.type) or pa.types.is_decimal(column.type)
    written = [text.strip().lower() for text in first_cells(table, name, 5000)]
    written = [text for text in written if text not in NONE][:100]
    return bool(written) and all(NUMBER.fullmatch(text) for text in written)


def first_cells(table: Table, name: str, count: int = 100) -> list[str]:
    """The first cells of a column as texts, without those that are null."""
    return [str(cell) for cell in table.columns[name].slice(0, count).to_pylist() if cell is not None]


def is_text(column: pa.ChunkedArray) -> bool:
    """Whether a column holds texts as written."""
    return pa.types.is_string(column.type) or pa.types.is_large_string(column.type)


def _first(column: pa.ChunkedArray, where: pa.ChunkedArray) -> str:
    return repr(str(column.filter(where)[0].as_py()).strip())


def _number(word: str) -> bool:
    try:
        float(word.replace(",", "."))
    except ValueError:
        return False
    return True


def cells_of(missing: Sequence[str | float], decimal: str) -> Cells:
    """Rules from what a scenario names as standing for no value, numbers or texts."""
    texts = frozenset(str(value).strip().lower() for value in missing if isinstance(value, str))
    absent = tuple(float(value) for value in missing if not isinstance(value, str))
    return Cells(texts, absent, decimal)
