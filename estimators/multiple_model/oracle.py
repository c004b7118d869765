"""The Kalman filter that is told the parameter: the bound none of the family can pass."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ...scenarios.arrays import Array
from ...scenarios.measurement import Interval
from ...scenarios.model import DesignModel, Grid, grid_of, whole_steps
from ...scenarios.randomness import RunRandom
from ..interface import Estimate
from .bank import ModeFilters


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
        modes = grid_of(model, type(self).__name__)
        self.prepare(model, runs, modes, 1)
        self.order = np.argsort(modes.grid)
        self.told = np.full((1, runs), float(modes.grid @ modes.prior))
        self.excited = reached(modes)

    def reveal(self, truth: Array) -> None:
        self.told = truth[self.model.nx:self.model.nx + 1].copy()

    def predict(self, u: Array, interval: Interval) -> None:
        """Whole sampling periods only: raises Unsupported otherwise."""
        whole_steps(interval, type(self).__name__)
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


def reached(modes: Grid) -> NDArray[np.bool_]:
    """States that process noise reaches, directly or through others, (nx,)."""
    reached = np.abs(modes.Q).sum(axis=1) > 0
    while True:
        more = reached | np.any((modes.A != 0).any(axis=0) & reached[None, :], axis=1)
        if (more == reached).all():
            return reached
        reached = more
