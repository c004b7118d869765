"""`railstate tune`: the search on known functions, and the command on a short scenario."""

from __future__ import annotations

import math
import tomllib

import numpy as np
import pandas as pd
import pytest
from railstate.benchmarks.studies.search import Axis, parse_axis, search
from railstate.scenarios.errors import InputError

from ..recordings import tram


def test_one_number_is_found_to_a_tenth_of_a_percent_of_its_loss_in_thirty_evaluations():
    """A loss as an RMSE over a process noise has it: flat at the right place, steep at the left."""
    def loss(told):
        x = math.log(told["knowledge.sigma_w"] / 0.28)
        return 0.066 + 0.02 * (math.exp(-0.8 * x) - 1 + 0.8 * x)

    found = search([Axis(("knowledge.sigma_w",), 0.01, 1.0, "log")], loss, 30)
    assert found.loss < 0.066 * 1.001 and len(found.losses) <= 30 and not found.edge


def test_two_numbers_in_sixty_evaluations_with_a_corner_that_is_infeasible():
    def loss(told):
        a, b = math.log(told["parameters.a"] / 0.3), math.log((1 - told["parameters.b"]) / 0.02)
        return math.inf if a > 1.5 else 1.0 + 0.3 * (a - 0.5 * b) ** 2 + 0.05 * b**2

    found = search([Axis(("parameters.a",), 0.01, 10.0, "log"), Axis(("parameters.b",), 0.5, 0.999, "log1m")], loss, 60)
    assert found.loss < 1.002 and len(found.losses) <= 60


def test_choices_integers_ties_edges_and_a_budget():
    found = search([Axis(("parameters.kind",), scale="choice", choices=("a", "b", "c"))],
                   lambda told: {"a": 3.0, "b": 1.0, "c": 2.0}[told["parameters.kind"]], 30)
    assert found.values == {"parameters.kind": "b"} and len(found.losses) == 3
    found = search([Axis(("parameters.n",), 1, 20, "int")], lambda told: (told["parameters.n"] - 7) ** 2, 30)
    assert found.values == {"parameters.n": 7}
    found = search([Axis(("knowledge.p", "knowledge.q"), 0.0, 1.0)], lambda told: -told["knowledge.q"], 30)
    assert found.edge == ["knowledge.p+knowledge.q"] and found.values["knowledge.p"] == found.values["knowledge.q"]
    assert len(search([Axis(("parameters.x",))], lambda told: told["parameters.x"], 5).losses) == 5


@pytest.mark.parametrize(("text", "message"), [
    ("disturbance.w_bar=0.1..1", "not the truth"), ("sigma_w=0.1..1", "not the truth"),
    ("knowledge.sigma_w", "expected KEY=LOW..HIGH"), ("knowledge.sigma_w=0.1", "expected KEY=LOW..HIGH"),
    ("knowledge.sigma_w=1..0.1", "expected KEY=LOW..HIGH"), ("knowledge.sigma_w=0..1:log", "LOW above 0"),
    ("parameters.stay=0.5..1:log1m", "HIGH below 1"), ("knowledge.sigma_w=0.1..1:cubic", "expected KEY=LOW..HIGH")])
def test_what_cannot_be_searched_is_refused(text, message):
    with pytest.raises(InputError, match=message):
        parse_axis(text)


def test_the_command_tunes_on_runs_of_its_own_and_writes_an_entry(railstate):
    """The disturbance's level that is told half as large as it is: tuning finds more noise, and the table's runs agree
    within their Monte Carlo error."""
    words = ("tune", "ningbo-metro/white", "--estimator", "ekf-naive", "--over", "knowledge.sigma_w=0.01..1:log",
             "--objective", "rmse:speed", "--runs", 4, "--budget", 12, "--out", "tuned.toml", "--jobs", 1)
    found = railstate(*words)
    assert found.code == 0, found.err
    written = tomllib.loads((railstate.folder / "tuned.toml").read_text())
    entry = written["estimators"]["ekf-naive-tuned"]
    assert entry["plugin"] == "ekf" and 0.04 < entry["knowledge"]["sigma_w"] < 0.3
    origin = written["origin"]["estimators.ekf-naive-tuned"]
    assert origin.startswith("tuned: railstate tune ningbo-metro/white") and "12 evaluations" in origin
    assert "train" in found.out and "test" in found.out
    again = railstate(*words)
    assert again.out == found.out
    for wrong, message in (
            (("--objective", "rmse:height"), "--objective rmse:height"), (("--estimator", "none"), "none"),
            (("--objective", "nees:state"), "a constraint, never an objective alone"),
            (("--budget", 2), "--budget 2")):
        bad = list(words)
        for flag, value in (wrong,):
            bad[bad.index(flag) + 1] = value
        refused = railstate(*bad)
        assert refused.code == 2 and message in refused.err
    assert np.isfinite(entry["knowledge"]["sigma_w"])


def test_a_recorded_trip_is_tuned_on_by_likelihood_and_another_is_shown(railstate):
    """No truth is needed: `inspect` writes the scenario, two trips are split, and what is said of the other trip is
    what a run on it says."""
    for seed in (1, 2):
        tram(seed).drop(columns=["s_ref_m", "v_ref_mps"]).to_csv(f"trip{seed}.csv", index=False)
    assert railstate("inspect", "trip1.csv", "--out", "trip.toml").code == 0
    words = ("tune", "trip.toml/as-recorded", "--estimator", "ekf", "--over", "knowledge.density=0.01..10:log",
             "--objective", "log-likelihood:innovation", "--runs", 1, "--budget", 6, "--jobs", 1,
             "--out", "tuned.toml", "--set", 'plant.recording=["trip1.csv", "trip2.csv"]', "--set", "plant.split=1")
    found = railstate(*words)
    assert found.code == 0 and "train: the trips on which was searched; test: the others." in found.out, found.err
    written = tomllib.loads((railstate.folder / "tuned.toml").read_text())
    density = written["estimators"]["ekf-tuned"]["knowledge"]["density"]
    lines = {row[0]: [float(value) for value in row[1:]] for row in map(str.split, found.out.splitlines())
             if row and row[0] in ("tuned", "untuned") and len(row) == 3}
    assert lines["tuned"][0] > lines["untuned"][0] and lines["tuned"][1] > lines["untuned"][1]
    for trip in (1, 2):
        done = railstate("run", "trip.toml/as-recorded", "--recording", f"trip{trip}.csv", "--estimators", "ekf",
                         "--set", f"estimators.ekf.knowledge.density={density}", "--runs", 1, "--jobs", 1, "--out",
                         f"out{trip}")
        assert done.code == 0, done.err
        row = pd.concat(pd.read_parquet(path) for path in (railstate.folder / f"out{trip}" / "rows").iterdir()).iloc[0]
        assert row["log-likelihood:innovation:1"] == pytest.approx(lines["tuned"][trip - 1], rel=1e-4)
    refused = railstate(*words[:-1], "plant.split=2")
    assert refused.code == 2 and "split = 2 leaves none of the 2 recordings" in refused.err
