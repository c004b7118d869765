"""The H-infinity filter against the Kalman filter, textbook loops in two printed forms, and its own guarantee."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from railstate.estimators.h_infinity import HInfinity
from railstate.estimators.interface import Estimate, Status
from railstate.estimators.kalman import ExtendedKalman
from railstate.scenarios.errors import Unsupported
from railstate.scenarios.model import DesignModel

from .. import models
from ..models import Array, Record, heard, part, whole

PLANTS = {"linear": models.linear, "correlated": lambda runs: models.linear(runs, correlated=True, ny=3),
          "coasting": models.coasting}


class Open(HInfinity):
    """Shows its P, which the filter claims for nothing."""

    def estimate(self) -> Estimate:
        return replace(super().estimate(), covariance=self._covariance)


def test_claims_no_covariance() -> None:
    estimator = HInfinity()
    estimator.start(models.linear(2), 2, models.random(2))
    estimate = estimator.estimate()
    assert estimate.covariance is None and estimator.update(heard(np.ones((2, 2)), np.ones((2, 2), bool))) is None


@pytest.mark.parametrize("plant", PLANTS)
def test_at_level_zero_it_is_the_kalman_filter(plant: str) -> None:
    model = PLANTS[plant](5)
    data = models.record(model, 5, 40)
    kalman = models.feed(ExtendedKalman(), model, data)
    for theta in (0.0, 1e-12):
        for mine, theirs in zip(models.feed(Open({"theta": theta}), model, data), kalman, strict=True):
            assert_allclose(mine, theirs, rtol=0, atol=1e-9)


def simon(model: DesignModel, data: Record, theta: float, S: Array) -> tuple[list[Array], list[Array]]:
    """P^- of every step by Simon's (11.89), the estimates by Hassibi, Sayed and Kailath's filter: one run."""
    linear, predicted, means = model.linear, [], []
    assert linear is not None
    F, Q, x = linear.A(0), linear.Q(0), model.initial_mean[:, 0]
    P = F @ model.initial_covariance[:, :, 0] @ F.T + Q
    for k in range(len(data.y)):
        got = data.received[k, :, 0]
        H, R = linear.C(0)[got], linear.R(0)[np.ix_(got, got)]
        x = F @ x + linear.B(0) @ data.u[k, :, 0] + linear.h(0)
        x = x + P @ H.T @ np.linalg.inv(H @ P @ H.T + R) @ (data.y[k, got, 0] - H @ x)
        predicted.append(P)
        means.append(x)
        P = F @ P @ np.linalg.inv(np.eye(len(x)) - theta * S @ P + H.T @ np.linalg.inv(R) @ H @ P) @ F.T + Q
    return predicted, means


@pytest.mark.parametrize("plant", ["linear", "correlated"])
def test_equals_the_textbook_loop(plant: str) -> None:
    model, weights = PLANTS[plant](3), [0.5, 0.0, 2.0]
    data = models.record(model, 3, 40)
    estimator = Open({"theta": 0.05, "weights": weights})
    estimator.start(model, 3, models.random(3))
    shapes, means = [], []
    for k in range(40):
        estimator.predict(data.u[k], whole(k))
        shapes.append(np.broadcast_to(estimator._covariance, (3, 3, 3)).copy())
        estimator.update(heard(data.y[k], data.received[k], k))
        means.append(estimator.estimate().mean.copy())
    assert not estimator.status.any()
    for run in range(3):
        alone = replace(model, initial_mean=model.initial_mean[:, run:run + 1])
        P, x = simon(alone, data.only(run), 0.05, np.diag(weights))
        assert_allclose(np.array(shapes)[..., run], P, rtol=0, atol=1e-9)
        assert_allclose(np.array(means)[..., run], x, rtol=0, atol=1e-9)


def test_keeps_its_level_against_the_worst_disturbance() -> None:
    """sum e' S e <= (1/theta) energy for every disturbance: the largest ratio of the whole trip as one matrix."""
    model, steps, theta = models.linear(1), 12, 0.3
    linear = model.linear
    assert linear is not None
    F, H, n, ny = linear.A(0), linear.C(0), 3, 2
    q, r = np.linalg.cholesky(linear.Q(0)), np.linalg.cholesky(linear.R(0))
    estimator = Open({"theta": theta, "weights": [1.0, 1.0, 1.0]})
    estimator.start(model, 1, models.random(1))
    size = n + steps * (n + ny)
    error, rows = np.eye(n, size), []  # e = error times the inputs of unit energy: start, disturbances, noises
    for k in range(steps):
        estimator.predict(np.zeros((1, 1)), whole(k))
        P = estimator._covariance[:, :, 0]
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + linear.R(0))
        at = n + k * (n + ny)
        error = F @ error
        error[:, at:at + n] += q
        error = (np.eye(n) - K @ H) @ error
        error[:, at + n:at + n + ny] -= K @ r
        estimator.update(heard(np.zeros((ny, 1)), np.ones((ny, 1), bool), k))
        rows.append(error)
    ratio = np.linalg.norm(np.vstack(rows), 2) ** 2
    assert not estimator.status.any() and 0.0 < ratio < 1 / theta


