"""The odometer's equations, compiled: a point mass under a biased accelerometer, and how far wheels have rolled.

States s, v, bias, travelled (m since the wheels were last read), and behind them the scales of wheels and radar."""

from __future__ import annotations

from functools import cache

import numpy as np
from numba import carray  # pyright: ignore[reportPrivateImportUsage]

from ...arrays import Array, Index
from ...compiled import address
from ...machine_code import njit
from ..dynamics import Slope, climb

S, V, BIAS, TRAVELLED = range(4)
INPUTS = ("reading", "effort", "begins", "distance-a", "distance-b", "speed-a", "speed-b")
"""The inputs told of each step: the accelerometer's reading m/s^2 (the gradient's pull in it), what drives (> 0) or
brakes, whether the wheels were read where the step begins, distance m by each wheel's count in the step, its mean speed
of late m/s. A setting may have more behind them."""
READING, EFFORT, BEGINS, DISTANCE_A, DISTANCE_B, SPEED_A, SPEED_B = range(7)


@njit(cache=True, error_model="numpy")
def transition(x, reading, h, fresh, slope, out):  # pyright: ignore
    """x, out (nx, P, S) h (S,) seconds later: a = reading - climb(s) - bias; fresh (S,): above 0 where the wheels were
    read where the interval begins, so that what is travelled starts anew."""
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
                out[TRAVELLED, p, r] = (0.0 if fresh[r] > 0 else x[TRAVELLED, p, r]) + moved


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
            out[TRAVELLED, TRAVELLED, r] = 0.0 if fresh[r] > 0 else 1.0


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


def packed(states: int, inputs: int, motion: int, rows: Index, slope: Slope) -> Array:
    """The data of the functions below: nx, inputs before the odometer's own, how a count moves it (`counted`), ny, the
    slope's origin and cells per metre, how many cells there are; rows (ny, 2) as in `readings`; the slope."""
    head = (states, inputs, motion, len(rows), slope.origin, slope.cells, len(slope.base))
    return np.concatenate([head, rows.ravel(), slope.base, slope.edge, slope.jump]).astype(float)


HEAD = 7


@njit(cache=True, error_model="numpy")
def _slope(data):  # pyright: ignore
    at, cells = HEAD + 2 * int(data[3]), int(data[6])
    return Slope(data[4], data[5], data[at:at + cells], data[at + cells:at + 2 * cells],
                 data[at + 2 * cells:at + 3 * cells])


@njit(cache=True, error_model="numpy")
def _rows(data):  # pyright: ignore
    rows = np.empty((int(data[3]), 2), np.int64)
    for j in range(rows.shape[0]):
        rows[j, 0], rows[j, 1] = int(data[HEAD + 2 * j]), int(data[HEAD + 2 * j + 1])
    return rows


@njit(cache=True, error_model="numpy")
def counted(x, effort, distance, speed, motion, share, h, out):  # pyright: ignore
    """Position and speed, out (2, P, S), by a share (S,) of a step's distance and its speed, as the wheels count them,
    (2, S) each: of wheel a (motion 0), b (1), or, braking, the faster, in traction the slower, else their mean (2)."""
    for p in range(x.shape[1]):
        for r in range(x.shape[2]):
            a, b = speed[0, r], speed[1, r]
            first = motion == 0 or (motion == 2 and (a >= b if effort[r] < 0.0 else a <= b))
            moved, v = distance[0 if first else 1, r], a if first else b
            if motion == 2 and effort[r] == 0.0:
                moved, v = 0.5 * (distance[0, r] + distance[1, r]), 0.5 * (a + b)
            out[S, p, r], out[V, p, r] = x[S, p, r], x[V, p, r]
            if h[r] > 0.0:
                out[S, p, r], out[V, p, r] = x[S, p, r] + share[r] * moved, v


def _move(x, u, seconds, data, points, width, stride, out):  # pyright: ignore
    """x+ of whole steps, of `compiled.SIGNATURE`."""
    head = carray(data, (HEAD,))
    nx, first = int(head[0]), int(head[1])
    data = carray(data, (HEAD + 2 * int(head[3]) + 3 * int(head[6]),))
    here, there = carray(x, (nx, points, stride))[:, :, :width], carray(out, (nx, points, stride))[:, :, :width]
    given = carray(u, (first + len(INPUTS), stride))
    if head[2] >= 0:
        counted(here, given[first + EFFORT], given[first + DISTANCE_A:first + DISTANCE_B + 1],
                given[first + SPEED_A:first + SPEED_B + 1], int(head[2]), np.ones(width), carray(seconds, (stride,)),
                there)
    else:
        transition(here, given[first + READING], carray(seconds, (stride,)), given[first + BEGINS], _slope(data), there)
    return 0


def _move_jacobian(x, u, seconds, data, points, width, stride, out):  # pyright: ignore
    """df/dx of whole steps by the accelerometer."""
    head = carray(data, (HEAD,))
    nx, first = int(head[0]), int(head[1])
    given = carray(u, (first + len(INPUTS), stride))
    jacobian(carray(seconds, (stride,)), given[first + BEGINS], carray(out, (nx, nx, stride))[:, :, :width])
    return 0


def _read(x, u, seconds, data, points, width, stride, out):  # pyright: ignore
    """h(x)."""
    head = carray(data, (HEAD,))
    data = carray(data, (HEAD + 2 * int(head[3]),))
    readings(carray(x, (int(head[0]), points, stride))[:, :, :width], _rows(data),
             carray(out, (int(head[3]), points, stride))[:, :, :width])
    return 0


def _read_jacobian(x, u, seconds, data, points, width, stride, out):  # pyright: ignore
    """dh/dx."""
    head = carray(data, (HEAD,))
    data = carray(data, (HEAD + 2 * int(head[3]),))
    nx, ny = int(head[0]), int(head[3])
    reading_jacobian(carray(x, (nx, stride))[:, :width], _rows(data), carray(out, (ny, nx, stride))[:, :, :width])
    return 0


@cache
def addresses() -> tuple[int, int, int, int]:
    """Of the four, for whole steps."""
    return address(_move), address(_move_jacobian), address(_read), address(_read_jacobian)
