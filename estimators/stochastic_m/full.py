"""The full step of the grid particle filters: every child its own Kalman prediction and update, as the paper writes it.

The reference for the factorised step, and the one to use where modes differ by more than a known input."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...scenarios.arrays import Array
from ...scenarios.machine_code import njit
from ...scenarios.model import Grid
from ..kernels.modes import kalman_block, mixture, normalise, whitened
from .select import collapse, distinct, select

CHUNK = 64


class FullModes(NamedTuple):
    """`scenarios.model.Grid` as plain arrays for the kernels; support (nx, nx): entries of A some mode fills."""

    A: Array
    B: Array
    C: Array
    Q: Array
    grid: Array
    support: NDArray[np.bool_]


class FullCloud(NamedTuple):
    """Particles of all runs, particles innermost: x (S, nx, capacity), P (S, nx, nx, capacity), theta and logw
    (S, capacity), alive (S,)."""

    x: Array
    P: Array
    theta: NDArray[np.int64]
    logw: Array
    alive: NDArray[np.bool_]


class FullMoments(NamedTuple):
    """What a step hands out: mean (nx, S), parameter (1, S), covariance (nx, nx, S), diversity (S,);
    log_likelihood (S,) as in `factorised.Moments`."""

    mean: Array
    parameter: Array
    covariance: Array
    diversity: Array
    log_likelihood: Array


def full_modes(modes: Grid) -> FullModes:
    """The modes as the kernels take them."""
    A, B, C, Q = (np.ascontiguousarray(part, dtype=float) for part in (modes.A, modes.B, modes.C, modes.Q))
    return FullModes(A, B, C, Q, np.ascontiguousarray(modes.grid, dtype=float), (A != 0).any(axis=0))


def still(modes: FullModes) -> FullModes:
    """The same modes with time standing still, for a second measurement at the same instant."""
    eye = np.eye(len(modes.Q))
    return modes._replace(A=np.repeat(eye[None], len(modes.A), axis=0), B=np.zeros_like(modes.B),
                          Q=np.zeros_like(modes.Q), support=eye != 0)


@njit(cache=True)
def step(model, children, log_prior, cloud, n, u, y, received, R, draws, keep, by_weight, memoryless, optimal, commit,
         out):
    """As `factorised.step`, with a Kalman filter per child."""
    runs, nx, _ = cloud.x.shape
    g = children.shape[1]
    size = n * g
    goes_on = keep if keep > 0 else (n if optimal else size)
    x, P = np.empty((nx, size)), np.empty((nx, nx, size))
    block_x, block_P, A = np.empty((nx, CHUNK)), np.empty((nx, nx, CHUNK)), np.empty((nx, nx, CHUNK))
    drive, loglik = np.empty((nx, CHUNK)), np.empty(CHUNK)
    logw, w, value, mode = np.empty(size), np.empty(size), np.empty(size), np.empty(size, np.int64)
    picked, index, kept = np.arange(size), np.empty(goes_on, np.int64), np.empty(goes_on)
    theta_new, seen = np.empty(goes_on, np.int64), np.empty(len(model.grid), np.bool_)
    mean, covariance = np.empty(nx), np.empty((nx, nx))
    Bu = np.empty((len(model.grid), nx))
    for s in range(runs):
        if not cloud.alive[s]:
            continue
        Cw, yw, constant = whitened(model.C, R[:, :, s if R.shape[2] > 1 else 0], y[s], received[s])
        for m in range(len(model.grid)):
            for i in range(nx):
                Bu[m, i] = 0.0
                for l in range(u.shape[1]):
                    Bu[m, i] += model.B[m, i, l] * u[s, l]
        for begin in range(0, size, CHUNK):
            c = min(CHUNK, size - begin)
            for k in range(c):
                parent = (begin + k) // g
                m = children[cloud.theta[s, parent], begin + k - parent * g]
                mode[begin + k], value[begin + k] = m, model.grid[m]
                for i in range(nx):
                    block_x[i, k], drive[i, k] = cloud.x[s, i, parent], Bu[m, i]
                    for j in range(nx):
                        block_P[i, j, k], A[i, j, k] = cloud.P[s, i, j, parent], model.A[m, i, j]
            kalman_block(A, drive, model.support, model.Q, Cw, yw, block_x, block_P, loglik, c)
            for i in range(nx):
                x[i, begin:begin + c] = block_x[i, :c]
                for j in range(nx):
                    P[i, j, begin:begin + c] = block_P[i, j, :c]
            for k in range(c):
                parent = (begin + k) // g
                row = cloud.theta[s, parent]
                before = 0.0 if memoryless else cloud.logw[s, parent]
                logw[begin + k] = before + log_prior[row, begin + k - parent * g] + loglik[k]
        count = size
        if optimal:
            collapse(logw, n, g, draws[s], picked, w)
            count = n
            for i in range(n):  # picked[i] >= i: nothing still to be read is overwritten
                mode[i], value[i] = mode[picked[i]], value[picked[i]]
                x[:, i], P[:, :, i] = x[:, picked[i]], P[:, :, picked[i]]
        total = normalise(logw, count, w)
        if np.isnan(total):
            cloud.alive[s] = False
            out.mean[:, s], out.parameter[0, s] = np.nan, np.nan
            out.covariance[:, :, s], out.diversity[s], out.log_likelihood[s] = np.nan, np.nan, np.nan
            continue
        out.log_likelihood[s] = total + constant
        out.parameter[0, s] = mixture(w, count, value, x, P, mean, covariance)
        out.mean[:, s], out.covariance[:, :, s] = mean, covariance
        if not commit:
            out.diversity[s] = distinct(cloud.theta[s], cloud.logw[s], n, seen)
            continue
        goes_on = select(logw, w, count, total, keep, by_weight, draws[s, 0], index, kept)
        for j in range(goes_on):
            theta_new[j] = mode[index[j]]
        for i in range(nx):
            for j in range(goes_on):
                cloud.x[s, i, j] = x[i, index[j]]
            for l in range(nx):
                for j in range(goes_on):
                    cloud.P[s, i, l, j] = P[i, l, index[j]]
        cloud.theta[s, :goes_on] = theta_new
        cloud.logw[s, :goes_on] = kept
        out.diversity[s] = distinct(theta_new, kept, goes_on, seen)
    return goes_on
