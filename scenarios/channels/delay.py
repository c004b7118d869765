"""Delay: packets that arrive do so some steps late, by a fixed or a random number, composed with any loss."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, NonNegativeInt, field_validator

from ..arrays import Index, Mask
from ..model import Reception
from ..randomness import RunRandom
from ..strict import KIND, key
from .base import Arrived, Base, Sent, beside
from .csma import Csma
from .gilbert_elliott import GilbertElliott
from .loss import Bernoulli, Ideal
from .markov_random_access import MarkovRandomAccess
from .random_access import RandomAccess
from .round_robin import RoundRobin
from .try_once_discard import TryOnceDiscard

Loss = Annotated[Ideal | Bernoulli | GilbertElliott | Csma | RandomAccess | MarkovRandomAccess | RoundRobin
                 | TryOnceDiscard, Field(discriminator="kind")]


class Delay(Base):
    """What gets through `loss` arrives late. The losses are those of `loss` without delay, bit for bit."""

    kind: Annotated[Literal["delay"], KIND]
    steps: Annotated[NonNegativeInt | Annotated[list[NonNegativeInt], Field(min_length=2, max_length=2)], key(
        "steps late: a number, or [least, most], uniform and fresh each step", "1")] = 1
    reorder: Annotated[bool, key(
        "whether packets may overtake each other; false: they queue, none arrives before an earlier one")] = True
    loss: Annotated[Loss, key("the channel that loses packets")] = Ideal()

    @field_validator("steps")
    @classmethod
    def _ordered(cls, steps: int | list[int]) -> int | list[int]:
        if isinstance(steps, list) and steps[0] > steps[1]:
            raise ValueError("steps = [least, most] needs least <= most")
        return steps

    @property
    def range(self) -> tuple[int, int]:
        """Least and greatest delay, steps."""
        return (self.steps, self.steps) if isinstance(self.steps, int) else (self.steps[0], self.steps[1])

    @property
    def longest(self) -> int:
        return 0 if self.silent == "hold" else self.range[1]

    def check(self, ny: int, field: str = "channel") -> None:
        self.loss.check(ny, f"{field}.loss")

    def delays(self, random: RunRandom, steps: int) -> Index:
        """By how many steps each step's packet is late, (steps, S)."""
        least, most = self.range
        drawn = beside(random, "delay").integers(least, most, steps)
        if self.reorder:
            return drawn
        stamps = np.arange(steps)[:, None]
        return np.maximum.accumulate(drawn + stamps) - stamps

    def draw(self, random: RunRandom, steps: int, ny: int) -> Mask:
        return self.loss.draw(random, steps, ny)

    def carried(self, random: RunRandom, sent: Sent) -> Arrived:
        through = self.loss.carried(random, sent)
        late = self.delays(random, len(sent.y))[:, None, :]
        late = np.where(through.received, late, 0)
        return Arrived(through.y, through.received & (late == 0), late)

    def transmitted(self) -> Reception:
        known = self.loss.reception()
        if self.range == (0, 0):
            return known
        return Reception(0.0, known.p_high, known.nodes, known.p, breaks="packets come late")
