"""Results folders: one writer, growth, rows' keys, what is read from strangers."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from railstate.benchmarks.store import folder as folder_module
from railstate.benchmarks.store.folder import Store, inside
from railstate.benchmarks.store.lock import LOCK, locked
from railstate.scenarios.errors import InputError

from ..conftest import Command
from ..synthetic_results import write_results
from .test_run import rows, same

CART = ("run", "cart.toml", "--jobs", 1)
PROGRAM = (sys.executable, "-c", "from railstate.benchmarks.cli import main; main()")


def parts(folder: str) -> dict[str, float]:
    """When each part of rows was written."""
    return {path.name: path.stat().st_mtime_ns for path in Path(folder, "rows").glob("*.parquet")}


def test_a_folder_grows_by_runs_estimators_and_variants(railstate: Command) -> None:
    steps = [("cart.toml/calm", "kalman", 5), ("cart.toml/calm", "kalman", 10), ("cart.toml/calm", "ekf", 3),
             ("cart.toml/rough", "kalman", 4)]
    seen: dict[str, float] = {}
    for name, label, runs in steps:
        done = railstate("run", name, "-e", label, "--runs", runs, "--jobs", 1, "--out", "grown")
        assert done.code == 0 and not done.err, done.err
        assert seen.items() <= parts("grown").items() and len(parts("grown")) == len(seen) + 1  # only what is missing
        seen = parts("grown")
    frame = rows("grown")
    assert frame.groupby(["variant", "estimator"]).size().to_dict() == {
        ("calm", "kalman"): 10, ("calm", "ekf"): 10, ("rough", "kalman"): 4}
    railstate("run", "cart.toml", "-e", "kalman,ekf", "--runs", 10, "--jobs", 1, "--out", "fresh")
    fresh = rows("fresh")
    asked = fresh[(fresh["variant"] == "calm") | ((fresh["estimator"] == "kalman") & (fresh["run"] < 4))]
    same(frame, asked.reset_index(drop=True))
    manifest = json.loads(Path("grown/manifest.json").read_text())
    assert manifest["finished"] and manifest["rows"] == 24 and manifest["configuration"]["runs"] == 10
    assert len(manifest["command"].split(" && ")) == 4
    timing = pd.read_csv("grown/timing.csv")
    summary = pd.read_csv("grown/summary.csv")
    whole = summary[~summary["quantity"].str.contains("-")]  # not every run has every phase
    assert len(timing) == 3 and set(whole["runs"]) == {4, 10}
    assert Path("grown/tables/cart~calm.md").is_file() and Path("grown/tables/cart~rough.md").is_file()
    kept, clean = Store("grown").trajectories(), Store("fresh").trajectories()
    assert kept is not None and clean is not None and not kept.duplicated(
        ["scenario", "variant", "estimator", "run", "name", "step"]).any()
    curve, clean_curve = (Store(name).curves().query("variant == 'calm'").sort_values(
        ["estimator", "quantity", "step"]).reset_index(drop=True) for name in ("grown", "fresh"))
    pd.testing.assert_frame_equal(curve, clean_curve, check_categorical=False, rtol=1e-12)


def test_nothing_is_done_where_nothing_is_missing(railstate: Command) -> None:
    words = (*CART, "-e", "kalman", "--runs", 3, "--out", "out")
    first = railstate(*words)
    before = {path: path.stat().st_mtime_ns for path in Path("out").rglob("*") if path.is_file() and path.name != LOCK}
    again = railstate(*words)
    assert again.code == 0 and again.out == first.out
    assert before == {path: path.stat().st_mtime_ns for path in before}
    written = parts("out")
    Path("out/timing.csv").unlink()
    railstate(*words)
    assert Path("out/timing.csv").is_file() and parts("out") == written


def test_only_what_changed_is_computed_anew(railstate: Command) -> None:
    plain = Path("half.py").read_text().split("\n\nclass ")
    plain = "\n\nclass ".join(plain[:2]) + "\n"
    Path("other.py").write_text(plain)
    words = ("run", "cart.toml/calm", "--jobs", 1, "--runs", 4, "--out", "out", "--plugin", "other.py", "-e",
             "other,kalman")
    assert railstate(*words).code == 0
    before, timed = parts("out"), Path("out/timing.csv").read_text()
    Path("other.py").write_text(plain.replace("fixed-gain filter", "filter") + "\n# a comment\n")
    assert not railstate(*words).err and parts("out") == before and Path("out/timing.csv").read_text() == timed
    Path("other.py").write_text(plain + "\nCHANGED = True\n")
    done = railstate(*words)
    assert done.code == 0 and "its code changed, computed anew: cart/calm/other" in done.err
    assert len(parts("out")) == 2 and len(rows("out")) == 8
    now = Path("out/timing.csv").read_text()
    assert [line in now for line in timed.splitlines() if "kalman" in line] == [True]
    assert [line in now for line in timed.splitlines() if "other" in line] == [False]
    refused = railstate("run", "cart.toml/calm", "--jobs", 1, "--runs", 9, "--out", "out", "-e", "kalman")
    assert refused.code == 2 and "cart/calm/other has to be computed along" in refused.err
    assert "--plugin" in refused.err and len(rows("out")) == 8


def test_overwrite_replaces_and_retry_computes_lost_rows(railstate: Command) -> None:
    words = ("run", "cart.toml/calm", "--plugin", "half.py", "-e", "raises,half", "--runs", 5, "--jobs", 1, "--out",
             "out")
    assert railstate(*words).code == 0
    before = rows("out")
    assert before["status"].tolist().count("failed") == 1
    done = railstate(*words, "--retry", "failed,crashed")
    assert done.code == 0, done.err
    same(before.drop(columns="exception"), rows("out").drop(columns="exception"))  # how deep a block was halved
    curves = Store("out").curves().query("quantity == 'position'").groupby("estimator", observed=True)["active"].max()
    assert curves.to_dict() == {"raises": 4, "half": 5}
    refused = railstate(*words, "--retry", "ok")
    assert refused.code == 2 and "allowed: diverged" in refused.err
    replaced = railstate("run", "cart.toml/rough", "-e", "kalman", "--runs", 2, "--seed", 9, "--jobs", 1, "--out",
                         "out", "--overwrite")
    assert replaced.code == 0, replaced.err
    assert rows("out").groupby(["variant", "estimator"]).size().to_dict() == {("rough", "kalman"): 2}
    assert sorted(path.name for path in Path("out/tables").glob("*.md")) == [
        "cart~rough.md", "cart~rough~position-phases.md", "cart~rough~speed-phases.md"]
    assert json.loads(Path("out/manifest.json").read_text())["configuration"]["seed"] == 9


def test_a_second_process_is_refused_with_who_holds_the_folder(railstate: Command) -> None:
    Path("out").mkdir()
    with locked(Path("out"), "railstate run something"):
        held = subprocess.run([*PROGRAM, *map(str, CART), "-e", "kalman", "--runs", "2", "--out", "out"],
                              capture_output=True, text=True, check=False)
        assert held.returncode == 2 and "Traceback" not in held.stderr
        assert f"is being written by process {os.getpid()} on " in held.stderr
        assert "railstate run something" in held.stderr
        refused = railstate(*CART, "-e", "kalman", "--runs", 2, "--out", "out")
        assert refused.code == 2 and "this very process" in refused.err
    assert railstate(*CART, "-e", "kalman", "--runs", 2, "--out", "out").code == 0


def test_a_dead_process_keeps_no_lock(railstate: Command) -> None:
    Path("out").mkdir()
    code = ("import os, signal\nfrom pathlib import Path\nfrom railstate.benchmarks.store.lock import locked\n"
            "with locked(Path('out'), 'x'):\n    os.kill(os.getpid(), signal.SIGKILL)")
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -signal.SIGKILL
    assert railstate(*CART, "-e", "kalman", "--runs", 2, "--out", "out").code == 0


@pytest.mark.parametrize("trials", [1, pytest.param(20, marks=pytest.mark.long)])
def test_two_processes_on_one_folder(railstate: Command, trials: int) -> None:
    railstate("run", "cart.toml", "-e", "kalman,ekf", "--runs", 12, "--jobs", 1, "--out", "right")
    for trial in range(trials):
        words = ("run", "cart.toml", "-e", "kalman,ekf", "--runs", "12", "--jobs", "1", "--out", f"out{trial}")
        both = [subprocess.Popen([*PROGRAM, *words, "--batch", batch], stderr=subprocess.PIPE, text=True,
                                 stdout=subprocess.DEVNULL) for batch in ("3", "5")]
        ended = [(process.communicate(timeout=300)[1], process.returncode) for process in both]
        assert {code for _, code in ended} <= {0, 2} and 0 in {code for _, code in ended}
        assert all("is being written by" in err for err, code in ended if code)
        same(rows("right"), rows(f"out{trial}"))


def test_compare_finds_no_difference_over_batches_and_jobs(railstate: Command) -> None:
    words = ("run", "cart.toml", "-e", "kalman,ekf", "--runs", 10)
    railstate(*words, "--jobs", 1, "--batch", 1, "--out", "first")
    for batch, jobs in ((1000, 1), (4, 2)):
        railstate(*words, "--jobs", jobs, "--batch", batch, "--out", f"out{batch}-{jobs}")
        found = railstate("compare", "first", f"out{batch}-{jobs}", "--fail-on", "different")
        assert found.code == 0 and "40 of 40 common rows bit-identical" in found.out
        same(rows("first"), rows(f"out{batch}-{jobs}"))


def test_rows_that_stand_twice_are_refused(railstate: Command) -> None:
    railstate(*CART, "-e", "kalman", "--runs", 4, "--out", "out")
    part = next(Path("out/rows").glob("*.parquet"))
    part.with_name("again.parquet").write_bytes(part.read_bytes())
    for words in (("report", "out"), (*CART, "-e", "kalman", "--runs", 4, "--out", "out")):
        refused = railstate(*words)
        assert refused.code == 2 and "rows more than once" in refused.err and "again.parquet" in refused.err
    part.with_name("again.parquet").unlink()
    assert railstate("report", "out").code == 0


def test_a_part_rewritten_by_pandas_is_read(railstate: Command) -> None:
    railstate(*CART, "-e", "kalman", "--runs", 4, "--out", "out")
    before = rows("out")
    for path in Path("out").rglob("*.parquet"):
        frame = pq.read_table(path).to_pandas()
        frame.astype({name: "large_string[pyarrow]" for name in frame if name in ("scenario", "estimator")}
                     ).to_parquet(path)
    same(before, rows("out"))
    assert railstate("report", "out").code == 0


def test_a_verdict_table_of_other_types_is_made_anew(railstate: Command) -> None:
    railstate(*CART, "-e", "kalman,ekf", "--runs", 3, "--out", "out")
    path, first = Path("out/verdicts.parquet"), railstate("table", "out", "--format", "csv")
    table = pq.read_table(path)
    for name in ("value", "eligible", "runs", "ratio_low"):
        odd = pa.array(["odd"] * table.num_rows)
        pq.write_table(table.set_column(table.column_names.index(name), name, odd), path)
        assert railstate("table", "out", "--format", "csv") == first and first.code == 0


def test_links_lead_nowhere(railstate: Command) -> None:
    railstate(*CART, "-e", "kalman", "--runs", 2, "--out", "out")
    Path("elsewhere").mkdir()
    Path("elsewhere/.cart.md.17").write_text("somebody's")
    for name in ("tables", "rows", "figures"):
        if Path("out", name).exists():
            Path("out", name).rename("moved")
        Path("out", name).symlink_to("../elsewhere")
        words = ("plot", "out") if name == "figures" else (*CART, "-e", "kalman", "--runs", 3, "--out", "out")
        refused = railstate(*words)
        assert refused.code == 2 and refused.err == f"error: out/{name}: is no folder but a link; remove it\n"
        Path("out", name).unlink()
        if Path("moved").exists():
            Path("moved").rename(f"out/{name}")
    assert [path.name for path in Path("elsewhere").iterdir()] == [".cart.md.17"]
    for name in ("manifest.json", ".lock", "timing.csv"):
        Path("out", name).rename("moved")
        os.mkfifo(f"out/{name}")
        ended = railstate(*CART, "-e", "kalman", "--runs", 2, "--out", "out")
        assert ended.code == (0 if name == "timing.csv" else 2) and ended.err.count("\n") == (ended.code > 0), ended
        if ended.code:
            os.replace("moved", f"out/{name}")


def test_names_from_a_folder_lead_nowhere(tmp_path: Path, railstate: Command) -> None:
    railstate(*CART, "-e", "kalman", "--runs", 2, "--out", "out")
    text = Path("out/manifest.json").read_text()
    Path("out/manifest.json").write_text(text.replace("calm", "v/../../../X"))
    for path in Path("out").rglob("*.parquet"):
        frame = pd.read_parquet(path).replace({"variant": {"calm": "v/../../../X"}})
        frame.to_parquet(path, index=False)
    for command in ("plot", "report"):
        refused = railstate(command, "out")
        assert refused.code == 2 and "manifest.json: damaged" in refused.err
    for name in ("../x", "a/../../x", "/x", "", ".x", "x\n", "a//b"):
        with pytest.raises(InputError, match="no name of a file"):
            inside(tmp_path, name)


def test_a_folder_that_cannot_be_written_is_read(railstate: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    words = (*CART, "-e", "kalman", "--runs", 2, "--out", "out")
    first = railstate(*words)
    monkeypatch.setattr(Store, "writable", False)
    again = railstate(*words)
    assert again.code == 0 and again.out == first.out
    refused = railstate(*CART, "-e", "kalman", "--runs", 3, "--out", "out")
    assert refused.code == 2 and "cannot be written" in refused.err
    assert railstate("report", "out", "--out", "page.html").code == 0 and Path("page.html").stat().st_size > 10_000
    assert not Path("out/report.html").exists()


def test_older_and_newer_folders_are_refused(railstate: Command) -> None:
    railstate(*CART, "-e", "kalman", "--runs", 2, "--out", "out")
    path = Path("out/manifest.json")
    content = json.loads(path.read_text())
    for version in (None, 1, 99):
        path.write_text(json.dumps({key: version if key == "schema_version" else value for key, value in content.items()
                                    if version or key != "schema_version"}))
        for words in (("report", "out"), (*CART, "-e", "kalman", "--runs", 2, "--out", "out")):
            refused = railstate(*words)
            assert refused.code == 2 and "was written by railstate" in refused.err and refused.err.count("\n") == 1
    path.write_text(json.dumps({**content, "schema_version": "1" * 30, "railstate": "v" * 50}))  # named, not all of it
    assert f"was written by railstate {'v' * 40} (folders of version {'1' * 20}; this" in railstate("report", "out").err


def test_other_versions_are_warned_of(railstate: Command) -> None:
    railstate(*CART, "-e", "kalman", "--runs", 2, "--out", "out")
    path = Path("out/manifest.json")
    content = json.loads(path.read_text())
    content["environment"]["packages"]["numba"] = "0.1"
    path.write_text(json.dumps(content))
    assert not railstate(*CART, "-e", "kalman", "--runs", 2, "--out", "out").err
    done = railstate(*CART, "-e", "kalman", "--runs", 3, "--out", "out")
    assert done.code == 0 and "begun with another version: numba 0.1 ->" in done.err


@pytest.mark.long
def test_many_runs_are_read_in_little_memory(railstate: Command, block: int = 100, copies: int = 150) -> None:
    """15,000 runs of five estimators: parts of one block written again for other runs."""
    railstate("run", "cbtc-csma/uniform", "--runs", block, "--jobs", 1, "--batch", block, "--out", "out")
    part = next(Path("out/rows").glob("*.parquet"))
    table = pq.read_table(part)
    for copy in range(1, copies):
        moved = pa.array(table["run"].to_numpy() + block * copy, pa.int32())
        pq.write_table(table.set_column(table.column_names.index("run"), "run", moved), f"out/rows/{copy:04d}.parquet")
        Path(f"out/curves/{copy:04d}.parquet").write_bytes(Path("out/curves", part.name).read_bytes())
    content = json.loads(Path("out/manifest.json").read_text())
    for cell in (content["configuration"], *content["configuration"]["cells"].values()):
        cell["runs"] = block * copies
    Path("out/manifest.json").write_text(json.dumps(content))
    code = ("import resource, sys\nfrom railstate.benchmarks.cli import main\n"
            "sys.argv = ['railstate', 'report', 'out']\ntry:\n    main()\nexcept SystemExit as end:\n"
            "    assert not end.code\nprint(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert int(done.stdout.split()[-1]) < 500_000  # kB
    assert Store("out").curves()["active"].max() == block * copies


def test_what_is_written_is_read(tmp_path: Path) -> None:
    store = Store(write_results(tmp_path / "synthetic"))
    frame = store.rows()
    assert len(frame) == 24 * (3 * 6 + 2 * 4 + 13)
    order = frame.drop_duplicates(["scenario", "variant", "estimator"])["estimator"].tolist()
    assert order[:6] == ["ekf", "ekf-naive", "ekf-inflated", "ukf", "robust-mean-square", "robust-ellipsoid"]
    assert np.array_equal(frame["run"].to_numpy()[:24], np.arange(24))
    assert json.loads((tmp_path / "synthetic" / "manifest.json").read_text())["schema_version"] == folder_module.SCHEMA
