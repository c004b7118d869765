"""The metro's compiled motion: the acceleration law with every constant in its place, in any number of tiles."""

from __future__ import annotations

import numpy as np
import pytest
from railstate.benchmarks.planning.plan import make_plan
from railstate.estimators.kalman import ExtendedKalman
from railstate.scenarios.compiled import Compiled
from railstate.scenarios.measurement import Interval
from railstate.scenarios.railway import dynamics
from railstate.scenarios.units import KMH

T = 0.5
FORCES = dynamics.Forces(1.1, 2.0, 0.5, -1e-3, 2e-5, -3e-7, 1.3, 1.5, 0.6, -2e-3, 3e-5, -4e-7, 0.02, 3e-4, 5e-6)
WHERE, STEEP = np.array([10.0, 60.0, 75.0, 300.0]), np.array([0.004, -0.02, 0.013, 0.0])


def accelerations(v: float, u: float, s: float) -> float:
    """At v m/s, with the input u, at s m."""
    f, V = FORCES, KMH * v
    top, *c = (f.brake, f.b0, f.b1, f.b2, f.b3, f.b4) if u < 0 else (f.drive, f.t0, f.t1, f.t2, f.t3, f.t4)
    share = min(1.0, max(0.0, c[0] / max(V, 0.1) + np.polyval(c[:0:-1], max(V, 0.1))))
    rise = STEEP[max(np.searchsorted(WHERE, s, side="right") - 1, 0)]
    return u * top * share - np.polyval([f.r2, f.r1, f.r0], V) - dynamics.GRAVITY * rise / 1.1


def test_every_constant_of_the_law_is_in_its_place() -> None:
    law = dynamics.constants(FORCES, dynamics.slope_grid(WHERE, STEEP, 0.1))
    v, u, s = (part.ravel() for part in np.meshgrid([0.0, 0.5, 7.0, 15.0, 21.0], [-1.0, -0.3, 0.0, 0.4, 1.0],
                                                    [-5.0, 10.0, 59.9, 60.0, 74.0, 80.0, 299.0, 4000.0]))
    x, told, interval = np.stack([s, v]), u[None], Interval(0, 0.0, T, 1.0)

    def given(interval: Interval, runs: int) -> tuple[np.ndarray, np.ndarray]:
        return law, np.full(runs, T)

    a = np.array([accelerations(*each) for each in zip(v, u, s, strict=True)])
    moved = Compiled(dynamics.driven, 1, given)(x, told, interval)
    np.testing.assert_allclose(moved, [s + T * v + 0.5 * T * T * a, v + T * a], rtol=1e-12, atol=1e-12)
    F, d = Compiled(dynamics.driven_jacobian, 1, given, square=True)(x, told, interval), 1e-6
    smooth = v > 0.4
    slopes = np.array([(accelerations(b + d, c, e) - accelerations(b - d, c, e)) / (2 * d)
                       for b, c, e in zip(v, u, s, strict=True)])
    expected = [[np.ones_like(v), T + 0.5 * T * T * slopes], [np.zeros_like(v), 1 + T * slopes]]
    np.testing.assert_allclose(F[..., smooth], np.array(expected)[..., smooth], rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("runs", [1024, 1025, 2500])
def test_runs_beyond_a_tile_are_predicted_as_any(runs: int) -> None:
    setting, rng = make_plan(["ningbo-metro/switching"], only=["ekf"]).cells[0].setting(), np.random.default_rng(4)
    mean = np.stack([rng.uniform(0.0, 1800.0, runs), rng.uniform(0.0, 20.0, runs)])
    u, whole = rng.uniform(-1.0, 1.0, (1, runs)), Interval(0, 0.0, setting.config.time.period, 1.0)

    def after(part: slice) -> list[np.ndarray]:
        estimator, model = ExtendedKalman({}), setting.design_model({}, mean[:, part].copy())
        estimator.start(model, mean[:, part].shape[1], None)
        for _ in range(3):
            estimator.predict(u[:, part].copy(), whole)
        found = estimator.estimate()
        return [found.mean, found.covariance]

    for all_, halves in zip(after(slice(None)), zip(after(slice(0, 700)), after(slice(700, None)), strict=True),
                            strict=True):
        assert np.array_equal(all_, np.concatenate(halves, axis=-1))
