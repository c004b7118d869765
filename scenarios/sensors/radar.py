"""Doppler radar: speed over ground with a scale error of the run and white noise, nothing at low speed."""

from __future__ import annotations

from pydantic import NonNegativeFloat, PositiveFloat

from ..arrays import Array, Mask
from ..randomness import RunRandom
from ..schema import Strict


class Radar(Strict):
    """scale: standard deviation of the run's scale error; noise m/s; least m/s: it is silent under this speed."""

    scale: NonNegativeFloat
    noise: PositiveFloat
    least: NonNegativeFloat

    def read(self, speed: Array, random: RunRandom) -> tuple[Array, Mask, Array]:
        """Readings (K, S) m/s, which there are, and the scale error (S,)."""
        scale = self.scale * random.normal()
        return speed * (1.0 + scale) + self.noise * random.normal(len(speed)), speed >= self.least, scale
