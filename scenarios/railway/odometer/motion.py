"""The odometer's equations, compiled: a point mass under a biased accelerometer, and how far wheels have rolled.

States s, v, bias, travelled (m since the wheels were last read), and behind them the scales of wheels and radar."""

from __future__ import annotations

from ...machine_code import njit
from ..dynamics import climb

S, V, BIAS, TRAVELLED = range(4)


@njit(cache=True, error_model="numpy")
def transition(x, reading, h, fresh, slope, out):  # pyright: ignore
    """x, out (nx, P, S) h (S,) seconds later: a = reading - climb(s) - bias; fresh (S,): the wheels were read where the
    interval begins, so that what is travelled starts anew."""
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
                out[TRAVELLED, p, r] = (0.0 if fresh[r] else x[TRAVELLED, p, r]) + moved


@njit(cache=True, error_model="numpy")
def readings(x, rows, out):  # pyright: ignore
    """What the sensors would read, out (ny, P, S) of x (nx, P, S): rows (ny, 2) tell of each the state that it reads,
    and that of its scale, -1 for none."""
    for j in range(rows.shape[0]):
        state, scale = rows[j]
        for p in range(x.shape[1]):
            for r in range(x.shape[2]):
                moved = x[state, p, r]
                out[j, p, r] = moved if scale < 0 else (1.0 + x[scale, p, r]) * moved


@njit(cache=True, error_model="numpy")
def reading_jacobian(x, rows, out):  # pyright: ignore
    """d/dx of `readings`, out (ny, nx, S) of x (nx, S)."""
    for j in range(rows.shape[0]):
        state, scale = rows[j]
        for i in range(out.shape[1]):
            for r in range(out.shape[2]):
                slope = 1.0 + (x[scale, r] if scale >= 0 else 0.0)
                out[j, i, r] = slope if i == state else x[state, r] if i == scale else 0.0


@njit(cache=True, error_model="numpy")
def jacobian(h, fresh, out):  # pyright: ignore
    """df/dx, out (nx, nx, S). The gradient's steps are left out: they have no width."""
    nx = out.shape[0]
    for i in range(nx):
        for j in range(nx):
            for r in range(out.shape[2]):
                out[i, j, r] = 1.0 if i == j else 0.0
    for r in range(out.shape[2]):
        length = h[r]
        if length > 0.0:
            out[S, V, r] = out[TRAVELLED, V, r] = length
            out[S, BIAS, r] = out[TRAVELLED, BIAS, r] = -0.5 * length * length
            out[V, BIAS, r] = -length
            out[TRAVELLED, TRAVELLED, r] = 0.0 if fresh[r] else 1.0


@njit(cache=True, error_model="numpy")
def covariance(h, whole, density, walks, out):  # pyright: ignore
    """Q, out (nx, nx, S): the reading's white noise of spectral `density` m^2/s^3, held through a whole step, and
    random walks (nx,) of the other states, per sqrt(s). Parts of a step take the continuous form, whose speed variance
    adds up to the whole's."""
    out[:] = 0.0
    for r in range(out.shape[2]):
        t = h[r]
        if t <= 0.0:
            continue
        ss = density * t**3 / (4 if whole[r] else 3)
        sv = density * t * t / 2
        out[S, S, r] = out[S, TRAVELLED, r] = out[TRAVELLED, S, r] = out[TRAVELLED, TRAVELLED, r] = ss
        out[S, V, r] = out[V, S, r] = out[V, TRAVELLED, r] = out[TRAVELLED, V, r] = sv
        out[V, V, r] = density * t
        for i in range(out.shape[0]):
            if walks[i] > 0.0:
                out[i, i, r] += walks[i] * walks[i] * t
