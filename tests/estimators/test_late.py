"""Late packets: rewinding equals the estimator that got everything in order, to the bit; the others do as they say."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from railstate.benchmarks.running.drive import prepare
from railstate.benchmarks.running.loop import Loop, Observer
from railstate.estimators.registry import estimators
from railstate.scenarios.errors import Infeasible
from railstate.scenarios.files import load
from railstate.scenarios.randomness import Streams

DELAY = {"channel.kind": "delay", "channel.steps": [0, 4], "channel.loss": {"kind": "bernoulli", "p": 0.8}}


class Last(Observer):
    """Keeps every estimate."""

    def __init__(self) -> None:
        self.seen: list[tuple[Any, ...]] = []

    def updated(self, step, event, estimate):
        parts = (estimate.mean, estimate.covariance, estimate.parameter, estimate.ellipsoid)
        self.seen.append(tuple(None if part is None else np.array(part) for part in parts))


def driven(scenario, variant, plugin, late, channel, steps=40, runs=(0, 1, 2), parameters=None):
    """All estimates of an estimator over the first steps of a scenario with a channel."""
    found = load(scenario, channel, variant).setting(variant)
    streams = Streams(5, scenario, variant, runs)
    world = found.world(streams)
    estimator, model = prepare(found, estimators()[plugin], parameters or {}, {}, world.initial_mean, late)
    estimator.design(model)
    estimator.start(model, len(runs), streams("estimator", plugin))
    seen = Last()
    loop = Loop(world, estimator, seen)
    for k in range(steps):
        loop.step(k)
    return seen.seen, estimator


CASES = [*(("ningbo-metro", "gaussian", name) for name in (
    "ekf", "ukf", "ckf", "particle", "robust-mean-square", "robust-ellipsoid", "dead-reckoning", "filterpy-ekf", "gate",
    "soft-gate", "huber", "mcc", "student-t", "student-t-roth", "adaptive-r", "ekf-second-order")),
    *(("braking-rate", "grid-drift", name) for name in ("imm", "rbpf", "sma", "gsma")),
    *(("rap-example-1", "corrected", name) for name in ("kalman", "direct"))]


@pytest.mark.parametrize(("scenario", "variant", "plugin"), CASES)
def test_rewinding_equals_the_estimator_that_got_all_in_order(scenario, variant, plugin):
    if variant not in load(scenario).variants:
        variant = load(scenario).default
    in_order = {"channel.kind": "bernoulli", "channel.p": 0.8}
    try:
        expected, _ = driven(scenario, variant, plugin, "drop", in_order)
    except Infeasible as error:
        pytest.skip(str(error))
    found, estimator = driven(scenario, variant, plugin, "rewind", DELAY)
    assert type(estimator).__name__ == "Rewinding"
    # the last four steps' packets may still be on their way: replayed without them the rest must be the same
    last = driven(scenario, variant, plugin, "rewind", {**DELAY, "channel.steps": [0, 4]}, steps=44)[0]
    assert len(found) == len(expected) and len(last) == 44
    settled = _settled(scenario, variant)
    for k in np.flatnonzero(settled[:40]):
        for mine, theirs in zip(found[k], expected[k], strict=True):
            if theirs is not None:
                np.testing.assert_array_equal(mine, theirs)
    assert settled[:40].any()


def _settled(scenario, variant):
    """Steps at whose end every packet sent so far has arrived, in all runs."""
    world = load(scenario, DELAY, variant).setting(variant).world(Streams(5, scenario, variant, (0, 1, 2)))
    late = world.late[:60].max(axis=(1, 2))
    arrives = np.arange(len(late)) + late
    return np.array([arrives[:k + 1].max() <= k for k in range(len(late))])


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
    seen, _ = driven(str(file), "default", "kalman", policy, {}, steps=150)
    P = seen[-1][1][0, 0, 0]
    ahead = 1.0
    for _ in range(300):
        before = a * a * ahead + 1
        ahead = before / (before + 1)
    exact = a ** (2 * d) * ahead + (a ** (2 * d) - 1) / (a * a - 1)
    claimed = {"drop": 1 / (1 - a * a), "as-new": ahead, "rewind": exact}[policy]
    assert P == pytest.approx(claimed, rel=1e-4)
    assert policy != "rewind" or exact == pytest.approx(3.1636, abs=5e-5)
