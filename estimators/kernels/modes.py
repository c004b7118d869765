"""Compiled steps over the modes of a run: likelihoods, mixtures, mode-matched updates."""

from __future__ import annotations

from math import factorial, log

import numpy as np

from ...scenarios.machine_code import njit
from .core import HALF_LOG_TURN
from .factors import compose, decompose, sequential, shift


@njit(cache=True, inner=True)
def whitened(C, R, y, received):
    """L^-1 C, L^-1 y of the received rows, L L' = R there: measurements to be used one at a time, variance 1 each; and
    the constant of their log-density, -log det L - r/2 log 2 pi."""
    rows = np.nonzero(received)[0]
    r, nx = len(rows), C.shape[1]
    L, Cw, yw = np.zeros((r, r)), np.empty((r, nx)), np.empty(r)
    constant = 0.0
    for a in range(r):
        for b in range(a + 1):
            total = R[rows[a], rows[b]]
            for l in range(b):
                total -= L[a, l] * L[b, l]
            L[a, b] = np.sqrt(total) if a == b else total / L[b, b]
        constant -= np.log(L[a, a]) + HALF_LOG_TURN
        for j in range(nx):
            Cw[a, j] = C[rows[a], j]
            for l in range(a):
                Cw[a, j] -= L[a, l] * Cw[l, j]
            Cw[a, j] /= L[a, a]
        yw[a] = y[rows[a]]
        for l in range(a):
            yw[a] -= L[a, l] * yw[l]
        yw[a] /= L[a, a]
    return Cw, yw, constant


@njit(cache=True)
def kalman_block(A, drive, support, Q, Cw, yw, x, P, loglik, c):
    """Predict and update c particles, each with its own model, in place (eqs. (14) to (16), (20), (21)).

    A (nx, nx, c'), drive B u (nx, c'), x (nx, c'), P (nx, nx, c'), c <= c'; Cw (r, nx), yw (r,) whitened. loglik (c',)
    becomes log N(y; y^, S) up to the constant all particles share."""
    nx = x.shape[0]
    moved, AP = np.zeros((nx, c)), np.zeros((nx, nx, c))
    for i in range(nx):
        for k in range(c):
            moved[i, k] = drive[i, k]
        for l in range(nx):
            if support[i, l]:
                for k in range(c):
                    moved[i, k] += A[i, l, k] * x[l, k]
                for j in range(nx):
                    for k in range(c):
                        AP[i, j, k] += A[i, l, k] * P[l, j, k]
    for i in range(nx):
        for k in range(c):
            x[i, k] = moved[i, k]
        for j in range(i + 1):
            for k in range(c):
                P[i, j, k] = Q[i, j]
            for l in range(nx):
                if support[j, l]:
                    for k in range(c):
                        P[i, j, k] += AP[i, l, k] * A[j, l, k]
            if j < i:
                for k in range(c):
                    P[j, i, k] = P[i, j, k]
    r = len(yw)
    rows, noise = Cw.copy().reshape(r, nx, 1), np.ones((r, 1))
    got, lost, work = np.ones((r, c), np.bool_), np.zeros(c, np.bool_), np.empty((nx + 3, c))
    gain, spread, innovation = np.empty((r, nx, c)), np.empty((r, c)), np.empty((r, c))
    for a in range(r):
        for k in range(c):
            innovation[a, k] = yw[a]
        for i in range(nx):
            for k in range(c):
                innovation[a, k] -= Cw[a, i] * x[i, k]
    decompose(P, lost, work, c)
    sequential(P, rows, noise, got, gain, spread, lost, work, c)
    compose(P, work, c)
    shift(x, innovation, rows, gain, work, c)
    volume = np.ones(c)  # a part of det S: one logarithm does for four rows, and their product stays a number
    for k in range(c):
        loglik[k] = 0.0
    for a in range(r):
        for k in range(c):
            volume[k] *= spread[a, k]
            loglik[k] -= 0.5 * (innovation[a, k] * innovation[a, k] / spread[a, k])
        if a % 4 == 3 or a == r - 1:
            for k in range(c):
                loglik[k] -= 0.5 * np.log(volume[k])
                volume[k] = 1.0


