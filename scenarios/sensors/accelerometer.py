"""Longitudinal accelerometer: it reads the gradient with the acceleration, has a bias of its own and noise."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import NonNegativeFloat

from ..arrays import Array
from ..randomness import RunRandom
from ..schema import Strict
from ..strict import key

REFERENCE = 0.1


class Accelerometer(Strict):
    """An accelerometer along the train."""

    bias: Annotated[NonNegativeFloat, key("standard deviation per run", "m/s^2")]
    noise: Annotated[NonNegativeFloat, key(
        "standard deviation per reading over 0.1 s (white: over longer steps the mean is better)", "m/s^2")]
    drift: Annotated[NonNegativeFloat, key("of the bias' random walk", "m/s^2 per sqrt(s)")] = 0.0

    def read(self, acceleration: Array, climb: Array, period: float | Array, random: RunRandom) -> tuple[Array, Array]:
        """Readings (K, S) m/s^2, the mean acceleration of each step and the gradient's pull with errors, and the bias
        (K, S). period: of the steps, s, a number or (K, 1)."""
        bias = np.repeat(self.bias * random.normal()[None], len(acceleration), axis=0)
        noise = self.noise * np.sqrt(REFERENCE / period) * random.normal(len(acceleration))
        if self.drift:
            bias += self.drift * np.sqrt(period) * np.cumsum(random.normal(len(acceleration)), axis=0)
        return acceleration + climb + bias + noise, bias

    def deviation(self, period: float) -> float:
        """Standard deviation of a reading's noise, m/s^2."""
        return self.noise * np.sqrt(REFERENCE / period)
