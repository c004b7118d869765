"""Inclusions: they hold the truth wherever the bounds do; the metro's agrees with a loop over corners."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from railstate.benchmarks.running.drive import drive, prepare
from railstate.estimators.registry import estimators
from railstate.scenarios.files import load
from railstate.scenarios.measurement import Interval, Measurement
from railstate.scenarios.metro.inclusion import Rectangles
from railstate.scenarios.randomness import Streams


def observer(variant, runs, skip=0.0):
    setting = load("ningbo-metro", {"score.skip": skip}).setting(variant)
    streams = Streams(5, "ningbo-metro", variant, range(runs))
    world = setting.world(streams)
    estimator, model = prepare(setting, estimators()["interval"], {}, {}, world.initial_mean)
    return setting, world, estimator, model, streams("estimator", "interval")


@pytest.mark.parametrize("variant", ["white", "sinusoid", "switching", "physical", "switching-bias"])
def test_the_truth_is_always_inside_where_the_bounds_hold(variant):
    """Position's claim in every step of 10 runs, and it is far narrower than the sensor's bound of 1 m."""
    setting, world, estimator, model, random = observer(variant, 10)
    scored = drive(setting, world, estimator, model, random).scored
    assert not scored.status.any()
    assert (scored.metrics["coverage", "ellipsoid"] == 1.0).all()
    assert scored.metrics["half-width", "position"].mean() < 0.75
    assert np.isnan(scored.metrics["half-width", "speed"]).all()  # of which nothing is claimed


def test_wheels_that_slide_one_way_hold_the_truth() -> None:
    """The first two minutes of wet trips, with a width that braking opens and balises close."""
    setting, streams = load("odometry").setting("wet"), Streams(5, "odometry", "wet", range(4))
    world = setting.world(streams)
    estimator, model = prepare(setting, estimators()["interval"], {}, {}, world.initial_mean)
    estimator.start(model, 4, streams("estimator", "interval"))
    widths = np.empty((1200, 4))
    for k in range(1200):
        step, gone = world.step(k, world.initial_mean), 0.0
        for event in step.events:
            share = event.share
            estimator.predict(step.u, Interval(k + 1, step.start + gone * step.length, share * step.length, share))
            estimator.update(Measurement(event.y, event.received, k + 1))
            gone = gone + share
        assert ((estimator.low[0] <= step.truth[0]) & (step.truth[0] <= estimator.high[0])).all()
        widths[k] = estimator.high[0] - estimator.low[0]
    assert widths.min() < 2.0 and 8.0 < widths.mean() < 16.0 and widths.max() < 40.0


def test_a_step_against_a_loop_over_corners_and_readings():
    _, world, estimator, model, random = observer("switching", 3)
    estimator.start(model, 3, random)
    for k in range(40):
        step, low, high = world.step(k, world.initial_mean), estimator.low.copy(), estimator.high.copy()
        interval = Interval(k + 1, 0.2 * k, 0.2)
        estimator.predict(step.u, interval)
        event = step.events[0]
        estimator.update(Measurement(event.y, event.received, k + 1))
        for r in range(3):
            s, v = (np.linspace(low[i, r], high[i, r], 3) for i in range(2))
            ends = np.array([model.transition(np.array([[a], [b]]), step.u[:, r:r + 1], interval)[:, 0]
                             for a in s for b in v])
            push = 0.15 * np.array([0.02, 0.2])
            bar = np.array([1.0, 0.2])
            assert_allclose(estimator.low[:, r], np.maximum(ends.min(0) - push, event.y[:, r] - bar), atol=1e-12)
            assert_allclose(estimator.high[:, r], np.minimum(ends.max(0) + push, event.y[:, r] + bar), atol=1e-12)


def test_what_is_not_heard_changes_nothing_and_a_wrong_bound_leaves_the_readings():
    _, world, estimator, model, random = observer("white", 2)
    estimator.start(model, 2, random)
    low = estimator.low.copy()
    y = world.initial_mean + 100.0
    estimator.update(Measurement(y, np.array([[False, True], [False, False]]), 0))
    assert (estimator.low[:, 0] == low[:, 0]).all() and estimator.low[1, 1] == low[1, 1]
    assert_allclose([estimator.low[0, 1], estimator.high[0, 1]], y[0, 1] + np.array([-1.0, 1.0]))


def test_rectangles_by_loops():
    """Corners and pushes run by run; readings cut what they agree with, to a point too, or stand alone."""
    def transition(x, u, interval):
        return np.stack([x[0] + interval.length * x[1], 0.9 * x[1] + u[0]])

    found = Rectangles(transition, 0.5, ((0, 1.0), (1, np.inf), (1, 0.25)))
    mean, start = np.array([[5.0, -3.0, 8.0], [2.0, 1.0, -1.0]]), np.array([2.0, 0.5])
    inclusion = found.inclusion(mean, start)
    assert_allclose(inclusion.low, [[3.0, -5.0, 6.0], [1.5, 0.5, -1.5]])
    assert_allclose(inclusion.high, [[7.0, -1.0, 10.0], [2.5, 1.5, -0.5]])
    u = np.array([[0.1, -0.2, 0.3]])
    for length in (0.4, np.array([0.4, 0.1, 0.0])):
        low, high = inclusion.predict(inclusion.low, inclusion.high, u, Interval(1, 0.0, length))
        for r, h in enumerate(np.broadcast_to(length, 3)):
            s, v = ([inclusion.low[i, r], inclusion.high[i, r]] for i in range(2))
            places, speeds = [a + h * b for a in s for b in v], [0.9 * b + u[0, r] for b in v]
            assert_allclose(low[:, r], [min(places) - h * h / 4, min(speeds) - h / 2], rtol=1e-12)
            assert_allclose(high[:, r], [max(places) + h * h / 4, max(speeds) + h / 2], rtol=1e-12)
    before = inclusion.low.copy()
    y = np.array([[2.0, -9.0, np.nan], [99.0, np.nan, 7.0], [2.0, 1.0, -9.0]])
    low, high = inclusion.observe(inclusion.low, inclusion.high, Measurement(y, np.array([
        [True, True, False], [True, False, True], [True, False, True]]), 1))
    assert_allclose(low, [[3.0, -10.0, 6.0], [1.75, 0.5, -9.25]])
    assert_allclose(high, [[3.0, -8.0, 10.0], [2.25, 1.5, -8.75]])
    assert np.array_equal(inclusion.low, before)