@njit(cache=True, inner=True)
def mixture(w, n, values, x, P, mean, covariance):
    """Into mean (nx,), covariance (nx, nx): moments of n weighted Gaussians x (nx, n), P (nx, nx, n). Returns the mean
    of `values` (n,)."""
    nx = x.shape[0]
    parameter = 0.0
    for c in range(n):
        parameter += w[c] * values[c]
    for i in range(nx):
        mean[i] = 0.0
        for c in range(n):
            mean[i] += w[c] * x[i, c]
    for i in range(nx):
        for j in range(i + 1):
            total = 0.0
            for c in range(n):
                total += w[c] * (P[i, j, c] + (x[i, c] - mean[i]) * (x[j, c] - mean[j]))
            covariance[i, j] = covariance[j, i] = total
    return parameter
# 1 / k! for k = 2..13: the last term at |r| <= ln 2 / 2 is 1e-16
_C = tuple(1 / factorial(k) for k in range(2, 14))
_C2, _C3, _C4, _C5, _C6, _C7, _C8, _C9, _C10, _C11, _C12, _C13 = _C
_ROUND = 1.5 * 2.0**52  # adding it rounds to an integer, which then stands in the low bits
_LOG2E, _LN2_HIGH, _LN2_LOW = 1 / log(2), 0.693147180369123816490, 1.90821492927058770002e-10


@njit(cache=True)
def exponentials(x, n, top, out):
    """out[i] = exp(x[i] - top) for x <= top, to 2 units in the last place; 0 under exp(-708) and for NaN.

    exp(t) = 2^k exp(r) with r = t - k ln 2: without branches, so that the loops vectorise (three times the speed of
    the library's function, by the same bits on every machine)."""
    power = np.empty(n)
    bits = power.view(np.int64)
    for i in range(n):
        t = x[i] - top
        t = t if t > -708.0 else -708.0
        rounded = t * _LOG2E + _ROUND
        k = rounded - _ROUND
        r = (t - k * _LN2_HIGH) - k * _LN2_LOW
        p = ((_C13 * r + _C12) * r + _C11) * r + _C10
        p = (((p * r + _C9) * r + _C8) * r + _C7) * r + _C6
        p = (((p * r + _C5) * r + _C4) * r + _C3) * r + _C2
        out[i] = (p * r + 1.0) * r + 1.0
        power[i] = rounded + 1023.0
    for i in range(n):
        bits[i] <<= 52
    for i in range(n):
        out[i] = out[i] * power[i] if x[i] - top >= -708.0 else 0.0


@njit(cache=True, inner=True)
def greatest(a, n):
    """Greatest of the first n entries that is not NaN; -inf where there is none."""
    t0, t1, t2, t3 = -np.inf, -np.inf, -np.inf, -np.inf
    whole = n // 4 * 4
    for i in range(0, whole, 4):
        t0 = a[i] if a[i] > t0 else t0
        t1 = a[i + 1] if a[i + 1] > t1 else t1
        t2 = a[i + 2] if a[i + 2] > t2 else t2
        t3 = a[i + 3] if a[i + 3] > t3 else t3
    for i in range(whole, n):
        t0 = a[i] if a[i] > t0 else t0
    return max(max(t0, t1), max(t2, t3))


@njit(cache=True)
def normalise(logw, n, w):
    """w[i] = exp(logw[i]) / sum over the first n; returns log sum exp, or NaN when all weights vanish."""
    top = greatest(logw, n)
    if not top > -np.inf or top == np.inf:
        return np.nan
    exponentials(logw, n, top, w)
    total = 0.0
    for i in range(n):
        total += w[i]
    for i in range(n):
        w[i] /= total
    return top + np.log(total)
