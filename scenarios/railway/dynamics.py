"""The train's longitudinal dynamics, compiled: forces, resistance and gradient as one acceleration law.

Truth and design model both call it, so that what separates them is the disturbance and nothing else."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import carray  # pyright: ignore[reportPrivateImportUsage]

from ..arrays import Array
from ..machine_code import njit
from ..units import KMH

GRAVITY = 9.81


class Forces(NamedTuple):
    """The acceleration law's constants (per mass, rotating parts included).

    drive, brake: greatest traction and braking, m/s^2. t1..t3, b1..b3: the share of it that is left at V km/h,
    min(1, t0/V + t1 + t2 V + t3 V^2 + t4 V^3). r0, r1, r2: resistance r0 + r1 V + r2 V^2, m/s^2."""

    drive: float
    t0: float
    t1: float
    t2: float
    t3: float
    t4: float
    brake: float
    b0: float
    b1: float
    b2: float
    b3: float
    b4: float
    r0: float
    r1: float
    r2: float


class Slope(NamedTuple):
    """Piecewise constant deceleration by the gradient, m/s^2, on a grid so fine that a cell holds at most one edge.

    origin: where the grid begins, m; cells: cells per metre. In cell c: base[c] before edge[c], base[c] + jump[c] from
    it on."""

    origin: float
    cells: float
    base: Array
    edge: Array
    jump: Array


@njit(cache=True, error_model="numpy", inner=True)
def share(V, c0, c1, c2, c3, c4):  # pyright: ignore
    """Share of the greatest force that is left at V km/h, within 0..1."""
    V = max(V, 0.1)
    left = c0 / V + (c1 + V * (c2 + V * (c3 + V * c4)))
    return max(0.0, min(1.0, left))


@njit(cache=True, error_model="numpy", inner=True)
def effect(u, forces):  # pyright: ignore
    """Greatest force and its five coefficients that the input u calls on: braking where negative, else traction."""
    back = u < 0.0
    return (forces.brake if back else forces.drive, forces.b0 if back else forces.t0, forces.b1 if back else forces.t1,
            forces.b2 if back else forces.t2, forces.b3 if back else forces.t3, forces.b4 if back else forces.t4)


@njit(cache=True, error_model="numpy", inner=True)
def level(v, u, forces):  # pyright: ignore
    """Acceleration on level track, m/s^2: traction for u > 0, braking for u < 0, less resistance."""
    V = KMH * v
    top, c0, c1, c2, c3, c4 = effect(u, forces)
    return u * top * share(V, c0, c1, c2, c3, c4) - (forces.r0 + V * (forces.r1 + V * forces.r2))


@njit(cache=True, error_model="numpy", inner=True)
def climb(s, slope):  # pyright: ignore
    """Deceleration by the gradient at s (m), m/s^2. Beyond the line its first and last gradients go on.

    A lost estimator may ask at NaN, whose conversion would be an index outside the table: it takes the first cell."""
    place, last = (s - slope.origin) * slope.cells, slope.base.shape[0] - 1
    cell = np.int32(last if place >= last else (place if place > 0.0 else 0.0))
    return slope.base[cell] + (slope.jump[cell] if s >= slope.edge[cell] else 0.0)


@njit(cache=True, error_model="numpy", inner=True)
def damping(v, u, forces):  # pyright: ignore
    """da/dv in 1/s."""
    V = KMH * v
    top, c0, c1, c2, c3, c4 = effect(u, forces)
    left = share(V, c0, c1, c2, c3, c4)
    W = max(V, 0.1)
    grade = c2 - c0 / (W * W) + W * (2.0 * c3 + W * 3.0 * c4)
    grade = grade if 0.0 < left < 1.0 else 0.0
    return KMH * (u * top * grade - forces.r1 - 2.0 * forces.r2 * V)


@njit(cache=True, error_model="numpy")
def climbs(s, slope, out):  # pyright: ignore
    """out[r] = climb(s[r]). Cells and look-up have a loop of their own each: only the first vectorises."""
    last, origin, cells = slope.base.shape[0] - 1, slope.origin, slope.cells
    for r in range(s.shape[0]):
        place = (s[r] - origin) * cells
        out[r] = last if place >= last else (place if place > 0.0 else 0.0)
    base, edge, jump = slope.base, slope.edge, slope.jump
    for r in range(s.shape[0]):
        cell = np.uint32(out[r])
        out[r] = base[cell] + (jump[cell] if s[r] >= edge[cell] else 0.0)


@njit(cache=True, error_model="numpy", inner=True)
def _advance(s, v, u, h, steep, forces, s_out, v_out):  # pyright: ignore
    for r in range(s.shape[0]):
        a = level(v[r], u[r], forces) - steep[r]
        s_out[r] = s[r] + h[r] * v[r] + 0.5 * h[r] * h[r] * a
        v_out[r] = v[r] + h[r] * a


@njit(cache=True, error_model="numpy")
def transition(x, u, h, forces, slope, width, out):  # pyright: ignore
    """Both states h seconds later (page: s+ = s + h v + h^2 a / 2, v+ = v + h a), of the first `width` runs.

    x, out (2, P, S); u, h (S,)."""
    steep = np.empty(width)
    for p in range(x.shape[1]):
        climbs(x[0, p, :width], slope, steep)
        _advance(x[0, p, :width], x[1, p], u, h, steep, forces, out[0, p], out[1, p])


@njit(cache=True, error_model="numpy")
def transition_jacobian(v, u, h, forces, width, out):  # pyright: ignore
    """df/dx, out (2, 2, S), at the speeds v (S,), of the first `width` runs. The gradient's steps are left out: they
    have no width."""
    rows = out[0, 0], out[0, 1], out[1, 0], out[1, 1]
    for r in range(width):
        d = damping(v[r], u[r], forces)
        rows[0][r] = 1.0
        rows[1][r] = h[r] + 0.5 * h[r] * h[r] * d
        rows[2][r] = 0.0
        rows[3][r] = 1.0 + h[r] * d


@njit(cache=True, error_model="numpy", inner=True)
def _told(data):  # pyright: ignore
    """`Forces` and `Slope` of what `constants` packed."""
    count = int(data[17])
    table = carray(data, (18 + 3 * count,))
    forces = Forces(data[0], data[1], data[2], data[3], data[4], data[5], data[6], data[7], data[8], data[9], data[10],
                    data[11], data[12], data[13], data[14])
    return forces, Slope(data[15], data[16], table[18:18 + count], table[18 + count:18 + 2 * count],
                         table[18 + 2 * count:])


def constants(forces: Forces, slope: Slope) -> Array:
    """The `data` of `driven` and `driven_jacobian`."""
    return np.concatenate([forces, [slope.origin, slope.cells, len(slope.base)], slope.base, slope.edge, slope.jump])


def driven(x, u, seconds, data, points, width, stride, out):  # pyright: ignore
    """`transition` as a compiled model's."""
    forces, slope = _told(data)
    transition(carray(x, (2, points, stride)), carray(u, (stride,)), carray(seconds, (stride,)), forces, slope, width,
               carray(out, (2, points, stride)))
    return 0


