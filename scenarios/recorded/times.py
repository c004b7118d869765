"""Times as seconds after a recording's first row: numbers with a unit, unix stamps, ISO 8601, times of day.

Zones are honoured, so that a clock change in the night is no jump; order and repeated stamps go by the scenario."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from typing import Literal

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from ..arrays import Array, Index
from .columns import Cells, Column, is_numeric, is_text, need_unit, numbers
from .readers import Table
from .readers.table import cause

ISO = r"^\d{4}-\d\d-\d\d([T ]\d\d:\d\d(:\d\d([.,]\d+)?)?)?\s*(Z|z|UTC|[-+]\d\d(:?\d\d)?)?$"
ZONE = r"(Z|z|UTC|\d:?\d\d[.,\d]*\s*[-+]\d\d(:?\d\d)?)$"
OF_DAY = r"^\d{1,2}:\d\d:\d\d([.,]\d+)?$"
HOUR, DAY = 3600.0, 86400.0
Order = Literal["refuse", "sort"]
Duplicates = Literal["refuse", "first", "mean"]


def seconds(table: Table, column: Column, text: str, cells: Cells) -> tuple[Array, str]:
    """Time (N,) in seconds after the first row, NaN where it is missing, and in words what kind it is. Raises
    ValueError."""
    values = table.columns[column.name]
    if pa.types.is_timestamp(values.type):
        ticks = pc.cast(values, pa.timestamp("ns", values.type.tz), safe=False)
        zone = "with zone" if values.type.tz else "without zone"
        return _since_first(pc.cast(ticks, pa.int64()), 1e-9), f"dates and times {zone}"
    if pa.types.is_integer(values.type):
        unit = need_unit("time", column, text)
        return _since_first(pc.cast(values, pa.int64()), unit), _kind(values, unit)
    if is_text(values) and not is_numeric(table, column.name):
        return _written(table, column.name, cells)
    unit = need_unit("time", column, text)
    found = numbers(table, column.name, cells)
    present = found[np.isfinite(found)]
    return unit * (found - (present[0] if len(present) else 0.0)), _kind(present[:1], unit)


def _since_first(ticks: pa.ChunkedArray, unit: float) -> Array:
    """Whole ticks as seconds after the first: subtracted before they become inexact."""
    there = ticks.is_valid().to_numpy()
    whole = pc.fill_null(ticks, 0).to_numpy()
    first = whole[there][0] if there.any() else 0
    return np.where(there, unit * (whole - first).astype(float), np.nan)


def _kind(values: Array | pa.ChunkedArray, unit: float) -> str:
    first = float(values[0].as_py() or 0) if isinstance(values, pa.ChunkedArray) else float(next(iter(values), 0.0))
    return "unix time" if 6e8 < first * unit < 4e9 else "seconds" if unit == 1.0 else f"units of {unit:g} s"


def _written(table: Table, name: str, cells: Cells) -> tuple[Array, str]:
    """Times written as texts: ISO 8601, or times of day."""
    written = pc.utf8_trim_whitespace(table.columns[name])
    lower = pc.utf8_lower(written)
    none = pc.is_in(lower, value_set=pa.array(["", "nat", "nan", "null", "none", "na", *sorted(cells.missing)]))
    written = pc.if_else(none, None, written)
    if pc.all(pc.fill_null(pc.match_substring_regex(written, OF_DAY), True)).as_py():
        return _of_day(written), "times of day"
    fits = pc.fill_null(pc.match_substring_regex(written, ISO), True)
    if not pc.all(fits).as_py():
        row = int(np.flatnonzero(~fits.to_numpy().astype(bool))[0])
        raise ValueError(f"{table.path}: time \"{name}\": row {row + 1} has {written[row].as_py()!r}; allowed: numbers "
                         "with a unit, or ISO 8601 such as 2025-03-01T08:03:37.255Z")
    zoned = pc.drop_null(pc.match_substring_regex(written, ZONE))
    some, every = bool(pc.any(zoned).as_py()), bool(pc.all(zoned).as_py())
    if some and not every:
        row = int(np.flatnonzero(~zoned.to_numpy().astype(bool))[0])
        raise ValueError(f"{table.path}: time \"{name}\": row {row + 1} has no zone, others have one")
    import pandas as pd

    plain = pc.replace_substring(pc.replace_substring_regex(written, r"\s*UTC$", "Z"), ",", ".")
    try:
        stamps = pd.to_datetime(plain.to_pandas(), format="ISO8601", utc=True)
    except (ValueError, OverflowError) as error:
        raise ValueError(f"{table.path}: time \"{name}\": {cause(error)}") from None
    ticks = pa.array(stamps.dt.as_unit("ns"), from_pandas=True)
    since = _since_first(pa.chunked_array([pc.cast(ticks, pa.int64())]), 1e-9)
    return since, "ISO 8601 with zone" if every else "ISO 8601 without zone"


def _of_day(written: pa.ChunkedArray) -> Array:
    """hh:mm:ss, of consecutive days where midnight is passed."""
    split = [None if text is None else text.replace(",", ".").split(":") for text in written.to_pylist()]
    found = np.array([np.nan if part is None else 3600 * int(part[0]) + 60 * int(part[1]) + float(part[2])
                      for part in split])
    there = np.flatnonzero(np.isfinite(found))
    days = np.cumsum(np.diff(found[there], prepend=found[there][:1]) < -DAY / 2)
    found[there] += DAY * days
    return found - found[there][0] if len(there) else found


def ordered(path: str, time: Array, order: Order, duplicates: Duplicates) -> tuple[Index, Index | None, list[str]]:
    """How to take rows so that time increases: the rows in their order, and for `duplicates = "mean"` the group (N,) of
    each of these rows; what was done, in words. Raises ValueError where rows are not in order, or repeat a stamp, and
    the scenario does not say what then."""
    missing = np.flatnonzero(np.isnan(time))
    if len(missing):
        raise ValueError(f"{path}: the time is missing in row {missing[0] + 1}" + (
            f" and {len(missing) - 1} more" if len(missing) > 1 else ""))
    rows, said = np.arange(len(time)), list[str]()
    steps = np.diff(time)
    back = np.flatnonzero(steps < 0)
    if len(back):
        k = back[0]
        why = ": order = \"sort\" sorts the rows"
        if abs(abs(steps[k]) - HOUR) < max(60.0, 5 * float(np.median(np.abs(steps)))):
            why = ": an hour back (a clock change? times with a zone would not jump)"
        if order == "refuse":
            raise ValueError(f"{path}: time must increase, but {time[k + 1]:.9g} s follows {time[k]:.9g} s (row "
                             f"{k + 2}; {len(back)} such places){why}")
        rows = np.argsort(time, kind="stable")
        said.append(f"{len(back)} places where the time goes back, sorted (the first at row {k + 2})")
    same = np.diff(time[rows]) == 0
    if not same.any():
        return rows, None, said
    place = int(same.argmax())
    if duplicates == "refuse":
        raise ValueError(f"{path}: time must increase, but {time[rows[place]]:.9g} s stands twice (row "
                         f"{rows[place + 1] + 1}; {int(same.sum())} rows repeat a time): duplicates = \"first\" or "
                         "\"mean\" takes one")
    said.append(f"{int(same.sum())} rows repeat a time: {'the first is' if duplicates == 'first' else 'their mean is'} "
                "taken")
    if duplicates == "first":
        return rows[np.concatenate([[True], ~same])], None, said
    return rows, np.concatenate([[0], np.cumsum(~same)]), said
