"""Wheel sensors: pulses counted per axle, a diameter that is not quite the nominal one, and the noise they tell."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt

from ..arrays import Array, Mask
from ..randomness import RunRandom
from ..schema import Strict
from ..strict import key

Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
SMOOTHED = 0.5
"""The wheels' speeds that dead reckoning is told are means over this, s."""


class Wheel(Strict):
    """A wheel's pulse counter."""

    diameter: Annotated[PositiveFloat, key("as nominal", "m")]
    pulses: Annotated[PositiveInt, key("pulses per turn", "1")]
    diameter_error: Annotated[float, Field(ge=0, lt=0.5), key(
        "the true one is larger by a share within +- this, or of this standard deviation, per axle and run", "1")]
    spread: Annotated[Literal["uniform", "gaussian"], key(
        "of that share: uniform within +- the error, or gaussian")] = "uniform"
    phase: Annotated[Pair, key("the counter starts within [least, most] of a pulse", "1")] = [0.0, 1.0]
    creep: Annotated[NonNegativeFloat, key(
        "what the sensor tells of micro-slip: a standard deviation as a share of the distance", "1")] = 0.003
    quiet: Annotated[PositiveFloat, key("stand without pulses after which it tells something else", "s")] = 1.0
    quiet_sd: Annotated[PositiveFloat, key("what it tells then", "m/s")] = 0.02

    @property
    def pulse(self) -> float:
        """Nominal distance per pulse q, m."""
        return np.pi * self.diameter / self.pulses

    def count(self, rolled: Array, random: RunRandom) -> tuple[Array, Array]:
        """Pulses counted (K, n, S) of n axles whose wheels rolled (K, n, S) m, whole numbers, and how much too far a
        wheel reads for its diameter (n, S), as a share."""
        axles = rolled.shape[1]
        drawn = random.uniform(-1.0, 1.0, axles) if self.spread == "uniform" else random.normal(axles)
        scale = 1.0 + self.diameter_error * drawn
        phase = self.phase[0] + (self.phase[1] - self.phase[0]) * random.uniform(0.0, 1.0, axles)
        return np.floor(rolled / (scale * self.pulse) + phase), 1.0 / scale - 1.0

    def travelled(self, counts: Array) -> Array:
        """Distance (K, n, S) m by the nominal diameter in each step."""
        return self.pulse * np.diff(counts, axis=0, prepend=0.0)

    def speed(self, counts: Array, period: float) -> Array:
        """Speed (K, n, S) by the nominal diameter, m/s: the mean over `SMOOTHED` s, at least a step."""
        span = max(1, round(SMOOTHED / period))
        smooth = np.concatenate([np.zeros((span, *counts.shape[1:])), counts])
        return self.pulse / (span * period) * (smooth[span:] - smooth[:-span])

    def variance(self, distance: Array, standing: Mask, period: float) -> Array:
        """What the sensor tells of the distances (K, n, S) m of its steps, m^2: see `rolled`; after a stand (standing
        (K, S)) without pulses for `quiet` seconds less."""
        noise = rolled(distance, self.pulse, self.creep)
        still = (distance == 0.0) & standing[:, None]
        steps = np.arange(len(distance))[:, None, None]
        since = steps - np.maximum.accumulate(np.where(still, -1, steps), axis=0)
        return np.where(still & (since * period > self.quiet), (self.quiet_sd * period)**2, noise)


def rolled(distance: Array, pulse: float, creep: float) -> Array:
    """Variance, m^2, of distances (m) between two counts: the counter's step, and micro-slip as a share."""
    return pulse**2 / 6.0 + (creep * distance) ** 2
