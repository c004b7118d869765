"""What surely holds of the odometer's state: intervals of position, speed and bias, from wheels that slide one way.

A braking wheel turns no faster than the train moves, so it bounds the speed from below alone; the accelerometer bounds
it from above until the trailer axle rolls freely again. Bounds of Gaussian errors are three standard deviations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import NonNegativeFloat, PositiveFloat

from ..arrays import Array
from ..measurement import Interval, Measurement
from ..model import Inclusion
from ..railway.dynamics import Slope, climbs
from ..railway.odometer import INPUTS
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
        limits, h = self.limits, np.asarray(interval.length, dtype=float)
        reading, standing, a, b, va, vb = u[0], u[STANDING] > 0, u[3], u[4], u[5], u[6]
        steep = np.stack([_climb(low[0], self.slope), _climb(high[0], self.slope)])
        count = np.maximum(u[STILL_COUNT], 1.0)
        still = u[STILL_MEAN] - 0.5 * (steep[0] + steep[1])
        loose = 3 * limits.noise / np.sqrt(count) + limits.gradient
        known = u[STILL_COUNT] > 0
        bias_low = np.where(known, np.maximum(still - loose, -limits.bias), low[2])
        bias_high = np.where(known, np.minimum(still + loose, limits.bias), high[2])
        fast = np.maximum(high[1] + h * (reading - steep.min(axis=0) - bias_low + limits.gradient), 0.0)
        slow = np.maximum(low[1] + h * (reading - steep.max(axis=0) - bias_high - limits.gradient), 0.0)
        free = u[FREE] >= limits.free
        # speed by the wheels of the step: a pulse more or less
        step = self.period
        surely = np.where(free, b, np.maximum(a, b)) / step
        slowest = (surely - self.pulse / step) * (1 - limits.wheel)
        fastest = np.where(free, (b + self.pulse) / step * (1 + limits.wheel), np.inf)
        slow, fast = _both(slow, fast, slowest, fastest)
        slow, fast = np.where(standing, 0.0, slow), np.where(standing, 0.0, fast)
        # distance: by the trailer's count while it rolls freely, else between the faster wheel and the accelerometer
        share = np.asarray(interval.share, dtype=float)
        begins = free & (u[FREE] < limits.free + step)
        least = np.where(free, b, np.where(va >= vb, a, b)) * (1 - limits.wheel)
        most = np.where(free, b * (1 + limits.wheel), 0.5 * step * (high[1] + fast))
        slack = np.where(begins, self.pulse, 0.0)
        moved = h > 0
        out_low, out_high = low.copy(), high.copy()
        out_low[0] = np.where(moved, low[0] + share * (least - slack), low[0])
        out_high[0] = np.where(moved, high[0] + share * (np.maximum(most, least) + slack), high[0])
        out_low[1], out_high[1] = np.where(moved, slow, low[1]), np.where(moved, fast, high[1])
        out_low[2], out_high[2] = np.where(moved, bias_low, low[2]), np.where(moved, bias_high, high[2])
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


def _both(low: Array, high: Array, least: Array, most: Array) -> tuple[Array, Array]:
    """The intersection; where it is empty what is new alone stands."""
    a, b = np.maximum(low, least), np.minimum(high, most)
    empty = a > b
    return np.where(empty, least, a), np.where(empty, np.where(np.isfinite(most), most, np.maximum(high, least)), b)


def _climb(s: Array, slope: Slope) -> Array:
    """The map's pull at each position, m/s^2."""
    out = np.empty_like(s)
    climbs(np.ascontiguousarray(s), slope, out)
    return out
