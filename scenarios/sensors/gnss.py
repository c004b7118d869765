"""Satellite positioning along the line: correlated and white errors, multipath jumps, outages in tunnels."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field, NonNegativeFloat, PositiveFloat

from ..arrays import Array, Mask
from ..randomness import RunRandom
from ..schema import Strict
from ..strict import key

Pair = Annotated[list[float], Field(min_length=2, max_length=2)]


class Gnss(Strict):
    """A satellite receiver, silent in tunnels."""

    every: Annotated[PositiveFloat, key("between fixes", "s")]
    slow: Annotated[NonNegativeFloat, key("standard deviation of the Gauss-Markov error", "m")]
    memory: Annotated[PositiveFloat, key("its time constant", "s")]
    white: Annotated[NonNegativeFloat, key("standard deviation of the white error", "m")]
    told: Annotated[PositiveFloat, key("standard deviation that the receiver tells", "m")]
    jump: Annotated[float, Field(ge=0, le=1), key("chance per fix that a jump begins", "1")]
    size: Annotated[NonNegativeFloat, key("its standard deviation", "m")]
    lasts: Annotated[Pair, key("least and greatest length of a jump", "s")]
    outage: Annotated[Pair, key("no fix from so far before a tunnel to so far behind", "m")]

    def read(self, position: Array, tunnels: list[list[float]], period: float, random: RunRandom,
             times: Array | None = None) -> tuple[Array, Mask]:
        """Readings (K, S) m and which there are: at the first step's end at or after each fix. times (K,) s of the
        steps' ends where they are not multiples of the period, which then is the usual one."""
        steps = len(position)
        at = fixes(self.every, period, steps) if times is None else ends(self.every, times)
        n = len(at)
        keep = float(np.exp(-max(self.every, period) / self.memory))
        shock = random.normal(n)
        white, begins = random.normal(n), random.uniform(0.0, 1.0, n)
        size, lasts = random.normal(n), random.uniform(0.0, 1.0, n)
        slow = np.empty_like(shock)
        left, height = np.zeros(position.shape[1]), np.zeros(position.shape[1])
        jumped = np.empty_like(shock)
        for i in range(n):
            slow[i] = shock[i] if i == 0 else keep * slow[i - 1] + np.sqrt(1 - keep * keep) * shock[i]
            new = (left <= 0) & (begins[i] < self.jump)
            height = np.where(new, self.size * size[i], height)
            left = np.where(new, self.lasts[0] + (self.lasts[1] - self.lasts[0]) * lasts[i], left)
            jumped[i] = np.where(left > 0, height, 0.0)
            left = left - max(self.every, period)
        y, there = np.zeros_like(position), np.zeros(position.shape, dtype=bool)
        y[at] = position[at] + self.slow * slow + self.white * white + jumped
        there[at] = True
        for begin, end in tunnels:
            there &= ~((position >= begin + self.outage[0]) & (position <= end + self.outage[1]))
        return y, there


def fixes(every: float, period: float, steps: int) -> np.ndarray:
    """The steps at whose end something is read that comes every so many seconds."""
    at = np.ceil(np.arange(1, int(steps * period / every) + 2) * every / period - 1e-9).astype(np.int64) - 1
    return np.unique(at[at < steps])


def ends(every: float, times: Array) -> np.ndarray:
    """The same of steps that end at times (K,) s, counted from 0."""
    at = np.searchsorted(times, np.arange(1, int(times[-1] / every + 1e-9) + 1) * every - 1e-9)
    return np.unique(at)
