"""Random access: exactly one node transmits each step (Zou, RAP)."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from ..arrays import Mask
from ..model import Reception
from ..randomness import RunRandom
from .base import Base


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
