"""A recording's columns as a file has them, before anything is known of what they mean.

Texts stay texts until a role is mapped to them: what a number is depends on the whole file (decimal commas)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa

from ...arrays import Array

INDEX = "__index_level_0__"
"""What pandas calls an index without a name in a Parquet file."""


@dataclass(frozen=True)
class Table:
    """columns: by name, of one length; texts as written, or typed where the format has types. units: of columns whose
    format tells them. said: how the file was read, for the user."""

    path: str
    columns: pa.Table = field(repr=False)
    said: str
    units: Mapping[str, str] = field(default_factory=dict)

    @property
    def names(self) -> list[str]:
        return [str(name) for name in self.columns.column_names]

    @property
    def rows(self) -> int:
        return int(self.columns.num_rows)


def cause(error: Exception) -> str:
    """The first line of what a package says of a file, "" where it says nothing."""
    return next(iter(str(error).splitlines()), "")


def table_of(path: str, columns: Mapping[str, Array | list[str]], said: str,
             units: Mapping[str, str] | None = None) -> Table:
    """A table from arrays of one length; NaN where a column has no value."""
    made = {name: pa.array(values, from_pandas=True) for name, values in columns.items()}
    return Table(path, pa.table(made), said, units or {})


def joined(path: str, series: Mapping[str, tuple[Array, Array]], clock: str, said: str,
           units: Mapping[str, str] | None = None) -> Table:
    """One row per stamp of several series {name: (stamps (n,), values (n,))}, each on its own clock ticks; `clock` is
    the column of the stamps. Where a series has no value at a stamp, or several, the row has none, or the last."""
    stamps = np.unique(np.concatenate([stamp for stamp, _ in series.values()])) if series else np.zeros(0)
    columns: dict[str, Array | list[str]] = {clock: stamps}
    for name, (stamp, values) in series.items():
        column = np.full(len(stamps), np.nan)
        column[np.searchsorted(stamps, stamp)] = values
        columns[name] = column
    return table_of(path, columns, said, units)
