"""A results folder checked by a stranger: what agrees, what was changed, what cannot be checked."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from railstate.benchmarks.store.provenance import environment
from railstate.benchmarks.studies import verify

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


def test_a_folder_as_it_was_made_agrees_and_no_other(railstate: Command, expected: Callable[[str, str], None],
                                                     monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever a stranger may have changed, one at a time."""
    assert railstate("run", "cart.toml/calm", "--estimators", "ekf,kalman,half", "--plugin", "half.py", "--runs", 3,
                     "--out", "done").code == 0
    before = {path: path.read_bytes() for path in Path("done").rglob("*") if path.is_file()}
    said = list[str]()

    def verified(what: str, *words: str | int, code: int = 0) -> None:
        found = railstate("verify", *words)
        assert found.code == code, found.out + found.err
        said.append(f"== {what}: {' '.join(map(str, words))}\n{found.out}{found.err}")

    def changed(name: str) -> Path:
        shutil.rmtree("copy", ignore_errors=True)
        shutil.copytree("done", "copy")
        return Path("copy") / name

    verified("as it was made", "done")
    verified("the plug-in's file is given", "done", "--plugin", "half.py", "--rows", 9)
    Path("half.py").write_text(Path("half.py").read_text() + "\nOTHER = 1\n")
    verified("it is another one", "done", "--plugin", "half.py", "--rows", 0)
    assert {path: path.read_bytes() for path in Path("done").rglob("*") if path.is_file()} == before

    text = changed("summary.csv")
    text.write_text(text.read_text().replace("ekf", "EKF"))
    verified("a word of a table", "copy", "--rows", 0, code=1)
    text.unlink()
    os.mkfifo(text)
    verified("no file that ends", "copy", "--rows", 0, code=1)
    for name in ("verdicts.csv", "verdicts.parquet", "timing.csv"):
        changed(name).unlink()
        verified(f"{name} gone", "copy", "--rows", 0, code=int(name != "verdicts.parquet"))
    for table in sorted(changed("tables").iterdir()):
        table.write_text("")
    verified("all tables emptied", "copy", "--rows", 0, code=1)
    part = sorted(changed("rows").glob("*.parquet"))[0]
    part.unlink()
    verified("rows gone", "copy", "--rows", 0, code=1)
    for path in sorted(changed("rows").glob("*.parquet")):
        altered(path, "rmse:position:m", 1, 0.5)
    verified("a number of a row", "copy", code=1)
    with monkeypatch.context() as patch:
        patch.setattr(verify, "environment", lambda: {**environment(), "processor": "mine"})
        manifest(Path("copy"), lambda content: content["environment"].update(processor="theirs"))
        verified("and another processor", "copy", code=1)
    manifest(Path("copy"), lambda content: content["environment"].update(processor=environment()["processor"]))
    manifest(Path("copy"), lambda content: content["environment"]["packages"].update(numpy="1.0"))
    verified("and another numpy", "copy", code=1)
    changed("rows")
    manifest(Path("copy"), lambda content: content["replay"]["cells"]["cart/calm"]["table"]["plant"].update(R=[[2.0]]))
    verified("another scenario", "copy", code=1)
    changed("manifest.json").write_text("[]")
    verified("no manifest", "copy", code=2)
    expected("verify", re.sub(r"numpy 1.0 -> \S+", "numpy 1.0 -> NOW", " ".join(said)).replace(str(Path.cwd()), "."))
