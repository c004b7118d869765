"""Channels between the sensors and the estimator: which measurement elements arrive at which step of which run.

Shared by every plant; a channel only ever draws from the stream "channel"."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PositiveInt, model_validator

from .model import Reception
from .randomness import RunRandom
from .schema import Probability, Strict

Mask = NDArray[np.bool_]
Counts = NDArray[np.int64]


class Base(Strict):
    """What every channel answers. draw: which elements arrive, (steps, ny, S) bool. reception: what estimators know."""

    def check(self, ny: int, field: str = "channel") -> None:
        """Raise ValueError where the channel does not fit ny measurement elements."""

    def draw(self, random: RunRandom, steps: int, ny: int) -> Mask:
        """Which of ny elements arrive at each of the steps of each run, (steps, ny, S)."""
        raise NotImplementedError

    def reception(self) -> Reception:
        """What an estimator may know of the channel."""
        raise NotImplementedError


class Ideal(Base):
    """Everything arrives."""

    kind: Literal["ideal"] = "ideal"

    def draw(self, random: RunRandom, steps: int, ny: int) -> Mask:
        return np.ones((steps, ny, len(random.runs)), dtype=bool)

    def reception(self) -> Reception:
        return Reception()


class Bernoulli(Base):
    """Each packet (all measurements of a step) arrives with probability p, independently."""

    kind: Literal["bernoulli"]
    p: Probability

    def draw(self, random: RunRandom, steps: int, ny: int) -> Mask:
        arrived = random.uniform(0.0, 1.0, steps) < self.p
        return np.repeat(arrived[:, None, :], ny, axis=1)

    def reception(self) -> Reception:
        return Reception(self.p, self.p)


class Csma(Base):
    """p-persistent CSMA: a packet arrives with probability p (1 - p)^(N(k) - 1), N(k) trains contending (Zou et al.
    2018, eqs. (6), (7)).

    trains: N, a number or [least, most]. traffic: `constant` (needs a single number), `uniform` (fresh each step), or
    `birth-death` (a train enters or leaves the cell with probability `rate` per step each)."""

    kind: Literal["csma"]
    p: Annotated[float, Field(gt=0, lt=1)] = 0.5
    trains: PositiveInt | Annotated[list[PositiveInt], Field(min_length=2, max_length=2)]
    traffic: Literal["constant", "uniform", "birth-death"] = "constant"
    rate: Annotated[float, Field(gt=0, le=0.5)] = 0.01

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

    def contending(self, random: RunRandom, steps: int) -> Counts:
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

    def reception(self) -> Reception:
        low, high = self.range
        least, most = self.p * (1 - self.p) ** (high - 1), self.p * (1 - self.p) ** (low - 1)
        return Reception(least, most, variance=most * (1 - most))  # for whole N it is greatest at the least N


class RandomAccess(Base):
    """Random access protocol: at each step exactly one node transmits, node i with probability p[i] (Zou, Wang, Han,
    Zhou, eqs. (1), (4), (5)). nodes[i] lists the measurement elements (from 0) of node i."""

    kind: Literal["random-access"]
    p: Annotated[list[Annotated[float, Field(gt=0, le=1)]], Field(min_length=1)]
    nodes: list[Annotated[list[Annotated[int, Field(ge=0)]], Field(min_length=1)]]

    @model_validator(mode="after")
    def _consistent(self) -> RandomAccess:
        if len(self.p) != len(self.nodes):
            raise ValueError(f"p has {len(self.p)} probabilities for {len(self.nodes)} nodes: one each is needed")
        if abs(sum(self.p) - 1) > 1e-9:
            raise ValueError(f"p must sum to 1, but sums to {sum(self.p):g}")
        owned = [index for node in self.nodes for index in node]
        if len(set(owned)) != len(owned):
            raise ValueError("nodes share a measurement element: each element belongs to one node")
        return self

    def check(self, ny: int, field: str = "channel") -> None:
        owned = sorted(index for node in self.nodes for index in node)
        if owned != list(range(ny)):
            raise ValueError(f"{field}.nodes list the measurement elements {', '.join(map(str, owned))}, but there are "
                             f"{ny}: each element 0 .. {ny - 1} must belong to a node, no others")

    def draw(self, random: RunRandom, steps: int, ny: int) -> Mask:
        self.check(ny)
        edges = np.cumsum(self.p)[:-1]
        chosen = np.searchsorted(edges, random.uniform(0.0, 1.0, steps), side="right")
        received = np.zeros((steps, ny, len(random.runs)), dtype=bool)
        for node, elements in enumerate(self.nodes):
            received[:, elements, :] = (chosen == node)[:, None, :]
        return received

    def reception(self) -> Reception:
        return Reception(min(self.p), max(self.p), tuple(tuple(node) for node in self.nodes), tuple(self.p))


Channel = Annotated[Ideal | Bernoulli | Csma | RandomAccess, Field(discriminator="kind")]
