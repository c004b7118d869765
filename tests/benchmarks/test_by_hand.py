"""The filters written out by hand beside textbook matrices, run by run: means and covariances, more runs than a block.

A speed comparison asks them for means of a few runs only."""

from __future__ import annotations

import numpy as np
import pytest
from railstate.benchmarks.speed import by_hand
from railstate.benchmarks.speed.measure import cell_of
from railstate.benchmarks.speed.metro import PlainMetro
from railstate.scenarios.arrays import Array
from railstate.scenarios.metro.setting import Metro

RUNS, STEPS = by_hand.BLOCK + 3, 4
Q, R = np.array([[0.3, 0.05], [0.05, 0.2]]), np.diag([25.0, 0.4])


def updated(m: Array, P: Array, y: Array, C: Array, R: Array) -> tuple[Array, Array]:
    K = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
    return m + K @ (y - C @ m), P - K @ C @ P


def test_a_kalman_filter_of_any_linear_model() -> None:
    """The measurement of step 0 comes before any prediction; a packet that is lost changes nothing."""
    rng = np.random.default_rng(1)
    A, B, h = np.eye(3) + rng.normal(0, 0.3, (3, 3)), rng.normal(size=(3, 2)), rng.normal(size=3)
    C, root, noise = np.array([[1.0, 0.0, 0.5], [0.0, -2.0, 0.0]]), rng.normal(size=(3, 3)), np.diag([0.5, 2.0])
    x, u, y = rng.normal(size=(3, RUNS)), rng.normal(size=(STEPS, 2, RUNS)), rng.normal(size=(STEPS, 2, RUNS))
    P = np.ascontiguousarray((root @ root.T)[:, :, None] * rng.uniform(1, 2, RUNS))
    received, process = rng.uniform(size=(STEPS, RUNS)) < 0.6, root.T @ root
    wanted = []
    for run in range(RUNS):
        m, V = x[:, run], P[:, :, run]
        for k in range(STEPS):
            if k:
                m, V = A @ m + B @ u[k, :, run] + h, A @ V @ A.T + process
            if received[k, run]:
                m, V = updated(m, V, y[k, :, run], C, noise)
        wanted.append((m, V))
    by_hand.kalman(x, P, u, y, received, A, B, h, C, process, noise)
    np.testing.assert_allclose(x.T, [m for m, _ in wanted], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(np.moveaxis(P, 2, 0), [V for _, V in wanted], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("kind", "scale", "centre", "weight"), [
    ("ekf", 0.0, 0.0, 0.0), ("ukf", 3.0**0.5, 1 / 3, 1 / 6), ("ckf", 2.0**0.5, 0.0, 0.25)])
def test_filters_of_the_metro(kind: str, scale: float, centre: float, weight: float) -> None:
    setting = cell_of("ningbo-metro/white", "ekf").setting()
    assert isinstance(setting, Metro)
    plant, plain, period = setting.config.plant, PlainMetro(setting), 0.7
    rng = np.random.default_rng(2)
    x = np.array([rng.uniform(0, 3000, RUNS), rng.uniform(3, 25, RUNS)])
    P = np.array([rng.uniform(9, 16, RUNS), rng.uniform(-0.5, 0.5, RUNS), rng.uniform(0.5, 1, RUNS)])
    u, y = rng.uniform(-1, 1, (STEPS, RUNS)), x + rng.normal(size=(STEPS, 2, RUNS))
    wanted = []
    for run in range(RUNS):
        m, V = x[:, run], P[[[0, 1], [1, 2]], run]
        for k in range(STEPS):
            if kind == "ekf":
                F = plain.F(m, period, u[k, run])
                m, V = plain.f(m, period, u[k, run]), F @ V @ F.T + Q
            else:
                away = scale * np.linalg.cholesky(V).T
                points = [plain.f(m + part, period, u[k, run]) for part in (0 * m, *away, *-away)]
                weights = [centre, *[weight] * 4]
                m = sum(w * point for w, point in zip(weights, points, strict=True))
                V = Q + sum(w * np.outer(point - m, point - m) for w, point in zip(weights, points, strict=True))
            m, V = updated(m, V, y[k, :, run], np.eye(2), R)
        wanted.append([*m, V[0, 0], V[0, 1], V[1, 1]])
    given = (x, P, u, y, period, plant.train.forces, plant.line.slope(plant.train.rotating), Q[[0, 1, 1], [0, 0, 1]],
             R.diagonal().copy())
    if kind == "ekf":
        by_hand.metro_ekf(*given)
    else:
        by_hand.metro_points(*given, scale, centre, weight)
    np.testing.assert_allclose(np.vstack([x, P]).T, wanted, rtol=1e-8, atol=1e-9)
