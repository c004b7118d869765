"""Filters written out by hand for one model each, compiled: what a program of nothing else would cost.

They check nothing, know no masks but whole packets, keep runs in blocks in the cache, and time inside the block."""

from __future__ import annotations

import numpy as np

from ...scenarios.machine_code import njit
from ...scenarios.railway.dynamics import climbs, damping, level

BLOCK = 128
compiled = njit(cache=True, error_model="numpy")


@njit(cache=True, error_model="numpy", inline="always")
def _measured(s, v, p, c, o, ys, yv, rs, rv):  # pyright: ignore
    """Position, then speed: mean (s, v) and covariance (p, c; c, o) after both."""
    k = 1.0 / (p + rs)
    e = (ys - s) * k
    s, v = s + p * e, v + c * e
    p, c, o = p * rs * k, c * rs * k, o - c * c * k
    k = 1.0 / (o + rv)
    e = (yv - v) * k
    return s + c * e, v + o * e, p - c * c * k, c * rv * k, o * rv * k


@compiled
def metro_ekf(x, P, u, y, h, forces, slope, q, r):  # pyright: ignore
    """x (2, S), P (3, S): p, c, o of each run, in place; u (K, S), y (K, 2, S); h seconds; q (3,), r (2,)."""
    steps, runs = u.shape
    climb, s, v, p, c, o = np.empty((6, BLOCK))
    for first in range(0, runs, BLOCK):
        width = min(BLOCK, runs - first)
        s[:width], v[:width] = x[0, first:first + width], x[1, first:first + width]
        for i in range(width):
            p[i], c[i], o[i] = P[0, first + i], P[1, first + i], P[2, first + i]
        for k in range(steps):
            climbs(s[:width], slope, climb)
            effort, ys, yv = u[k, first:first + width], y[k, 0, first:first + width], y[k, 1, first:first + width]
            for i in range(width):
                d = damping(v[i], effort[i], forces)
                a = level(v[i], effort[i], forces) - climb[i]
                f, g = h + 0.5 * h * h * d, 1.0 + h * d
                left = c[i] + f * o[i]
                s[i], v[i], p[i], c[i], o[i] = _measured(
                    s[i] + h * v[i] + 0.5 * h * h * a, v[i] + h * a, p[i] + f * (c[i] + left) + q[0], g * left + q[1],
                    g * g * o[i] + q[2], ys[i], yv[i], r[0], r[1])
        x[0, first:first + width], x[1, first:first + width] = s[:width], v[:width]
        for i in range(width):
            P[0, first + i], P[1, first + i], P[2, first + i] = p[i], c[i], o[i]


@compiled
def metro_points(x, P, u, y, h, forces, slope, q, r, scale, centre, weight):  # pyright: ignore
    """Unscented and cubature filter, as `metro_ekf`: points at `scale` deviations of one weight, and the mean of weight
    `centre` where that is not 0."""
    steps, runs = u.shape
    first_point = 0 if centre != 0.0 else 1
    sp, vp, climb = np.empty((5, BLOCK)), np.empty((5, BLOCK)), np.empty(BLOCK)
    s, v, p, c, o = np.empty((5, BLOCK))
    for first in range(0, runs, BLOCK):
        width = min(BLOCK, runs - first)
        s[:width], v[:width] = x[0, first:first + width], x[1, first:first + width]
        for i in range(width):
            p[i], c[i], o[i] = P[0, first + i], P[1, first + i], P[2, first + i]
        for k in range(steps):
            effort, ys, yv = u[k, first:first + width], y[k, 0, first:first + width], y[k, 1, first:first + width]
            for i in range(width):
                root = np.sqrt(p[i])
                one, low = scale * root, c[i] / root
                two = scale * np.sqrt(o[i] - low * low)
                low = scale * low
                sp[0, i], sp[1, i], sp[2, i], sp[3, i], sp[4, i] = s[i], s[i] + one, s[i], s[i] - one, s[i]
                vp[0, i], vp[1, i], vp[2, i], vp[3, i], vp[4, i] = v[i], v[i] + low, v[i] + two, v[i] - low, v[i] - two
            for j in range(first_point, 5):
                here, speed = sp[j], vp[j]
                climbs(here[:width], slope, climb)
                for i in range(width):
                    a = level(speed[i], effort[i], forces) - climb[i]
                    here[i] += h * speed[i] + 0.5 * h * h * a
                    speed[i] += h * a
            for i in range(width):
                ms = weight * (sp[1, i] + sp[2, i] + sp[3, i] + sp[4, i])
                mv = weight * (vp[1, i] + vp[2, i] + vp[3, i] + vp[4, i])
                if centre != 0.0:
                    ms, mv = ms + centre * sp[0, i], mv + centre * vp[0, i]
                ss, sv, vv = 0.0, 0.0, 0.0
                for j in range(1, 5):
                    a, b = sp[j, i] - ms, vp[j, i] - mv
                    ss, sv, vv = ss + a * a, sv + a * b, vv + b * b
                ss, sv, vv = weight * ss + q[0], weight * sv + q[1], weight * vv + q[2]
                if centre != 0.0:
                    a, b = sp[0, i] - ms, vp[0, i] - mv
                    ss, sv, vv = ss + centre * a * a, sv + centre * a * b, vv + centre * b * b
                s[i], v[i], p[i], c[i], o[i] = _measured(ms, mv, ss, sv, vv, ys[i], yv[i], r[0], r[1])
        x[0, first:first + width], x[1, first:first + width] = s[:width], v[:width]
        for i in range(width):
            P[0, first + i], P[1, first + i], P[2, first + i] = p[i], c[i], o[i]


