"""The metro model's EKF, UKF and CKF against filterpy's, in a bare loop with a plain Python model, and by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
from filterpy.kalman import (
    CubatureKalmanFilter,
    ExtendedKalmanFilter,
    MerweScaledSigmaPoints,
    UnscentedKalmanFilter,
    spherical_radial_sigmas,
)

from ...estimators.sigma_point import UnscentedKalman
from ...scenarios.arrays import Array
from ...scenarios.measurement import Interval, untold
from ...scenarios.metro.setting import Metro
from . import by_hand
from .measure import BY_HAND, Line, cell_of, contest, ours, peer, recorded

RUNS, STEPS, PEER_RUNS = (1, 100, 1000), 200, 3


class PlainMetro:
    """The metro model as a filterpy user would write it: Python numbers, no arrays but the state."""

    def __init__(self, setting: Metro) -> None:
        plant, self.period = setting.config.plant, setting.config.time.period
        self.forces, slope = plant.train.forces, plant.line.slope(plant.train.rotating)
        self.origin, self.cells, self.count = slope.origin, slope.cells, len(slope.base) - 1
        self.base, self.edge, self.jump = slope.base.tolist(), slope.edge.tolist(), slope.jump.tolist()

    def _share(self, V: float, c: tuple[float, ...]) -> float:
        return c[0] / V + c[1] + V * (c[2] + V * (c[3] + V * c[4]))

    def f(self, x: Array, dt: float, u: float) -> Array:
        """The state dt seconds later."""
        s, v = x.tolist()
        q, V = self.forces, 3.6 * v
        top, c = (q.brake, q[7:12]) if u < 0 else (q.drive, q[1:6])
        cell = int(min(max((s - self.origin) * self.cells, 0.0), self.count))
        climb = self.base[cell] + (self.jump[cell] if s >= self.edge[cell] else 0.0)
        left = min(max(self._share(max(V, 0.1), c), 0.0), 1.0)
        a = u * top * left - (q.r0 + V * (q.r1 + V * q.r2)) - climb
        return np.array([s + dt * v + 0.5 * dt * dt * a, v + dt * a])

    def F(self, x: Array, dt: float, u: float) -> Array:
        """Its Jacobian."""
        q, V = self.forces, 3.6 * float(x[1])
        top, c = (q.brake, q[7:12]) if u < 0 else (q.drive, q[1:6])
        W = max(V, 0.1)
        grade = c[2] - c[0] / (W * W) + W * (2 * c[3] + 3 * W * c[4]) if 0 < self._share(W, c) < 1 else 0.0
        d = 3.6 * (u * top * grade - q.r1 - 2 * q.r2 * V)
        return np.array([[1.0, dt + 0.5 * dt * dt * d], [0.0, 1.0 + dt * d]])


def race(repeats: int) -> list[Line]:
    """Each filter at each number of runs against filterpy and the loop written by hand."""
    lines = []
    for label in ("ekf", "ukf", "ckf"):
        cell = cell_of("ningbo-metro/white", label)
        for runs in RUNS:
            sides = [peer("filterpy", _Loop(cell, label, min(runs, PEER_RUNS)).run),
                     peer(BY_HAND, _ByHand(cell, label, runs).run)]
            lines += contest(ours(cell, label, runs, STEPS), 2, runs, sides, repeats)
    return lines


class _ByHand:
    """The compiled loop of one kind over the same truths."""

    def __init__(self, cell: Any, label: str, runs: int) -> None:
        setting = cell.setting()
        assert isinstance(setting, Metro)
        self.label, self.world, plant = label, recorded(cell, runs), setting.config.plant
        self.law = plant.train.forces, plant.line.slope(plant.train.rotating)
        self.period, (self.P0, self.Q, self.R) = setting.config.time.period, _covariances(setting, self.world)
        self.u = np.ascontiguousarray(self.world.u[:STEPS, 0])
        self.y = np.ascontiguousarray(self.world.y[:STEPS])

    def run(self) -> tuple[int, Array]:
        """All runs; returns the number of run-steps and the final means (2, runs)."""
        runs = self.u.shape[1]
        x, P = self.world.initial_mean.copy(), np.repeat(self.P0[[0, 1, 1], [0, 0, 1], None], runs, axis=1)
        given = (x, P, self.u, self.y, self.period, *self.law, self.Q[[0, 1, 1], [0, 0, 1]], self.R.diagonal().copy())
        if self.label == "ekf":
            by_hand.metro_ekf(*given)
        elif self.label == "ukf":
            by_hand.metro_points(*given, 3.0**0.5, 1 / 3, 1 / 6)
        else:
            by_hand.metro_points(*given, 2.0**0.5, 0.0, 0.25)
        return runs * len(self.u), x


def _covariances(setting: Metro, world: Any) -> tuple[Array, Array, Array]:
    """P0, Q, R (2, 2) as the design model has them."""
    model = setting.design_model({}, world.initial_mean)
    assert model.process_covariance and model.measurement_covariance
    whole = Interval(1, 0.0, setting.config.time.period)
    Q = model.process_covariance(world.initial_mean, world.u[0], whole)
    R = model.measurement_covariance(untold(1, 2))
    return model.initial_covariance[:, :, 0].copy(), Q[:, :, 0].copy(), R[:, :, 0].copy()


class _Loop:
    """filterpy's filter of one kind over a few runs of the same truths."""

    def __init__(self, cell: Any, label: str, runs: int) -> None:
        setting = cell.setting()
        assert isinstance(setting, Metro)
        self.label, self.plain, self.world, self.runs = label, PlainMetro(setting), recorded(cell, runs), runs
        self.P0, self.Q, self.R = _covariances(setting, self.world)

    def run(self) -> tuple[int, Array]:
        """All runs; returns the number of run-steps and the final means (2, runs)."""
        loops = {"ekf": self._ekf, "ukf": self._ukf, "ckf": self._ckf}
        last = [loops[self.label](run) for run in range(self.runs)]
        return self.runs * STEPS, np.array(last).T

    def _set(self, filter: Any, run: int) -> Any:
        filter.x, filter.P, filter.Q, filter.R = self.world.initial_mean[:, run].copy(), self.P0.copy(), self.Q, self.R
        return filter

    def _ekf(self, run: int) -> Array:
        filter, plain, dt = self._set(ExtendedKalmanFilter(2, 2), run), self.plain, self.plain.period
        identity = np.eye(2)
        for k in range(STEPS):
            u = float(self.world.u[k, 0, run])
            filter.F, moved = plain.F(filter.x, dt, u), plain.f(filter.x, dt, u)
            filter.predict()
            filter.x = moved
            filter.update(self.world.y[k, :, run], lambda x: identity, lambda x: x)
        return filter.x

    def _ukf(self, run: int) -> Array:
        p: Any = UnscentedKalman().parameters
        points = MerweScaledSigmaPoints(2, p.alpha, p.beta, p.kappa_for(2))
        dt = self.plain.period
        filter = self._set(UnscentedKalmanFilter(2, 2, dt, lambda x: x, self.plain.f, points), run)
        for k in range(STEPS):
            filter.predict(u=float(self.world.u[k, 0, run]))
            filter.update(self.world.y[k, :, run])
        return filter.x

    def _ckf(self, run: int) -> Array:
        dt = self.plain.period
        filter: Any = self._set(CubatureKalmanFilter(2, 2, dt, lambda x: x, self.plain.f), run)
        filter.x = filter.x[:, None]
        for k in range(STEPS):
            u = float(self.world.u[k, 0, run])
            filter.fx = lambda x, dt, u=u: self.plain.f(x, dt, u)
            filter.predict()
            filter.sigmas_f = spherical_radial_sigmas(filter.x, filter.P)  # filterpy reuses points without Q
            filter.update(self.world.y[k, :, run][:, None])
        return filter.x[:, 0]
