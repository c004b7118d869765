"""A certificate for the ellipsoid's favourite answer, K = C^-1: believe the measurement alone.

There the objective of F2 has a kink that the alternation only creeps towards; this test settles it at once."""

from __future__ import annotations

import numpy as np

from ..kernels.core import inner
from .small import SMALLEST_PIVOT, factorise_one, invert


@inner
def raw_measurement(L, g, C, R, K, G, V, u, row):  # pyright: ignore
    """True, with K = C^-1, where that gain (G = 0) is certified to be the ellipsoid's optimum.

    The objective is a sum of norms with a kink at G = 0, towards which the alternation only creeps. With k_i the
    columns of C^-1, Y = sum_i v_i k_i k_i' / |k_i| is minus the slope of the sensors' part there; G = 0 is optimal if
    Y = Z E'A' + sum_j u_j g_j' for some |Z| <= 1 (Frobenius), |u_j| <= 1. L = A Pi A' must be PD."""
    n, nw = L.shape[0], g.shape[1]
    if not invert(C, n, K, G):
        return False
    for i in range(n):
        for j in range(i + 1):
            V[i, j] = L[i, j]
    if not factorise_one(V, n, SMALLEST_PIVOT):
        return False
    # Rows of G: Y V^-T, so that |row|^2 is y' L^-1 y; h_j = V^-1 g_j likewise.
    for i in range(n):
        for l in range(n):
            total = 0.0
            for j in range(n):
                size = 0.0
                for k in range(n):
                    size += K[k, j] * K[k, j]
                total += np.sqrt(R[j, j]) * K[i, j] * K[l, j] / np.sqrt(size)
            G[i, l] = total
        for l in range(n):
            for k in range(l):
                G[i, l] -= V[l, k] * G[i, k]
            G[i, l] /= V[l, l]
    u[:, :] = 0.0
    for _ in range(1 if nw == 1 else 10):
        for w in range(nw):
            for l in range(n):
                row[l] = g[l, w]
                for k in range(l):
                    row[l] -= V[l, k] * row[k]
                row[l] /= V[l, l]
            size, length = 0.0, 0.0
            for l in range(n):
                size += row[l] * row[l]
            if size == 0.0:
                continue
            for i in range(n):
                total = 0.0
                for l in range(n):
                    total += (G[i, l] + u[i, w] * row[l]) * row[l]
                for l in range(n):
                    G[i, l] += u[i, w] * row[l]
                u[i, w] = total / size
                length += u[i, w] * u[i, w]
            length = max(np.sqrt(length), 1.0)
            for i in range(n):
                u[i, w] /= length
                for l in range(n):
                    G[i, l] -= u[i, w] * row[l]
    total = 0.0
    for i in range(n):
        for l in range(n):
            total += G[i, l] * G[i, l]
    return total <= 1.0
