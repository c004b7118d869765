"""What is in a recording before anything is decided: its columns, and a mapping to start from.

Roles are found by the words in columns' names, units that no name tells by what fits the other columns."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc

from ..arrays import Array
from .against import compared, way
from .columns import (
    NONE,
    ROLES,
    cells_of,
    decimal_sign,
    find_column,
    first_cells,
    is_numeric,
    is_text,
    numbers,
    unit_in,
)
from .readers import Table
from .recording import Meaning, read_recording
from .times import seconds

WORDS: dict[str, tuple[str, ...]] = {
    "time": ("t", "time", "timestamp", "tst", "tsi", "ts", "stamp", "datetime", "utc", "zeit", "log"),
    "latitude": ("lat", "latitude"), "longitude": ("lon", "long", "lng", "longitude"),
    "position": ("s", "pos", "position", "distance", "dist", "chainage", "km"),
    "wheel-a": ("wheel", "axle", "tacho"), "balise": ("balise", "eurobalise", "beacon"),
    "speed": ("v", "speed", "spd", "velocity", "vel"), "odometer": ("odo", "odometer", "mileage"),
    "acceleration": ("acc", "accel", "acceleration", "a"), "control": ("u", "control", "notch", "throttle"),
    "position_sd": ("accuracy", "sd", "std", "sigma", "hacc", "quality", "fix", "type")}
REFERENCE = {"ref", "reference", "true", "truth", "smooth", "smoothed", "gt"}
NOT = {"diff", "calc", "id", "index", "error", "off", "across", "limit"}
CLASSES: dict[str, float | str] = {
    "NARROW_INT": 0.05, "NARROW_INT3": 0.05, "L1_INT": 0.05, "WIDE_INT": 0.15, "NARROW_FLOAT": 0.5, "FLOATCONV": 0.5,
    "PSRDIFF": 1.0, "WAAS": 1.0, "SINGLE": 3.0, "PROPAGATED": "missing", "NONE": "missing", "RTK fixed": 0.05,
    "RTK float": 0.5, "differential": 1.0, "GNSS": 3.0, "none": "missing", "dead reckoning": "missing"}
"""Usual standard deviations, m, of what satellite receivers call their fixes: to start from."""
UNITS = frozenset(unit for units in ROLES.values() for unit in units)
UNIX = ((6e8, 4e9, "s"), (6e11, 4e12, "ms"), (6e14, 4e15, "us"), (6e17, 4e18, "ns"))


@dataclass(frozen=True)
class Mapping:
    """A mapping to start from: map, role -> column with its unit; quality of a column of classes; why, by role, where
    something had to be supposed."""

    map: dict[str, str]
    quality: dict[str, float | str]
    why: dict[str, str]


def suggested(table: Table, balises: bool = False) -> Mapping:
    """Roles for a recording's columns; balises: whether there is a table of their places by name."""
    chosen: dict[str, str] = {}
    for name in table.names:
        role = _role(table, name, balises)
        if role == "wheel-a" and role in chosen:
            role = "wheel-b"
        if role and role not in chosen:
            chosen[role] = name
    if "position" in chosen or "reference_position" in chosen:
        for role in ("latitude", "longitude"):
            chosen.pop(role, None)
    if "position" not in chosen and not {"latitude", "longitude"} <= set(chosen):
        chosen.pop("position_sd", None)
    quality: dict[str, float | str] = {}
    if "position_sd" in chosen and not is_numeric(table, chosen["position_sd"]):
        words = [word for word in pc.unique(table.columns[chosen["position_sd"]]).to_pylist()
                 if word is not None and word.strip().lower() not in NONE - {"none"}]
        if set(words) <= set(CLASSES):
            quality = {word: CLASSES[word] for word in words}
        else:
            del chosen["position_sd"]
    return _with_units(table, chosen, quality, ("latitude", "longitude", *(["balise"] if balises else [])))


def _role(table: Table, name: str, balises: bool) -> str:
    """What a column looks like, "" for nothing."""
    bare = re.sub(r"\W*[\[(].*", "", name)
    head, _, unit = re.fullmatch(r"(?:(.+)(_|\sin\s))?(.*)", bare, re.DOTALL).groups()  # pyright: ignore
    words = [word for word in re.split(r"[^a-z0-9]+", (head if head and unit in UNITS else bare).lower()) if word]
    if balises and set(words) & set(WORDS["balise"]):
        return "balise"
    if not words or set(words) & NOT:
        return ""
    dated = not is_numeric(table, name)
    for role, known in WORDS.items():
        if not set(words) & set(known):
            continue
        if role == "time":
            if not dated or _is_time(table, name):
                return role
        elif role == "position_sd":
            if not dated or not is_text(table.columns[name]) or len(pc.unique(table.columns[name])) < 12:
                return role
        elif not dated:
            if set(words) & REFERENCE and role in ("position", "speed"):
                return f"reference_{role}"
            return role
    return ""


