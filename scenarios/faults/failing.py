"""Sensors that fail for a while: stuck at a value, drifting away, silent, losing readings in bursts."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np

from ..channels.gilbert_elliott import bursts
from ..randomness import RunRandom
from ..schema import Probability
from ..strict import KIND, key
from .base import Base, Readings


class Stuck(Base):
    """The reading stays what it was when the fault began."""

    kind: Annotated[Literal["stuck"], KIND]
    beforehand = True

    def apply(self, random: RunRandom, readings: Readings) -> None:
        elements = readings.sensing.chosen(self.sensors)
        inside, since = self.present(random, readings.time)
        held = readings.y[0][elements]
        for k in range(1, len(readings.time)):
            begins = ~inside[k - 1] | (since[k] <= since[k - 1])  # or once more, where episodes are shorter than steps
            held = np.where(inside[k] & ~begins, held, readings.y[k][elements])
            readings.y[k][elements] = held
        self.mark(readings, elements, inside)


class Drift(Base):
    """The reading moves away from the beginning of the fault on."""

    kind: Annotated[Literal["drift"], KIND]
    rate: Annotated[float, key("by which it moves", "the reading's, per s")] = 0.1

    def apply(self, random: RunRandom, readings: Readings) -> None:
        elements = readings.sensing.chosen(self.sensors)
        inside, since = self.present(random, readings.time)
        for element in elements:
            readings.y[:, element] = np.where(inside, readings.y[:, element] + self.rate * since,
                                              readings.y[:, element])
        self.mark(readings, elements, inside)


class Dropout(Base):
    """The sensor gives nothing."""

    kind: Annotated[Literal["dropout"], KIND]

    def apply(self, random: RunRandom, readings: Readings) -> None:
        inside, _ = self.present(random, readings.time)
        readings.there[:, readings.sensing.chosen(self.sensors)] &= ~inside[:, None, :]


class Burst(Base):
    """Readings are lost in bursts: a two-state chain, all sensors of the entry together (Gilbert-Elliott)."""

    kind: Annotated[Literal["burst"], KIND]
    p_good_bad: Annotated[Probability, key("probability of turning bad from one step to the next", "1")] = 0.02
    p_bad_good: Annotated[Probability, key("probability of turning good", "1")] = 0.2

    def apply(self, random: RunRandom, readings: Readings) -> None:
        bad = bursts(random, len(readings.time), self.p_good_bad, self.p_bad_good)
        inside, _ = self.present(random, readings.time)
        readings.there[:, readings.sensing.chosen(self.sensors)] &= ~(bad & inside)[:, None, :]
