"""Gilbert-Elliott: losses come in bursts, from a channel that is good or bad (Gilbert 1960, Elliott 1963)."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from ..arrays import Mask
from ..model import Reception
from ..randomness import RunRandom
from ..schema import Probability
from ..strict import KIND, key
from .base import Base, beside

Chance = Annotated[float, Field(ge=0, le=1)]


class GilbertElliott(Base):
    """A packet (all measurements of a step) arrives with another probability in good steps and in bad ones.

    A bad stretch lasts 1 / p_bad_good steps on average. The first step's state is drawn from the stationary
    distribution. The states have a stream of their own, the packets that of `bernoulli`: with p_good = p_bad it is that
    channel, bit for bit."""

    kind: Annotated[Literal["gilbert-elliott"], KIND]
    p_good_bad: Annotated[Probability, key("probability of turning bad from one step to the next", "1")]
    p_bad_good: Annotated[Probability, key("probability of turning good", "1")]
    p_good: Annotated[Chance, key("probability of arrival in good steps", "1")] = 1.0
    p_bad: Annotated[Chance, key("probability of arrival in bad steps", "1")] = 0.0

    def bad(self, random: RunRandom, steps: int) -> Mask:
        """Which steps are bad (steps, S)."""
        return bursts(beside(random, "state"), steps, self.p_good_bad, self.p_bad_good)

    def draw(self, random: RunRandom, steps: int, ny: int) -> Mask:
        p = np.where(self.bad(random, steps), self.p_bad, self.p_good)
        arrived = random.uniform(0.0, 1.0, steps) < p
        return np.repeat(arrived[:, None, :], ny, axis=1)

    def transmitted(self) -> Reception:
        """The probability of the next packet given all before it lies between these two."""
        turns = (self.p_good_bad, 1 - self.p_bad_good)
        p = [share * self.p_bad + (1 - share) * self.p_good for share in turns]
        return Reception(min(p), max(p))


def bursts(random: RunRandom, steps: int, p_good_bad: float, p_bad_good: float) -> Mask:
    """Which steps of a two-state chain are bad (steps, S), from its stationary distribution on."""
    draws = random.uniform(0.0, 1.0, steps)
    out = np.empty(draws.shape, dtype=bool)
    bad = draws[0] < p_good_bad / (p_good_bad + p_bad_good)
    for k in range(steps):
        bad = bad if k == 0 else np.where(bad, draws[k] >= p_bad_good, draws[k] < p_good_bad)
        out[k] = bad
    return out
