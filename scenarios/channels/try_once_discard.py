"""Try-once-discard: the node transmits whose readings have moved most since it last did (Walsh, Ye, Bushnell)."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np

from ..arrays import Mask
from ..model import Reception
from ..randomness import RunRandom
from ..strict import KIND
from .base import Arrived, Sent
from .nodes import OneAtATime

BY_CONTENT = "try-once-discard picks readings by their content, noise included"


class TryOnceDiscard(OneAtATime):
    """Each step the node with the greatest sum of (y - last sent)^2 / R over its elements transmits; nodes never heard
    come first, in their order. Ties go to the earlier node; a node without a reading does not contend.

    It picks nodes for their noise too, so that no covariance that takes readings as they come holds any more."""

    kind: Annotated[Literal["try-once-discard"], KIND]

    def draw(self, random: RunRandom, steps: int, ny: int) -> Mask:
        raise NotImplementedError("try-once-discard looks at the readings: it is asked by `carried`")

    def carried(self, random: RunRandom, sent: Sent) -> Arrived:
        steps, ny, runs = sent.y.shape
        self.check(ny)
        groups, precision = self.groups(ny), np.broadcast_to(sent.sd, (steps, ny)) ** -2.0
        last, heard = np.zeros((ny, runs)), np.zeros((len(groups), runs), dtype=bool)
        chosen = np.empty((steps, runs), dtype=np.int64)
        for k in range(steps):
            moved = np.where(sent.there[k], (sent.y[k] - last) ** 2 * precision[k][:, None], 0.0)
            urgency = np.empty((len(groups), runs))
            for node, elements in enumerate(groups):
                total = moved[elements[0]].copy()
                for element in elements[1:]:
                    total += moved[element]
                ready = sent.there[k][elements].any(axis=0)
                urgency[node] = np.where(ready, np.where(heard[node], total, np.inf), -1.0)
            chosen[k] = np.where(urgency.max(axis=0) < 0, -1, urgency.argmax(axis=0))
            for node, elements in enumerate(groups):
                sends = chosen[k] == node
                heard[node] |= sends
                last[elements] = np.where(sends & sent.there[k][elements], sent.y[k][elements], last[elements])
        return Arrived(sent.y, sent.there & self.heard(chosen, ny))

    def transmitted(self) -> Reception:
        return Reception(0.0, 1.0, *self.shares(), breaks=BY_CONTENT, spoils=BY_CONTENT)
