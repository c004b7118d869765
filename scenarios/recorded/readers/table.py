"""Reading a recorded trip: CSV or Parquet columns with their units, named by a map of roles, as SI arrays.

Whatever is wrong with the file gets one message that names it, the column and what is allowed."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np
import pandas as pd

from ...arrays import Array
from ...units import LENGTHS, SHARES, SPEEDS, TIMES

ROLES = {"time": TIMES, "position": LENGTHS, "speed": SPEEDS, "odometer": LENGTHS, "control": SHARES,
         "reference_position": LENGTHS, "reference_speed": SPEEDS}
STANDING, OFTEN = 1.0, 0.1
"""An odometer is coarse where it stands still at more than this share of the samples at which the train moves (m/s)."""


@dataclass(frozen=True)
class Recording:
    """time (N,) s, increasing; position, speed (N,): the reference; measured: the readings (N,), NaN where none.

    control (N,): the share of the greatest force that is asked for from each time on, None where it is not recorded.
    reference: in words, what position and speed are."""

    time: Array
    position: Array
    speed: Array
    measured: dict[str, Array] = field(repr=False)
    control: Array | None = field(repr=False, default=None)
    reference: str = ""

    @property
    def odometer_step(self) -> float:
        """The odometer's step in m: its usual increment where it often stands still while the train moves, else 0."""
        counted = self.measured["odometer"]
        there = np.isfinite(counted)
        increments = np.diff(counted[there])[self.speed[there][1:] > STANDING]
        coarse = increments.size and np.mean(increments == 0) > OFTEN and increments.max() > 0
        return float(np.median(increments[increments > 0])) if coarse else 0.0


def read_recording(path: str, columns: Mapping[str, str]) -> Recording:
    """The recording at `path`. Raises ValueError. A column is `name_unit` or `name [unit]`.

    The reference is `reference_position` and `reference_speed`; where they are not mapped, the measured columns are
    their own reference, and a reference speed that is in no column is the derivative of the reference position."""
    stamp = Path(path).stat().st_mtime_ns if Path(path).is_file() else 0
    return _read(path, tuple(sorted(columns.items())), stamp)


@lru_cache(maxsize=8)
def _read(path: str, columns: tuple[tuple[str, str], ...], stamp: int) -> Recording:
    table = _table(path)
    found: dict[str, Array] = {}
    for role, text in columns:
        if role not in ROLES:
            raise ValueError(f"map.{role}: no such role; allowed: {', '.join(ROLES)}")
        name, scale = _column(role, text)
        if name not in table.columns:
            raise ValueError(f"map.{role}: {path} has no column \"{name}\"; it has "
                             f"{', '.join(map(str, table.columns))}")
        found[role] = scale * _numbers(table[name], name, path)
    if "time" not in found or not {"position", "reference_position"} & set(found):
        raise ValueError(f"map: needs time and position (or reference_position), such as time=t_s,position=s_m; {path} "
                         f"has {', '.join(map(str, table.columns))}")
    time = found["time"]
    if len(time) < 3:
        raise ValueError(f"{path}: needs at least three rows, but has {len(time)}")
    if np.isnan(time).any():
        raise ValueError(f"{path}: the time is missing in row {int(np.isnan(time).argmax()) + 1}")
    back = np.flatnonzero(np.diff(time) <= 0)
    if len(back):
        raise ValueError(f"{path}: time must increase, but {time[back[0] + 1]:g} s follows {time[back[0]]:g} s (row "
                         f"{back[0] + 2})")
    position = found.get("reference_position", found.get("position", time))
    speed = found.get("reference_speed", found.get("speed", np.gradient(position, time)))
    named = dict(columns)
    reference = (f"position: {named['reference_position']}" if "reference_position" in found
                 else f"position: the reading {named['position']} itself") + "; speed: " + (
        named["reference_speed"] if "reference_speed" in found else f"the reading {named['speed']} itself"
        if "speed" in found else "the derivative of that position")
    for name, values in (("position", position), ("speed", speed)):
        gaps = np.flatnonzero(np.isnan(values))
        if len(gaps):
            raise ValueError(f"{path}: the reference {name} is missing in {len(gaps)} rows, first at "
                             f"{time[gaps[0]]:g} s: leave such rows out")
    measured = {role: found[role] for role in ("position", "speed", "odometer") if role in found}
    control = found.get("control")
    if control is not None and not np.abs(control).max() <= 1:
        raise ValueError(f"{path}: control {named['control']} is a share of the greatest force: -1 .. 1 in every row")
    counted = measured.get("odometer")
    if counted is not None and len(np.unique(counted[np.isfinite(counted)])) < 2:
        raise ValueError(f"{path}: the odometer {named['odometer']} never counts: it needs two different readings")
    return Recording(time, position, speed, measured, control, reference)


def _table(path: str) -> pd.DataFrame:
    try:
        table = pd.read_parquet(path) if path.endswith((".parquet", ".pq")) else pd.read_csv(path)
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:  # what pandas and pyarrow raise for text that is no table
        raise ValueError(f"{path}: not a {'Parquet' if path.endswith(('.parquet', '.pq')) else 'CSV'} table: "
                         f"{str(error).splitlines()[0]}") from None
    return table


def _column(role: str, text: str) -> tuple[str, float]:
    """Name and factor to SI of `name_unit` or `name [unit]`."""
    units = ROLES[role]
    explicit = re.fullmatch(r"(.*\S)\s*\[(.+)\]", text)
    name, unit = (explicit[1], explicit[2]) if explicit else (text, text.rpartition("_")[2])
    if unit not in units:
        raise ValueError(f"map.{role}: the unit of \"{text}\" is unknown; end the column's name in a unit (_"
                         f"{', _'.join(u for u in units if '/' not in u)}) or write \"{name} [{next(iter(units))}]\"; "
                         f"allowed: {', '.join(units)}")
    return name, units[unit]


def _numbers(column: pd.Series, name: str, path: str) -> Array:
    if column.dtype.kind in "bmM" or isinstance(column.dtype, pd.DatetimeTZDtype):
        raise ValueError(f"{path}: column \"{name}\" holds {column.dtype}: numbers are needed, times as seconds")
    values = pd.to_numeric(column, errors="coerce").to_numpy(dtype=float)
    bad = np.flatnonzero(~np.isfinite(values) & column.notna().to_numpy())
    if len(bad):
        raise ValueError(f"{path}: column \"{name}\" is not numeric: row {bad[0] + 1} has {column.iloc[bad[0]]!r}")
    return values
