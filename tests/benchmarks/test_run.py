"""`railstate run`, `replay`: files written, reproducibility to the last bit, failures as rows, resumption."""

from __future__ import annotations

import itertools
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from railstate.benchmarks.judging.table import SUMMARY_COLUMNS as SUMMARY
from railstate.benchmarks.judging.table import VERDICT_COLUMNS, verdicts
from railstate.benchmarks.scoring.columns import TIMING
from railstate.benchmarks.studies.complete import Store
from railstate.benchmarks.telling.figures.canvas import LIGHT

from ..conftest import Command

CART = ("run", "cart.toml", "--plugin", "half.py")


def rows(folder: Path | str) -> pd.DataFrame:
    """The rows of a folder without the one column that measures time."""
    frame = Store(folder).rows().drop(columns="seconds")
    return frame.sort_values(["scenario", "variant", "estimator", "run"]).reset_index(drop=True)


def same(a: pd.DataFrame, b: pd.DataFrame) -> None:
    """Bit for bit, whatever the order of the columns."""
    pd.testing.assert_frame_equal(a, b[a.columns.tolist()], check_exact=True)


def test_files_and_their_columns(railstate: Command) -> None:
    done = railstate(*CART, "--estimators", "half", "--runs", 12, "--out", "out", "--keep", 2)
    assert done.code == 0, done.err
    out = railstate.folder / "out"
    frame = Store(out).rows()
    assert len(frame) == 24 and set(frame["status"]) == {"ok"}
    assert {"rmse:position:m", "mae:speed:m/s", "max:position:m"} <= set(frame.columns)
    summary, timing = pd.read_csv(out / "summary.csv"), pd.read_csv(out / "timing.csv")
    assert tuple(summary.columns) == SUMMARY and tuple(timing.columns) == TIMING
    assert (timing["latency_us_p99"] >= timing["latency_us_median"]).all() and (timing["throughput_ns"] > 0).all()
    assert (timing["samples"] >= 1000).all()
    part = frame[frame["variant"] == "rough"]["rmse:position:m"].to_numpy()
    line = summary.query("variant == 'rough' and metric == 'rmse' and quantity == 'position'").iloc[0]
    assert line["mean"] == pytest.approx(np.sqrt(np.mean(part**2)), rel=1e-12) and line["runs"] == 12
    table = pd.read_parquet(out / "verdicts.parquet")
    assert tuple(table) == VERDICT_COLUMNS
    pd.testing.assert_frame_equal(table, verdicts(frame, Store(out).manifest()))
    written = pd.read_csv(out / "verdicts.csv", keep_default_na=False, na_values=[""])
    assert len(written) == len(table) and written["value"].to_numpy() == pytest.approx(table["value"].to_numpy())
    assert (out / "tables" / "cart~calm.md").read_text().startswith("## cart/calm")
    assert "± is half of the 95 % interval" in (out / "tables" / "cart~calm.md").read_text()
    tex = (out / "tables" / "cart~calm.tex").read_text()
    assert r"\toprule" in tex and tex.isascii()
    manifest = json.loads((out / "manifest.json").read_text())
    assert manifest["finished"] and manifest["statuses"] == {"ok": 24}
    kept = Store(out).trajectories()
    assert kept is not None and set(kept["run"]) == {0, 1}
    assert "cart/rough" in done.out and "24 rows: 24 ok" in done.out and done.err == ""


@pytest.mark.parametrize("words", [
    ("--jobs", "2"), ("--batch", "7"), ("--batch", "1000"), ("--jobs", "2", "--batch", "5")], ids=" ".join)
def test_rows_do_not_depend_on_the_machinery(railstate: Command, words: tuple[str, ...]) -> None:
    common = (*CART, "--estimators", "half,slow,kalman", "--runs", 20)
    assert railstate(*common, "--jobs", 1, "--out", "one").code == 0
    assert railstate(*common, *words, "--out", "two").code == 0
    same(rows("one"), rows("two"))


def test_adding_and_permuting_estimators_moves_nothing(railstate: Command) -> None:
    railstate(*CART, "--estimators", "half", "--runs", 9, "--out", "one")
    railstate(*CART, "--estimators", "slow,kalman,half", "--runs", 9, "--out", "more")
    more = rows("more")
    same(rows("one"), more[more["estimator"] == "half"].reset_index(drop=True))


def test_runs_are_nested(railstate: Command) -> None:
    railstate(*CART, "--estimators", "half", "--runs", 5, "--out", "few")
    railstate(*CART, "--estimators", "half", "--runs", 15, "--out", "many")
    many = rows("many")
    same(rows("few"), many[many["run"] < 5].reset_index(drop=True))


