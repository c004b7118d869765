"""What every channel answers; shared by all kinds."""

from __future__ import annotations

from ..arrays import Mask
from ..model import Reception
from ..randomness import RunRandom
from ..schema import Strict


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
