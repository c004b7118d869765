"""p-persistent CSMA: nodes contend for slots (Zou et al. 2018)."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, PositiveInt, model_validator

from ..arrays import Index, Mask
from ..model import Reception
from ..randomness import RunRandom
from ..strict import KIND, key
from .base import Base


class Csma(Base):
    """p-persistent CSMA: a packet arrives with probability p (1 - p)^(N(k) - 1), N(k) trains contending (Zou et al.
    2018, eqs. (6), (7))."""

    kind: Annotated[Literal["csma"], KIND]
    p: Annotated[float, Field(gt=0, lt=1), key("probability of transmitting in a slot", "1")] = 0.5
    trains: Annotated[PositiveInt | Annotated[list[PositiveInt], Field(min_length=2, max_length=2)], key(
        "N, a number or [least, most]", "1")]
    traffic: Annotated[Literal["constant", "uniform", "birth-death"], key(
        "constant (needs a single number), uniform (fresh each step), or birth-death (a train enters or leaves "
        "the cell)")] = "constant"
    rate: Annotated[float, Field(gt=0, le=0.5), key(
        "probability per step that a train enters, and that one leaves (birth-death)", "1")] = 0.01

    @model_validator(mode="after")
    def _consistent(self) -> Csma:
        if self.traffic == "constant" and isinstance(self.trains, list):
            raise ValueError("traffic = \"constant\" needs a single number of trains, such as trains = 2")
        if isinstance(self.trains, list) and self.trains[0] > self.trains[1]:
            raise ValueError("trains = [least, most] needs least <= most")
        return self

    @property
    def range(self) -> tuple[int, int]:
        """Least and greatest number of trains N(k)."""
        return (self.trains, self.trains) if isinstance(self.trains, int) else (self.trains[0], self.trains[1])

    def contending(self, random: RunRandom, steps: int) -> Index:
        """N(k), shape (steps, S)."""
        low, high = self.range
        if self.traffic == "uniform":
            return random.integers(low, high, steps)
        if self.traffic == "constant":
            return np.full((steps, len(random.runs)), low, dtype=np.int64)
        count = random.integers(low, high)
        moves = random.uniform(0.0, 1.0, steps)
        out = np.empty((steps, len(random.runs)), dtype=np.int64)
        for k in range(steps):
            count = np.clip(count + (moves[k] < self.rate) - (moves[k] > 1 - self.rate), low, high)
            out[k] = count
        return out

    def draw(self, random: RunRandom, steps: int, ny: int) -> Mask:
        trains = self.contending(random, steps)
        arrived = random.uniform(0.0, 1.0, steps) < self.p * (1 - self.p) ** (trains - 1)
        return np.repeat(arrived[:, None, :], ny, axis=1)

    def transmitted(self) -> Reception:
        low, high = self.range
        least, most = self.p * (1 - self.p) ** (high - 1), self.p * (1 - self.p) ** (low - 1)
        return Reception(least, most, variance=most * (1 - most))  # for whole N it is greatest at the least N