def driven_jacobian(x, u, seconds, data, points, width, stride, out):  # pyright: ignore
    """`transition_jacobian` as a compiled model's."""
    transition_jacobian(carray(x, (2, stride))[1], carray(u, (stride,)), carray(seconds, (stride,)), _told(data)[0],
                        width, carray(out, (2, 2, stride)))
    return 0


def slope_grid(positions: Array, gradients: Array, rotating: float) -> Slope:
    """The gradient (m/m) from each position (m) on as a `Slope`. Positions strictly increase by at least 0.1 m."""
    steep = GRAVITY * gradients / (1 + rotating)
    gap = float(np.diff(positions).min()) if len(positions) > 1 else 1.0
    origin = float(positions[0])
    # A hair finer than the smallest distance: two edges never share a cell, whatever the rounding of s * cells.
    cells = 1.001 / gap
    starts = origin + np.arange(int((positions[-1] - origin) * cells) + 3) / cells
    before = np.searchsorted(positions, starts, side="right") - 1
    base = steep[np.maximum(before, 0)]
    edge, jump = np.full(len(starts), np.inf), np.zeros(len(starts))
    for k in range(1, len(positions)):
        cell = int((positions[k] - origin) * cells)
        edge[cell], jump[cell] = positions[k], steep[k] - steep[k - 1]
        base[cell] = steep[k - 1]
    return Slope(origin, cells, base, edge, jump)
