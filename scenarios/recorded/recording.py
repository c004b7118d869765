"""A recorded trip as SI arrays: a table's columns by their roles, in order of time, each value where there is one.

What a file is to mean (`Meaning`) comes from the scenario; whatever is wrong gets one message that names the place."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np
import pyarrow as pa

from ..arrays import Array, Index, Mask
from .checks import Finding, examine
from .columns import (
    Column,
    cells_of,
    classed,
    decimal_sign,
    find_column,
    first_cells,
    is_numeric,
    need_unit,
    numbers,
)
from .counters import step_of, unwound
from .readers import Table, read
from .times import Duplicates, Order, ordered, seconds
from .wheels import balises_in, passages, placed, together

MEASURED = ("position", "speed", "odometer", "wheel-a", "wheel-b", "balise")
SENSORS = (*MEASURED, "acceleration")
KEPT = 200_000
"""Tables of more rows than this are not kept in memory for the next who asks."""
COUNTERS = ("odometer", "wheel-a", "wheel-b")
PLACES = ("position", "reference_position", "balise")
REFERENCE_SD = 10.0
"""m; a reading that says it is worse than this is no reference for others."""


@dataclass(frozen=True)
class Meaning:
    """What a scenario says of a recording: map, role -> column; missing, values that stand for none; quality, a class
    -> m or NaN for no reading; order and duplicates of stamps; wrap m of the odometer; track, a GeoJSON file; span
    (from, to) and without ((from, to), ..) in s after the first row; balises, places in m by name or a file of such."""

    map: tuple[tuple[str, str], ...]
    missing: tuple[str | float, ...] = ()
    quality: tuple[tuple[str, float], ...] = ()
    order: Order = "refuse"
    duplicates: Duplicates = "refuse"
    wrap: float | None = None
    track: str | None = None
    span: tuple[float, float] | None = None
    without: tuple[tuple[float, float], ...] = ()
    balises: str | tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class Recording:
    """time (N,) s after the file's first row, increasing. measured: the readings (N,), NaN where none, of wheels and
    odometer their counts in m; told: standard deviations (N,) of those that say how good they are, NaN where one does
    not.

    position, speed (N,): the reference, filled between its values; known: where there is one (N,). apart: whether the
    reference of position and of speed is a column of its own. control (N,): the share of the greatest force that is
    asked for from each time on. reference: in words, what position and speed are. said: how the file was read, and
    what was done. findings: what is odd or cannot be."""

    path: str
    time: Array = field(repr=False)
    position: Array = field(repr=False)
    speed: Array = field(repr=False)
    known: Mapping[str, Mask] = field(repr=False)
    apart: Mapping[str, bool]
    measured: Mapping[str, Array] = field(repr=False)
    told: Mapping[str, Array] = field(repr=False)
    control: Array | None = field(repr=False)
    reference: str
    said: tuple[str, ...]
    findings: tuple[Finding, ...]

    @property
    def own(self) -> str:
        """The reading that is the position's reference where no column of its own is: of satellites, or balises."""
        return "position" if "position" in self.measured else "balise"

    @property
    def odometer_step(self) -> float:
        """The odometer's step in m, 0 for a fine one."""
        if "odometer" not in self.measured:
            return 0.0
        return step_of(self.measured["odometer"], self.measured.get("speed", self.speed))


def read_recording(path: str, meaning: Meaning) -> Recording:
    """The recording at `path`. Raises ValueError.

    The reference is `reference_position` and `reference_speed`; where they are not mapped, the measured columns are
    their own reference, and a reference speed that is in no column is the derivative of the reference position."""
    beside = [file for file in (meaning.track, meaning.balises) if isinstance(file, str)]
    return _recording(path, meaning, _stamp(path), max(map(_stamp, beside), default=0))


def table_at(path: str) -> Table:
    """The columns of a file, kept for the next who asks as long as the file stays as it is. Raises ValueError."""
    return _table(path, _stamp(path))


def _stamp(path: str) -> int:
    found = Path(path)
    inside = [found, *found.rglob("*")] if found.is_dir() else [found]
    return max((os.stat(one).st_mtime_ns for one in inside if one.exists()), default=0)


@lru_cache(maxsize=4)
def _table(path: str, stamp: int) -> Table:
    return read(path)


