"""The tables of a results folder, part by part: columns brought to their types, rows unique, sums taken as they come.

A part of `rows` is written last and says what counts: curves and trajectories of estimators without rows in the part
of the same name do not."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from ...estimators.interface import Status
from ...scenarios.errors import InputError
from ..scoring.columns import IDENTITY

if TYPE_CHECKING:
    import pandas as pd

CURVES = ("scenario", "variant", "estimator", "quantity", "step", "time")
SUMS = ("active", "squared", "fourth", "error", "floor")
"""Sums over runs; `floor`, of the least mean squares, is NaN where there is none, and parts without it are read."""
TRAJECTORIES = (*IDENTITY, "step", "time", "name", "truth", "estimate", "sd")
NEEDED = {"rows": (*IDENTITY, "status", "reason", "exception", "seconds"), "curves": (*CURVES, *SUMS[:4]),
          "trajectories": TRAJECTORIES}
"""Columns that every part of a kind has."""
_WORDS = ("scenario", "variant", "estimator", "status", "reason", "exception", "quantity", "name")
_COUNTS = ("run", "step", "steps", "nees_states")


def part_paths(folder: Path, kind: str) -> list[Path]:
    """The parts of a kind that count."""
    rows = {path.name for path in (folder / "rows").glob("*.parquet")}
    return [path for path in sorted((folder / kind).glob("*.parquet")) if path.name in rows]


def read_part(path: Path, kind: str, columns: Sequence[str] | None = None) -> pa.Table:
    """A part with its columns in their types, whoever wrote it. Raises InputError where it is damaged."""
    try:
        if path.exists() and not path.is_file():
            raise ValueError("no file")
        coded = [] if kind == "rows" else [name for name in pq.read_schema(path).names if name in _WORDS]
        found = pq.ParquetFile(path, read_dictionary=coded).read(None if columns is None else list(columns))
        missing = [name for name in columns or NEEDED[kind] if name not in found.column_names]
        if missing:
            raise ValueError(f"no column {missing[0]}")
        if len(set(found.column_names)) < found.num_columns:
            raise ValueError("a column stands in it twice")
        found = pa.table({name: _typed(name, found[name]) for name in found.column_names
                          if not name.startswith("__index_level")})
        found.validate(full=True)
        return found
    except PermissionError:
        raise InputError(f"{path}: may not be read") from None
    except (pa.ArrowException, OSError, ValueError, TypeError, KeyError, OverflowError) as error:
        said = (str(error) or type(error).__name__).splitlines()[0][:200]
        raise InputError(f"{path}: damaged ({said}); remove it and run again: only its rows are computed anew"
                         ) from None


def _typed(name: str, column: pa.ChunkedArray) -> pa.ChunkedArray:
    metric = name.count(":") == 2
    number = metric or name in (*SUMS, *TRAJECTORIES[5:6], *TRAJECTORIES[7:], "seconds")
    wanted = (pa.string() if name in _WORDS else pa.int32() if name in _COUNTS else pa.float64() if number else None)
    if wanted is None:
        if pa.types.is_nested(column.type):
            raise ValueError(f"{name}: holds {column.type}")
        return column
    if (wanted == pa.string()) != _textual(column.type) and not pa.types.is_null(column.type):
        raise ValueError(f"{name}: holds {column.type}, not {wanted}")
    if (name in _WORDS or name in ("run", "step")) and column.null_count:
        raise ValueError(f"{name}: lacks values")
    if pa.types.is_dictionary(column.type) and column.type.value_type == pa.string():
        return column.unify_dictionaries()
    return column if column.type == wanted else column.cast(wanted)


def _textual(kind: pa.DataType) -> bool:
    return (pa.types.is_string(kind) or pa.types.is_large_string(kind) or pa.types.is_string_view(kind)
            or (pa.types.is_dictionary(kind) and _textual(kind.value_type)))


def read_rows(folder: Path, cells: Mapping[str, Any], columns: Sequence[str] | None = None) -> pa.Table | None:
    """All rows, each once, of what the manifest knows; None where there are none. cells: the manifest's
    `configuration.cells`. Raises InputError where parts are damaged, hold a row twice, or what is not the folder's."""
    paths = part_paths(folder, "rows")
    if not paths:
        return None
    tables = []
    for path in paths:
        table = read_part(path, "rows", columns)
        _known(path, table, cells)
        tables.append(table)
    whole = pa.concat_tables(tables, promote_options="default")
    counts = whole.select(IDENTITY).group_by(list(IDENTITY)).aggregate([([], "count_all")])
    twice = counts.filter(pc.field("count_all") > 1)
    if twice.num_rows:
        first = twice.slice(0, 1).to_pylist()[0]
        key = "/".join(str(first[name]) for name in IDENTITY)
        held = [path.name for path, table in zip(paths, tables, strict=True) if _holds(table, first)]
        raise InputError(f"{folder}: holds {twice.num_rows} rows more than once, {key} first, in rows/"
                         f"{' and rows/'.join(held)}; remove all of these but one and run again")
    return whole


