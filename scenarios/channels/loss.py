"""Channels that lose elements independently, or none."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np

from ..arrays import Mask
from ..model import Reception
from ..randomness import RunRandom
from ..schema import Probability
from ..strict import KIND, key
from .base import Base


class Ideal(Base):
    """Everything arrives."""

    kind: Annotated[Literal["ideal"], KIND] = "ideal"

    def draw(self, random: RunRandom, steps: int, ny: int) -> Mask:
        return np.ones((steps, ny, len(random.runs)), dtype=bool)

    def transmitted(self) -> Reception:
        return Reception()


class Bernoulli(Base):
    """Each packet (all measurements of a step) arrives with probability p, independently."""

    kind: Annotated[Literal["bernoulli"], KIND]
    p: Annotated[Probability, key("probability of arrival", "1")]

    def draw(self, random: RunRandom, steps: int, ny: int) -> Mask:
        arrived = random.uniform(0.0, 1.0, steps) < self.p
        return np.repeat(arrived[:, None, :], ny, axis=1)

    def transmitted(self) -> Reception:
        return Reception(self.p, self.p)