@lru_cache(maxsize=16)
def _recording(path: str, meaning: Meaning, stamp: int, beside: int) -> Recording:
    table = _table(path, stamp)
    columns = {role: find_column(table, role, text) for role, text in meaning.map}
    _enough(path, columns, table)
    time, kind, found, told, decimal = _values(table, columns, meaning)
    said = [f"read as: {table.said}{', decimal commas' if decimal == ',' else ''}; time: {kind}"]
    large = table.rows > KEPT
    del table, columns
    if large:
        _table.cache_clear()
        pa.default_memory_pool().release_unused()
    rows, groups, done = ordered(path, time, meaning.order, meaning.duplicates)
    said += done
    if done:
        time, found, told = time[rows], _taken(found, rows), _taken(told, rows)
    if groups is not None:
        time = time[np.unique(groups, return_index=True)[1]]
        found, told = ({role: _means(values, groups) for role, values in part.items()} for part in (found, told))
    if {"latitude", "longitude"} & set(found):
        from .places import along
        latitude, longitude = found.pop("latitude"), found.pop("longitude")
        place, across, line = along(latitude, longitude, told.get("position"), meaning.track, path)
        found["position"], found["across"] = place, across
        said.append(f"position: latitude and longitude along {line}, at most {np.nanmax(across):.3g} m beside it")
    for name in COUNTERS:
        if name in found:
            found[name], done = unwound(path, time, found[name], meaning.wrap, name)
            said += done
    keep = _kept(time, meaning, path)
    if not keep.all():
        said.append(f"{len(time) - keep.sum()} of {len(time)} rows left out (from, to, without)")
        time, found, told = time[keep], _taken(found, keep), _taken(told, keep)
    if len(time) < 3:
        raise ValueError(f"{path}: needs at least three rows, but has {len(time)}")
    together(path, found, said)
    if "balise" in found:
        found["balise"] = passages(found["balise"], said)
    return _assembled(path, time, found, told, dict(meaning.map), said)


def _enough(path: str, columns: Mapping[str, Column], table: Table) -> None:
    places = {"position", "reference_position", "balise"} & set(columns)
    fix = {"latitude", "longitude"} & set(columns)
    if len(fix) == 1:
        raise ValueError(f"map: latitude and longitude go together, but {path} has only {fix.pop()} mapped")
    if fix and "position" in columns:
        raise ValueError("map: position, or latitude and longitude, not both")
    if "time" not in columns or not (places or fix):
        raise ValueError(f"map: needs time and position (or reference_position, or latitude and longitude), such as "
                         f"time=t_s,position=s_m; {path} has {', '.join(table.names)}")
    for role in ("position", "speed", "odometer", "balise"):
        if f"{role}_sd" in columns and role not in columns and not (role == "position" and fix):
            raise ValueError(f"map.{role}_sd: says how good {role} is, which is not mapped")


def _values(table: Table, columns: Mapping[str, Column], meaning: Meaning) -> tuple[
        Array, str, dict[str, Array], dict[str, Array], str]:
    """Time and in words its kind, the columns of the roles and the told standard deviations in SI, the decimal sign."""
    texts, classes = dict(meaning.map), dict(meaning.quality)
    told: dict[str, Array] = {}
    numeric = dict(columns)
    for role in [role for role in columns if role.endswith("_sd")]:
        if not classes and is_numeric(table, columns[role].name):
            continue
        deviations = classed(table, columns[role].name, classes)
        if deviations is not None:
            told[role.removesuffix("_sd")] = deviations
            del numeric[role]
    lost = {sensor: np.isnan(deviations) for sensor, deviations in told.items()}
    time = numeric.pop("time")
    written = [column.name for role, column in (*numeric.items(), ("time", time))
               if not (role == "balise" and meaning.balises)]
    decimal = decimal_sign(table, [name for name in dict.fromkeys(written) if not _dated(table, name)])
    cells = cells_of(meaning.missing, decimal)
    stamps, kind = seconds(table, time, texts["time"], cells)
    found: dict[str, Array] = {}
    for role, column in numeric.items():
        if role == "balise" and meaning.balises:
            places = (balises_in(table_at(meaning.balises)) if isinstance(meaning.balises, str)
                      else dict(meaning.balises))
            found[role] = placed(table, column.name, places)
            continue
        values = need_unit(role, column, texts[role]) * numbers(table, column.name, cells)
        if role.endswith("_sd"):
            if np.nanmin(values, initial=1.0) < 0:
                raise ValueError(f"{table.path}: column \"{column.name}\" is a standard deviation, but row "
                                 f"{int(np.nanargmin(values)) + 1} has {np.nanmin(values):g}")
            told[role.removesuffix("_sd")] = np.where(values > 0, values, np.nan)
        else:
            found[role] = values
    for sensor, gone in lost.items():
        for role in (("latitude", "longitude") if sensor == "position" and "latitude" in found else (sensor,)):
            found[role] = np.where(gone, np.nan, found[role])
    return stamps, kind, found, told, decimal


