"""Parts of a results folder as strangers write them: taken in their types, or refused with what is wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from railstate.benchmarks.store.parts import read_part, read_rows
from railstate.scenarios.errors import InputError

ROW: dict[str, Any] = {"scenario": ["s"] * 2, "variant": ["v"] * 2, "estimator": ["a"] * 2,
                       "run": pa.array([0, 1], pa.int64()), "status": ["ok", "failed"], "reason": ["", "r"],
                       "exception": ["", ""], "seconds": pa.array([1, 2], pa.int8()), "rmse:x:m": [0.5, None]}
CELLS = {"s/v": {"estimators": {"a": {}}, "runs": 2}}


def written(path: Path, **changes: Any) -> Path:
    table = {key: value for key, value in {**ROW, **changes}.items() if value is not None}
    pq.write_table(pa.table(table), path)
    return path


def test_columns_in_their_types_whoever_wrote_them(tmp_path: Path) -> None:
    coded = pa.array(["a", "a"]).dictionary_encode()
    found = read_part(written(tmp_path / "p.parquet", estimator=coded, reason=pa.array(["", "r"], pa.large_string()),
                              __index_level_0__=[1, 2], own=[True, False]), "rows")
    assert found.schema.field("run").type == pa.int32() and found.schema.field("seconds").type == pa.float64()
    assert found.schema.field("reason").type == pa.string() and found.schema.field("own").type == pa.bool_()
    assert "__index_level_0__" not in found.column_names and found["rmse:x:m"].to_pylist() == [0.5, None]
    assert found["estimator"].to_pylist() == ["a", "a"] and found["run"].to_pylist() == [0, 1]
    some = read_part(tmp_path / "p.parquet", "rows", ("run", "status"))
    assert some.column_names == ["run", "status"]


@pytest.mark.parametrize(("changes", "said"), [
    ({"status": None}, "no column status"), ({"run": ["0", "1"]}, "run: holds string, not int32"),
    ({"scenario": [1, 2]}, "scenario: holds int64, not string"),
    ({"estimator": ["a", None]}, "estimator: lacks values"),
    ({"run": pa.array([0, None], pa.int32())}, "run: lacks values"), ({"run": [0, 2**40]}, "nteger value"),
    ({"rmse:x:m": ["0.5", "1"]}, "rmse:x:m: holds string, not double"), ({"own": [[1], [2]]}, "own: holds list"),
    ({"rmse:x:m": [[1.0], [2.0]]}, "Unsupported cast from list")])
def test_what_is_damaged(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    path = written(tmp_path / "p.parquet", **changes)
    with pytest.raises(InputError) as caught:
        read_part(path, "rows")
    words = str(caught.value)
    assert words.startswith(f"{path}: damaged (") and said in words, words
    assert words.endswith("); remove it and run again: only its rows are computed anew")


@pytest.mark.parametrize(("changes", "said"), [
    ({"estimator": ["a", "b"]}, "holds rows of 's/v/b', which manifest.json does not know; remove it"),
    ({"variant": ["v", "w"]}, "holds rows of 's/w/a', which manifest.json does not know; remove it"),
    ({"run": [0, 2]}, "holds run 2 of s/v/a, which has 2; remove it"),
    ({"run": [-1, 0]}, "holds run 0 of s/v/a, which has 2; remove it"),
    ({"status": ["ok", "odd"]}, "damaged (status 'odd'; allowed: ok, ")])
def test_rows_that_are_not_the_folder_s(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    (tmp_path / "rows").mkdir()
    assert read_rows(tmp_path, CELLS) is None
    path = written(tmp_path / "rows" / "p.parquet", **changes)
    with pytest.raises(InputError) as caught:
        read_rows(tmp_path, CELLS)
    assert str(caught.value).startswith(f"{path}: {said}")


def test_a_row_stands_once(tmp_path: Path) -> None:
    (tmp_path / "rows").mkdir()
    written(tmp_path / "rows" / "p.parquet")
    found = read_rows(tmp_path, CELLS)
    assert found is not None and found.num_rows == 2
    written(tmp_path / "rows" / "q.parquet", run=[1, 1])
    with pytest.raises(InputError) as caught:
        read_rows(tmp_path, CELLS)
    assert str(caught.value) == (f"{tmp_path}: holds 1 rows more than once, s/v/a/1 first, in rows/p.parquet and "
                                 "rows/q.parquet; remove all of these but one and run again")