@pytest.mark.parametrize("shared", [True, False])
def test_a_level_that_cannot_be_kept_is_flagged(shared: bool) -> None:
    model = models.still(4)
    received = np.ones((1, 4), bool) if shared else np.array([[True, True, False, True]])
    estimator = HInfinity({"theta": 1.2})  # P after the first reading: 1/2, without it 1
    estimator.start(model, 4, models.random(4))
    for k in range(2):
        estimator.predict(np.zeros((1, 4)), whole(k))
        estimator.update(heard(np.zeros((1, 4)), received, k))
    want = [Status.ok] * 4 if shared else [Status.ok, Status.ok, Status.infeasible, Status.ok]
    assert estimator.status.tolist() == want
    if not shared:
        assert "no filter keeps this level" in estimator.reasons[2] and list(estimator.reasons) == [2]
        assert np.isfinite(np.delete(estimator.estimate().mean, 2, axis=1)).all()
        estimator.predict(np.zeros((1, 4)), whole(2))
        estimator.update(heard(np.zeros((1, 4)), np.ones((1, 4), bool), 2))
        assert estimator.status.tolist() == want and np.isnan(estimator.estimate().mean[0, 2])
    else:
        estimator = HInfinity({"theta": 2.5})
        estimator.start(model, 4, models.random(4))
        for k in range(2):
            estimator.predict(np.zeros((1, 4)), whole(k))
            estimator.update(heard(np.zeros((1, 4)), received, k))
        assert estimator.status.tolist() == [Status.infeasible] * 4


def test_batches_are_bit_identical() -> None:
    model = models.coasting(12)
    data = models.record(model, 12, 20)
    data = replace(data, received=data.received | (np.arange(12) % 3 > 0))
    data = replace(data, y=np.where(data.received, np.nan_to_num(data.y), np.nan))
    together = models.feed(Open({"theta": 0.05}), model, data)
    for run in (0, 1, 7):
        alone = models.feed(Open({"theta": 0.05}), replace(model, initial_mean=model.initial_mean[:, [run]]),
                            data.only(run))
        for many, one in zip(together, alone, strict=True):
            assert_array_equal(many[..., [run]], one)


def test_a_run_that_stays_does_not_change_and_weights_are_the_states() -> None:
    model = models.coasting(2)
    estimator = Open({"theta": 0.05})
    estimator.start(model, 2, models.random(2))
    estimator.predict(np.zeros((1, 2)), whole(0, 0.5))
    mean, P = estimator.estimate().mean.copy(), np.repeat(estimator._covariance, 2, axis=2)[..., :2]
    estimator.predict(np.zeros((1, 2)), part(1, np.array([0.0, 1.0]), 0.5))
    assert_array_equal(estimator.estimate().mean[:, 0], mean[:, 0])
    assert_array_equal(estimator._covariance[..., 0], P[..., 0])
    with pytest.raises(Unsupported, match="1 elements, the setting 2 states"):
        HInfinity({"weights": [1.0]}).design(model)