def test_another_seed_is_another_truth(railstate: Command) -> None:
    railstate(*CART, "--estimators", "half", "--runs", 3, "--out", "one")
    railstate(*CART, "--estimators", "half", "--runs", 3, "--out", "two", "--seed", 2)
    assert not np.isclose(rows("one")["rmse:position:m"], rows("two")["rmse:position:m"]).any()


def test_a_killed_run_resumes_to_the_same_rows(railstate: Command) -> None:
    words = [*CART, "--estimators", "slow,half", "--runs", "12", "--batch", "2", "--jobs", "1"]
    railstate(*words, "--out", "whole")
    program = [sys.executable, "-c", "from railstate.benchmarks.cli import main; main()"]
    process = subprocess.Popen([*program, *words, "--out", "killed"], cwd=railstate.folder, stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 60
    while len(list((railstate.folder / "killed" / "rows").glob("*.parquet"))) < 2:
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.02)
    process.kill()
    process.wait()
    assert 0 < len(rows("killed")) < len(rows("whole"))
    again = railstate(*words, "--out", "killed")
    assert again.code == 0, again.err
    same(rows("whole"), rows("killed"))


def test_interrupt_leaves_finished_rows_and_says_how_to_continue(railstate: Command) -> None:
    words = [*CART, "--estimators", "slow", "--runs", "20", "--batch", "1", "--jobs", "1", "--out", "out"]
    program = [sys.executable, "-c", "from railstate.benchmarks.cli import main; main()"]
    process = subprocess.Popen(  # a shell has what it starts in the background ignore the signal
        [*program, *words], cwd=railstate.folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL))
    while not list((railstate.folder / "out" / "rows").glob("*.parquet")):
        time.sleep(0.02)
    os.kill(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "interrupted" in err and "continues" in err and "Traceback" not in err
    assert len(rows("out")) >= 1


def test_reasons_do_not_depend_on_the_batch(railstate: Command) -> None:
    Path("tells.py").write_text(Path("half.py").read_text().replace('raise ArithmeticError("run 3 is not for me")',
                                                                    'raise ArithmeticError("x")') + '''

from railstate.estimators.interface import Status, flag


class Tells(Half):
    def update(self, measurement):
        for s, number in enumerate(self.numbers):
            flag(self, np.arange(len(self.numbers)) == s, Status.failed, f"run {number} says so")
''')
    found = []
    for batch in (1, 100):
        railstate("run", "cart.toml/calm", "--plugin", "tells.py", "--estimators", "tells", "--runs", 4, "--batch",
                  batch, "--jobs", 1, "--out", f"out{batch}")
        found.append(rows(f"out{batch}"))
    same(*found)
    assert found[0]["reason"].tolist() == [f"run {n} says so" for n in range(4)]


def test_another_configuration_is_refused(railstate: Command) -> None:
    railstate(*CART, "--estimators", "half", "--runs", 4, "--out", "out")
    before = rows("out")
    refused = railstate(*CART, "--estimators", "half", "--runs", 4, "--out", "out", "--seed", 7)
    assert refused.code == 2 and "seed: 1 -> 7" in refused.err
    refused = railstate(*CART, "--estimators", "half", "--runs", 4, "--out", "out", "--set", "plant.R=[[4]]")
    assert refused.code == 2 and "scenario" in refused.err
    same(before, rows("out"))


def test_what_an_estimator_raises_costs_only_its_run(railstate: Command) -> None:
    done = railstate(*CART, "--estimators", "raises,half,wanders", "--runs", 8, "--out", "out")
    assert done.code == 0
    frame = rows("out").set_index(["variant", "estimator", "run"])
    bad = frame[frame["status"] != "ok"]
    assert sorted(bad.index) == [(v, e, r) for v in ("calm", "rough") for e, r in (("raises", 3), ("wanders", 2))]
    assert bad.loc[("calm", "raises", 3), "reason"] == "ArithmeticError: run 3 is not for me"
    assert bad.loc[("calm", "wanders", 2), "status"] == "diverged"
    for run in (0, 7):
        mine, theirs = (frame.loc[("calm", label, run), "rmse:position:m"] for label in ("raises", "half"))
        assert mine == pytest.approx(theirs, rel=1e-7)  # their own streams differ by 1e-9 m
    assert "railstate replay cart/calm/raises/3 --out out" in done.out
    replayed = railstate("replay", "cart/calm/raises/3", "--out", "out", "--plugin", "half.py")
    assert replayed.code == 0 and "run 3 is not for me" in replayed.out and "Traceback" in replayed.out
    fine = railstate("replay", "cart/rough/half/6", "--out", "out", "--plugin", "half.py")
    assert "bit-identical to the row in out" in fine.out


def test_runs_without_a_scored_step_are_rows(railstate: Command) -> None:
    done = railstate(*CART, "--estimators", "blank,half", "--runs", 3, "--out", "out")
    assert done.code == 0, done.err
    assert rows("out").groupby("estimator")["status"].unique().map(list).to_dict() == {
        "blank": ["diverged"], "half": ["ok"]}
    refused = railstate(*CART, "--set", "score.skip=40")
    assert refused.code == 2 and "score.skip = 40 s leaves nothing" in refused.err


def test_two_scenarios_of_one_name_are_told_apart_or_refused(railstate: Command) -> None:
    text = Path("cart.toml").read_text()
    Path("same.toml").write_text(text.replace("a cart on a line", "the same under another title"))
    Path("other.toml").write_text(text.replace("R = [[1]]", "R = [[2]]"))
    refused = railstate("run", "cart.toml", "other.toml", "--plugin", "half.py", "--runs", 2)
    assert refused.code == 2 and "other.toml and cart.toml are both named cart" in refused.err
    railstate(*CART, "--estimators", "half", "--runs", 2, "--out", "out")
    again = railstate("run", "same.toml", "--plugin", "half.py", "--estimators", "half", "--runs", 2, "--out", "out")
    assert again.code == 0, again.err  # a title changes no row


def test_a_variant_on_request_and_files_from_the_scenarios_own_folder(railstate: Command) -> None:
    Path("sub").mkdir()
    Path("sub/K.csv").write_text("0.5\n0.1\n")
    Path("sub/mine.toml").write_text(
        Path("cart.toml").read_text().replace('[estimators.half]\nplugin = "half"', '[estimators.fixed]\n'
                                              'plugin = "fixed-gain"\nparameters = { gain = "K.csv" }')
        + '[variants.long]\ndefault = false\ntitle = "on request"\n')
    run = ("run", "sub/mine.toml", "--runs", 2, "--jobs", 1, "--out", "out")
    done = railstate(*run)
    assert done.code == 0, done.err
    assert set(rows("out")["variant"]) == {"calm", "rough"}
    assert railstate("run", "sub/mine.toml/long", "--runs", 2, "--jobs", 1, "--out", "asked").code == 0
    Path("sub/K.csv").write_text("0.6\n0.1\n")
    refused = railstate(*run)
    assert refused.code == 2 and "fixed.parameters.gain" in refused.err and len(refused.err) < 1000
    Path("sub/K.csv").unlink()
    refused = railstate(*run)
    assert refused.code == 2 and "K.csv: there is no such file" in refused.err


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_plug_in_that_dies_costs_only_its_rows(railstate: Command, jobs: int) -> None:
    done = railstate("run", "cart.toml/calm", "--plugin", "half.py", "--estimators", "half,dies", "--runs", 6,
                     "--batch", 3, "--jobs", jobs, "--out", "out")
    assert done.code == 0
    frame = rows("out")
    bad = frame[frame["status"] != "ok"]
    assert [tuple(row) for row in bad[["estimator", "run", "status"]].to_numpy()] == [("dies", 5, "crashed")]
    assert len(frame) == 12


def test_a_plug_in_that_dies_in_the_first_run_costs_its_latency_too(railstate: Command) -> None:
    done = railstate(*CART, "--estimators", "half,dies-at-once", "--runs", 3, "--jobs", 1, "--out", "out")
    assert done.code == 0, done.err
    frame = rows("out")
    bad = frame[frame["status"] != "ok"]
    assert set(bad["estimator"]) == {"dies-at-once"} and set(bad["run"]) == {0} and set(bad["status"]) == {"crashed"}
    timing = pd.read_csv("out/timing.csv").set_index("estimator")["latency_us_median"]
    assert timing["dies-at-once"].isna().all() and timing["half"].notna().all()


@pytest.mark.parametrize(("label", "reason", "runs"), [
    ("leaves", "SystemExit: 5", [2]), ("short", "mean has shape (1, 1)", [0, 1, 2]),
    ("one-for-all", "covariance has shape (2, 2, 2)", [2]), ("listing", "mean is list, not an array", [0, 1, 2])])
def test_what_is_no_estimate_is_a_failed_row(railstate: Command, label: str, reason: str, runs: list[int]) -> None:
    done = railstate("run", "cart.toml/calm", "--plugin", "half.py", "--estimators", label, "--runs", 3, "--batch",
                     1 if label != "one-for-all" else 3, "--jobs", 1, "--out", "out", "--keep", 1)
    assert done.code == 0, done.err
    frame = rows("out")
    if label != "one-for-all":  # which is right for one run, and so for every run the block is halved to
        assert frame.loc[frame["status"] == "failed", "run"].tolist() == runs
        assert frame.loc[frame["status"] == "failed", "reason"].str.contains(reason, regex=False).all()
    else:
        assert set(frame["status"]) == {"ok"}


def test_a_plug_in_that_hangs_costs_only_its_rows(railstate: Command) -> None:
    # on a new machine this compiles the scoring, which takes longer than the timeout
    assert railstate(*CART, "--estimators", "half", "--runs", 2, "--jobs", 1).code == 0
    done = railstate("run", "cart.toml/calm", "--plugin", "half.py", "--estimators", "hangs", "--runs", 3,
                     "--batch", 1, "--jobs", 2, "--out", "out", "--timeout", 6)
    assert done.code == 0
    assert rows("out")["status"].tolist() == ["ok", "timeout", "ok"]


def test_no_scheduler_is_one_message(railstate: Command) -> None:
    done = railstate(*CART, "--backend", "dask", "--runs", 2)
    assert done.code == 2 and "--scheduler" in done.err


def test_sweep_says_where_a_bound_is_exceeded_and_what_a_design_takes(railstate: Command) -> None:
    """The certificate is for 1 to 3 trains: with 20 the measured mean square is beyond it, and said to be."""
    done = railstate("sweep", "cbtc-csma", "--over", "channel.trains=1,20", "--set", "channel.traffic=constant",
                     "--set", "knowledge.trains=[1,3]", "--set", "plant.cars=2", "--set", "time.steps=1500",
                     "--estimators", "ultimate-bound", "--runs", 20, "--jobs", 1, "--metric",
                     "mean-square:performance,design:seconds", "--out", "swept")
    assert done.code == 0, done.err
    said = [line for line in done.out.splitlines() if line.startswith("at channel.trains = ")]
    assert len(said) == 1 and "20: ultimate-bound: measured mean square" in said[0] and "certified bound" in said[0]
    table = pd.read_csv(railstate.folder / "swept" / "sweep.csv")
    bound, measured = (table[(table["channel.trains"] == 20) & (table["metric"] == metric)]["value"].iloc[0]
                       for metric in ("bound", "mean-square"))
    assert f"is {measured / bound:.1f} times its certified bound" in said[0] and measured > bound
    assert (table[table["metric"] == "design"]["value"] > 0).sum() == 2 and "design seconds" in done.out


def test_sweep_writes_rows_table_and_plots(railstate: Command) -> None:
    done = railstate("sweep", "cart.toml", "--plugin", "half.py", "--over", "channel.p=0.3,0.9", "--runs", 10,
                     "--estimators", "half,kalman", "--out", "swept")
    assert done.code == 0, done.err
    table = pd.read_csv(railstate.folder / "swept" / "sweep.csv")
    part = table.query("kind == 'error' and quantity == 'position' and estimator == 'kalman'").set_index("channel.p")
    assert part.loc[0.3, "value"] > part.loc[0.9, "value"]
    drawn = (railstate.folder / "swept" / "rmse-position.svg").read_text()
    assert LIGHT["c0"] in drawn and LIGHT["c1"] in drawn  # the report's colours, one for each estimator
    assert "rmse position" in done.out


def test_a_sweep_over_several_keys_says_who_meets_which_requirement_where(railstate: Command) -> None:
    asked = "".join(f'''
[[requirements]]
name = "{name}"
form = "percentile"
quantity = "position"
percent = 95
limit = {within}
accept = 0.5
''' for name, within in (("wide", 1e6), ("none", 1e-9)))
    text = Path("cart.toml").read_text()
    Path("cart.toml").write_text(text.replace("[estimators.half]", asked + "[estimators.half]", 1))
    done = railstate("sweep", "cart.toml", "--plugin", "half.py", "--over", "channel.p=0.3,0.9", "--over",
                     "time.period=1.0,2.0", "--runs", 12, "--estimators", "ekf,kalman", "--jobs", 1, "--out", "swept")
    assert done.code == 0, done.err
    table = pd.read_csv(railstate.folder / "swept" / "requirements.csv")
    keys = ["requirement", "channel.p", "time.period", "estimator"]
    met = {point: {"wide": "met", "none": "not met"}[str(point[0])] for point in itertools.product(
        ("wide", "none"), (0.3, 0.9), (1.0, 2.0), ("ekf", "kalman"))}
    assert table.set_index(keys)["verdict"].to_dict() == met
    lines = (railstate.folder / "swept" / "requirements.md").read_text().splitlines()
    grid = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("|")]
    assert grid[0] == ["requirement", "channel.p", "time.period", "ekf", "kalman"]
    assert len(grid) == 2 + 8 and all(
        row[3].startswith("✓ 100 %" if row[0] == "wide, 50 %" else "✗ 0 %") and "; P95 over runs: p95" in row[3]
        for row in grid[2:])
    assert "which estimator keeps what" in done.out
    assert railstate("report", "swept").code == 0
    [first] = re.findall('<table class="sortable" data-name="who keeps what">(.*?)</table>',
                         (railstate.folder / "swept" / "report.html").read_text(), re.S)
    page = [[re.sub("<[^>]+>", "", cell).replace("\u202f", " ").strip() for cell in re.findall(
        "<t[hd].*?</t[hd]>", line, re.S)] for line in re.findall("<tr>(.*?)</tr>", first, re.S)]
    assert page[0] == grid[0] and [row[:3] for row in page[1:]] == [row[:3] for row in grid[2:]]
    for row, line in zip(page[1:], grid[2:], strict=True):  # the same shares and sizes of errors in both
        assert [cell.replace(" ", "") for cell in row[3:]] == [
            cell.replace("; P95 over runs: ", "").replace("]", "]%").replace(" ", "") for cell in line[3:]]