def _holds(table: pa.Table, row: Mapping[str, Any]) -> bool:
    here = [pc.field(name) == row[name] for name in IDENTITY]
    return table.filter(here[0] & here[1] & here[2] & here[3]).num_rows > 0


def _known(path: Path, table: pa.Table, cells: Mapping[str, Any]) -> None:
    """Raises InputError for rows of cells, estimators, runs or statuses that the manifest does not have."""
    names = table.select(IDENTITY).group_by(list(IDENTITY[:3])).aggregate([("run", "min"), ("run", "max")])
    for item in names.to_pylist():
        cell = cells.get(f"{item['scenario']}/{item['variant']}", {"estimators": {}, "runs": 0})
        label = "/".join(item[name] for name in IDENTITY[:3])
        if item["estimator"] not in cell["estimators"]:
            raise InputError(f"{path}: holds rows of {label[:200]!r}, which manifest.json does not know; remove it")
        if not 0 <= item["run_min"] <= item["run_max"] < cell["runs"]:
            raise InputError(f"{path}: holds run {item['run_max']} of {label}, which has {cell['runs']}; remove it")
    if "status" in table.column_names:
        odd = set(table["status"].unique().to_pylist()) - {status.name for status in Status}
        if odd:
            raise InputError(f"{path}: damaged (status {sorted(odd)[0][:80]!r}; allowed: "
                             f"{', '.join(status.name for status in Status)}); remove it and run again")


def read_curves(folder: Path) -> pd.DataFrame:
    """Sums over all runs per scenario, variant, estimator, quantity and step, columns `CURVES` and `SUMS`: one part is
    held at a time."""
    import pandas as pd

    sums: dict[tuple[str, ...], np.ndarray] = {}
    for path in part_paths(folder, "curves"):
        table = _counting(read_part(path, "curves"), folder / "rows" / path.name)
        for key, part in _curves_of(table):
            before = sums.get(key)
            sums[key] = part if before is None else _added(before, part)
        del table
        pa.default_memory_pool().release_unused()
    keys, lengths = list(sums), [part.shape[1] for part in sums.values()]
    columns: dict[str, Any] = {}
    for place, name in enumerate(CURVES[:4]):
        columns[name] = pd.Categorical(np.repeat(np.array([key[place] for key in keys], dtype=object), lengths))
    values = np.concatenate(list(sums.values()), axis=1) if sums else np.empty((7, 0))
    columns.update(zip((*CURVES[4:], *SUMS), (values[0].astype(np.int32), *values[1:]), strict=True))
    return pd.DataFrame(columns, columns=[*CURVES, *SUMS])


def _curves_of(table: pa.Table) -> Iterator[tuple[tuple[str, ...], np.ndarray]]:
    """(scenario, variant, estimator, quantity) and, sorted by step, step, time and the sums (7, K) of a part."""
    code, names = codes(table, CURVES[:4])
    none = np.full(table.num_rows, np.nan)
    values = np.array([table[name].to_numpy() if name in table.column_names else none
                       for name in (*CURVES[4:], *SUMS)], dtype=float)
    order = np.argsort(code, kind="stable")
    if ((np.diff(values[0][order]) < 0) & (np.diff(code[order]) == 0)).any():
        order = np.lexsort((values[0], code))
    code, values = code[order], values[:, order]
    new = np.flatnonzero(np.r_[True, (np.diff(code) != 0) | (np.diff(values[0]) != 0)]) if len(code) else []
    if len(new) < len(code):  # a step stands in it several times: blocks of runs
        values = np.vstack([values[:2, new], np.add.reduceat(values[2:], new, axis=1)])
        code = code[new]
    edges = np.searchsorted(code, np.arange(len(names) + 1))
    for number, name in enumerate(names):
        yield name, values[:, edges[number]:edges[number + 1]]


