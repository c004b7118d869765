"""Random access whose node follows a Markov chain (Zou, Wang, Han, Zhou, Remark 1)."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from ..arrays import Array, Index, Mask
from ..model import Reception
from ..randomness import RunRandom
from ..strict import KIND, key
from .nodes import OneAtATime

Row = Annotated[list[Annotated[float, Field(ge=0, le=1)]], Field(min_length=1)]


class MarkovRandomAccess(OneAtATime):
    """Exactly one node transmits each step; the next one follows from it by a Markov chain.

    The first node is drawn from the chain's stationary distribution."""

    kind: Annotated[Literal["markov-random-access"], KIND]
    transition: Annotated[list[Row], key("row i has the probabilities of who follows node i", "1")] = []
    stay: Annotated[Annotated[float, Field(ge=0, lt=1)] | None, key(
        "in place of it: the probability that the same node goes on, all others following alike", "1")] = None

    @model_validator(mode="after")
    def _consistent(self) -> MarkovRandomAccess:
        if bool(self.transition) == (self.stay is not None):
            raise ValueError("needs either transition (a row of probabilities a node) or stay (a probability)")
        for number, row in enumerate(self.transition):
            if len(row) != len(self.transition) or abs(sum(row) - 1) > 1e-9:
                raise ValueError(f"transition must be square with rows that sum to 1; row {number} has {len(row)} "
                                 f"entries that sum to {sum(row):.12g}")
        if self.transition:
            values = np.linalg.eigvals(np.array(self.transition))
            if np.sum(np.abs(values - 1) < 1e-9) > 1:
                raise ValueError("transition has nodes that never follow from others: no one stationary distribution")
        return self

    def check(self, ny: int, field: str = "channel") -> None:
        super().check(ny, field)
        if self.transition and len(self.transition) != len(self.groups(ny)):
            raise ValueError(f"{field}.transition has {len(self.transition)} rows for {len(self.groups(ny))} nodes: "
                             "one each is needed")

    def chain(self, nodes: int) -> Array:
        """The transition matrix (nodes, nodes)."""
        if self.stay is None:
            return np.array(self.transition)
        if nodes == 1:
            return np.ones((1, 1))
        return np.where(np.eye(nodes, dtype=bool), self.stay, (1 - self.stay) / (nodes - 1))

    def chosen(self, random: RunRandom, steps: int, nodes: int) -> Index:
        """The node of each step (steps, S)."""
        chain = self.chain(nodes)
        edges = np.cumsum(chain, axis=1)[:, :-1]
        draws = random.uniform(0.0, 1.0, steps)
        out = np.empty((steps, len(random.runs)), dtype=np.int64)
        now = np.searchsorted(np.cumsum(stationary(chain))[:-1], draws[0], side="right")
        for k in range(steps):
            now = now if k == 0 else (draws[k] >= edges[now].T).sum(axis=0)
            out[k] = now
        return out

    def draw(self, random: RunRandom, steps: int, ny: int) -> Mask:
        return self.heard(self.chosen(random, steps, len(self.groups(ny))), ny)

    def transmitted(self) -> Reception:
        nodes = tuple(tuple(node) for node in self.nodes)
        if not nodes:
            return Reception(0.0, 1.0, breaks="who transmits depends on who did before")
        chain = self.chain(len(nodes))
        return Reception(float(chain.min()), float(chain.max()), nodes, tuple(stationary(chain).tolist()),
                         breaks="who transmits depends on who did before")


def stationary(chain: Array) -> Array:
    """The distribution that a transition matrix (n, n) keeps, (n,)."""
    n = len(chain)
    system = np.vstack([chain.T - np.eye(n), np.ones((1, n))])
    found = np.linalg.lstsq(system, np.append(np.zeros(n), 1.0), rcond=None)[0]
    return np.maximum(found, 0.0) / np.maximum(found, 0.0).sum()
