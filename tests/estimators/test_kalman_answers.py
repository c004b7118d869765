"""Kalman filters against what is known otherwise: the joint Gaussian of all states, NEES, extreme variances, many
states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from railstate.estimators.kalman import Kalman
from railstate.estimators.sigma_point import CubatureKalman, UnscentedKalman
from railstate.scenarios.errors import Infeasible, Unsupported
from railstate.scenarios.model import DesignModel

from .. import models
from ..models import Array, heard
from .test_kalman_family import textbook


def joint_posterior(model: DesignModel, data: models.Record, run: int, steps: int) -> tuple[Array, Array]:
    """Mean and covariance of the states of steps 0 .. K, one below the other, given the measurements of the first
    `steps`: from the joint Gaussian of all states and received measurements at once."""
    part = model.linear
    assert part is not None
    a, b, h, c = part.A(0), part.B(0), part.h(0), part.C(0)
    n, ny, K = model.nx, model.ny, len(data.y)
    mean, noise = [model.initial_mean[:, run]], np.zeros(((K + 1) * n, (K + 1) * n))
    lower = np.eye((K + 1) * n)
    noise[:n, :n] = np.eye(n)
    for k in range(K):
        at = slice((k + 1) * n, (k + 2) * n)
        mean.append(a @ mean[-1] + b @ data.u[k, :, run] + h)
        lower[at] += np.hstack([np.zeros((n, k * n)), a, np.zeros((n, (K - k) * n))]) @ lower
        noise[at, at] = part.Q(0)
    states = lower @ noise @ lower.T
    rows = [(k, j) for k in range(steps) for j in range(ny) if data.received[k, j, run]]
    big, r = np.zeros((len(rows), (K + 1) * n)), np.zeros((len(rows), len(rows)))
    for i, (k, j) in enumerate(rows):
        big[i, (k + 1) * n:(k + 2) * n] = c[j]
        for i2, (k2, j2) in enumerate(rows):
            r[i, i2] = part.R(0)[j, j2] if k == k2 else 0.0
    y = np.array([data.y[k, j, run] for k, j in rows])
    gain = states @ big.T @ np.linalg.inv(big @ states @ big.T + r)
    return np.concatenate(mean) + gain @ (y - big @ np.concatenate(mean)), states - gain @ big @ states


def test_kalman_equals_the_joint_gaussian() -> None:
    """The posterior of the last state from the joint Gaussian of all states and received measurements at once."""
    runs, steps = 3, 6
    model = models.linear(runs, correlated=True, ny=3)
    data = models.record(model, runs, steps)
    means, covariances = models.feed(Kalman(), model, data)
    n = model.nx
    for run in range(runs):
        mean, covariance = joint_posterior(model, data, run, steps)
        np.testing.assert_allclose(means[-1, :, run], mean[-n:], rtol=0, atol=1e-9)
        np.testing.assert_allclose(covariances[-1, :, :, run], covariance[-n:, -n:], rtol=0, atol=1e-9)


def test_nees_is_consistent() -> None:
    """Mean NEES of the matched Kalman filter is nx, to its own Monte Carlo error: runs x independent chi-square."""
    runs, nx = 400, 3
    model = models.linear(runs)
    data = models.record(model, runs, 15)
    means, covariances = models.feed(Kalman(), model, data)
    error = data.truth[-1] - means[-1]
    nees = [error[:, s] @ np.linalg.solve(covariances[-1, :, :, s], error[:, s]) for s in range(runs)]
    assert abs(np.mean(nees) - nx) < 3 * np.sqrt(2 * nx / runs)


def test_joseph_form_survives_precise_measurements() -> None:
    """Variance 1e12 before and 1e-6 after: P - K S K' loses all digits, the Joseph form keeps them."""
    model = replace(models.linear(2, nx=2, ny=1), initial_covariance=1e12 * np.eye(2)[:, :, None],
                    measurement_covariance=lambda measurement: np.full((1, 1, 1), 1e-6),
                    process_covariance=lambda x, u, interval: np.zeros((2, 2, 1)),
                    measurement_jacobian=lambda x, k: np.array([[[1.0], [0.0]]]), measurement=lambda x, k: x[:1])
    for make in (Kalman, UnscentedKalman, CubatureKalman):
        estimator = make()
        estimator.start(model, 2, models.random(2))
        estimator.update(heard(np.zeros((1, 2)), np.array([[True, True]])))
        covariance = estimator.estimate().covariance
        assert covariance[0, 0, 0] == pytest.approx(1e-6, rel=1e-6)
        assert covariance[1, 1, 0] == pytest.approx(1e12)


def test_wide_states_pass_through_several_tiles() -> None:
    runs = 150
    model = models.linear(runs, nx=12, ny=5)
    data = models.record(model, runs, 4)
    means, covariances = models.feed(Kalman(), model, data)
    for run in (0, 63, 64, 149):
        single = replace(model, initial_mean=model.initial_mean[:, run:run + 1])
        mean, covariance = textbook(Kalman, single, data.only(run))
        np.testing.assert_allclose(means[:, :, run], mean, rtol=0, atol=1e-9)
        np.testing.assert_allclose(covariances[..., run], covariance, rtol=0, atol=1e-9)


def test_parameters_are_checked() -> None:
    with pytest.raises(ValueError, match="alpha and beta"):
        UnscentedKalman({"points": "julier", "alpha": 0.5})
    with pytest.raises(ValueError, match="alpha"):
        UnscentedKalman({"alpha": 0.0})
    with pytest.raises(Infeasible, match="above -2"):
        UnscentedKalman({"kappa": -2.0}).design(models.coasting(1))
    with pytest.raises(Unsupported, match="linear"):
        Kalman.require(models.coasting(1))


def test_a_linear_model_of_whole_steps_refuses_parts() -> None:
    estimator = Kalman()
    estimator.start(models.linear(2), 2, models.random(2))
    for share in (0.5, np.array([1.0, 0.5])):
        with pytest.raises(Unsupported, match="whole sampling periods"):
            estimator.predict(np.zeros((1, 2)), models.part(0, share))
    estimator.predict(np.zeros((1, 2)), models.part(0, np.ones(2)))
