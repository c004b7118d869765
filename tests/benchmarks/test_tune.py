"""`railstate tune`: the search on known functions, and the command on a short scenario."""

from __future__ import annotations

import json
import math
import re
import signal
import time
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from railstate.benchmarks.planning.catalogue import Catalogue
from railstate.benchmarks.planning.naming import find_one
from railstate.benchmarks.running.runner import Machinery
from railstate.benchmarks.studies.deadline import Overdue, within
from railstate.benchmarks.studies.entries import put
from railstate.benchmarks.studies.search import Axis, parse_axis, parse_constraint, search
from railstate.benchmarks.studies.tune import Scored, Task, Tuned, tune
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


def test_every_evaluation_of_a_search(expected):
    """Whole, with fewer evaluations than an optimiser would end with: each scale of an axis, with what breaks a
    constraint, what is infeasible, and ties."""
    def bowl(told):
        return sum((float(value) - 0.37) ** 2 for value in told.values())

    def limited(told):
        return math.inf if max(told.values()) > 0.9 else bowl(told), 0.5 - min(told.values())

    x, y, n = Axis(("parameters.x",), 0.1, 2.0, "log"), Axis(("parameters.y",), 0.2, 0.99, "log1m"), "parameters.n"
    out = []
    for axes, loss, budget in (
            ([x], bowl, 14), ([y], bowl, 6), ([Axis((n,), 1, 9, "int")], bowl, 12), ([x, y], bowl, 22),
            ([Axis((n,), scale="choice", choices=(1, 2, 0.5))], bowl, 30), ([x, y], limited, 24),
            ([Axis(("a.b", "a.c"))], limited, 13)):
        found = search(axes, loss, budget)
        out += [f"{budget} {found.values} {found.loss:.8e} {found.edge}",
                *(f"  {[axis.at(place) for axis, place in zip(axes, places, strict=True)]} {value:.8e} {broken:.8e}"
                  for places, value, broken in zip(found.places, found.losses, found.broken, strict=True))]
    expected("search", "\n".join(out))


def whole(found):
    """What a command says and writes, without its times, its day and the machine."""
    told = json.loads(Path("tuned.json").read_text()) if Path("tuned.json").exists() else {"evaluations": []}
    for name in ("started", "finished", "environment", "limit"):
        told.pop(name, None)
    evaluations = [{**one, "seconds": 0.0} for one in told.pop("evaluations")]
    text = "\n".join([found.out, found.err, *(f"{name}: {json.dumps(value)}" for name, value in told.items()),
                      *map(json.dumps, evaluations)])
    return re.sub(r", \d{4}-\d\d-\d\d;", ", DATE;", text)


def test_the_command_tunes_on_runs_of_its_own_and_writes_an_entry(railstate, expected):
    """The disturbance's level that is told half as large as it is: tuning finds more noise, and the table's runs agree
    within their Monte Carlo error."""
    words = ("tune", "ningbo-metro/white", "--estimator", "ekf-naive", "--over", "knowledge.sigma_w=0.01..1:log",
             "--objective", "rmse:speed", "--runs", 4, "--budget", 12, "--out", "tuned.toml", "--jobs", 1)
    found = railstate(*words)
    assert found.code == 0, found.err
    expected("tune", whole(found))
    written = tomllib.loads((railstate.folder / "tuned.toml").read_text())
    entry = written["estimators"]["ekf-naive-tuned"]
    assert entry["plugin"] == "ekf" and 0.04 < entry["knowledge"]["sigma_w"] < 0.3
    origin = written["origin"]["estimators.ekf-naive-tuned"]
    assert origin.startswith("tuned: railstate tune ningbo-metro/white") and "12 evaluations" in origin
    told, lines = json.loads((railstate.folder / "tuned.json").read_text()), found.out.splitlines()
    both = ("train", "test")
    for which in ("untuned", "tuned"):
        sides = [[told[side][which][name][0] for name in ("objective", "standard_errors")] for side in both]
        words_of = next(line for line in lines if line.startswith(f"{which} "))
        assert " ".join(words_of.split()) == " ".join([which, *(f"{v:.5g} ± {1.96 * sd:.2g}" for v, sd in sides)])
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


def test_what_is_not_said_is_the_usual(railstate):
    refused = railstate("tune", "nowhere", "--estimator", "ekf", "--over", "knowledge.p=0..1", "--objective", "rmse:x")
    assert refused.code == 2 and refused.err.startswith("error: nowhere: "), refused.err


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


def test_what_breaks_a_constraint_ranks_behind_what_keeps_it_and_before_what_is_infeasible():
    """The least loss lies where the constraint is broken: the search comes to its edge; one that nothing keeps says by
    how little it is broken."""
    def loss(told):
        x = told["knowledge.x"]
        return (math.inf, 0.0) if x > 0.9 else (x, 0.4 - x)

    found = search([Axis(("knowledge.x",))], loss, 30)
    assert 0.4 <= found.values["knowledge.x"] < 0.402 and found.broken[found.losses.index(found.loss)] <= 0
    found = search([Axis(("knowledge.x",))], lambda told: (told["knowledge.x"], 2.0 - told["knowledge.x"]), 12)
    assert found.values == {"knowledge.x": 1.0} and min(found.broken) == 1.0
    two = [Axis(("knowledge.x",)), Axis(("knowledge.y",))]
    found = search(two, lambda told: ((told["knowledge.x"] - 0.3)**2 + (told["knowledge.y"] - 0.7)**2,
                                      0.5 - told["knowledge.x"]), 60)
    assert found.loss < 0.0405 and found.values["knowledge.x"] >= 0.5