@compiled
def kalman(x, P, u, y, received, A, B, h, C, Q, R):  # pyright: ignore
    """Kalman filter of any linear model: x (n, S), P (n, n, S) in place; u (K, nu, S), y (K, ny, S), received (K, S);
    the measurement of step 0 comes before any prediction. R diagonal; P - K S K', which may turn indefinite."""
    steps, ny, runs = y.shape
    n = x.shape[0]
    m, moved, p, half = np.empty((n, BLOCK)), np.empty((n, BLOCK)), np.empty((n, n, BLOCK)), np.empty((n, n, BLOCK))
    e, g = np.empty(BLOCK), np.empty(BLOCK)
    for first in range(0, runs, BLOCK):
        width = min(BLOCK, runs - first)
        for a in range(n):
            m[a, :width] = x[a, first:first + width]
            for b in range(n):
                p[a, b, :width] = P[a, b, first:first + width]
        for k in range(steps):
            for a in range(n if k > 0 else 0):
                for i in range(width):
                    moved[a, i] = h[a]
                for b in range(u.shape[1]):
                    drive = u[k, b, first:first + width]
                    for i in range(width):
                        moved[a, i] += B[a, b] * drive[i]
                for b in range(n):
                    for i in range(width):
                        moved[a, i] += A[a, b] * m[b, i]
                for b in range(n):
                    for i in range(width):
                        half[a, b, i] = 0.0
                for l in range(n):
                    for b in range(n):
                        for i in range(width):
                            half[a, b, i] += A[a, l] * p[l, b, i]
            for a in range(n if k > 0 else 0):
                for i in range(width):
                    m[a, i] = moved[a, i]
                for b in range(a + 1):
                    for i in range(width):
                        p[a, b, i] = Q[a, b]
                    for l in range(n):
                        for i in range(width):
                            p[a, b, i] += half[a, l, i] * A[b, l]
                    for i in range(width):
                        p[b, a, i] = p[a, b, i]
            got = received[k, first:first + width]
            for j in range(ny):
                seen = y[k, j, first:first + width]
                for i in range(width):
                    e[i], g[i] = seen[i], R[j, j]
                for a in range(n):
                    for i in range(width):
                        moved[a, i] = 0.0
                    for b in range(n):
                        if C[j, b] != 0.0:
                            for i in range(width):
                                moved[a, i] += C[j, b] * p[a, b, i]
                for b in range(n):
                    if C[j, b] != 0.0:
                        for i in range(width):
                            e[i] -= C[j, b] * m[b, i]
                            g[i] += C[j, b] * moved[b, i]
                for i in range(width):
                    g[i] = 1.0 / g[i] if got[i] else 0.0
                    e[i] = e[i] * g[i] if got[i] else 0.0
                for a in range(n):
                    for i in range(width):
                        m[a, i] += moved[a, i] * e[i]
                    for b in range(a + 1):
                        for i in range(width):
                            p[a, b, i] -= moved[a, i] * moved[b, i] * g[i]
                        for i in range(width):
                            p[b, a, i] = p[a, b, i]
        for a in range(n):
            x[a, first:first + width] = m[a, :width]
            for b in range(n):
                P[a, b, first:first + width] = p[a, b, :width]
