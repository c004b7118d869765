"""What surely holds of the metro's state: intervals of position and speed from the bounds of disturbance and sensors.

Both states grow with both states, so the corners of a rectangle of states bound where it goes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..arrays import Array
from ..measurement import Interval, Measurement
from ..model import Inclusion


@dataclass(frozen=True)
class Rectangles:
    """The two functions of an `Inclusion`. transition: the design model's, of position and speed; w_bar m/s^2; reads:
    of each measurement which of the two it reads, and its bound in m or m/s, infinite for none."""

    transition: Callable[[Array, Array, Interval], Array]
    w_bar: float
    reads: tuple[tuple[int, float], ...]

    def inclusion(self, mean: Array, start: Array) -> Inclusion:
        """From mean (2, S) +- start (2,)."""
        return Inclusion(mean - start[:, None], mean + start[:, None], self.predict, self.observe)

    def predict(self, low: Array, high: Array, u: Array, interval: Interval) -> tuple[Array, Array]:
        """Where the corners go, w_bar to either side; low, high (2, S). A gradient lasts longer than an interval of
        positions is wide, so that no edge but one lies in it."""
        h = interval.length
        corners = np.stack([np.stack([s, v]) for s in (low[0], high[0]) for v in (low[1], high[1])], axis=1)
        moved = self.transition(corners, u, interval)
        push = self.w_bar * np.stack(np.broadcast_arrays(0.5 * h * h, h)).reshape(2, -1)
        return moved.min(axis=1) - push, moved.max(axis=1) + push

    def observe(self, low: Array, high: Array, measurement: Measurement) -> tuple[Array, Array]:
        """What agrees with the readings; where nothing does, a bound is wrong and the readings stand alone."""
        low, high = low.copy(), high.copy()
        for i, (state, bar) in enumerate(self.reads):
            below, above = measurement.y[i] - bar, measurement.y[i] + bar
            least, most = np.maximum(low[state], below), np.minimum(high[state], above)
            wrong = least > most
            least, most = np.where(wrong, below, least), np.where(wrong, above, most)
            heard = measurement.received[i]
            low[state], high[state] = np.where(heard, least, low[state]), np.where(heard, most, high[state])
        return low, high