def _dated(table: Table, name: str) -> bool:
    first = next((text for text in first_cells(table, name) if text), "")
    return ":" in first or first.count("-") > 1


def _taken(columns: Mapping[str, Array], rows: Index | Mask) -> dict[str, Array]:
    return {role: values[rows] for role, values in columns.items()}


def _means(values: Array, groups: Index) -> Array:
    """Mean of each group of rows, over the values there are; NaN where there are none."""
    there = np.isfinite(values)
    total = np.bincount(groups, np.where(there, values, 0.0))
    count = np.bincount(groups, there)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _kept(time: Array, meaning: Meaning, path: str) -> Mask:
    keep = np.ones(len(time), dtype=bool)
    if meaning.span is not None:
        keep &= (time >= meaning.span[0]) & (time <= meaning.span[1])
    for begin, end in meaning.without:
        keep &= (time < begin) | (time > end)
    if not keep.any():
        raise ValueError(f"{path}: from, to and without leave no row of the {time[-1]:g} s that there are")
    return keep


def _assembled(path: str, time: Array, found: dict[str, Array], told: dict[str, Array], named: Mapping[str, str],
               said: list[str]) -> Recording:
    """The recording from its columns in SI, from the first position reading on. Raises ValueError."""
    start = next((role for role in PLACES if role in found), "")
    if start and start != "reference_position" and np.isfinite(found[start]).any():
        first = int(np.isfinite(found[start]).argmax())
        if first:
            said.append(f"begins at t = {time[first]:.6g} s, with the first {start} ({first} rows before it left out)")
            time = time[first:]
            found, told = ({role: values[first:] for role, values in part.items()} for part in (found, told))
    measured = {role: found[role] for role in SENSORS if role in found}
    for role, values in found.items():
        if role != "across" and not np.isfinite(values).any():
            raise ValueError(f"{path}: {role} ({named.get(role, '')}) has no value in any row")
    apart = {"position": "reference_position" in found, "speed": "reference_speed" in found}
    own = "position" if "position" in found else "balise"  # its own reference where there is no other
    place = found["reference_position"] if apart["position"] else found[own]
    known = {"position": np.isfinite(place)}
    if not apart["position"] and own in told:
        vague = np.nan_to_num(told[own]) > REFERENCE_SD
        if (vague & known["position"]).any():
            said.append(f"{int((vague & known['position']).sum())} positions that tell more than {REFERENCE_SD:g} m "
                        "are readings, but no reference")
        known["position"] &= ~vague
    if known["position"].sum() < 3:
        raise ValueError(f"{path}: the reference position has {known['position'].sum()} values; at least three are "
                         "needed")
    pace = found.get("reference_speed", found.get("speed"))
    derived = pace is None
    if pace is None:
        pace = np.full(len(time), np.nan)
        where = known["position"]
        pace[where] = np.gradient(place[where], time[where])
        apart["speed"] = apart["position"]
    known["speed"] = np.isfinite(pace)
    at = named.get(own, "latitude and longitude")
    reference = (f"position: {named['reference_position']}" if apart["position"] else
                 f"position: the reading {at} itself") + "; speed: " + (
        named["reference_speed"] if "reference_speed" in found else f"the reading {named['speed']} itself"
        if not derived else "the derivative of that position")
    filled = {name: np.interp(time, time[known[name]], values[known[name]])
              for name, values in (("position", place), ("speed", pace))}
    control = found.get("control")
    if control is not None and not np.abs(control).max() <= 1:
        raise ValueError(f"{path}: control {named['control']} is a share of the greatest force: -1 .. 1 in every row")
    counted = measured.get("odometer")
    if counted is not None and len(np.unique(counted[np.isfinite(counted)])) < 2:
        raise ValueError(f"{path}: the odometer {named['odometer']} never counts: it needs two different readings")
    return Recording(path, time, filled["position"], filled["speed"], known, apart, measured, told, control, reference,
                     tuple(said), tuple(examine(time, found, told)))
