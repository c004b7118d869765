"""What every channel answers; shared by all kinds: what is sent, what arrives, and when.

A channel draws from the stream "channel" and streams beside it only, so that one knob moves no other draw."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np

from ..arrays import Array, Index, Mask
from ..model import Reception
from ..randomness import RunRandom, Streams
from ..schema import Strict
from ..strict import key

OLD = "the receiver hands on old values as if they were fresh"


@dataclass(frozen=True)
class Sent:
    """What the sensors hand to the channel: y (K, ny, S); there (K, ny, S): which readings there are at all; sd (ny,)
    or (K, ny): their standard deviations; of random.runs S runs."""

    y: Array
    there: Mask
    sd: Array


@dataclass(frozen=True)
class Arrived:
    """What the receiver has: y (K, ny, S); received (K, ny, S): readings that came in the step they belong to.

    late (K, ny, S): by how many steps each reading comes late, 0 for one in time or never; None: none is late."""

    y: Array
    received: Mask
    late: Index | None = None


class Base(Strict):
    """What every channel answers. draw: which elements arrive, (steps, ny, S) bool. reception: what estimators know."""

    silent: Annotated[Literal["nothing", "hold"], key(
        "what the receiver makes of an element that does not arrive: nothing, or hold: the last value it has of "
        "it, handed on as if it were fresh")] = "nothing"

    @property
    def longest(self) -> int:
        """By how many steps a packet can be late."""
        return 0

    def check(self, ny: int, field: str = "channel") -> None:
        """Raise ValueError where the channel does not fit ny measurement elements."""

    @abstractmethod
    def draw(self, random: RunRandom, steps: int, ny: int) -> Mask:
        """Which of ny elements arrive at each of the steps of each run, (steps, ny, S)."""

    def carried(self, random: RunRandom, sent: Sent) -> Arrived:
        """What arrives of what is sent, before the receiver makes up for silence."""
        steps, ny, _ = sent.y.shape
        return Arrived(sent.y, sent.there & self.draw(random, steps, ny))

    def carry(self, streams: Streams, sent: Sent) -> Arrived:
        """What the receiver has in the end."""
        arrived = self.carried(streams("channel"), sent)
        return held(arrived) if self.silent == "hold" else arrived

    @abstractmethod
    def transmitted(self) -> Reception:
        """What an estimator may know of who transmits, whatever the receiver does."""

    def reception(self) -> Reception:
        """What an estimator may know of the channel."""
        found = self.transmitted()
        if self.silent == "nothing":
            return found
        return replace(found, breaks=OLD, spoils=OLD)


def beside(random: RunRandom, name: str) -> RunRandom:
    """A stream of its own beside `random`, of the same runs."""
    return RunRandom(random.seed, (*random.names, name), random.runs)


def held(arrived: Arrived) -> Arrived:
    """With the receiver's register of the newest reading of each element in place of what it hears: from an element's
    first reading on every step has one."""
    steps = len(arrived.y)
    y, received = np.zeros_like(arrived.y), np.zeros_like(arrived.received)
    register, stamp = np.array(0.0), np.array(-1)
    depth = 0 if arrived.late is None else int(arrived.late.max())
    for k in range(steps):
        for age in range(min(depth, k), -1, -1):
            comes = arrived.received[k] if age == 0 else late_by(arrived, k - age, age)
            new = comes & (k - age > stamp)
            register, stamp = np.where(new, arrived.y[k - age], register), np.where(new, k - age, stamp)
        y[k], received[k] = register, stamp >= 0
    return Arrived(y, received)


def late_by(arrived: Arrived, stamp: int, age: int) -> Mask:
    """Which readings of step `stamp` come `age` steps late, (ny, S)."""
    assert arrived.late is not None
    return arrived.late[stamp] == age