def _added(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Sums of two parts, of which either may have steps that the other has not."""
    if np.array_equal(a[0], b[0]):
        return np.vstack([a[:2], a[2:] + b[2:]])
    steps = np.union1d(a[0], b[0])
    out = np.zeros((len(a), len(steps)))
    out[0] = steps
    for part in (a, b):
        where = np.searchsorted(steps, part[0])
        out[1, where] = part[1]
        out[2:, where] += part[2:]
    return out


def codes(table: pa.Table, names: Sequence[str]) -> tuple[np.ndarray, list[tuple[str, ...]]]:
    """A number for each line's combination of words, and the combinations by number."""
    whole = np.zeros(table.num_rows, dtype=np.int64)
    words: list[list[str]] = []
    for name in names:
        column = table[name].combine_chunks()
        column = column if pa.types.is_dictionary(column.type) else column.dictionary_encode()
        column = column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column
        words.append(column.dictionary.to_pylist())
        whole = whole * max(1, len(words[-1])) + column.indices.to_numpy(zero_copy_only=False)
    there, found = np.unique(whole, return_inverse=True)
    combinations = []
    for number in there.tolist():
        combination: list[str] = []
        for part in reversed(words):
            number, place = divmod(number, max(1, len(part)))
            combination.append(part[place])
        combinations.append(tuple(reversed(combination)))
    return found, combinations


def read_trajectories(folder: Path) -> pa.Table | None:
    """The kept trajectories, each once: what belongs to the truth may stand in the parts of several estimators."""
    seen: set[tuple[Any, ...]] = set()
    tables = []
    for path in part_paths(folder, "trajectories"):
        table = _counting(read_part(path, "trajectories"), folder / "rows" / path.name, ("",))
        tables.append(table.filter(pc.field("estimator") != ""))
        truth = table.filter(pc.field("estimator") == "")
        keys = list(zip(*(truth[name].to_pylist() for name in (*IDENTITY, "name")), strict=True))
        new = set(keys) - seen
        tables.append(truth.filter(pa.array([key in new for key in keys], pa.bool_())))
        seen |= new
    return pa.concat_tables(tables, promote_options="default").unify_dictionaries() if tables else None


def _counting(table: pa.Table, rows: Path, always: Collection[str] = ()) -> pa.Table:
    """What of a part belongs to estimators that have rows in the part of the same name."""
    labels = [*read_part(rows, "rows", ["estimator"])["estimator"].unique().to_pylist(), *always]
    return table.filter(pc.field("estimator").isin(labels))


def without(table: pa.Table, gone: Mapping[tuple[str, str], Collection[int] | None]) -> pa.Table:
    """A part of rows without some: (scenario/variant, estimator) -> runs (None: all). Where one of them was carried
    through, and so stands in the sums of the curves, all the part's rows of that estimator go."""
    cells = np.char.add(np.char.add(_text(table, "scenario"), "/"), _text(table, "variant"))
    labels, runs = _text(table, "estimator"), table["run"].to_numpy()
    driven = (np.array(table["steps"].is_valid()) if "steps" in table.column_names
              else np.zeros(table.num_rows, dtype=bool))
    stay = np.ones(table.num_rows, dtype=bool)
    for (cell, label), some in gone.items():
        mine = (cells == cell) & (labels == label)
        out = mine if some is None else mine & np.isin(runs, list(some))
        stay &= ~(mine if (out & driven).any() else out)
    return table.filter(pa.array(stay))


def _text(table: pa.Table, name: str) -> np.ndarray:
    return np.array(table[name].to_pylist(), dtype=str)


def labels_in(table: pa.Table) -> Iterator[tuple[str, str, int]]:
    """(scenario/variant, estimator, run) of a table's rows."""
    for scenario, variant, estimator, run in zip(*(table[name].to_pylist() for name in IDENTITY), strict=True):
        yield f"{scenario}/{variant}", estimator, run
