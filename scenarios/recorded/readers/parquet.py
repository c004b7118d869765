"""Parquet tables. Types are the file's own; pandas' index without a name is called `index`.

Nested columns are left out, since no role can be one."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from .table import INDEX, Table, cause


def read_parquet(path: Path) -> Table:
    """The columns of a Parquet file. Raises ValueError."""
    try:
        found = pq.ParquetFile(path).read()
    except (pa.ArrowException, OSError, ValueError, KeyError) as error:
        raise ValueError(f"{path}: not a Parquet table: {cause(error)}") from None
    names = [str(name) for name in found.column_names]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"{path}: two columns are called \"{twice[0]}\": names must differ")
    flat = [name for name in names if not pa.types.is_nested(found.schema.field(name).type)]
    found = found.select(flat)
    if INDEX in flat and "index" not in flat:
        found = found.rename_columns(["index" if name == INDEX else name for name in flat])
    return Table(str(path), found, "Parquet")
