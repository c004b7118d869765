"""What a plug-in does wrong costs its own rows only: it raises, dies, hangs, or returns what is no estimate."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from ..conftest import Command
from .test_run import CART, rows, same


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
    of_file = railstate("replay", "cart.toml/rough/half/6", "--plugin", "half.py")
    assert of_file.out.splitlines()[1:] == fine.out.splitlines()[1:-1]


def test_runs_without_a_scored_step_are_rows(railstate: Command) -> None:
    done = railstate(*CART, "--estimators", "blank,half", "--runs", 3, "--out", "out")
    assert done.code == 0, done.err
    assert rows("out").groupby("estimator")["status"].unique().map(list).to_dict() == {
        "blank": ["diverged"], "half": ["ok"]}
    refused = railstate(*CART, "--set", "score.skip=40")
    assert refused.code == 2 and "score.skip = 40 s leaves nothing" in refused.err


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
