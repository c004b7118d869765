"""Noise that is not what a sensor promises: single readings far off, and heavy tails."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, NonNegativeFloat, PositiveFloat

from ..randomness import RunRandom
from ..strict import KIND, key
from ..world import Sensing
from .base import Base, Readings


class Outliers(Base):
    """A share of the readings is off.

    Each reading draws whether it is one, whatever the share: the outliers of a smaller share are among those of a
    greater one."""

    kind: Annotated[Literal["outliers"], KIND]
    share: Annotated[float, Field(ge=0, le=1), key("of the readings that are outliers", "1")] = 0.1
    size: Annotated[NonNegativeFloat, key("by how much they are off", "standard deviations")] = 20.0
    sign: Annotated[Literal["both", "plus"], key("to both sides, or to plus only")] = "both"

    def apply(self, random: RunRandom, readings: Readings) -> None:
        elements = readings.sensing.chosen(self.sensors)
        steps = len(readings.time)
        drawn = random.uniform(0.0, 1.0, steps, len(elements))
        upwards = random.uniform(0.0, 1.0, steps, len(elements)) < 0.5
        inside, _ = self.present(random, readings.time)
        hit = (drawn < self.share) & inside[:, None, :]
        off = self.size * readings.sd[:, elements, None]
        off = np.where(upwards | (self.sign == "plus"), off, -off)
        readings.y[:, elements] = np.where(hit, readings.y[:, elements] + off, readings.y[:, elements])
        self.mark(readings, elements, hit)


class StudentT(Base):
    """The sensor's noise times sqrt(dof / chi-square): Gaussian noise becomes Student's t of its own scale.

    Where a setting's readings have no noise of their own, t-distributed noise of the sensor's standard deviation is
    added. No single reading counts as faulty."""

    kind: Annotated[Literal["student-t"], KIND]
    beforehand = True
    dof: Annotated[PositiveFloat, key("degrees of freedom", "1")] = 3.0

    def check(self, sensing: Sensing, following: bool = True) -> None:
        if self.told:
            raise ValueError("told: heavy tails have no single faulty readings to tell of: leave it out")
        super().check(sensing, following)

    def apply(self, random: RunRandom, readings: Readings) -> None:
        from scipy.special import gammaincinv

        elements = readings.sensing.chosen(self.sensors)
        steps = len(readings.time)
        chance = random.uniform(0.0, 1.0, steps, len(elements))
        wide = np.sqrt(self.dof / (2 * gammaincinv(self.dof / 2, 1 - chance)))
        inside, _ = self.present(random, readings.time)
        y = readings.y[:, elements]
        if readings.clean is None:
            moved = y + readings.sd[:, elements, None] * wide * random.normal(steps, len(elements))
        else:
            clean = readings.clean[:, elements]
            moved = clean + (y - clean) * wide
        readings.y[:, elements] = np.where(inside[:, None, :], moved, y)
