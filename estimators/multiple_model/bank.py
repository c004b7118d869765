"""A bank of mode-matched Kalman filters, one step of all of them at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...scenarios.arrays import Array
from ...scenarios.machine_code import njit
from ...scenarios.measurement import Measurement
from ...scenarios.model import DesignModel, Grid, grid_of
from ..interface import Estimate, Estimator, Innovation, Status, flag
from ..kernels.modes import kalman_block, mixture, whitened
from ..mode_grid import VARIANCE_FLOOR, sensor_noise


@njit(cache=True)
def filters(A, drive, support, Q, C, R, x, P, logw, y, received, alive, log_likelihood):
    """Mode-matched Kalman filters: A (runs or 1, nx, nx, m), drive (S, nx, m), R (ny, ny, S or 1); updates x, P, logw
    in place, and writes log_likelihood (S,), log p(y received | before)."""
    runs, m = logw.shape
    loglik = np.empty(m)
    for s in range(runs):
        if not alive[s]:
            continue
        Cw, yw, constant = whitened(C, R[:, :, s if R.shape[2] > 1 else 0], y[s], received[s])
        kalman_block(A[s if A.shape[0] > 1 else 0], drive[s], support, Q, Cw, yw, x[s], P[s], loglik, m)
        top = -np.inf
        for j in range(m):
            logw[s, j] += loglik[j]
            top = max(top, logw[s, j])
        if not np.isfinite(top):
            alive[s] = False
            logw[s], x[s], P[s], log_likelihood[s] = np.nan, np.nan, np.nan, np.nan
            continue
        total = 0.0
        for j in range(m):
            total += np.exp(logw[s, j] - top)
        log_likelihood[s] = constant + top + np.log(total)
        for j in range(m):
            logw[s, j] -= top + np.log(total)


@njit(cache=True)
def combined(x, P, logw, grid, mean, parameter, covariance):
    """Moments over the modes: mean (nx, S), parameter (1, S), covariance (nx, nx, S)."""
    runs, nx, m = x.shape
    one, square, w = np.empty(nx), np.empty((nx, nx)), np.empty(m)
    for s in range(runs):
        for j in range(m):
            w[j] = np.exp(logw[s, j])
        parameter[0, s] = mixture(w, m, grid, x[s], P[s], one, square)
        mean[:, s], covariance[:, :, s] = one, square


class ModeFilters(Estimator):
    """A bank of Kalman filters, one per mode, runs outermost inside: x (S, nx, m), P (S, nx, nx, m), logw (S, m)."""

    needs = ("modes",)
    claims = ("parameter", "covariance")
    honours = ("covariance",)

    @classmethod
    def require(cls, model: DesignModel) -> None:
        super().require(model)
        grid_of(model, cls.__name__)

    def prepare(self, model: DesignModel, runs: int, modes: Grid, m: int) -> None:
        """Start m filters a run at the prior."""
        nx = model.nx
        self.modes, self.alive = modes, np.ones(runs, dtype=bool)
        self.x = np.repeat(model.initial_mean.T[:, :, None], m, axis=2)
        self.P = np.empty((runs, nx, nx, m))
        self.P[:] = model.initial_covariance[None]
        self.logw = np.full((runs, m), -np.log(m))
        self.mean, self.parameter, self.covariance = np.empty((nx, runs)), np.empty((1, runs)), np.empty((nx, nx, runs))
        self.C, self.Q = (np.ascontiguousarray(part, dtype=float) for part in (modes.C, modes.Q))
        self.R = np.ascontiguousarray(modes.R[:, :, None], dtype=float)
        self.log_likelihood, self.unused = np.zeros(runs), np.zeros(runs)
        self.support = (modes.A != 0).any(axis=0)
        self.nothing = np.zeros((runs, model.ny)), np.zeros((runs, model.ny), dtype=bool)
        # With no measurement and time standing still `filters` leaves everything as it is.
        self.eye = np.repeat(np.eye(nx)[None, :, :, None], m, axis=3)

    def advance(self, A: Array, drive: Array) -> None:
        """Predict with A (S or 1, nx, nx, m) and B u = drive (S, nx, m)."""
        filters(A, drive, self.support, self.Q, self.C, self.R, self.x, self.P, self.logw, *self.nothing, self.alive,
                self.unused)

    def update(self, measurement: Measurement) -> Innovation | None:
        still = np.zeros_like(self.x)
        filters(self.eye, still, np.eye(len(self.Q)) != 0, np.zeros_like(self.Q), self.C,
                sensor_noise(self.model, measurement), self.x, self.P, self.logw, np.array(measurement.y.T, order="C"),
                np.array(measurement.received.T, order="C"), self.alive, self.log_likelihood)
        flag(self, ~self.alive, Status.failed, "all modes became impossible")
        return Innovation(log_likelihood=self.log_likelihood)

    def claim(self, states: NDArray[np.bool_], parameter: Array) -> Estimate:
        """The estimate, its covariance claimed up to the last of `states` (nx,)."""
        combined(self.x, self.P, self.logw, self.modes.grid, self.mean, self.parameter, self.covariance)
        c = int(np.flatnonzero(states).max(initial=-1)) + 1
        covariance = self.covariance[:c, :c].copy()
        for i in range(c):
            covariance[i, i] += VARIANCE_FLOOR
        return Estimate(self.mean, parameter=parameter, covariance=covariance)
