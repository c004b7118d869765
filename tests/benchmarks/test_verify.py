"""A results folder checked by a stranger: what agrees, what was changed, what cannot be checked."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from ..conftest import Command


def altered(path: Path, column: str, run: int, factor: float) -> None:
    """A rows file with one number changed, ekf's of one run."""
    table = pq.read_table(path)
    values, labels, runs = (table[name].to_pylist() for name in (column, "estimator", "run"))
    changed = [value * factor if label == "ekf" and number == run else value
               for value, label, number in zip(values, labels, runs, strict=True)]
    if changed != values:
        pq.write_table(table.set_column(table.schema.get_field_index(column), column, pa.array(changed)), path)


def manifest(folder: Path, change: Any) -> None:
    content = json.loads((folder / "manifest.json").read_text())
    change(content)
    (folder / "manifest.json").write_text(json.dumps(content))


def test_a_folder_as_it_was_made_agrees(railstate: Command) -> None:
    assert railstate("run", "cart.toml/calm", "--estimators", "ekf,kalman,half", "--plugin", "half.py", "--runs", 3,
                     "--out", "done").code == 0
    before = {path: path.read_bytes() for path in Path("done").rglob("*") if path.is_file()}
    found = railstate("verify", "done")
    assert found.code == 0, found.out + found.err
    assert "rows: all 9 that the manifest tells of are there" in found.out
    assert "sample: 6 of the rows, drawn and computed anew, are bit-identical" in found.out
    assert "not checked: 3 rows: half is not known here: give its file with --plugin" in found.out
    assert found.out.splitlines()[-1] == "done: all that could be checked agrees"
    found = railstate("verify", "done", "--plugin", "half.py", "--rows", 9)
    assert found.code == 0 and "sample: 9 of the rows" in found.out and "not checked" not in found.out
    Path("half.py").write_text(Path("half.py").read_text() + "\nOTHER = 1\n")
    found = railstate("verify", "done", "--plugin", "half.py", "--rows", 0)
    assert found.code == 0 and "not checked: 3 rows: other code of half here" in found.out
    assert {path: path.read_bytes() for path in Path("done").rglob("*") if path.is_file()} == before

    # what a stranger may have changed, one at a time
    def changed(name: str) -> Path:
        shutil.rmtree("copy", ignore_errors=True)
        shutil.copytree("done", "copy")
        return Path("copy") / name

    text = changed("summary.csv")
    text.write_text(text.read_text().replace("ekf", "EKF"))
    found = railstate("verify", "copy", "--rows", 0)
    assert found.code == 1 and "are not what the rows give: summary.csv" in found.out

    for path in sorted(changed("rows").glob("*.parquet")):
        altered(path, "rmse:position:m", 1, 0.5)
    found = railstate("verify", "copy")
    assert found.code == 1 and "sample: 1 of 6 rows computed anew differ: " in found.out
    assert "/calm/ekf/1" in found.out and found.out.splitlines()[-1] == "copy: does not agree with itself"

    manifest(Path("copy"), lambda content: content["environment"]["packages"].update(numpy="1.0"))
    found = railstate("verify", "copy")
    assert "not checked: 1 of 6 rows computed anew differ" in " ".join(found.out.split())
    assert "numpy 1.0 -> " in " ".join(found.out.split())

    changed("rows")
    manifest(Path("copy"), lambda content: content["replay"]["cells"]["cart/calm"]["table"]["plant"].update(R=[[2.0]]))
    found = railstate("verify", "copy")
    assert found.code == 1 and "WRONG: 6 rows: their scenario" in found.out

    changed("manifest.json").write_text("[]")
    found = railstate("verify", "copy")
    assert found.code == 2 and len(found.err.splitlines()) == 1
