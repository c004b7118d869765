"""The stadium track: its analytic map from arc length to the plane and back, and the planar motion model on it.

Compiled, one point at a time over runs, so that a result does not depend on how many runs stand beside it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import carray  # pyright: ignore[reportPrivateImportUsage]

from ..arrays import Array
from ..compiled import Compiled
from ..machine_code import njit
from ..measurement import Interval, PerRun


@njit(cache=True, inner=True)
def place(s, half, radius):
    """Arc length s (any lap) -> x, y, cos and sin of the heading. half: half a straight; all lengths in m."""
    arc = math.pi * radius
    length = 4 * half + 2 * arc
    s = s - length * math.floor(s / length)
    if s < half:
        return radius, s, 0.0, 1.0
    if s < half + arc:
        angle = (s - half) / radius
        return radius * math.cos(angle), half + radius * math.sin(angle), -math.sin(angle), math.cos(angle)
    if s < 3 * half + arc:
        return -radius, 2 * half + arc - s, 0.0, -1.0
    if s < 3 * half + 2 * arc:
        angle = (s - 3 * half - arc) / radius
        return -radius * math.cos(angle), -half - radius * math.sin(angle), math.sin(angle), -math.cos(angle)
    return radius, s - length, 0.0, 1.0


@njit(cache=True, inner=True)
def project(x, y, half, radius):
    """Arc length in [0, length) of the track's point nearest to (x, y); m."""
    arc = math.pi * radius
    if y > half:
        return half + radius * math.atan2(y - half, x)
    if y < -half:
        return 3 * half + arc + radius * math.atan2(-half - y, -x)
    if x < 0:
        return 2 * half + arc - y
    return y if y >= 0 else 4 * half + 2 * arc + y


@njit(cache=True, inner=True)
def curvature(s, half, radius):
    """1 / radius on the arcs, 0 on the straights; 1/m."""
    arc = math.pi * radius
    s = s - (4 * half + 2 * arc) * math.floor(s / (4 * half + 2 * arc))
    if half < s < half + arc or 3 * half + arc < s < 3 * half + 2 * arc:
        return 1.0 / radius
    return 0.0


@njit(cache=True)
def _advance(points, u, share, half, radius, width, out):
    """p + D [cos th, sin th], th at s(p) + D/2, D = share u. points, out (4, N, S), u (2, S), share (S,), of which the
    first `width` runs count. On an arc the heading at p is turned by D/2, whose sine and cosine the points of a run
    share; only who changes between arc and straight, in a step shorter than either, needs the map."""
    travel, cosine, sine, turned = np.empty(width), np.empty(width), np.empty(width), np.empty(width, np.bool_)
    for train in range(2):
        for s in range(width):
            travel[s] = u[train, s] * share[s]
            if s > 0 and travel[s] == travel[s - 1]:  # particles of one run
                cosine[s], sine[s], turned[s] = cosine[s - 1], sine[s - 1], turned[s - 1]
            else:
                angle = travel[s] / (2 * radius)
                cosine[s], sine[s] = math.cos(angle), math.sin(angle)
                turned[s] = abs(angle) < 1.0 and abs(travel[s]) < 4 * half
        for n in range(points.shape[1]):
            xs, ys = points[2 * train, n], points[2 * train + 1, n]
            x_out, y_out = out[2 * train, n], out[2 * train + 1, n]
            for s in range(width):
                x, y, distance = xs[s], ys[s], travel[s]
                side = 1.0 if y > 0.0 else -1.0
                forward = 1.0 if x >= 0.0 else -1.0  # on the straights
                right, up = side * x, side * y - half  # from the arc's centre, as on the upper arc
                norm, along = math.sqrt(right * right + up * up), sine[s] * right + cosine[s] * up
                if up > 0.0 and along > 0.0 and turned[s]:
                    cos, sin = -side * along / norm, side * (cosine[s] * right - sine[s] * up) / norm
                elif up <= 0.0 and abs(y + forward * distance / 2) <= half and turned[s]:
                    cos, sin = 0.0, forward
                else:
                    _, _, cos, sin = place(project(x, y, half, radius) + distance / 2, half, radius)
                x_out[s] = x + distance * cos
                y_out[s] = y + distance * sin


def _moved(x, u, share, data, points, width, stride, out):  # pyright: ignore
    """`_advance` as a compiled model's, with data = half, radius, and shares of a step in place of seconds."""
    half, radius = carray(data, (2,))
    _advance(carray(x, (4, points, stride)), carray(u, (2, stride)), carray(share, (stride,)), half, radius, width,
             carray(out, (4, points, stride)))
    return 0


