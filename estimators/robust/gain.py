"""The gain of least objective for fixed multipliers, K = S C'(C S C' + R~)^-1, for one run at a time.

By the innovation's matrix where that is well conditioned, else from the roots of S and R~ by orthogonal steps."""

from __future__ import annotations

import numpy as np

from ..kernels.core import inner
from .small import SMALLEST_PIVOT, factorise_one, solve_one

SAFE_PIVOT = 1e-8
"""A Cholesky pivot of C S C' + R~ under this share of its diagonal entry has lost half of its digits."""


@inner
def best_gain(S, L, p, c2, sigma, M, g, C, m, R, share, ellipsoid, V, tall, K):  # pyright: ignore
    """K (n, m) for S (n, n) = [L + p p'/sigma + M M' (c2 + sigma)] / share_0 + sum over channels of g g' / share and
    R~ = R, or for the ellipsoid diag(R_jj / share_j). False where C S C' + R~ is singular.

    V (ny, ny) and tall (n + 2 + nw + ny, ny + n) are for scratch. Redundant sensors (more of them than states) make S
    so large beside R~ that C S C' + R~ is singular in floating point though it is not: its root then comes from the
    parts."""
    n, offset = S.shape[0], 1 + g.shape[1]
    for i in range(n):
        for j in range(m):
            total = 0.0
            for k in range(n):
                total += S[i, k] * C[j, k]
            K[i, j] = total
    for j in range(m):
        for l in range(j + 1):
            total = _noise(R, share, offset, ellipsoid, j, l)
            for k in range(n):
                total += C[j, k] * K[k, l]
            V[j, l] = total
    if not factorise_one(V, m, SAFE_PIVOT):
        return _careful_gain(L, p, c2, sigma, M, g, C, m, R, share, ellipsoid, tall, K)
    for i in range(n):
        solve_one(V, m, K[i])
    return True


@inner
def _noise(R, share, offset, ellipsoid, j, k):  # pyright: ignore
    """Entry (j, k) of R~: R itself, or for the ellipsoid diag(v_bar^2 / share)."""
    if not ellipsoid:
        return R[j, k]
    return R[j, j] / share[offset + j] if j == k else 0.0


@inner
def _root_column(X, r, n, factor):  # pyright: ignore
    """Column r of the lower Cholesky factor of the semi-definite X (n, n), whose columns before stand in factor (n, n):
    zero where the pivot is."""
    for i in range(r, n):
        total = X[i, r]
        for k in range(r):
            total -= factor[i, k] * factor[r, k]
        if i == r:
            factor[r, r] = np.sqrt(total) if total > SMALLEST_PIVOT * X[r, r] else 0.0
        else:
            factor[i, r] = total / factor[r, r] if factor[r, r] > 0.0 else 0.0


@inner
def _careful_gain(L, p, c2, sigma, M, g, C, m, R, share, ellipsoid, tall, K):  # pyright: ignore
    """As `best_gain`, by least squares: K' minimises |F' (I - C'K')|^2 + |R~^.5 K'|^2 with F F' = S, whose normal
    equations are (C S C' + R~) K' = C S. tall [F'C'; R~^.5 | F'; 0] becomes triangular by Householder reflections."""
    n, nw = L.shape[0], g.shape[1]
    height, width = n + 2 + nw + m, m + n
    root = np.zeros((max(n, m), max(n, m)))
    for r in range(height):
        for j in range(width):
            tall[r, j] = 0.0
    for r in range(n):
        _root_column(L, r, n, root)
        for i in range(r, n):
            tall[r, m + i] = root[i, r] / np.sqrt(share[0])
    for i in range(n):
        if c2 > 0.0:
            tall[n, m + i] = p[i] / np.sqrt(sigma * share[0])
            tall[n + 1, m + i] = M[i] * np.sqrt((c2 + sigma) / share[0])
        for w in range(nw):
            tall[n + 2 + w, m + i] = g[i, w] / np.sqrt(share[1 + w])
    first = n + 2 + nw
    for r in range(first):
        for j in range(m):
            for k in range(n):
                tall[r, j] += C[j, k] * tall[r, m + k]
    for r in range(m):
        if ellipsoid:
            tall[first + r, r] = np.sqrt(R[r, r] / share[1 + nw + r])
        else:
            _root_column(R, r, m, root)
            for j in range(r, m):
                tall[first + r, j] = root[j, r]
    for c in range(m):
        whole, below = 0.0, 0.0
        for r in range(height):
            whole += tall[r, c] * tall[r, c]
            if r >= c:
                below += tall[r, c] * tall[r, c]
        if not (below > SMALLEST_PIVOT * SMALLEST_PIVOT * whole):
            return False
        head = -np.sqrt(below) if tall[c, c] > 0.0 else np.sqrt(below)
        tall[c, c] -= head
        size = 2.0 * (below - head * (tall[c, c] + head))  # the reflector's squared length
        for j in range(c + 1, width):
            total = 0.0
            for r in range(c, height):
                total += tall[r, c] * tall[r, j]
            total *= 2.0 / size
            for r in range(c, height):
                tall[r, j] -= total * tall[r, c]
        tall[c, c] = head
    for i in range(n):
        for c in range(m - 1, -1, -1):
            total = tall[c, m + i]
            for j in range(c + 1, m):
                total -= tall[c, j] * K[i, j]
            K[i, c] = total / tall[c, c]
    return True
