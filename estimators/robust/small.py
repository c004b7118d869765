"""Compiled algebra of one small matrix at a time, for kernels that walk over the runs one by one.

A run that iterates to its own convergence cannot share loops with others; `kernels.py` serves those that can."""

from __future__ import annotations

import numpy as np

from ..kernels.core import inner, kernel

TINY = 1e-200
"""A squared linearisation error under this is none: its multiplier would overflow."""
SMALLEST_PIVOT = 1e-13
"""A Cholesky pivot under this share of its diagonal entry counts as zero."""


@inner
def factorise_one(V, m, least):  # pyright: ignore
    """Cholesky factor of the leading (m, m) block of V, in place in its lower triangle. False where V is not PD: a
    pivot is not above `least` of its diagonal entry."""
    for i in range(m):
        scale = V[i, i]
        for j in range(i + 1):
            total = V[i, j]
            for k in range(j):
                total -= V[i, k] * V[j, k]
            if i == j:
                if not (total > least * scale):
                    return False
                V[i, i] = np.sqrt(total)
            else:
                V[i, j] = total / V[j, j]
    return True


@inner
def solve_one(V, m, row):  # pyright: ignore
    """Replace row[:m] by V^-1 row, V factorised."""
    for i in range(m):
        for k in range(i):
            row[i] -= V[i, k] * row[k]
        row[i] /= V[i, i]
    for i in range(m - 1, -1, -1):
        for k in range(i + 1, m):
            row[i] -= V[k, i] * row[k]
        row[i] /= V[i, i]


@inner
def invert(C, n, inverse, work):  # pyright: ignore
    """inverse (n, n) of C (n, n) by Gauss-Jordan with row pivoting. False where C is singular."""
    size = 0.0
    for i in range(n):
        for j in range(n):
            work[i, j] = C[i, j]
            inverse[i, j] = 1.0 if i == j else 0.0
            size = max(size, abs(C[i, j]))
    for c in range(n):
        best = c
        for i in range(c + 1, n):
            if abs(work[i, c]) > abs(work[best, c]):
                best = i
        if not (abs(work[best, c]) > SMALLEST_PIVOT * size):
            return False
        if best != c:
            for j in range(n):
                work[c, j], work[best, j] = work[best, j], work[c, j]
                inverse[c, j], inverse[best, j] = inverse[best, j], inverse[c, j]
        pivot = 1.0 / work[c, c]
        for j in range(n):
            work[c, j] *= pivot
            inverse[c, j] *= pivot
        for i in range(n):
            factor = work[i, c]
            if i != c and factor != 0.0:
                for j in range(n):
                    work[i, j] -= factor * work[c, j]
                    inverse[i, j] -= factor * inverse[c, j]
    return True


@inner
def largest_eigenvalue(X):  # pyright: ignore
    """Largest eigenvalue of the symmetric X (n, n) by Jacobi rotations (X is overwritten). NaN: X is not finite."""
    n = X.shape[0]
    if n == 2:
        half = 0.5 * (X[0, 0] - X[1, 1])
        return 0.5 * (X[0, 0] + X[1, 1]) + np.sqrt(half * half + X[1, 0] * X[1, 0])
    for _ in range(30):
        off, size = 0.0, 0.0
        for i in range(n):
            size += abs(X[i, i])
            for j in range(i):
                off += abs(X[i, j])
        if not np.isfinite(size + off):
            return np.nan
        if off <= 1e-14 * size:
            break
        for i in range(1, n):
            for j in range(i):
                if X[i, j] == 0.0:
                    continue
                slope = (X[i, i] - X[j, j]) / (2.0 * X[i, j])
                t = 1.0 / (abs(slope) + np.sqrt(slope * slope + 1.0))
                if slope < 0.0:
                    t = -t
                c = 1.0 / np.sqrt(t * t + 1.0)
                s = t * c
                for k in range(n):
                    a, b = X[k, j], X[k, i]
                    X[k, j], X[k, i] = c * a - s * b, s * a + c * b
                for k in range(n):
                    a, b = X[j, k], X[i, k]
                    X[j, k], X[i, k] = c * a - s * b, s * a + c * b
    top = X[0, 0]
    for i in range(1, n):
        top = max(top, X[i, i])
    return top


@kernel
def contraction(G, A, M, N, work, gram):  # pyright: ignore
    """max over |Delta| <= 1 of |G (A + M Delta N)|^2 (spectral norm): convex in Delta, so it lies at Delta = +-1."""
    n = G.shape[0]
    uncertain = False
    for j in range(n):
        uncertain |= N[j] != 0.0
    top = 0.0
    for side in range(2 if uncertain else 1):
        sign = 1.0 - 2.0 * side
        for i in range(n):
            for j in range(n):
                total = 0.0
                for k in range(n):
                    total += G[i, k] * (A[k, j] + sign * M[k] * N[j])
                work[i, j] = total
        for i in range(n):
            for j in range(i + 1):
                total = 0.0
                for k in range(n):
                    total += work[i, k] * work[j, k]
                gram[i, j] = total
                gram[j, i] = total
        value = largest_eigenvalue(gram)
        if not value <= top:
            top = value
    return top
