"""Round-robin: the nodes transmit in turn, one each step."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np

from ..arrays import Mask
from ..model import Reception
from ..randomness import RunRandom
from ..strict import KIND
from .nodes import OneAtATime


class RoundRobin(OneAtATime):
    """Node k mod n transmits at step k, in every run: nothing is drawn. One node is the ideal channel."""

    kind: Annotated[Literal["round-robin"], KIND]

    def draw(self, random: RunRandom, steps: int, ny: int) -> Mask:
        turn = np.arange(steps) % len(self.groups(ny))
        return self.heard(np.repeat(turn[:, None], len(random.runs), axis=1), ny)

    def transmitted(self) -> Reception:
        if len(self.nodes) == 1:
            return Reception()
        return Reception(0.0, 1.0, *self.shares(), breaks="a node's turn is no independent draw")
