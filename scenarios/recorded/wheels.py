"""Wheels and balises of a recording: what wheels rolled between their readings, which balises were passed and when.

A counter goes on while nobody hears it; a column that holds the last balise is one passage for each change."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from ..arrays import Array, Mask
from .columns import NONE, Cells, find_column, need_unit, numbers
from .readers import Table

WHEELS = ("wheel-a", "wheel-b")
SMOOTHED = 0.5
"""The wheels' speeds that dead reckoning is told are means over at least this, s."""
EVENT = 1.5
"""A row without a count lies inside a step of the counters where the counts around it are at most so many usual steps
apart; in a longer gap they stand still until they are heard again."""
COASTING = 0.1
"""m/s^2; under it a train without a recorded control neither drives nor brakes."""
FINEST = 1e-4
"""m; counters are taken to count in whole multiples of this."""


def together(path: str, found: dict[str, Array], said: list[str]) -> None:
    """Wheels are heard where all have a count. Raises ValueError where they seldom do."""
    wheels = [name for name in WHEELS if name in found]
    if not wheels:
        return
    there = np.all([np.isfinite(found[name]) for name in wheels], axis=0)
    lone = int(np.any([np.isfinite(found[name]) & ~there for name in wheels], axis=0).sum())
    if there.sum() < 3:
        raise ValueError(f"{path}: {' and '.join(wheels)} have {there.sum()} rows in which all have a count; at least "
                         "three are needed")
    for name in wheels:
        found[name] = np.where(there, found[name], np.nan)
        if len(np.unique(found[name][there])) < 2:
            raise ValueError(f"{path}: {name} never counts: it needs two different readings")
    if lone:
        said.append(f"{lone} rows have a count of one wheel only: taken with the next of both")


def placed(table: Table, name: str, places: Mapping[str, float]) -> Array:
    """A column of balises' names as their places (N,) in m, NaN where none was passed. Raises ValueError naming those
    without a place."""
    column = table.columns[name]
    if pa.types.is_floating(column.type):
        column = pc.cast(column, pa.int64(), safe=False)
    column = pc.utf8_trim_whitespace(pc.cast(column, pa.string()))
    words = [word for word in pc.unique(column).to_pylist() if word is not None and word.lower() not in NONE]
    unknown = [word for word in words if word not in places]
    if unknown:
        raise ValueError(f"plant.balises: {table.path} has {', '.join(unknown[:6])} in \"{name}\" without a place "
                         f"(m); {len(places)} balises have one")
    at = pc.index_in(column, value_set=pa.array(list(places), pa.string()))
    return np.array([*places.values(), np.nan])[pc.fill_null(at, len(places)).to_numpy()]


def balises_in(table: Table) -> dict[str, float]:
    """Places in m by the name of each balise, from a file of two columns: `name` and `position`, with its unit. Raises
    ValueError."""
    column = next((name for name in table.names if name.lower().startswith(("position", "s_", "km"))), "")
    names = [name for name in table.names if name != column]
    if len(table.names) != 2 or not column:
        raise ValueError(f"plant.balises: {table.path} needs two columns, a name and a position with its unit "
                         f"(position_m, position [km]); it has {', '.join(table.names)}")
    where = need_unit("balise", find_column(table, "balise", column), column) * numbers(table, column, Cells())
    words = [str(word).strip() for word in pc.cast(table.columns[names[0]], pa.string()).to_pylist()]
    twice = [word for word in dict.fromkeys(words) if words.count(word) > 1]
    if twice or not np.isfinite(where).all():
        raise ValueError(f"plant.balises: {table.path}: " + (f"\"{twice[0]}\" stands twice" if twice else
                                                            "a balise has no place"))
    return dict(zip(words, where.tolist(), strict=True))


def passages(place: Array, said: list[str]) -> Array:
    """A balises' column (N,) with each passage once, where it begins; a value that is held is said."""
    there = np.flatnonzero(np.isfinite(place))
    held = [b for a, b in pairwise(there) if b == a + 1 and place[a] == place[b]]
    if held:
        said.append(f"{len(held)} rows repeat the balise of the row before: taken as one passage")
    out = place.copy()
    out[held] = np.nan
    return out


def counted(trip_time: Array, counts: Array) -> tuple[Array, Mask, Mask]:
    """Of a counter (N,), for each of the N - 1 steps: the distance since the last reading before (m, 0 where none ends
    it), whether one ends it, and whether one stands where it begins."""
    there = np.isfinite(counts)
    rows = np.flatnonzero(there)
    distance, ends = np.zeros(len(trip_time) - 1), np.zeros(len(trip_time) - 1, dtype=bool)
    distance[rows[1:] - 1], ends[rows[1:] - 1] = np.diff(counts[rows]), True
    begins = there[:-1].copy()
    begins[0] = True
    return distance, ends, begins


def step_of(counts: Array) -> float:
    """The step in m that a counter (N,) counts in: what all its increments are multiples of, to a tenth of a mm."""
    increments = np.diff(counts[np.isfinite(counts)])
    return FINEST * float(np.gcd.reduce(np.round(increments / FINEST).astype(np.int64)))


def told(time: Array, counts: Sequence[Array], heard: Sequence[Mask], there: Mask, reading: Array,
         control: Array | None) -> Array:
    """The inputs (K, 7, S) of `railway.odometer.INPUTS`. counts (N, S) of one or two wheels, heard (N, S) where they
    are; there (N,): rows with a count; reading (K, S) m/s^2: the accelerometer's mean over each step, 0 without one;
    control (K,)."""
    rows = np.flatnonzero(there)
    back = np.minimum(np.searchsorted(time[rows], time[rows] - SMOOTHED + 1e-9, side="right") - 1,
                      np.arange(len(rows)) - 1).clip(0)
    spans = (time[rows] - time[rows[back]])[:, None]
    distance, speed = [], []
    # rows of events between two counts share what was rolled between these, by time, as parts of a step do
    after = np.searchsorted(rows, np.arange(len(time)), side="right").clip(1, len(rows) - 1)
    a, b = rows[after - 1], rows[after]
    inside = np.flatnonzero((a < np.arange(len(time))) & (np.arange(len(time)) < b) & (
        time[b] - time[a] <= EVENT * np.median(np.diff(time[rows]))))
    a, b = a[inside], b[inside]
    part = ((time[inside] - time[a]) / (time[b] - time[a]))[:, None]
    for values, got in zip(counts, heard, strict=True):
        values, got = values.copy(), got.copy()
        values[inside], got[inside] = values[a] + part * (values[b] - values[a]), got[a] & got[b]
        distance.append(np.diff(held(np.where(got, values, np.nan)), axis=0))
        late = np.full(values.shape, np.nan)
        late[rows] = np.where(spans > 0, (values[rows] - values[rows[back]]) / np.where(spans > 0, spans, 1.0), 0.0)
        speed.append(held(np.where(got, late, np.nan))[1:])
    effort = (np.where(np.abs(reading) < COASTING, 0.0, reading) if control is None
              else np.broadcast_to(control[:, None], reading.shape))
    begins = there[:-1].astype(float)
    begins[0] = 1.0
    return np.stack([reading, effort, np.broadcast_to(begins[:, None], reading.shape), distance[0], distance[-1],
                     speed[0], speed[-1]], axis=1)


def held(values: Array) -> Array:
    """Missing readings (N, S) filled with the last one before them, or with the first one there is."""
    there = np.isfinite(values)
    last = np.maximum.accumulate(np.where(there, np.arange(len(values))[:, None], there.argmax(axis=0)), axis=0)
    return np.nan_to_num(np.take_along_axis(values, last, axis=0))
