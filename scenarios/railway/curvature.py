"""How far da/dv may change within an error bound of the speed: the factor kappa of the linearisation error.

A bound and no sample: the force curves are taken piece by piece, each with its ends and its turning points."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..machine_code import njit
from ..units import KMH
from .dynamics import Forces, damping, effect

SLOWEST = 0.1  # km/h: the force curves are constant below


class Pieces(NamedTuple):
    """Where traction and braking change their formula: edges (n,) in km/h, increasing. Between edge i - 1 and edge i
    the share of the force that is left follows its curve where bends[i], (n + 1,), and is constant (0 or 1) elsewhere.
    """

    drive: Array
    drive_bends: NDArray[np.bool_]
    brake: Array
    brake_bends: NDArray[np.bool_]


def pieces(forces: Forces) -> Pieces:
    """The pieces of both curves."""
    return Pieces(*_pieces(np.array(forces[1:6])), *_pieces(np.array(forces[7:12])))


def _pieces(curve: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Edges and bends of c0/V + c1 + c2 V + c3 V^2 + c4 V^3, cut to 0..1."""
    edges = [SLOWEST]
    for level in (0.0, 1.0):
        roots = np.roots((curve - np.array([0.0, level, 0.0, 0.0, 0.0]))[::-1])
        edges += [float(root.real) for root in roots if abs(root.imag) < 1e-9 * abs(root) and root.real > SLOWEST]
    edges.sort()
    inside = np.array([*((a + b) / 2 for a, b in pairwise(edges)), 2 * edges[-1]])
    left = np.polyval(curve[::-1], inside) / inside
    return np.array(edges), np.array([False, *((left > 0) & (left < 1))])


@njit(cache=True, error_model="numpy", inline="always")
def _bend(W, pull, c0, c2, c3, c4, forces):  # pyright: ignore
    """da/dv in 1/s at W km/h on a piece that bends; pull: u times the greatest force."""
    return KMH * (pull * (c2 - c0 / (W * W) + W * (2.0 * c3 + W * 3.0 * c4)) - forces.r1 - 2.0 * forces.r2 * W)


@njit(cache=True, error_model="numpy", inline="always")
def _turning(W, pull, c0, c3, c4, forces):  # pyright: ignore
    """d/dW of `_bend` times W^3, but for a factor: zero where da/dv turns."""
    return pull * c0 + W * W * W * (pull * (c3 + 3.0 * c4 * W) - forces.r2)


@njit(cache=True, error_model="numpy", inner=True)
def _farthest_on_bend(a, b, here, pull, c0, c2, c3, c4, forces):  # pyright: ignore
    """Greatest |da/dv - here| between a and b km/h on a piece that bends.

    It turns at most twice, with `_turning`'s own single turning point between, so that bisection finds each."""
    most = max(abs(_bend(a, pull, c0, c2, c3, c4, forces) - here), abs(_bend(b, pull, c0, c2, c3, c4, forces) - here))
    middle = a
    if pull * c4 != 0.0:
        middle = min(max(-(pull * c3 - forces.r2) / (4.0 * pull * c4), a), b)
    for side in range(2):
        low, high = (a, middle) if side == 0 else (middle, b)
        rises = _turning(low, pull, c0, c3, c4, forces) < 0.0
        if rises == (_turning(high, pull, c0, c3, c4, forces) < 0.0):
            continue
        for _ in range(50):
            between = 0.5 * (low + high)
            if (_turning(between, pull, c0, c3, c4, forces) < 0.0) == rises:
                low = between
            else:
                high = between
        most = max(most, abs(_bend(low, pull, c0, c2, c3, c4, forces) - here))
    return most


@njit(cache=True, error_model="numpy")
def slope_change(v, u, Pi, h, forces, curves, out):  # pyright: ignore
    """kappa, out (S,): h times the largest change of da/dv within the error bound, at speeds v^ +- sqrt(Pi_22).

    v, u (S,); Pi (2, 2, S or 1); h in s; curves: `Pieces`. By the mean value theorem a(v) - a(v^) is then within
    (da/dv(v^) +- kappa / h) (v - v^), kinks of the force curves included."""
    for r in range(v.shape[0]):
        e = KMH * np.sqrt(max(Pi[1, 1, r if Pi.shape[2] > 1 else 0], 0.0))
        here, V = damping(v[r], u[r], forces), KMH * v[r]
        top, c0, _, c2, c3, c4 = effect(u[r], forces)
        pull, low, high = u[r] * top, V - e, V + e
        edges = curves.brake if u[r] < 0.0 else curves.drive
        bends = curves.brake_bends if u[r] < 0.0 else curves.drive_bends
        most = 0.0
        for piece in range(edges.shape[0] + 1):
            a = low if piece == 0 else max(low, edges[piece - 1])
            b = high if piece == edges.shape[0] else min(high, edges[piece])
            if not a <= b:
                continue
            if bends[piece]:
                most = max(most, _farthest_on_bend(a, b, here, pull, c0, c2, c3, c4, forces))
            else:
                for W in (a, b):
                    most = max(most, abs(-KMH * (forces.r1 + 2.0 * forces.r2 * W) - here))
        out[r] = h * most