def test_constraints_as_words_and_what_they_keep():
    one = parse_constraint("nees:state=0.8..1.25")
    assert one.broken(1.0) < 0 and one.broken(0.4) == pytest.approx(0.5) and one.broken(2.5) == pytest.approx(1.0)
    assert one.broken(math.nan) == math.inf and parse_constraint("coverage:ellipsoid=0.99..").high == math.inf
    for text in ("nees=0.8..1", "nees:state", "nees:state=1", "nees:state=2..1", "nees:state=1..2:log"):
        with pytest.raises(InputError, match="METRIC:QUANTITY=LOW"):
            parse_constraint(text)


def test_single_elements_of_lists_and_what_is_none():
    entry = {"plugin": "ekf", "parameters": {"a": [1, 2]}}
    put(entry, "knowledge.v_bar.1", 0.5, {"knowledge": {"v_bar": [1.0, 0.2]}})
    put(entry, "parameters.a.0", 9, {})
    assert entry["knowledge"] == {"v_bar": [1.0, 0.5]} and entry["parameters"] == {"a": [9, 2]}
    for key, message in (("knowledge.v_bar.2", "there are 2 elements"), ("knowledge.kappa.0", "is no list here"),
                         ("parameters.a.b", "is no table")):
        with pytest.raises(InputError, match=message):
            put(entry, key, 1.0, {"knowledge": {"v_bar": [1.0, 0.2], "kappa": None}})


def test_values_have_the_digits_that_are_written_down():
    axis = Axis(("knowledge.x",), 1e-3, 1.0, "log")
    assert axis.at(0.123456) == float(f"{axis.at(0.123456):.6g}")
    assert 1 - Axis(("parameters.stay",), 0.5, 0.999, "log1m").at(1.0) == pytest.approx(0.001)


SLOW = '''
from time import sleep

import numpy as np
from railstate.estimators.interface import Estimate, Estimator, Parameters
from pydantic import Field


class Slow(Estimator):
    """A share of the way to the reading; sleeps where it is told so."""

    summary = "a share of the way to the reading"

    class Parameters(Parameters):
        share: float = Field(0.1, ge=0, le=1, description="share")
        sleepy: float = Field(2.0, description="shares over it sleep")

    def start(self, model, runs, random):
        super().start(model, runs, random)
        self.x = model.initial_mean.copy()

    def predict(self, u, interval):
        if self.parameters.share > self.parameters.sleepy:
            sleep(0.5)
        self.x = self.model.transition(self.x, u, interval)

    def update(self, measurement):
        innovation = np.where(measurement.received, measurement.y / 1.66 - self.x, 0.0)
        self.x = self.x + self.parameters.share * innovation

    def estimate(self):
        return Estimate(self.x)
'''


def test_a_loose_plugin_is_tuned_and_what_takes_too_long_counts_as_lost(railstate, expected):
    """The slow end of the axis is given up after three seconds; the manifest says so of each evaluation."""
    (railstate.folder / "slow.py").write_text(SLOW)
    found = railstate("tune", "rap-example-2/corrected", "--estimator", "slow", "--plugin", "slow.py", "--set",
                      "time.steps=40", "--over", "parameters.share=0..1", "--objective", "rmse:x1", "--runs", 2,
                      "--set", 'estimators.slow={plugin="slow", parameters={sleepy=0.95}}', "--budget", 9, "--limit", 3,
                      "--jobs", 1, "--beside", "random-access-conditional", "--out", "tuned.toml")
    assert found.code == 0, found.err
    expected("tune-loose", whole(found))
    told = json.loads((railstate.folder / "tuned.json").read_text())
    over = [one["values"]["parameters.share"] > 0.95 for one in told["evaluations"]]
    assert [bool(one.get("over")) for one in told["evaluations"]] == over and any(over)
    assert told["budget"] == 9 and len(told["evaluations"]) == 9 and told["limit"] == 3
    assert told["command"].startswith("railstate tune rap-example-2/corrected") and told["entry"]["tuned"]
    best = min(one["loss"] for one in told["evaluations"] if one["loss"] is not None)
    assert told["train"]["tuned"]["loss"] == best


