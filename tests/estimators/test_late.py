"""Late packets: rewinding equals the estimator that got everything in order, to the bit; the others do as they say."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from railstate.benchmarks.running.drive import prepare
from railstate.benchmarks.running.loop import Loop, Observer
from railstate.estimators.late import Rewinding, for_late
from railstate.estimators.registry import estimators
from railstate.scenarios.files import load
from railstate.scenarios.randomness import Streams

LATE, DEPTH = 12, 4


class Last(Observer):
    """Keeps every estimate."""

    def __init__(self) -> None:
        self.seen: list[tuple[Any, ...]] = []

    def updated(self, step, event, estimate):
        parts = (estimate.mean, estimate.covariance, estimate.parameter, estimate.ellipsoid)
        self.seen.append(tuple(None if part is None else np.array(part) for part in parts))


def driven(scenario, variant, plugin, late, channel, steps, runs=(0, 1, 2), change=lambda world: world, depth=0):
    """All estimates of an estimator over the first steps of a scenario with a channel."""
    found = load(scenario, channel, variant).setting(variant)
    streams = Streams(5, scenario, variant, runs)
    world = change(found.world(streams))
    estimator, model = prepare(found, estimators()[plugin], {}, {}, world.initial_mean, late)
    if depth:
        estimator = for_late(estimator, late, depth)
    estimator.design(model)
    estimator.start(model, len(runs), streams("estimator", plugin))
    seen = Last()
    loop = Loop(world, estimator, seen)
    for k in range(steps):
        loop.step(k)
    return seen.seen, estimator


def delayed(world):
    """The same world with each reading of the first steps late by 0..DEPTH steps, each element on its own."""
    late = np.random.default_rng(2).integers(0, DEPTH, world.y.shape, endpoint=True)
    late[LATE:] = 0
    late = np.where(world.received, late, 0)
    return replace(world, received=world.received & (late == 0), late=late)


CASES = [*(("ningbo-metro", "gaussian", name) for name in (
    "ekf", "ukf", "ckf", "particle", "robust-mean-square", "robust-ellipsoid", "dead-reckoning", "filterpy-ekf", "gate",
    "soft-gate", "huber", "mcc", "student-t", "student-t-roth", "adaptive-r", "ekf-second-order",
    "ukf-mcc")),
    *(("braking-rate", "paper", name) for name in ("imm", "rbpf", "sma", "gsma")),
    ("rap-example-1", "corrected", "kalman"), ("cbtc-csma", "uniform", "direct")]


@pytest.mark.parametrize(("scenario", "variant", "plugin"), CASES)
def test_rewinding_equals_the_estimator_that_got_all_in_order(scenario, variant, plugin):
    lossy = {"channel.kind": "bernoulli", "channel.p": 0.8}
    steps = LATE + DEPTH + 3
    expected, _ = driven(scenario, variant, plugin, "drop", lossy, steps)
    found, estimator = driven(scenario, variant, plugin, "rewind", lossy, steps, change=delayed, depth=DEPTH)
    assert isinstance(estimator, Rewinding)
    if plugin != "dead-reckoning":
        assert any(not np.array_equal(mine[0], theirs[0]) for mine, theirs in zip(found, expected, strict=True))
    for k in range(LATE + DEPTH, steps):
        for mine, theirs in zip(found[k], expected[k], strict=True):
            assert (mine is None) == (theirs is None)
            if theirs is not None:
                np.testing.assert_array_equal(mine, theirs)


@pytest.mark.parametrize("policy", ["drop", "as-new", "rewind"])
def test_policies_against_the_scalar_recursion(policy, tmp_path):
    """x+ = a x + w, y = x + v, delay d: rewind P = a^(2d) P+ + q (a^(2d) - 1)/(a^2 - 1); drop is dead reckoning."""
    a, d = 0.95, 3
    file = tmp_path / "scalar.toml"
    file.write_text(f'''name = "scalar"
title = "a scalar plant"
time = {{ period = 1.0, steps = 200 }}
plant = {{ kind = "linear", A = [[{a}]], B = [[1]], C = [[1]], Q = [[1]], R = [[1]], x0 = [0], P0 = [[1]] }}
channel = {{ kind = "delay", steps = {d} }}
[estimators.kalman]
plugin = "kalman"
''')
    seen, _ = driven(str(file), "default", "kalman", policy, {}, 150)
    P = seen[-1][1][0, 0, 0]
    ahead = 1.0
    for _ in range(300):
        before = a * a * ahead + 1
        ahead = before / (before + 1)
    exact = a ** (2 * d) * ahead + (a ** (2 * d) - 1) / (a * a - 1)
    claimed = {"drop": 1 / (1 - a * a), "as-new": ahead, "rewind": exact}[policy]
    assert pytest.approx(claimed, rel=1e-4) == P
    assert policy != "rewind" or exact == pytest.approx(3.1636, abs=5e-5)
