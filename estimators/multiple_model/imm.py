"""The interacting multiple model filter, and the Kalman filter that is told the parameter: yardsticks of the family.

Both work on the same grid of modes as RBPF, SMA and GSMA; the second is an oracle, the bound none of them can pass."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import numpy as np
from numba import njit
from numpy.typing import NDArray
from pydantic import Field, model_validator

from ..scenarios.model import DesignModel, Modes, Portion, whole_steps
from ..scenarios.randomness import RunRandom
from .interface import Estimate, Estimator, Mask, Parameters, Status, flag, used_with
from .stochastic_m import transition as transitions
from .stochastic_m.cloud import ROUNDING
from .stochastic_m.factorised import known_states
from .stochastic_m.full import kalman_block, mixture, whitened
from .stochastic_m.select import normalise

Array = NDArray[np.float64]


@njit(cache=True)
def _mix(transition, x, P, logw, alive):
    """Interaction: x[s] (nx, m), P[s] (nx, nx, m), logw[s] (m,) become the mixed priors of each mode, in place."""
    runs, nx, m = x.shape
    old_x, old_P, shares, w = np.empty((nx, m)), np.empty((nx, nx, m)), np.empty(m), np.empty(m)
    mean, covariance, old = np.empty(nx), np.empty((nx, nx)), np.empty(m)
    for s in range(runs):
        if not alive[s]:
            continue
        old_x[:], old_P[:], old[:] = x[s], P[s], logw[s]
        for j in range(m):
            for i in range(m):
                shares[i] = old[i] + transition[i, j]
            logw[s, j] = normalise(shares, m, w)
            if np.isnan(logw[s, j]):  # no way into this mode: it keeps its own state and has no weight
                logw[s, j] = -np.inf
                continue
            mixture(w, m, w, old_x, old_P, mean, covariance)
            x[s, :, j], P[s, :, :, j] = mean, covariance


@njit(cache=True)
def _filter(A, drive, support, Q, C, R, x, P, logw, y, received, alive):
    """Mode-matched Kalman filters: A (runs or 1, nx, nx, m), drive (S, nx, m); updates x, P, logw in place."""
    runs, m = logw.shape
    loglik = np.empty(m)
    for s in range(runs):
        if not alive[s]:
            continue
        Cw, yw = whitened(C, R, y[s], received[s])
        kalman_block(A[s if A.shape[0] > 1 else 0], drive[s], support, Q, Cw, yw, x[s], P[s], loglik, m)
        top = -np.inf
        for j in range(m):
            logw[s, j] += loglik[j]
            top = max(top, logw[s, j])
        if not np.isfinite(top):
            alive[s] = False
            logw[s], x[s], P[s] = np.nan, np.nan, np.nan
            continue
        total = 0.0
        for j in range(m):
            total += np.exp(logw[s, j] - top)
        for j in range(m):
            logw[s, j] -= top + np.log(total)


@njit(cache=True)
def _combine(x, P, logw, grid, mean, parameter, covariance):
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

    def prepare(self, model: DesignModel, runs: int, modes: Modes, m: int) -> None:
        """Start m filters a run at the prior."""
        nx = model.nx
        self.modes, self.alive = modes, np.ones(runs, dtype=bool)
        self.x = np.repeat(model.initial_mean.T[:, :, None], m, axis=2)
        self.P = np.empty((runs, nx, nx, m))
        self.P[:] = model.initial_covariance[None]
        self.logw = np.full((runs, m), -np.log(m))
        self.mean, self.parameter, self.covariance = np.empty((nx, runs)), np.empty((1, runs)), np.empty((nx, nx, runs))
        self.C, self.Q, self.R = (np.ascontiguousarray(part, dtype=float) for part in (modes.C, modes.Q, modes.R))
        self.support = (modes.A != 0).any(axis=0)
        self.nothing = np.zeros((runs, model.ny)), np.zeros((runs, model.ny), dtype=bool)
        # With no measurement and time standing still `_filter` leaves everything as it is.
        self.eye = np.repeat(np.eye(nx)[None, :, :, None], m, axis=3)

    def advance(self, A: Array, drive: Array) -> None:
        """Predict with A (S or 1, nx, nx, m) and B u = drive (S, nx, m)."""
        _filter(A, drive, self.support, self.Q, self.C, self.R, self.x, self.P, self.logw, *self.nothing, self.alive)

    def update(self, y: Array, received: Mask) -> None:
        still = np.zeros_like(self.x)
        _filter(self.eye, still, np.eye(len(self.Q)) != 0, np.zeros_like(self.Q), self.C, self.R, self.x, self.P,
                self.logw, np.ascontiguousarray(y.T), np.ascontiguousarray(received.T), self.alive)
        flag(self, ~self.alive, Status.failed, "all modes became impossible")

    def claim(self, states: NDArray[np.bool_], parameter: Array) -> Estimate:
        """The estimate, its covariance claimed up to the last of `states` (nx,)."""
        _combine(self.x, self.P, self.logw, self.modes.grid, self.mean, self.parameter, self.covariance)
        c = int(np.flatnonzero(states).max(initial=-1)) + 1
        covariance = self.covariance[:c, :c].copy()
        for i in range(c):
            covariance[i, i] += ROUNDING
        return Estimate(self.mean, parameter=parameter, covariance=covariance)


class ModelTransition(Parameters):
    """p(theta'|theta) of the Markov chain over the modes."""

    transition: Literal["uniform", "tridiagonal", "groups"] = Field(
        "tridiagonal", description="uniform: any value from any; tridiagonal: stay, or one grid value up or down; "
        "groups: any value of the GSMA's group")
    stay: float = Field(0.9, gt=0, le=1, description="probability of staying (tridiagonal)")

    @model_validator(mode="after")
    def _used(self) -> ModelTransition:
        used_with(self, "stay", "transition", "tridiagonal")
        return self


class InteractingMultipleModel(ModeFilters):
    """IMM: mix the modes' Gaussians by the transition probabilities, filter each with its mode, weigh, combine."""

    Parameters = ModelTransition
    summary = "interacting multiple model filter over the parameter's grid"
    source = "Blom, Bar-Shalom, IEEE Transactions on Automatic Control 33(8), 1988"

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        super().start(model, runs, random)
        modes = model.modes
        assert modes is not None
        m = len(modes.grid)
        self.prepare(model, runs, modes, m)
        self.uncertain = ~known_states(modes, model.initial_covariance[:, :, 0])
        with np.errstate(divide="ignore"):
            self.log_transition = np.log(self._transition(modes.grid))
            self.logw[:] = np.log(modes.prior)
        self.A = np.ascontiguousarray(modes.A.transpose(1, 2, 0))[None]
        self.kalman_updates = np.zeros(runs)

    def _transition(self, grid: Array) -> Array:
        """p(theta'|theta), (m, m)."""
        if self.parameters.transition == "groups":
            return transitions.within(transitions.triples(grid, printed=False))
        if self.parameters.transition == "uniform":
            return transitions.uniform(len(grid))
        return transitions.tridiagonal(len(grid), self.parameters.stay)

    def predict(self, u: Array, portion: Portion) -> None:
        """Whole sampling periods only: raises Unsupported otherwise."""
        whole_steps(portion, type(self).__name__)
        _mix(self.log_transition, self.x, self.P, self.logw, self.alive)
        drive = np.zeros_like(self.x)
        for i, j, l in np.ndindex(self.modes.B.shape[1], len(self.modes.grid), len(u)):
            drive[:, i, j] += self.modes.B[j, i, l] * u[l]
        self.advance(self.A, drive)

    def update(self, y: Array, received: Mask) -> None:
        super().update(y, received)
        self.kalman_updates += len(self.modes.grid)

    def estimate(self) -> Estimate:
        return self.claim(self.uncertain, self.parameter)

    def counters(self) -> dict[str, Array]:
        return {"kalman-updates": self.kalman_updates}


class KnownParameterKalman(ModeFilters):
    """The Kalman filter that is told the true parameter of each step: what the state's error cannot fall below.

    Between grid values A and B are interpolated linearly, which is exact where they are affine in the parameter. The
    claimed covariance covers the states that process noise reaches: of the others nothing but rounding is left."""

    oracle: ClassVar[bool] = True
    summary = "Kalman filter that knows the parameter (a bound, not an estimator)"
    source = "Kalman, J. Basic Eng. 82, 1960, with A(theta), B(theta) of the true theta"

    def design(self, model: DesignModel) -> dict[str, Any]:
        return {"told": "the true parameter of every step"}

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        super().start(model, runs, random)
        assert model.modes is not None
        self.prepare(model, runs, model.modes, 1)
        self.order = np.argsort(model.modes.grid)
        self.told = np.full((1, runs), float(model.modes.grid @ model.modes.prior))
        self.excited = _reached(model.modes)

    def reveal(self, truth: Array) -> None:
        self.told = truth[self.model.nx:self.model.nx + 1].copy()

    def predict(self, u: Array, portion: Portion) -> None:
        """Whole sampling periods only: raises Unsupported otherwise."""
        whole_steps(portion, type(self).__name__)
        theta, grid = self.told[0], self.modes.grid[self.order]
        A, B = self.modes.A[self.order], self.modes.B[self.order]
        drive = np.zeros_like(self.x)
        transition = np.empty((self.runs, *A.shape[1:], 1))
        for i in range(A.shape[1]):
            for l in range(A.shape[1]):
                transition[:, i, l, 0] = _between(theta, grid, A[:, i, l])
            for l in range(len(u)):
                drive[:, i, 0] += _between(theta, grid, B[:, i, l]) * u[l]
        self.advance(transition, drive)

    def estimate(self) -> Estimate:
        return self.claim(self.excited, self.told)


def _between(theta: Array, grid: Array, values: Array) -> Array:
    """Linear interpolation over an increasing grid, continued beyond its ends; exact at its points."""
    if len(grid) == 1:
        return np.full_like(theta, values[0])
    left = np.clip(np.searchsorted(grid, theta, side="right") - 1, 0, len(grid) - 2)
    share = (theta - grid[left]) / (grid[left + 1] - grid[left])
    return values[left] + share * (values[left + 1] - values[left])


def _reached(modes: Modes) -> NDArray[np.bool_]:
    """States that process noise reaches, directly or through others, (nx,)."""
    reached = np.abs(modes.Q).sum(axis=1) > 0
    while True:
        more = reached | np.any((modes.A != 0).any(axis=0) & reached[None, :], axis=1)
        if (more == reached).all():
            return reached
        reached = more
