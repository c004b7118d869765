"""The odometer's equations, compiled: a point mass under a biased accelerometer, and the mean speed that wheels read.

States s, v, bias, scale-a, scale-b, mean (and scale-radar behind it); mean is that over the step under way."""

from __future__ import annotations

from numba import njit

from ..railway.dynamics import climb

S, V, BIAS, SCALE_A, SCALE_B, MEAN, RADAR = range(7)


@njit(cache=True, error_model="numpy")
def transition(x, reading, h, fresh, period, slope, out):  # pyright: ignore
    """x, out (nx, P, S) h (S,) seconds later: a = reading - climb(s) - bias; fresh (S,): the interval begins its step,
    so that the mean speed starts anew."""
    for p in range(x.shape[1]):
        for r in range(x.shape[2]):
            length = h[r]
            for i in range(x.shape[0]):
                out[i, p, r] = x[i, p, r]
            if length > 0.0:
                a = reading[r] - climb(x[S, p, r], slope) - x[BIAS, p, r]
                moved = length * (x[V, p, r] + 0.5 * length * a)
                out[S, p, r] = x[S, p, r] + moved
                out[V, p, r] = x[V, p, r] + length * a
                out[MEAN, p, r] = (0.0 if fresh[r] else x[MEAN, p, r]) + moved / period


@njit(cache=True, error_model="numpy")
def jacobian(h, fresh, period, out):  # pyright: ignore
    """df/dx, out (nx, nx, S). The gradient's steps are left out: they have no width."""
    nx = out.shape[0]
    for i in range(nx):
        for j in range(nx):
            for r in range(out.shape[2]):
                out[i, j, r] = 1.0 if i == j else 0.0
    for r in range(out.shape[2]):
        length = h[r]
        if length > 0.0:
            out[S, V, r], out[S, BIAS, r] = length, -0.5 * length * length
            out[V, BIAS, r] = -length
            out[MEAN, V, r], out[MEAN, BIAS, r] = length / period, -0.5 * length * length / period
            out[MEAN, MEAN, r] = 0.0 if fresh[r] else 1.0


@njit(cache=True, error_model="numpy")
def covariance(h, whole, period, sd, bias, scale, out):  # pyright: ignore
    """Q, out (nx, nx, S): the reading's white noise (sd over a whole step, held through it), random walks of bias and
    scales (per sqrt(s)). Parts of a step take the continuous form, whose speed variance adds up to the whole's."""
    out[:] = 0.0
    for r in range(out.shape[2]):
        t = h[r]
        if t <= 0.0:
            continue
        q = sd * sd * period
        ss, sv, vv = (q * t**3 / 4, q * t * t / 2, q * t) if whole[r] else (q * t**3 / 3, q * t * t / 2, q * t)
        out[S, S, r], out[S, V, r], out[V, S, r], out[V, V, r] = ss, sv, sv, vv
        out[S, MEAN, r] = out[MEAN, S, r] = ss / period
        out[V, MEAN, r] = out[MEAN, V, r] = sv / period
        out[MEAN, MEAN, r] = ss / period**2
        out[BIAS, BIAS, r] = bias * bias * t
        out[SCALE_A, SCALE_A, r] = out[SCALE_B, SCALE_B, r] = scale * scale * t
        if out.shape[0] > RADAR:
            out[RADAR, RADAR, r] = 0.0
