"""The part of a factorised step that all particles of a run share: its gain, and its innovation as theta moves it.

Small matrices in plain loops, one run at a time, so that results do not depend on the batch."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...scenarios.arrays import Array
from ...scenarios.machine_code import njit
from ..kernels.core import HALF_LOG_TURN


class Factors(NamedTuple):
    """x_u(k+1) = F x_u + (D0 + theta D1) x_k + (B0 + theta B1) u + noise Q, x_k(k+1) = Ak x_k + Bk u exactly;
    y = C x_u + Ck x_k + noise. u: uncertain states, k: known ones. grid (m,)."""

    F: Array
    D0: Array
    D1: Array
    B0: Array
    B1: Array
    Ak: Array
    Bk: Array
    C: Array
    Ck: Array
    Q: Array
    grid: Array


@njit(cache=True, inner=True)
def pair_product(a, b, transposed):
    """a b, or a b' (small matrices)."""
    rows, inner = a.shape
    columns = b.shape[0] if transposed else b.shape[1]
    out = np.zeros((rows, columns))
    for i in range(rows):
        for j in range(columns):
            for l in range(inner):
                out[i, j] += a[i, l] * (b[j, l] if transposed else b[l, j])
    return out


@njit(cache=True, inner=True)
def _add(a, b, out):
    """out += a b, b and out vectors."""
    for i in range(a.shape[0]):
        for l in range(a.shape[1]):
            out[i] += a[i, l] * b[l]


@njit(cache=True, inner=True)
def _solve_lower(L, b):
    """L^-1 b in place, b (r, columns)."""
    for i in range(L.shape[0]):
        for c in range(b.shape[1]):
            for l in range(i):
                b[i, c] -= L[i, l] * b[l, c]
            b[i, c] /= L[i, i]


@njit(cache=True, inner=True)
def gain_of(model, P, received, R):
    """What depends on neither data nor input: received rows, L with L L' = S, M = L^-1 C F, the gain W = P C' L^-T of
    whitened innovations, G = (1 - K C) F, and the posterior covariance; and -log det L - r/2 log 2 pi. R (ny, ny)."""
    rows = np.nonzero(received)[0]
    P = pair_product(pair_product(model.F, P, False), model.F, True) + model.Q
    C = model.C[rows]
    CP = pair_product(C, P, False)
    L = pair_product(CP, C, True)
    constant = 0.0
    for a in range(len(rows)):
        for b in range(a + 1):
            total = L[a, b] + R[rows[a], rows[b]]
            for l in range(b):
                total -= L[a, l] * L[b, l]
            L[a, b] = np.sqrt(total) if a == b else total / L[b, b]
        constant -= np.log(L[a, a]) + HALF_LOG_TURN
    M = pair_product(C, model.F, False)
    _solve_lower(L, M)
    _solve_lower(L, CP)
    W = np.ascontiguousarray(CP.T)
    return (rows, C, L, M, W, model.F - pair_product(W, M, False), P - pair_product(W, W, True)), constant


@njit(cache=True, inner=True)
def innovation(model, gain, known, u, y, now, g, z, e):
    """What depends on data and input, into now (nk,), z (r, 2), e (nu, 2): the whitened innovation of a particle is
    z[:, 0] - M x - theta z[:, 1], its posterior mean G x + e[:, 0] + theta e[:, 1]; g (nu, 2) is scratch."""
    rows, C, L, _, W, _, _ = gain
    now[:], g[:] = 0.0, 0.0
    _add(model.Ak, known, now)
    _add(model.Bk, u, now)
    _add(model.D0, known, g[:, 0])
    _add(model.B0, u, g[:, 0])
    _add(model.D1, known, g[:, 1])
    _add(model.B1, u, g[:, 1])
    for a in range(len(rows)):
        z[a, 0], z[a, 1] = y[rows[a]], 0.0
        for l in range(len(now)):
            z[a, 0] -= model.Ck[rows[a], l] * now[l]
        for l in range(len(g)):
            z[a, 0] -= C[a, l] * g[l, 0]
            z[a, 1] += C[a, l] * g[l, 1]
    _solve_lower(L, z)
    for l in range(len(g)):
        e[l, 0], e[l, 1] = g[l, 0], g[l, 1]
        for a in range(len(rows)):
            e[l, 0] += W[l, a] * z[a, 0]
            e[l, 1] -= W[l, a] * z[a, 1]
