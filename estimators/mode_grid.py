"""Where a grid parameter may go in one step: transition matrices and the groups of the stochastic M-algorithm.

Shared by the particle filters and the interacting multiple model filter, so that their priors can be equal."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..scenarios.arrays import Array, Index
from ..scenarios.errors import Unsupported
from ..scenarios.measurement import Measurement
from ..scenarios.model import DesignModel, Grid, grid_of

VARIANCE_FLOOR = 1e-18  # variance added to claims: a particle cloud of one value may claim less than rounding errors


def sensor_noise(model: DesignModel, measurement: Measurement) -> Array:
    """R (ny, ny, S or 1) of a measurement for estimators that work on modes."""
    if model.measurement_covariance is None:
        return np.ascontiguousarray(grid_of(model, "the estimator").R[:, :, None], dtype=float)
    R = model.measurement_covariance(measurement)
    return np.ascontiguousarray(R, dtype=float)


def known_states(modes: Grid, initial_covariance: Array) -> NDArray[np.bool_]:
    """States that are known exactly: no initial variance, no process noise, the same rule in every mode, driven by
    each other and the input alone. Shape (nx,)."""
    known = (np.diag(initial_covariance) == 0) & (np.abs(modes.Q).sum(axis=1) == 0)
    known &= (np.ptp(modes.A, axis=0) == 0).all(axis=1) & (np.ptp(modes.B, axis=0) == 0).all(axis=1)
    while True:
        leaning = np.array([np.any(modes.A[0, i, ~known] != 0) for i in range(len(known))])
        if not (known & leaning).any():
            return known
        known &= ~leaning


def uniform(m: int) -> Array:
    """Every value equally likely, whatever the present one. Shape (m, m)."""
    return np.full((m, m), 1 / m)


def tridiagonal(m: int, stay: float) -> Array:
    """Stay with probability `stay`, else one grid value up or down, equally likely where there are both. (m, m)."""
    if m == 1:
        return np.ones((1, 1))
    out = np.diag(np.full(m, stay))
    for i in range(m):
        neighbours = [j for j in (i - 1, i + 1) if 0 <= j < m]
        out[i, neighbours] = (1 - stay) / len(neighbours)
    return out


def everywhere(m: int) -> Index:
    """The SMA's children: every grid value from every other. (m, m)."""
    return np.repeat(np.arange(m)[None], m, axis=0)


def triples(grid: Array, printed: bool) -> Index:
    """The GSMA's children: of all groups of three neighbours the one whose mean is nearest the value. Shape (m, 3).

    printed: without the group of the three largest values, as the paper's list of eight has it. Raises Unsupported
    when the grid is too short."""
    m = len(grid)
    starts = np.arange(m - 2)
    if printed:
        starts = np.delete(starts, np.argmax([grid[s:s + 3].mean() for s in starts])) if m > 2 else starts
    if len(starts) == 0:
        raise Unsupported(f"groups of three need a grid of at least {4 if printed else 3} values; this one has {m}")
    centres = np.array([grid[s:s + 3].mean() for s in starts])
    # Rounding must not decide between two groups equally near: distances are compared to nine digits.
    nearest = starts[np.argmin(np.round(np.abs(grid[:, None] - centres), 9), axis=1)]
    return nearest[:, None] + np.arange(3)


def within(children: Index) -> Array:
    """Every child of a value equally likely: the SMA's and GSMA's own prior as a transition matrix, (m, m)."""
    m, g = children.shape
    out = np.zeros((m, m))
    np.put_along_axis(out, children, 1 / g, axis=1)
    return out


def log_prior(transition: Array, children: Index) -> Array:
    """log p(theta'|theta) of each child, (m, g), a probability over the children; minus infinity where the transition
    forbids it."""
    chances = np.take_along_axis(transition, children, axis=1)
    with np.errstate(divide="ignore"):
        return np.log(chances / chances.sum(axis=1, keepdims=True))