@njit(cache=True)
def _jacobian(points, u, share, half, radius, width, out):
    """d f / d p. points (4, S), u, share as above, out (4, 4, S)."""
    out[:, :, :width] = 0.0
    for train in range(2):
        i = 2 * train
        for run in range(width):
            x, y = points[i, run], points[i + 1, run]
            distance = u[train, run] * share[run]
            s = project(x, y, half, radius)
            _, _, along_x, along_y = place(s, half, radius)
            # The nearest point moves slower than a point outside the arc and faster than one inside it.
            if abs(y) > half:
                lever = radius / math.sqrt(x * x + (abs(y) - half) ** 2)
                along_x, along_y = lever * along_x, lever * along_y
            _, _, cos, sin = place(s + distance / 2, half, radius)
            turn = distance * curvature(s + distance / 2, half, radius)
            out[i, i, run] = 1.0 - turn * sin * along_x
            out[i, i + 1, run] = -turn * sin * along_y
            out[i + 1, i, run] = turn * cos * along_x
            out[i + 1, i + 1, run] = 1.0 + turn * cos * along_y


def _moved_jacobian(x, u, share, data, points, width, stride, out):  # pyright: ignore
    """`_jacobian` as a compiled model's."""
    half, radius = carray(data, (2,))
    _jacobian(carray(x, (4, stride)), carray(u, (2, stride)), carray(share, (stride,)), half, radius, width,
              carray(out, (4, 4, stride)))
    return 0


@njit(cache=True)
def _travel_slope(points, travel, half, radius, out):
    """d f / d D. points (4, S), travel (2, S), out (4, 2, S), zero on entry."""
    for train in range(2):
        i = 2 * train
        for run in range(points.shape[1]):
            distance = travel[train, run]
            s = project(points[i, run], points[i + 1, run], half, radius) + distance / 2
            _, _, cos, sin = place(s, half, radius)
            turn = distance * curvature(s, half, radius) / 2
            out[i, train, run] = cos - turn * sin
            out[i + 1, train, run] = sin + turn * cos


@njit(cache=True)
def _places(s, half, radius, x, y, heading):
    for i in range(s.size):
        x[i], y[i], cos, sin = place(s[i], half, radius)
        heading[i] = math.atan2(sin, cos)


@njit(cache=True)
def _projects(x, y, half, radius, s):
    for i in range(s.size):
        s[i] = project(x[i], y[i], half, radius)


@dataclass(frozen=True)
class StadiumTrack:
    """Two straights along y joined by half circles, run counter-clockwise; s = 0 lies at (radius, 0). Lengths in m."""

    straight: float
    radius: float

    @property
    def half(self) -> float:
        return self.straight / 2

    @property
    def length(self) -> float:
        return 2 * self.straight + 2 * math.pi * self.radius

    def points(self, s: Array) -> tuple[Array, Array, Array]:
        """Arc lengths (any shape, any lap) -> x, y in m and heading in rad, each of the same shape."""
        flat = np.ascontiguousarray(s, dtype=float).reshape(-1)
        x, y, heading = np.empty_like(flat), np.empty_like(flat), np.empty_like(flat)
        _places(flat, self.half, self.radius, x, y, heading)
        return x.reshape(np.shape(s)), y.reshape(np.shape(s)), heading.reshape(np.shape(s))

    def arc_lengths(self, x: Array, y: Array) -> Array:
        """Arc length in [0, length) of the nearest point of the track; x, y of one shape, m."""
        out = np.empty(np.size(x))
        _projects(np.ascontiguousarray(x, dtype=float).reshape(-1), np.ascontiguousarray(y, dtype=float).reshape(-1),
                  self.half, self.radius, out)
        return out.reshape(np.shape(x))

    def tags(self, count: int) -> Array:
        """Arc lengths (count,) of evenly spaced tags, the first half a spacing behind s = 0."""
        return (np.arange(count) + 0.5) * self.length / count

    def _given(self, interval: Interval, runs: int) -> tuple[Array, Array]:
        """What both compiled functions are told: the lengths of the track, and each run's share of a step."""
        return self._lengths, np.full(runs, interval.share)

    @cached_property
    def _lengths(self) -> Array:
        return np.array([self.half, self.radius])

    @cached_property
    def transition(self) -> Compiled:
        """Both trains' planar motion (Faruqi et al. 2019, eq. (30), with the heading at the midpoint of the way, since
        the printed Euler step spirals outward). x (4, .., S), u (2, S) measured distances of a whole step."""
        return Compiled(_moved, 2, self._given)

    @cached_property
    def jacobian(self) -> Compiled:
        """Jacobian (4, 4, S) of `transition` at x (4, S)."""
        return Compiled(_moved_jacobian, 2, self._given, square=True)

    def input_jacobian(self, x: Array, u: Array, interval: Interval) -> Array:
        """d f / d u (4, 2, S) of `transition` at x (4, S)."""
        out = np.zeros((4, 2, x.shape[1]))
        _travel_slope(np.ascontiguousarray(x), travelled(u, interval.share), self.half, self.radius, out)
        return out * interval.share


def travelled(u: Array, share: PerRun) -> Array:
    """The share, a number or (S,), of a step's distances u (2, S)."""
    return np.ascontiguousarray(u * share)
