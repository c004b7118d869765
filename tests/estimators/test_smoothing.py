"""Smoothers against the dense joint Gaussian of all states, and the properties every one must have."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from railstate.estimators.interface import Estimate
from railstate.estimators.kalman import ExtendedKalman
from railstate.estimators.late import for_late
from railstate.estimators.smoothing.rts import FixedLag, RauchTungStriebel
from railstate.scenarios.errors import Unsupported
from railstate.scenarios.measurement import Measurement

from .. import models
from .test_kalman_answers import joint_posterior

Found = dict[int, Estimate]


def smoothed(estimator: RauchTungStriebel, model: Any, data: models.Record, shares: Any = (1.0,)) -> Found:
    """All that it says of the past, by step."""
    found: Found = {}

    def each(k: int, _: Estimate) -> None:
        past = estimator.past() if estimator.lag else None
        if past is not None and estimator.lag:
            found[k + 1 - estimator.lag] = past

    models.feed(estimator, model, data, shares, each)
    for step, estimate in estimator.finish():
        found.setdefault(step, estimate)
    return found


@pytest.mark.parametrize("filter_", ["ekf", "ukf"])
@pytest.mark.parametrize("correlated", [False, True])
def test_smoothing_is_the_joint_gaussian(filter_: str, correlated: bool) -> None:
    runs, steps, n = 3, 9, 3
    model = models.linear(runs, correlated=correlated)
    data = models.record(model, runs, steps)
    found = smoothed(RauchTungStriebel({"filter": filter_}), model, data)
    assert sorted(found) == list(range(steps + 1))
    for run in range(runs):
        mean, covariance = joint_posterior(model, data, run, steps)
        for step, estimate in found.items():
            at = slice(step * n, (step + 1) * n)
            assert estimate.covariance is not None
            np.testing.assert_allclose(estimate.mean[:, run], mean[at], rtol=0, atol=1e-8)
            np.testing.assert_allclose(estimate.covariance[..., run], covariance[at, at], rtol=0, atol=1e-8)


@pytest.mark.parametrize("filter_", ["ekf", "ukf"])
def test_a_fixed_lag_knows_what_came_until_then(filter_: str) -> None:
    runs, steps, n, lag = 2, 9, 3, 4
    model = models.linear(runs)
    data = models.record(model, runs, steps)
    found = smoothed(FixedLag({"filter": filter_, "steps": lag}), model, data)
    assert sorted(found) == list(range(steps + 1))
    for step, estimate in found.items():
        known = min(steps, step + lag)
        for run in range(runs):
            mean, covariance = joint_posterior(model, data, run, known)
            at = slice(step * n, (step + 1) * n)
            assert estimate.covariance is not None
            np.testing.assert_allclose(estimate.mean[:, run], mean[at], rtol=0, atol=1e-8)
            np.testing.assert_allclose(estimate.covariance[..., run], covariance[at, at], rtol=0, atol=1e-8)


def test_what_is_known_exactly_is_revised_by_nothing() -> None:
    """A start without spread, and a state that no noise reaches: singular predicted covariances."""
    from dataclasses import replace

    model = models.linear(2)
    part = model.linear
    assert part is not None
    Q = part.Q(0).copy()
    Q[0], Q[:, 0] = 0.0, 0.0
    A = part.A(0).copy()
    A[0] = [1.0, 0.0, 0.0]
    exact = models.linear_model(
        replace(part, A=lambda k: A, Q=lambda k: Q), states=model.states, measurements=model.measurements, period=1.0,
        initial_mean=model.initial_mean, initial_covariance=np.zeros((3, 3, 1)))
    data = models.record(model, 2, 6)
    found = smoothed(RauchTungStriebel(), exact, data)
    assert (found[0].mean == exact.initial_mean).all()
    for estimate in found.values():
        assert estimate.covariance is not None and np.isfinite(estimate.mean).all()
        assert (estimate.covariance[0] == 0).all() and (np.linalg.eigvalsh(estimate.covariance[..., 0]) > -1e-12).all()


@pytest.mark.parametrize("filter_", ["ekf", "ukf"])
def test_no_run_s_bits_depend_on_its_company(filter_: str) -> None:
    """Run 0 has no event in mid-step, the others have one."""
    runs, steps = 4, 7
    model, alone = models.coasting(runs), models.coasting(1)
    data = models.record(model, runs, steps)
    halves = np.array([0.0, 0.4, 0.7, 0.2])
    together = smoothed(RauchTungStriebel({"filter": filter_}), model, data, (halves, 1 - halves))
    single = smoothed(RauchTungStriebel({"filter": filter_}), alone, data.only(0), (1.0,))
    for step, estimate in single.items():
        np.testing.assert_array_equal(together[step].mean[:, :1], estimate.mean)
        assert estimate.covariance is not None and together[step].covariance is not None
        np.testing.assert_array_equal(together[step].covariance[..., :1], estimate.covariance)


def test_a_run_that_ended_is_not_revised() -> None:
    """It hears nothing any more: from its last reading on smoothed and filtered are the same to the bit."""
    model = models.linear(2)
    data = models.record(model, 2, 8, loss=0.0)
    data.received[4:, :, 1] = False
    means, _ = models.feed(ExtendedKalman(), model, data)
    found = smoothed(RauchTungStriebel(), model, data)
    for step in range(4, 9):
        np.testing.assert_array_equal(found[step].mean[:, 1], means[step - 1, :, 1])


def test_smoothers_do_not_rewind() -> None:
    with pytest.raises(Unsupported, match="cannot rewind"):
        for_late(FixedLag(), "rewind", 3)
    model = models.linear(1)
    data = models.record(model, 1, 3)
    estimator = FixedLag({"steps": 2})
    estimator.design(model)
    estimator.start(model, 1, models.random(1))
    estimator.predict(data.u[0], models.whole(0))
    estimator.update(Measurement(data.y[0], data.received[0], 1))
    assert estimator.past() is None
