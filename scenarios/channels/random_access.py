"""Random access: exactly one node transmits each step (Zou, RAP)."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from ..arrays import Mask
from ..model import Reception
from ..randomness import RunRandom
from ..strict import KIND, key
from .nodes import Node, OneAtATime


class RandomAccess(OneAtATime):
    """Random access protocol: at each step exactly one node transmits (Zou, Wang, Han, Zhou, eqs. (1), (4), (5))."""

    kind: Annotated[Literal["random-access"], KIND]
    p: Annotated[list[Annotated[float, Field(gt=0, le=1)]], Field(min_length=1), key("probability of each node", "1")]
    nodes: Annotated[list[Node], key(  # pyright: ignore[reportGeneralTypeIssues]
        "nodes[i] lists the measurement elements (from 0) of node i", "1")]

    @model_validator(mode="after")
    def _consistent(self) -> RandomAccess:
        if len(self.p) != len(self.nodes):
            raise ValueError(f"p has {len(self.p)} probabilities for {len(self.nodes)} nodes: one each is needed")
        if abs(sum(self.p) - 1) > 1e-9:
            raise ValueError(f"p must sum to 1, but sums to {sum(self.p):.12g}")
        return self

    def draw(self, random: RunRandom, steps: int, ny: int) -> Mask:
        edges = np.cumsum(self.p)[:-1]
        return self.heard(np.searchsorted(edges, random.uniform(0.0, 1.0, steps), side="right"), ny)

    def transmitted(self) -> Reception:
        return Reception(min(self.p), max(self.p), tuple(tuple(node) for node in self.nodes), tuple(self.p))