def test_a_damaged_sweep_is_one_message(railstate: Command) -> None:
    Path("swept").mkdir()
    for text in ("{", "[]", '{"name": "a"}'):
        Path("swept/sweep.json").write_text(text)
        done = railstate("report", "swept")
        assert done.code == 2 and "sweep.json" in done.err and "Traceback" not in done.err


def test_a_parameter_that_is_not_estimated_has_no_numbers(railstate: Command) -> None:
    done = railstate("run", "braking-rate/paper", "--estimators", "kalman,kalman-known-f", "--runs", 3, "--out", "out")
    assert done.code == 0, done.err
    frame = Store("out").rows().set_index("estimator")
    assert set(frame["status"]) == {"ok"}
    assert frame.loc["kalman", "rmse:f:1"].isna().all() and (frame.loc["kalman-known-f", "rmse:f:1"] == 0).all()
    assert (frame.loc["kalman", "rmse:speed:m/s"] > 0).all()
    curves = Store("out").curves()
    assert set(curves.query("quantity == 'f'")["estimator"]) == {"kalman-known-f"}
    kept = Store("out").trajectories()
    assert kept is not None and set(kept.query("name == 'f'")["estimator"]) == {"kalman-known-f"}


def test_more_runs_and_estimators_go_where_the_first_went(railstate: Command) -> None:
    """Without --out: the folder is that of the scenario as it is; another truth gets another."""
    assert railstate("run", "cart.toml/calm", "--runs", 2, "--estimators", "ekf").code == 0
    assert railstate("run", "cart.toml/calm", "--runs", 3, "--estimators", "ekf,kalman").code == 0
    [folder] = Path("results").iterdir()
    assert len(Store(folder).rows()) == 6
    assert railstate("run", "cart.toml/calm", "--runs", 2, "--estimators", "ekf", "--seed", 2).code == 0
    Path("cart.toml").write_text(Path("cart.toml").read_text().replace("x0 = [0, 1]", "x0 = [0, 2]"))
    assert railstate("run", "cart.toml/calm", "--runs", 2, "--estimators", "ekf").code == 0
    assert len(list(Path("results").iterdir())) == 3


def test_a_loose_plug_in_runs_beside_the_scenario_s_own_without_being_asked_for(railstate: Command) -> None:
    Path("other.py").write_text(Path("half.py").read_text().partition("\n\nclass Raises")[0])
    Path("cart.toml").write_text(Path("cart.toml").read_text().replace(
        '[estimators.half]\nplugin = "half"', '[estimators.ekf]\nplugin = "ekf"'))
    done = railstate(*CART[:-2], "--plugin", "other.py", "--runs", 1, "--jobs", 1, "--out", "out")
    assert done.code == 0 and set(rows("out")["estimator"]) == {"ekf", "other"}
