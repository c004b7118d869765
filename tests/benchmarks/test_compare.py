"""`railstate compare`: known differences are found and nothing else, whoever is A; two folders tell what changed."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from railstate.benchmarks.judging.comparison import between_estimators, between_folders
from railstate.benchmarks.store.folder import Store
from railstate.scenarios.files import load
from railstate.scenarios.randomness import Streams

from ..conftest import Command

PLUGIN = '''
import numpy as np
from railstate.estimators.interface import Estimate
from railstate.estimators.kalman import Kalman


class Shifted(Kalman):
    """The Kalman filter with its position moved by draws of its own: worse by a known amount."""
    size = 0.5

    def start(self, model, runs, random):
        super().start(model, runs, random)
        self.shift = np.stack([self.size * random.normal(), np.zeros(runs)])

    def estimate(self):
        return Estimate(self._mean + self.shift)


class Trembling(Shifted):
    """So little that it is a tie."""
    size = 1e-3


class Twin(Kalman):
    """The same numbers under another name."""


class Faint(Kalman):
    """Loses the runs with odd numbers."""

    def start(self, model, runs, random):
        super().start(model, runs, random)
        self.odd = np.array(random.runs) % 2 == 1

    def estimate(self):
        return Estimate(np.where(self.odd, np.nan, self._mean))
'''
RUNS = 60
WITH = ("--scenario", "cart.toml/calm", "--plugin", "others.py", "--runs", RUNS, "--jobs", 1)


@pytest.fixture
def others(railstate: Command) -> Command:
    (railstate.folder / "others.py").write_text(PLUGIN)
    return railstate


def test_a_worse_estimator_is_told_and_by_how_much(others: Command) -> None:
    done = others("compare", "kalman", "shifted", *WITH, "--out", "out", "--fail-on", "worse")
    assert done.code == 1, done.err
    assert "cart/calm: position rmse: shifted is worse than kalman, +" in done.out
    assert "shifted against kalman: better in 0, worse in 1, tie in 1, undecided in 0 of 2 comparisons" in done.out
    assert re.search(r"cart/calm: shifted is ([\d.]+ times (slower|faster) than|as fast as) kalman", done.out)
    store = Store("out")
    found = {item.b["quantity"]: item
             for item in between_estimators(store.rows(), store.manifest(), "kalman", "shifted")}
    rows = store.rows().set_index(["estimator", "run"])["rmse:position:m"]
    position = found["position"].b
    assert position["ratio"] == pytest.approx(np.sqrt((rows["shifted"]**2).mean() / (rows["kalman"]**2).mean()))
    assert 1 < position["ratio_low"] < position["ratio"] < position["ratio_high"]
    assert position["won"] == (rows["shifted"] < rows["kalman"]).mean() < 0.5
    assert found["speed"].verdict == "tie" and found["speed"].b["ratio"] == 1


def test_a_limit_is_exceeded_where_the_whole_interval_lies_beyond_it(others: Command) -> None:
    ask = ("compare", "kalman", "shifted", *WITH, "--out", "out")
    done = others(*ask, "--fail-on", "rmse:position>5%", "--json")
    told = json.loads(done.out)
    position = next(each for each in told["comparisons"] if each["b"]["quantity"] == "position")
    assert done.code == 1 and position["b"]["ratio_low"] > 1.05 and position["verdict"] == "worse"
    assert told["failed"][0].startswith("cart/calm: position rmse: shifted is worse than kalman")
    beyond = 100 * (position["b"]["ratio_low"] - 1) + 1  # the ratio is larger, its interval is not
    done = others(*ask, "--fail-on", f"rmse:position>{beyond:.2f}%,rmse:speed>5 %", "--quiet")
    assert done.code == 0 and done.out == ""
    done = others(*ask, "--fail-on", "rmse:height>5%")
    assert done.code == 2 and "not among what is compared: rmse:position, rmse:speed" in done.err
    done = others(*ask, "--fail-on", "much")
    assert done.code == 2 and "expected worse, different, or METRIC:QUANTITY>PERCENT%" in done.err


def test_the_other_way_round_it_is_better(others: Command) -> None:
    done = others("compare", "shifted", "kalman", *WITH, "--fail-on", "worse")
    assert done.code == 0
    assert "position rmse: kalman is better than shifted, −" in done.out


@pytest.mark.parametrize("other", ["trembling", "twin"])
def test_what_is_no_difference_is_a_tie(others: Command, other: str) -> None:
    done = others("compare", "kalman", other, *WITH, "--fail-on", "worse")
    assert done.code == 0
    assert f"{other} against kalman: better in 0, worse in 0, tie in 2, undecided in 0 of 2 comparisons" in done.out


def test_runs_that_are_lost_count(others: Command) -> None:
    done = others("compare", "kalman", "faint", *WITH, "--fail-on", "worse", "--out", "out")
    assert done.code == 1
    assert "faint ends well in 50 % of the runs, kalman in 100 %" in done.out
    store = Store("out")
    *others_found, lost = between_estimators(store.rows(), store.manifest(), "kalman", "faint")
    assert lost.lost and (lost.verdict, lost.b["lost"], lost.b["runs"]) == ("worse", RUNS // 2, RUNS)
    # a lost run is as large as the largest error of either: worse, although equal in every run that both finished
    assert all(item.verdict == "worse" and item.b["runs"] == RUNS // 2 for item in others_found)


def test_a_scenario_is_found_for_two_plug_ins(others: Command) -> None:
    done = others("compare", "random-access", "random-access-conditional", "--runs", 3, "--jobs", 1)
    assert done.code == 0 and "rap-example-1/corrected: x1 rmse" in done.out and "rap-example-2/corrected" in done.out
    done = others("compare", "kalman", "twin", "--plugin", "others.py", "--runs", 3, "--jobs", 1)
    assert done.code == 0 and "undecided in 3 of 3" in done.out


@pytest.mark.parametrize(("words", "message"), [
    (("kalman", "kalman"), "cannot be compared with itself"),
    (("kalman", "nobody"), "no built-in scenario knows both kalman and nobody"),
    (("kalman", "nobody", "--scenario", "cart.toml"), "no such estimator"),
    (("kalman", "half", "--fail-on", "different"), "is for two results folders"),
])
def test_one_message_for_what_cannot_be(others: Command, words: tuple[str, ...], message: str) -> None:
    done = others("compare", *words)
    assert done.code == 2 and message in done.err and len(done.err.splitlines()) == 1


def test_the_same_run_twice_is_identical_to_the_bit(others: Command) -> None:
    for folder in ("one", "two"):
        others("run", "cart.toml", "--plugin", "half.py", "--estimators", "half", "--runs", 6, "--jobs", 1, "--out",
               folder)
    done = others("compare", "one", "two", "--fail-on", "different")
    assert done.code == 0, done.out
    assert "12 of 12 common rows bit-identical" in done.out and "worse" not in done.out


def test_runs_that_end_at_different_times_are_identical_in_any_batch(railstate: Command) -> None:
    for batch in (1, 5):
        railstate("run", "ningbo-metro/white", "--estimators", "ekf,ckf", "--runs", 5, "--batch", batch, "--jobs", 1,
                  "--out", f"of-{batch}")
    done = railstate("compare", "of-1", "of-5", "--fail-on", "different")
    assert done.code == 0 and "10 of 10 common rows bit-identical" in done.out, done.out
    rows = Store("of-5").rows()
    scenario = load("ningbo-metro")
    under_way = scenario.setting("white").world(Streams(1, "ningbo-metro", "white", range(5))).active.sum(axis=0)
    assert len(set(under_way)) > 1
    for _, part in rows.sort_values("run").groupby("estimator"):
        assert part["steps"].tolist() == under_way.tolist()


def test_what_changed_between_two_folders(others: Command) -> None:
    half = (others.folder / "half.py").read_text()
    run = ("run", "cart.toml/calm", "--plugin", "half.py", "--estimators", "half,kalman", "--jobs", 1)
    others(*run, "--runs", 30, "--out", "before")
    (others.folder / "later").mkdir()
    (others.folder / "later" / "half.py").write_text(half.replace("0.5 * innovation", "0.05 * innovation"))
    others("run", "cart.toml/calm", "--plugin", "later/half.py", "--estimators", "half,kalman", "--jobs", 1, "--runs",
           40, "--out", "after")
    done = others("compare", "before", "after", "--fail-on", "worse")
    assert done.code == 1
    assert "cart/calm/half: source changed" in done.out and "runs: 30 -> 40" in done.out
    assert "30 of 60 common rows bit-identical; 0 only in before, 20 only in after" in done.out
    assert "cart/calm/half: position rmse: after is worse than before, 2." in done.out
    changes = between_folders(Store("before"), Store("after"))
    assert {(item.label, item.common, item.identical, item.only_b) for item in changes.alike} == {
        ("half", 30, 0, 10), ("kalman", 30, 30, 10)}
    assert {item.label for item in changes.found} == {"half"}
    assert others("compare", "after", "before", "--fail-on", "worse").code == 0
    assert others("compare", "after", "before", "--fail-on", "different").code == 1


def test_one_changed_bit_is_seen(others: Command) -> None:
    run = ("run", "cart.toml/calm", "--plugin", "half.py", "--estimators", "half")
    others(*run, "--runs", 5, "--jobs", 1, "--out", "one")
    shutil.copytree("one", "two")
    part = next(Path("two/rows").glob("*.parquet"))
    frame = pd.read_parquet(part)
    frame.loc[0, "mae:speed:m/s"] = np.nextafter(frame.loc[0, "mae:speed:m/s"], 1.0)
    pq.write_table(pq.read_table(part).set_column(
        frame.columns.get_loc("mae:speed:m/s"), "mae:speed:m/s", [frame["mae:speed:m/s"].to_numpy()]), part)
    done = others("compare", "one", "two", "--fail-on", "different")
    assert done.code == 1 and "4 of 5 common rows bit-identical" in done.out


def test_other_truths_are_not_paired(others: Command) -> None:
    run = ("run", "cart.toml/calm", "--plugin", "half.py", "--estimators", "half", "--runs", 4, "--jobs", 1)
    others(*run, "--out", "one")
    others(*run, "--out", "seed", "--seed", 2)
    others(*run, "--out", "noise", "--set", "plant.R=[[4]]")
    done = others("compare", "one", "seed")
    assert "the seed changed: these are not the same runs, nothing is compared" in done.out
    assert "seed: 1 -> 2" in done.out
    done = others("compare", "one", "noise")
    assert "[plant] of the scenario changed: these are not the same runs" in done.out
    assert "0 of 4 common rows bit-identical" in done.out and "rmse" not in done.out
    refused = others("compare", "one", "half")
    assert refused.code == 2 and "half: not a results folder" in refused.err
