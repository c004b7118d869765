"""The interacting multiple model filter, and the Kalman filter that is told the parameter: yardsticks of the family.

Both work on the same grid of modes as RBPF, SMA and GSMA; the second is an oracle, the bound none of them can pass."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from ...scenarios.arrays import Array
from ...scenarios.machine_code import njit
from ...scenarios.measurement import Interval, Measurement
from ...scenarios.model import DesignModel, grid_of, whole_steps
from ...scenarios.randomness import RunRandom
from .. import mode_grid as transitions
from ..interface import Estimate, Innovation, Parameters, used_with
from ..kernels.modes import mixture, normalise
from ..mode_grid import known_states
from .bank import ModeFilters


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
    family = "IMM"
    summary = "interacting multiple model filter over the parameter's grid"
    source = "Blom, Bar-Shalom, IEEE Transactions on Automatic Control 33(8), 1988"

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        super().start(model, runs, random)
        modes = grid_of(model, type(self).__name__)
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

    def predict(self, u: Array, interval: Interval) -> None:
        """Whole sampling periods only: raises Unsupported otherwise."""
        whole_steps(interval, type(self).__name__)
        _mix(self.log_transition, self.x, self.P, self.logw, self.alive)
        drive = np.zeros_like(self.x)
        for i, j, l in np.ndindex(self.modes.B.shape[1], len(self.modes.grid), len(u)):
            drive[:, i, j] += self.modes.B[j, i, l] * u[l]
        self.advance(self.A, drive)

    def update(self, measurement: Measurement) -> Innovation | None:
        self.kalman_updates += len(self.modes.grid)
        return super().update(measurement)

    def estimate(self) -> Estimate:
        return self.claim(self.uncertain, self.parameter)

    def counters(self) -> dict[str, Array]:
        return {"kalman-updates": self.kalman_updates}
