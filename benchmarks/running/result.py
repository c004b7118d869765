"""The tables of a task: rows, curves and trajectories, also those of runs that were lost.

What a process of its own sends back is looked at before anybody relies on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from ...estimators.interface import Status
from ..planning.plan import Task

ROWS = {"scenario": pa.string(), "variant": pa.string(), "estimator": pa.string(), "run": pa.int32(),
        "status": pa.string(), "reason": pa.string(), "exception": pa.string(), "seconds": pa.float64()}
COUNTS = ("steps", "nees_states")
OTHERS = {"curves": {**dict.fromkeys(("scenario", "variant", "estimator", "quantity"), pa.string()),
                     "step": pa.int32(),
                     **dict.fromkeys(("time", "active", "squared", "fourth", "error", "floor"), pa.float64())},
          "kept": {**dict.fromkeys(("scenario", "variant", "estimator", "name"), pa.string()),
                   **dict.fromkeys(("run", "step"), pa.int32()),
                   **dict.fromkeys(("time", "truth", "estimate", "sd"), pa.float64())}}


@dataclass(frozen=True)
class Result:
    """Tables of a task: rows (one per estimator and run), curves (sums per step), kept trajectories (or None)."""

    task: Task
    rows: pa.Table
    curves: pa.Table | None
    kept: pa.Table | None


def joined(tables: Sequence[pa.Table]) -> pa.Table:
    """Tables one below the other, columns that one lacks left empty."""
    return pa.concat_tables(tables, promote_options="default")


def arrow_table(columns: dict[str, Any]) -> pa.Table:
    """A table of arrays of numbers and lists of texts. `pa.array` would import pandas, in every worker."""
    return pa.table({name: _column(values) for name, values in columns.items()})


def _column(values: Any) -> pa.Array:
    if isinstance(values, np.ndarray):
        return pa.Array.from_buffers(pa.from_numpy_dtype(values.dtype), len(values),
                                     [None, pa.py_buffer(np.ascontiguousarray(values))])
    if isinstance(values, list):
        n = len(values)
        if n and values.count(values[0]) == n:  # as most are
            text = values[0].encode()
            ends, data = len(text) * np.arange(n + 1, dtype=np.int32), n * text
        else:
            texts = [text.encode() for text in values]
            ends, data = np.cumsum([0, *map(len, texts)], dtype=np.int32), b"".join(texts)
        return pa.StringArray.from_buffers(n, pa.py_buffer(ends), pa.py_buffer(data))
    return values


def identity(task: Task, label: str, runs: Sequence[int]) -> dict[str, Any]:
    """The first columns of rows."""
    n = len(runs)
    return {"scenario": [task.cell.scenario] * n, "variant": [task.cell.variant] * n, "estimator": [label] * n,
            "run": np.array(runs, np.int32)}


def failed(task: Task, label: str, runs: Sequence[int], status: Status, reason: str, trace: str = "") -> pa.Table:
    """Rows of runs without numbers."""
    n = len(runs)
    return arrow_table({**identity(task, label, runs), "status": [status.name] * n, "reason": [reason] * n,
                        "exception": [trace] * n, "seconds": np.zeros(n)})


def lost(task: Task, status: Status, reason: str) -> Result:
    """The rows of a task whose process died or hung."""
    return Result(task, joined([failed(task, label, task.runs, status, reason) for label in task.labels]), None, None)


def sound(task: Task, found: Any) -> Result | None:
    """What a process of its own sent back of a task (see `execute_apart`), if it has the form of a result."""
    columns = {**ROWS, **dict.fromkeys(COUNTS, pa.int32())}
    if not isinstance(found, dict) or not _typed(found.get("rows"), columns, len(ROWS)):
        return None
    rows: pa.Table = found["rows"]
    extra = [name for name in rows.column_names if name not in ROWS and name not in COUNTS]
    if not all(name.count(":") == 2 and rows.schema.field(name).type == pa.float64() for name in extra):
        return None
    places = sorted(zip(*(rows[name].to_pylist() for name in list(ROWS)[:4]), strict=True), key=repr)
    asked = [(task.cell.scenario, task.cell.variant, label, run) for label in task.labels for run in task.runs]
    if places != sorted(asked, key=repr) or not set(rows["status"].to_pylist()) <= set(Status.__members__):
        return None
    for name, columns in OTHERS.items():
        table = found.get(name)
        if table is None:
            continue
        if not _typed(table, columns, len(columns)):
            return None
        if not {*zip(*(table[key].to_pylist() for key in ("scenario", "variant", "estimator")), strict=True)} <= {
                (task.cell.scenario, task.cell.variant, label) for label in (*task.labels, "")}:
            return None
    return Result(task, rows, found.get("curves"), found.get("kept"))


def _typed(table: Any, columns: dict[str, pa.DataType], needed: int) -> bool:
    """Whether this is a table with the first `needed` of the columns, full, and all those it has of their type."""
    if not isinstance(table, pa.Table):
        return False
    names = table.column_names
    return len(set(names)) == len(names) and set(list(columns)[:needed]) <= set(names) and all(
        table.schema.field(name).type == columns[name] for name in names if name in columns) and all(
        table[name].null_count == 0 for name in list(columns)[:needed])
