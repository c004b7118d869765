"""`railstate run`: files written, reproducibility to the last bit, resumption."""

from __future__ import annotations

import json
import os
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
    assert (timing["samples"] >= 200).all()
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


def test_rows_depend_on_no_machinery_no_neighbour_and_no_number_of_runs(railstate: Command) -> None:
    words = (*CART, "--estimators", "half,slow,kalman", "--runs", 12)
    assert railstate(*words, "--jobs", 1, "--out", "one").code == 0
    one = rows("one")
    for number, more in enumerate((("--jobs", 2), ("--batch", 5), ("--batch", 1000), ("--jobs", 2, "--batch", 5))):
        assert railstate(*words, *more, "--out", f"out{number}").code == 0
        same(one, rows(f"out{number}"))
    for number, labels in enumerate(("half", "kalman,half")):
        railstate(*CART, "--estimators", labels, "--runs", 5, "--jobs", 1, "--out", f"few{number}")
        part = one[(one["run"] < 5) & one["estimator"].isin(labels.split(","))].reset_index(drop=True)
        same(rows(f"few{number}"), part)


def test_another_seed_is_another_truth(railstate: Command) -> None:
    railstate(*CART, "--estimators", "half", "--runs", 3, "--out", "one")
    railstate(*CART, "--estimators", "half", "--runs", 3, "--out", "two", "--seed", 2)
    assert not np.isclose(rows("one")["rmse:position:m"], rows("two")["rmse:position:m"]).any()


def test_a_run_killed_and_then_interrupted_resumes_to_the_same_rows(railstate: Command) -> None:
    words = [*CART, "--estimators", "slow,half", "--runs", "8", "--batch", "2", "--jobs", "1"]
    railstate(*words, "--out", "whole")
    program = [sys.executable, "-c", "from railstate.benchmarks.cli import main; main()"]
    for act, code, parts in ((signal.SIGKILL, -signal.SIGKILL, 2), (signal.SIGINT, 130, 5)):
        process = subprocess.Popen(  # a shell has what it starts in the background ignore the signal
            [*program, *words, "--out", "cut"], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL))
        deadline = time.monotonic() + 60
        while len(list(Path("cut/rows").glob("*.parquet"))) < parts:
            assert time.monotonic() < deadline and process.poll() is None
            time.sleep(0.02)
        os.kill(process.pid, act)
        err = process.communicate(timeout=60)[1]
        assert process.returncode == code and "Traceback" not in err
        assert 0 < len(rows("cut")) < len(rows("whole"))
    assert "interrupted" in err and "continues" in err
    again = railstate(*words, "--out", "cut")
    assert again.code == 0, again.err
    same(rows("whole"), rows("cut"))


def test_another_configuration_is_refused(railstate: Command) -> None:
    railstate(*CART, "--estimators", "half", "--runs", 4, "--out", "out")
    before = rows("out")
    refused = railstate(*CART, "--estimators", "half", "--runs", 4, "--out", "out", "--seed", 7)
    assert refused.code == 2 and "seed: 1 -> 7" in refused.err
    refused = railstate(*CART, "--estimators", "half", "--runs", 4, "--out", "out", "--set", "plant.R=[[4]]")
    assert refused.code == 2 and "scenario" in refused.err
    same(before, rows("out"))


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


def test_no_scheduler_is_one_message(railstate: Command) -> None:
    done = railstate(*CART, "--backend", "dask", "--runs", 2)
    assert done.code == 2 and "--scheduler" in done.err


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
