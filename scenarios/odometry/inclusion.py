"""What surely holds of the odometer's state: intervals of position, speed and bias, from wheels that slide one way.

A braking wheel turns no faster than the train moves, so it bounds the speed from below alone; the accelerometer bounds
it from above until the trailer axle rolls freely again. Bounds of Gaussian errors are three standard deviations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import NonNegativeFloat, PositiveFloat

from ..arrays import Array
from ..machine_code import njit
from ..measurement import Interval, Measurement
from ..model import Inclusion
from ..railway.dynamics import Slope, climbs
from ..railway.odometer import INPUTS
from ..railway.odometer.motion import DISTANCE_A, DISTANCE_B, READING, SPEED_A, SPEED_B
from ..schema import Strict
from ..strict import key

STANDING, FREE, STILL_MEAN, STILL_COUNT = range(len(INPUTS), len(INPUTS) + 4)
"""Inputs behind those of the odometer: whether the train stands; seconds since the brakes last pulled more than
`Limits.braking`; the accelerometer's mean over the stand under way, m/s^2, and of how many readings it is (0: the train
moves)."""


class Limits(Strict):
    """Bounds of all errors."""

    bias: Annotated[PositiveFloat, key("of the accelerometer, before the first stand", "m/s^2")]
    noise: Annotated[NonNegativeFloat, key("standard deviation of its readings", "m/s^2")]
    gradient: Annotated[NonNegativeFloat, key("error of the map's", "m/s^2")]
    wheel: Annotated[NonNegativeFloat, key("of a wheel's reading that does not slide, as a share", "1")]
    map: Annotated[PositiveFloat, key("of a balise's place, its reading included", "m")]
    braking: Annotated[PositiveFloat, key(
        "a trailer axle rolls freely some time after the last braking over this", "m/s^2")]
    free: Annotated[NonNegativeFloat, key("that time", "s")]


@dataclass(frozen=True)
class Intervals:
    """The two functions of an `Inclusion`. slope: the map's gradient; pulse m; balise: place among the measurements."""

    limits: Limits
    slope: Slope
    pulse: float
    period: float
    balise: int

    def inclusion(self, position: float) -> Inclusion:
        """Intervals of (position, speed, bias), from a stand at `position`."""
        low = np.array([[position - self.limits.map], [0.0], [-self.limits.bias]])
        high = np.array([[position + self.limits.map], [0.0], [self.limits.bias]])
        return Inclusion(low, high, self.predict, self.observe)

    def predict(self, low: Array, high: Array, u: Array, interval: Interval) -> tuple[Array, Array]:
        """The intervals at the end of the interval, wheels used; low, high (3, S)."""
        limits, runs = self.limits, low.shape[1]
        out_low, out_high = low.copy(), high.copy()
        steep = np.stack([_climb(low[0], self.slope), _climb(high[0], self.slope)])
        length, share = (np.array(np.broadcast_to(np.asarray(part, dtype=float), (runs,)))
                         for part in (interval.length, interval.share))
        _move(low, high, np.ascontiguousarray(u), steep, length, share, self.period, self.pulse, limits.bias,
              limits.noise, limits.gradient, limits.wheel, limits.free, out_low, out_high)
        return out_low, out_high

    def observe(self, low: Array, high: Array, measurement: Measurement) -> tuple[Array, Array]:
        """What a balise leaves of the position's interval."""
        if self.balise < 0 or not measurement.received[self.balise].any():
            return low, high
        got, y = measurement.received[self.balise], measurement.y[self.balise]
        margin = self.limits.map + self.pulse
        low, high = low.copy(), high.copy()
        least, most = _both(low[0], high[0], y - margin, y + margin)
        low[0], high[0] = np.where(got, least, low[0]), np.where(got, most, high[0])
        return low, high


@njit(cache=True)
def _move(low, high, u, steep, length, share, step, pulse, bias, noise, gradient, wheel, free, out_low, out_high):
    """`Intervals.predict` run by run: low, high, out (3, S), u (nu, S), steep (2, S) the map's pull at low and high,
    length, share (S,); the rest as in `Limits` and `Intervals`. Runs of no length are left as they are."""
    for s in range(low.shape[1]):
        if not length[s] > 0.0:
            continue
        least_bias, most_bias = low[2, s], high[2, s]
        if u[STILL_COUNT, s] > 0.0:
            still = u[STILL_MEAN, s] - 0.5 * (steep[0, s] + steep[1, s])
            loose = 3 * noise / np.sqrt(max(u[STILL_COUNT, s], 1.0)) + gradient
            least_bias, most_bias = max(still - loose, -bias), min(still + loose, bias)
        flat, climb = min(steep[0, s], steep[1, s]), max(steep[0, s], steep[1, s])
        fast = max(high[1, s] + length[s] * (u[READING, s] - flat - least_bias + gradient), 0.0)
        slow = max(low[1, s] + length[s] * (u[READING, s] - climb - most_bias - gradient), 0.0)
        a, b, rolls = u[DISTANCE_A, s], u[DISTANCE_B, s], u[FREE, s] >= free
        # speed by the wheels of the step: a pulse more or less
        slowest = ((b if rolls else max(a, b)) / step - pulse / step) * (1 - wheel)
        fastest = (b + pulse) / step * (1 + wheel) if rolls else np.inf
        slow = max(slow, slowest)
        if slow > min(fast, fastest):  # what is new alone stands
            slow, fast = slowest, fastest if rolls else max(fast, slowest)
        else:
            fast = min(fast, fastest)
        if u[STANDING, s] > 0.0:
            slow, fast = 0.0, 0.0
        # distance: by the trailer's count while it rolls freely, else between the faster wheel and the accelerometer
        least = (b if rolls or u[SPEED_A, s] < u[SPEED_B, s] else a) * (1 - wheel)
        most = b * (1 + wheel) if rolls else 0.5 * step * (high[1, s] + fast)
        slack = pulse if rolls and u[FREE, s] < free + step else 0.0
        out_low[0, s] = low[0, s] + share[s] * (least - slack)
        out_high[0, s] = high[0, s] + share[s] * (max(most, least) + slack)
        out_low[1, s], out_high[1, s] = slow, fast
        out_low[2, s], out_high[2, s] = least_bias, most_bias


def _both(low: Array, high: Array, least: Array, most: Array) -> tuple[Array, Array]:
    """The intersection; where it is empty what is new alone stands."""
    a, b = np.maximum(low, least), np.minimum(high, most)
    empty = a > b
    return np.where(empty, least, a), np.where(empty, most, b)


def _climb(s: Array, slope: Slope) -> Array:
    """The map's pull at each position, m/s^2."""
    out = np.empty_like(s)
    climbs(np.ascontiguousarray(s), slope, out)
    return out