def _is_time(table: Table, name: str) -> bool:
    if pa.types.is_timestamp(table.columns[name].type):
        return True
    cells = [cell for cell in first_cells(table, name) if cell.strip()]
    return bool(cells) and all(re.match(r"\s*(\d{4}-\d\d-\d\d|\d{1,2}:\d\d:\d\d)", cell) for cell in cells)


def _with_units(table: Table, chosen: dict[str, str], quality: dict[str, float | str],
                plain: tuple[str, ...]) -> Mapping:
    """The columns with a unit where their names have none; plain: roles without one."""
    out, why = {}, dict[str, str]()
    for role, name in chosen.items():
        out[role] = name
        units = ROLES[role]
        known = table.units.get(name, "") in units or unit_in(name, units)
        if known or role in plain or (role == "position_sd" and quality):
            continue
        if role == "time":
            if is_numeric(table, name):
                try:
                    first = float(numbers(table, name, cells_of((), decimal_sign(table, [name])))[0])
                except ValueError:  # which is said where it is read
                    first = 0.0
                unit = next((unit for low, high, unit in UNIX if low < first < high), "s")
                out[role], why[role] = f"{name} [{unit}]", "supposed by its size" if unit != "s" or first > 6e8 else (
                    "supposed")
            continue
        out[role], why[role] = f"{name} [{next(iter(units))}]", "supposed: the name tells no unit"
    _fitted(table, out, why)
    return Mapping(dict(sorted(out.items(), key=lambda item: list(ROLES).index(item[0]))), quality, why)


def _fitted(table: Table, out: dict[str, str], why: dict[str, str]) -> None:
    """Units that had to be supposed, as they fit the other columns."""
    for role in [role for role in why if role in ("speed", "odometer", "reference_speed")]:
        try:
            for unit in ("m", "km") if role == "odometer" else ("m/s", "km/h", "mph", "kn"):
                name = out[role].rpartition(" [")[0]
                tried = {key: value for key, value in out.items() if key in (
                    "time", "latitude", "longitude", "position", "reference_position")} | {role: f"{name} [{unit}]"}
                found = read_recording(table.path, Meaning(tuple(sorted(tried.items())), order="sort",
                                                           duplicates="first"))
                columns = {"position": np.where(found.known["position"], found.position, np.nan),
                           role: found.speed if role == "reference_speed" else found.measured[role]}
                ratio, together = compared(found.time, way(found.time, columns, role), columns["position"])
                if together > 0.8 and abs(ratio - 1) < 0.15:
                    out[role], why[role] = f"{name} [{unit}]", f"its way is {ratio:.3g} times that of the position"
                    break
        except ValueError:
            continue


def described(table: Table, clock: str) -> pd.DataFrame:
    """Of each column its values, rate, longest gap, range and largest change from one value to the next. clock: the
    mapped time, "" where there is none."""
    try:
        decimal = decimal_sign(table, [name for name in table.names if is_numeric(table, name)])
    except ValueError:
        decimal = "."
    cells = cells_of((), decimal)
    time: Array | None = None
    if clock:
        try:
            time = seconds(table, find_column(table, "time", clock), clock, cells)[0]
        except ValueError:
            time = None
    rows = []
    for name in table.names:
        column = table.columns[name]
        row = {"column": name, "values": table.rows - column.null_count, "step s": "", "longest gap s": "", "from": "",
               "to": "", "largest change": ""}
        try:
            values = numbers(table, name, cells) if is_numeric(table, name) else None
        except ValueError as error:
            row["from"], values = str(error).rpartition(": ")[2], None
        if values is None:
            words = pc.unique(pc.cast(column, pa.string())).to_pylist()
            row["from"] = row["from"] or (", ".join(str(word)[:30] for word in words[:2]) + (
                f", .. ({len(words)})" if len(words) > 2 else ""))
        else:
            there = np.flatnonzero(np.isfinite(values))
            row["values"] = len(there)
            if len(there):
                row["from"], row["to"] = f"{values[there].min():.10g}", f"{values[there].max():.10g}"
            if len(there) > 1:
                row["largest change"] = f"{np.abs(np.diff(values[there])).max():.4g}"
                if time is not None:
                    steps = np.diff(time[there])
                    row["step s"], row["longest gap s"] = f"{np.nanmedian(steps):.4g}", f"{np.nanmax(steps):.4g}"
        rows.append(row)
    return pd.DataFrame(rows)
