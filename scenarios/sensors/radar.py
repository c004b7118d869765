"""Doppler radar: speed over ground with a scale error of the run and white noise, nothing at low speed."""

from __future__ import annotations

from typing import Annotated

from pydantic import NonNegativeFloat, PositiveFloat

from ..arrays import Array, Mask
from ..randomness import RunRandom
from ..schema import Strict
from ..strict import key


class Radar(Strict):
    """A Doppler radar."""

    scale: Annotated[NonNegativeFloat, key("standard deviation of the run's scale error", "1")]
    noise: Annotated[PositiveFloat, key("standard deviation of a reading", "m/s")]
    least: Annotated[NonNegativeFloat, key("it is silent under this speed", "m/s")]

    def read(self, speed: Array, random: RunRandom) -> tuple[Array, Mask, Array]:
        """Readings (K, S) m/s, which there are, and the scale error (S,)."""
        scale = self.scale * random.normal()
        return speed * (1.0 + scale) + self.noise * random.normal(len(speed)), speed >= self.least, scale
