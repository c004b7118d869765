"""Late packets: rewinding equals the estimator that got everything in order, to the bit; the others do as they say."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from railstate.benchmarks.running.drive import prepare
from railstate.benchmarks.running.loop import Loop, Observer
from railstate.estimators.interface import Estimate, Estimator
from railstate.estimators.late import Mailbox, Rewinding, for_late
from railstate.estimators.registry import estimators
from railstate.scenarios.errors import Unsupported
from railstate.scenarios.files import load
from railstate.scenarios.measurement import Interval, Measurement
from railstate.scenarios.randomness import Streams
from railstate.scenarios.world import Event

from ..models import random, still

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
    "ukf-mcc", "truth")),
    *(("braking-rate", "paper", name) for name in ("imm", "rbpf", "sma", "gsma", "kalman-known-parameter")),
    ("rap-example-1", "corrected", "kalman"), ("cbtc-csma", "uniform", "direct")]


@pytest.mark.parametrize(("scenario", "variant", "plugin"), CASES)
def test_rewinding_equals_the_estimator_that_got_all_in_order(scenario, variant, plugin):
    lossy = {"channel.kind": "bernoulli", "channel.p": 0.8}
    steps = LATE + DEPTH + 3
    expected, _ = driven(scenario, variant, plugin, "drop", lossy, steps)
    found, estimator = driven(scenario, variant, plugin, "rewind", lossy, steps, change=delayed, depth=DEPTH)
    assert isinstance(estimator, Rewinding)
    if plugin not in ("dead-reckoning", "truth"):
        assert any(not np.array_equal(mine[0], theirs[0]) for mine, theirs in zip(found, expected, strict=True))
    for k in range(0 if plugin == "truth" else LATE + DEPTH, steps):
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


def test_a_mailbox_hands_out_what_has_come_oldest_stamp_first() -> None:
    def told(policy: str, listens: Any = None) -> list[list[tuple[Any, ...]]]:
        mail = Mailbox(policy)
        for step, number, late in ((3, 0, [[1, 2, 0]]), (2, 1, [[2, 0, 2]]), (2, 0, [[2, 3, 1]])):
            y = np.array([[10.0 * step + number] * 3])
            mail.post(Event(1.0, y, np.zeros((1, 3), bool), y[None], np.array(late)), step, number, 0.5 * step)
        mail.post(Event(1.0, y, np.ones((1, 3), bool)), 3, 2, 0.0)
        return [[(m.y[0, 0], m.received.tolist(), m.step, m.event, m.time, m.covariance.shape)
                 for m in mail.due(step, 7, 9.0, listens)] for step in range(2, 7)]

    a, b, c, both, shape = *np.eye(3, dtype=bool)[:, None].tolist(), [[True, False, True]], (1, 1, 3)
    assert told("rewind") == [
        [], [(20.0, c, 2, 0, 1.0, shape)],
        [(20.0, a, 2, 0, 1.0, shape), (21.0, both, 2, 1, 1.0, shape), (30.0, a, 3, 0, 1.5, shape)],
        [(20.0, b, 2, 0, 1.0, shape), (30.0, b, 3, 0, 1.5, shape)], []]
    assert told("as-new", np.array([True, False, True])) == [
        [], [(20.0, c, 3, 7, 9.0, shape)],
        [(20.0, a, 4, 7, 9.0, shape), (21.0, both, 4, 7, 9.0, shape), (30.0, a, 4, 7, 9.0, shape)], [], []]
    assert told("drop") == [[]] * 5


class Order(Estimator):
    """A number that tells in which order things have come."""

    def start(self, model: Any, runs: int, random: Any) -> None:
        super().start(model, runs, random)
        self.x, self.heard = np.ones((1, runs)), np.zeros(runs)

    def predict(self, u: Any, interval: Interval) -> None:
        self.x = (2 * self.x + interval.step) % 9973

    def update(self, measurement: Measurement) -> None:
        self.x = np.where(measurement.received, 5 * self.x + measurement.y, self.x) % 9973
        self.heard = self.heard + measurement.received.sum(axis=0)

    def estimate(self) -> Estimate:
        return Estimate(self.x)

    def counters(self) -> dict[str, Any]:
        return {"heard": self.heard}

    def extremes(self) -> dict[str, Any]:
        return {"x": self.x[0]}


@pytest.mark.parametrize(("depth", "moves"), [(1, 2), (2, 2), (5, 2), (2, 1), (5, 0)])
def test_all_events_of_a_step_are_gone_through_again(depth: int, moves: int) -> None:
    """Two events a step, the first ones come with a prediction, each packet late by 0 to 3 steps; what is older than
    `depth` steps is not taken."""
    rng, runs, steps = np.random.default_rng(depth), 3, 15
    late = rng.integers(0, 4, (steps, 2, 1, runs))
    own, estimator = still(runs), for_late(Order(), "rewind", depth)
    assert isinstance(estimator, Rewinding) and (estimator.late, estimator.depth) == ("rewind", depth)
    estimator.start(own, runs, random(runs))
    for k in range(steps):
        for event in range(2):
            if event < moves:
                estimator.predict(np.zeros((1, runs)), Interval(k, 0.0, 0.5, 0.5))
            estimator.update(Measurement(np.full((1, runs), 10.0 * k + event), late[k, event] == 0, k, event))
        for stamp in range(k):
            for event in range(2):
                if (came := late[stamp, event] == k - stamp).any():
                    estimator.update(Measurement(np.full((1, runs), 10.0 * stamp + event), came, stamp, event))
        wanted = Order()
        wanted.start(own, runs, random(runs))
        for stamp in range(k + 1):
            for event in range(2):
                if event < moves:
                    wanted.predict(np.zeros((1, runs)), Interval(stamp, 0.0, 0.5, 0.5))
                there = late[stamp, event] <= min(depth, k - stamp)
                wanted.update(Measurement(np.full((1, runs), 10.0 * stamp + event), there, stamp, event))
        counted = (estimator.extremes, estimator.counters, lambda: {"mean": estimator.estimate().mean})
        for say in counted if k % 2 else counted[::-1]:
            for name, value in say().items():
                np.testing.assert_array_equal(value, {"x": wanted.x[0], "heard": wanted.heard, "mean": wanted.x}[name])


def test_who_rewinds() -> None:
    own, smoother = Order(), Order()
    smoother.lag, smoother.handles_late = None, False
    assert [for_late(own, policy, depth) is own for policy, depth in (("drop", 3), ("as-new", 3), ("rewind", 0))] == [
        True, True, True]
    with pytest.raises(Unsupported, match=r'^a smoother cannot rewind: late = "drop" or "as-new"$'):
        for_late(smoother, "rewind", 0)
    assert for_late(smoother, "as-new", 2).late == "as-new"
