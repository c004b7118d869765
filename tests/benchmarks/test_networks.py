"""Protocols against each other at the same load, late packets dropped, taken as new and rewound: the built-in variants.

Numbers are those of an independent program, of as many runs."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from railstate.benchmarks.judging.table import verdicts_of
from railstate.benchmarks.planning.plan import make_plan
from railstate.benchmarks.running.execute import execute
from railstate.benchmarks.store.folder import Store
from railstate.estimators.registry import estimators
from railstate.scenarios.files import load
from railstate.scenarios.measurement import Interval, Measurement
from railstate.scenarios.randomness import Streams

from ..conftest import Command

PROTOCOLS = {f"protocol-{name}" for name in ("round-robin", "random-access", "try-once-discard", "markov", "bernoulli")}


def rows(name: str, labels: tuple[str, ...], runs: int) -> pd.DataFrame:
    plan = make_plan([name], only=labels)
    return pd.concat([execute(plan.task(cell, tuple(cell.entries), tuple(range(runs)))).rows.to_pandas()
                      for cell in plan.cells])


def near(frame: pd.DataFrame, label: str, wanted: float, quantity: str = "rmse:position:m") -> None:
    """Within 5 %, or within the Monte Carlo error of both programs."""
    squares = frame.loc[frame["estimator"] == label, quantity].to_numpy() ** 2
    found = np.sqrt(squares.mean())
    error = squares.std(ddof=1) / np.sqrt(len(squares)) / 2 / found
    assert abs(found - wanted) < max(0.05 * wanted, 2 * np.sqrt(2) * error), (label, found, error)


@pytest.mark.parametrize(("scenario", "share", "only"), [
    ("cbtc-csma", 1 / 6, "direct,kalman,ultimate-bound-published"), ("rap-example-1", 1 / 2, "")])
def test_protocols_run_at_the_same_load(scenario: str, share: float, only: str, railstate: Command) -> None:
    done = railstate("run", f"{scenario}/protocol-*", "--runs", 2, "--set", "time.steps=60", "--estimators", only,
                     "--jobs", 1, "--out", "out")
    assert done.code == 0
    store = Store("out")
    assert set(store.rows()["variant"]) == PROTOCOLS
    assert set(store.rows()["status"]) == {"ok"}
    lines = verdicts_of(store)
    doubted = lines[lines["verdict"] == "not certified"]
    spoiled = doubted[doubted["variant"] == "protocol-try-once-discard"]
    assert "kalman" in set(spoiled["estimator"]) and "kalman" not in set(
        doubted.loc[doubted["variant"] != "protocol-try-once-discard", "estimator"])
    found = load(scenario)
    for variant in sorted(PROTOCOLS):
        world = found.setting(variant).world(Streams(1, scenario, variant, tuple(range(20))))
        each = world.received[:300].mean(axis=(0, 1))
        assert abs(each.mean() - share) < 1e-12 + 4 * each.std() / np.sqrt(len(each))


def test_a_pattern_that_no_variant_has(railstate: Command) -> None:
    done = railstate("run", "cbtc-csma/protokol-*")
    assert done.code == 2 and "cbtc-csma/protokol-*: there is no such variant; allowed: uniform, " in done.err


@pytest.mark.parametrize(("variant", "ratio"), [("protocol-try-once-discard", 0.855), ("protocol-round-robin", 1.0)])
def test_mean_square_over_the_claim(variant: str, ratio: float) -> None:
    """Try-once-discard picks nodes for their noise too: the filter's covariance is no longer its error's."""
    streams = Streams(1, "rap-example-1", variant, tuple(range(200)))
    setting = load("rap-example-1").setting(variant)
    world = setting.world(streams)
    model, estimator = setting.design_model({}, world.initial_mean), estimators()["kalman"]({})
    estimator.start(model, 200, streams("estimator"))
    errors, claims = np.zeros(200), np.zeros(200)
    for k in range(300):
        step = world.step(k, world.initial_mean)
        estimator.predict(step.u, Interval(step.number, step.start, step.length))
        estimator.update(Measurement(step.events[0].y, step.events[0].received, step.number))
        errors += ((estimator.estimate().mean - world.truth[k]) ** 2).sum(axis=0)
        claims += np.trace(estimator.estimate().covariance)
    each = errors / claims.mean()
    assert abs(each.mean() - ratio) < 4 * each.std() / np.sqrt(200)


@pytest.mark.parametrize(("variant", "as_new", "drop", "rewind"), [
    ("late", 3.60, 6.06, 0.0686), ("late-random", 10.8, 6.06, 0.0739)])
def test_late_packets_of_the_metro(variant: str, as_new: float, drop: float, rewind: float) -> None:
    frame = rows(f"ningbo-metro/{variant}", ("ekf", "ekf-as-new", "ekf-rewind"), 100)
    for label, wanted in (("ekf-as-new", as_new), ("ekf", drop), ("ekf-rewind", rewind)):
        near(frame, label, wanted)


def test_late_packets_of_example_1() -> None:
    """Here dead reckoning is the worst: the order of dropping and taking as new is the plant's."""
    frame = rows("rap-example-1/late", ("kalman", "kalman-as-new", "kalman-rewind"), 100)
    frame["all"] = np.sqrt(sum(frame[f"rmse:x{i}:1"] ** 2 for i in (1, 2, 3)))
    for label, wanted in (("kalman-as-new", 1.01), ("kalman", 5.15), ("kalman-rewind", 0.68)):
        near(frame, label, wanted, "all")


@pytest.mark.long
@pytest.mark.parametrize(("protocol", "plain", "walk"), [
    ("round-robin", 0.434, 0.204), ("random-access", 0.451, 0.204), ("try-once-discard", 0.457, 0.249),
    ("bernoulli", 0.545, 0.213), ("markov", 0.674, 0.207)])
def test_protocols_of_coupled_cars(protocol: str, plain: float, walk: float) -> None:
    frame = rows(f"cbtc-csma/protocol-{protocol}", ("kalman", "kalman-force"), 30)
    near(frame, "kalman", plain)
    near(frame, "kalman-force", walk)
