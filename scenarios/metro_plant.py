"""The train's longitudinal dynamics, compiled: forces, resistance and gradient as one acceleration law.

Truth and design model both call it, so that what separates them is the disturbance and nothing else."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

GRAVITY = 9.81
KMH = 3.6


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

    cells: cells per metre. In cell c: base[c] before edge[c], base[c] + jump[c] from it on."""

    cells: float
    base: Array
    edge: Array
    jump: Array


@njit(cache=True, inline="always")
def share(V, c0, c1, c2, c3, c4):  # pyright: ignore
    """Share of the greatest force that is left at V km/h, within 0..1."""
    V = max(V, 0.1)
    left = c0 / V + (c1 + V * (c2 + V * (c3 + V * c4)))
    return max(0.0, min(1.0, left))


@njit(cache=True, inline="always")
def climb(s, slope):  # pyright: ignore
    """Deceleration by the gradient at s (m), m/s^2. Beyond the line its first and last gradients go on."""
    place = s * slope.cells
    if not place > 0.0:
        place = 0.0
    last = slope.base.shape[0] - 1
    cell = int(min(place, last))
    return slope.base[cell] + (slope.jump[cell] if s >= slope.edge[cell] else 0.0)


@njit(cache=True, inline="always")
def acceleration(s, v, u, forces, slope):  # pyright: ignore
    """a(s, v, u) in m/s^2: traction for u > 0, braking for u < 0, less resistance and gradient."""
    V = KMH * v
    pull = forces.drive * share(V, forces.t0, forces.t1, forces.t2, forces.t3, forces.t4)
    hold = forces.brake * share(V, forces.b0, forces.b1, forces.b2, forces.b3, forces.b4)
    resistance = forces.r0 + V * (forces.r1 + V * forces.r2)
    return u * (hold if u < 0.0 else pull) - resistance - climb(s, slope)


@njit(cache=True, inline="always")
def damping(v, u, forces):  # pyright: ignore
    """da/dv in 1/s."""
    V = KMH * v
    if u < 0.0:
        c0, c1, c2, c3, c4 = forces.b0, forces.b1, forces.b2, forces.b3, forces.b4
        force = forces.brake
    else:
        c0, c1, c2, c3, c4 = forces.t0, forces.t1, forces.t2, forces.t3, forces.t4
        force = forces.drive
    left = share(V, c0, c1, c2, c3, c4)
    grade = c2 - c0 / max(V, 0.1) ** 2 + V * (2.0 * c3 + V * 3.0 * c4)
    if left <= 0.0 or left >= 1.0:
        grade = 0.0
    return KMH * (u * force * grade - forces.r1 - 2.0 * forces.r2 * V)


@njit(cache=True)
def transition(x, u, h, forces, slope):  # pyright: ignore
    """Both states h seconds later (page: s+ = s + h v + h^2 a / 2, v+ = v + h a). x (2, P, S), u (S,), h (S,) or (1,)."""
    out = np.empty_like(x)
    _, points, runs = x.shape
    for p in range(points):
        for r in range(runs):
            step = h[r] if h.shape[0] > 1 else h[0]
            s, v = x[0, p, r], x[1, p, r]
            a = acceleration(s, v, u[r], forces, slope)
            out[0, p, r] = s + step * v + 0.5 * step * step * a
            out[1, p, r] = v + step * a
    return out


@njit(cache=True)
def transition_jacobian(x, u, h, forces):  # pyright: ignore
    """df/dx (2, 2, S) at x (2, S). The gradient's steps are left out: it is constant almost everywhere."""
    runs = x.shape[1]
    out = np.empty((2, 2, runs))
    for r in range(runs):
        step = h[r] if h.shape[0] > 1 else h[0]
        d = damping(x[1, r], u[r], forces)
        out[0, 0, r] = 1.0
        out[0, 1, r] = step + 0.5 * step * step * d
        out[1, 0, r] = 0.0
        out[1, 1, r] = 1.0 + step * d
    return out


@njit(cache=True)
def slope_change(x, u, Pi, h, forces):  # pyright: ignore
    """kappa (S,): h times the largest change of da/dv within the error bound, at v^ + q sqrt(Pi_22), q = +-0.5, +-1."""
    runs = x.shape[1]
    out = np.zeros(runs)
    for r in range(runs):
        e = np.sqrt(max(Pi[1, 1, r if Pi.shape[2] > 1 else 0], 0.0))
        here = damping(x[1, r], u[r], forces)
        for q in (-1.0, -0.5, 0.5, 1.0):
            out[r] = max(out[r], h * abs(damping(x[1, r] + q * e, u[r], forces) - here))
    return out


def slope_grid(positions: Array, gradients: Array, rotating: float) -> Slope:
    """The gradient (m/m) from each position (m) on as a `Slope`. Positions strictly increase by at least 0.1 m."""
    steep = GRAVITY * gradients / (1 + rotating)
    gap = float(np.diff(positions).min()) if len(positions) > 1 else 1.0
    count = int(np.ceil(positions[-1] / gap)) + 2
    # A hair finer than the smallest distance: two edges never share a cell, whatever the rounding of s * cells.
    cells = 1.001 / gap
    starts = np.arange(count + 2) / cells
    before = np.searchsorted(positions, starts, side="right") - 1
    base = steep[np.maximum(before, 0)]
    edge, jump = np.full(len(starts), np.inf), np.zeros(len(starts))
    for k in range(1, len(positions)):
        cell = int(positions[k] * cells)
        edge[cell], jump[cell] = positions[k], steep[k] - steep[k - 1]
        base[cell] = steep[k - 1]
    return Slope(cells, base, edge, jump)