def test_a_constraint_on_the_command_line_and_an_optimum_at_a_limit_are_said(railstate, expected):
    """The filter that is told too little noise is too sure wherever the search may go."""
    words = ("tune", "rap-example-2/corrected", "--estimator", "random-access-conditional", "--over",
             "knowledge.R=0.1..0.2:log", "--objective", "rmse:x1", "--runs", 8, "--budget", 4, "--jobs", 1)
    found = railstate(*words)
    assert found.code == 0, found.err
    expected("tune-limit", whole(found))
    refused = railstate(*words, "--subject-to", "nees:state=0.9..1.1")
    assert refused.code == 2 and "--subject-to: none of 4 evaluations" in refused.err
    refused = railstate(*words, "--subject-to", "nees:height=0.9..1.1")
    assert refused.code == 2 and "--subject-to nees:height" in refused.err and "nees:state" in refused.err
    refused = railstate(*words[:7], "log-likelihood:innovation,rmse:x1", *words[8:])
    assert refused.code == 2 and "take it alone" in refused.err


@pytest.mark.long
@pytest.mark.parametrize(("estimator", "over", "objective", "levels", "evaluations", "within"), [
    ("ekf", "knowledge.sigma_w=0.01..1:log", "rmse:speed", (200,), 30, 1e-3),
    ("robust-mean-square", "knowledge.w_bar=0.02..1:log,knowledge.sigma_v.1=0.02..1:log", "rmse:position,rmse:speed",
     (9, 9, 5), 60, 2e-3)])
def test_few_evaluations_come_as_near_as_a_grid_of_hundreds(estimator, over, objective, levels, evaluations, within,
                                                            capsys):
    """On ningbo-metro/switching, the same 40 runs for search and grid: the loss within .1 % (two numbers: .2 %) of the
    best of a grid of 200 (of lattices, each around the best of the one before, the last with 65 places an axis); and
    on the table's runs within its Monte Carlo error, a fixed entry's own gap off."""
    scenario, variant = find_one("ningbo-metro/switching")
    aims = tuple((metric, quantity) for metric, _, quantity in (part.partition(":") for part in objective.split(",")))
    task = Task(scenario, "ningbo-metro", variant, estimator, {}, aims, 40, 1, Machinery(jobs=1), Catalogue())
    axes = [parse_axis(part) for part in over.split(",")]
    tuned = tune(task, axes, evaluations)
    told = {"knowledge": {"sigma_v": scenario.setting(variant).resolve_knowledge({}).sigma_v}}

    def loss(places):
        entry = task.entry(estimator)
        for axis, place in zip(axes, places, strict=True):
            put(entry, axis.keys[0], axis.at(place), told)
        return task.score(entry, training=True).loss

    low, high, found = np.zeros(len(axes)), np.ones(len(axes)), {}
    for n in levels:
        lattice = [np.linspace(a, b, n) for a, b in zip(low, high, strict=True)]
        for places in map(tuple, np.stack(np.meshgrid(*lattice), axis=-1).reshape(-1, len(axes))):
            if places not in found:
                found[places] = loss(places)
        best, cell = np.array(min(found, key=found.get)), (high - low) / (n - 1)
        low, high = np.maximum(best - cell, 0), np.minimum(best + cell, 1)
    best, (added, error) = min(found.values()), tuned.added()
    with capsys.disabled():
        print(f"\n{estimator}: {len(tuned.found.losses)} evaluations, loss {tuned.found.loss:.6g}, the grid's "
              f"{best:.6g} of {len(found)}: {tuned.found.loss / best - 1:+.3%}; tuning adds {added:+.2%} ± {error:.2%}")
    assert len(tuned.found.losses) <= evaluations and not tuned.found.edge
    assert tuned.found.loss <= best * (1 + within)
    assert abs(added) < 1.96 * error and error < 0.02


@pytest.mark.skipif(not hasattr(signal, "SIGALRM"), reason="there is no such signal here")
def test_a_deadline_ends_what_takes_too_long_and_nothing_else():
    before, begun = signal.getsignal(signal.SIGALRM), time.monotonic()
    with pytest.raises(Overdue), within(0.02):
        time.sleep(20)
    assert time.monotonic() - begun < 10
    with within(0.02):
        pass
    time.sleep(0.03)
    assert signal.getsignal(signal.SIGALRM) is before


def test_the_gap_between_training_and_test_with_its_error():
    """The runs of both are independent; what tuning adds is of the same runs, where what both share cancels."""
    def scored(loss, *pulls):
        return Scored(loss, (loss,), (0.0,), np.array(pulls))

    train = {"tuned": scored(1.0, -0.1, 0.1, 0.0), "untuned": scored(2.0, -0.1, 0.1, 0.0)}
    test = {"tuned": scored(1.2, 0.3, -0.3), "untuned": scored(2.1, 0.4, -0.4)}
    tuned = Tuned({}, None, train, test, [], 0.0, False)
    sides = [np.std([-0.1, 0.1, 0.0], ddof=1) / np.sqrt(3), np.std([0.3, -0.3], ddof=1) / np.sqrt(2)]
    assert tuned.gap("tuned") == pytest.approx((0.2, 1.2 * math.hypot(*sides)))
    assert tuned.gap("untuned")[0] == pytest.approx(0.05)
    assert tuned.added() == pytest.approx((0.15, 1.2 * np.std([-0.1, 0.1], ddof=1) / np.sqrt(2)))
    one = Tuned({}, None, {"tuned": scored(0.0, 0.0)}, {"tuned": scored(1.0, 0.0)}, [], 0.0, False)
    assert np.isnan(one.gap("tuned")).all()
