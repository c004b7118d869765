"""What the channels share in which one node transmits at a time: who owns which measurement elements.

A node is a list of elements (from 0) that travel together; where none are given, each element is one."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from ..arrays import Index, Mask
from ..strict import key
from .base import Base

Node = Annotated[list[Annotated[int, Field(ge=0)]], Field(min_length=1)]


class OneAtATime(Base):
    """One node transmits at a time."""

    nodes: Annotated[list[Node], key(
        "nodes[i] lists the measurement elements (from 0) of node i; none: each element is a node (coupled cars: "
        "each car)", "1")] = []

    @model_validator(mode="after")
    def _own_elements(self) -> OneAtATime:
        owned = [index for node in self.nodes for index in node]
        if len(set(owned)) != len(owned):
            raise ValueError("nodes share a measurement element: each element belongs to one node")
        return self

    def check(self, ny: int, field: str = "channel") -> None:
        owned = sorted(index for node in self.groups(ny) for index in node)
        if owned != list(range(ny)):
            raise ValueError(f"{field}.nodes list the measurement elements {', '.join(map(str, owned))}, but there are "
                             f"{ny}: each element 0 .. {ny - 1} must belong to a node, no others")

    def groups(self, ny: int) -> list[list[int]]:
        """The elements of each node."""
        return self.nodes or [[element] for element in range(ny)]

    def shares(self) -> tuple[tuple[tuple[int, ...], ...], tuple[float, ...]]:
        """The nodes as far as they are given, and an equal share of the steps for each."""
        return tuple(tuple(node) for node in self.nodes), tuple(1 / len(self.nodes) for _ in self.nodes)

    def heard(self, chosen: Index, ny: int) -> Mask:
        """Which elements arrive (K, ny, S) where node chosen (K, S) transmits; none where it is negative."""
        self.check(ny)
        received = np.zeros((chosen.shape[0], ny, chosen.shape[1]), dtype=bool)
        for node, elements in enumerate(self.groups(ny)):
            received[:, elements, :] = (chosen == node)[:, None, :]
        return received
