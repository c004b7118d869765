"""Faults of where and when: jumps of the vehicle or of the reading only, and time stamps that are wrong."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np

from ..arrays import Array
from ..randomness import RunRandom
from ..strict import KIND, key
from ..world import Sensing
from .base import Base, Readings


class Jump(Base):
    """From the beginning on the position is further than it was (until `to`, of a reading)."""

    kind: Annotated[Literal["jump"], KIND]
    size: Annotated[float, key("by how much", "m, or the reading's")] = 30.0
    truth: Annotated[bool, key(
        "true: the vehicle is somewhere else, all readings are right, and so is the line under it: it is its "
        "coordinates that have moved; false: only the readings of `sensors` move, by their own unit where the "
        "setting has no position")] = True

    def check(self, sensing: Sensing, following: bool = True) -> None:
        super().check(sensing)
        if not self.truth:
            return
        if not following:
            raise ValueError("jump: the vehicle cannot be moved in a closed loop; allowed: truth = false")
        if sensing.place is None:
            raise ValueError("jump: this setting has no position along a line to move; allowed: truth = false")
        given = sorted({"to", "every", "lasts", "sensors", "told"} & self.model_fields_set)
        if given:
            raise ValueError(f"jump: {', '.join(given)} has no meaning where the vehicle itself moves: leave it out, "
                             "or set truth = false")

    def shift(self, time: float | Array) -> float | Array:
        """How far the vehicle has been moved by `time` (s), m."""
        return np.where(np.asarray(time) >= self.from_ - 1e-9, self.size, 0.0) if self.truth else 0.0

    def ends(self) -> float:
        return self.from_ if self.truth else super().ends()

    def apply(self, random: RunRandom, readings: Readings) -> None:
        place, time = readings.sensing.place, readings.time
        if self.truth:
            assert place is not None and readings.truth is not None
            moved = np.asarray(self.shift(time))[:, None, None]
            for values, along in ((readings.truth, place[0]), (readings.y, place[1]), (readings.clean, place[1])):
                if values is not None:
                    elements = np.flatnonzero(along)
                    values[:, elements] = np.where(moved != 0, values[:, elements] + moved * along[elements, None],
                                                   values[:, elements])
            return
        elements = readings.sensing.chosen(self.sensors)
        along = np.ones(len(readings.sensing.names)) if place is None else place[1]
        elements = [element for element in elements if along[element] or self.sensors]
        inside, _ = self.present(random, time)
        for element in elements:
            size = self.size * (along[element] or 1.0)
            readings.y[:, element] = np.where(inside, readings.y[:, element] + size, readings.y[:, element])
        self.mark(readings, elements, inside)


class Stamps(Base):
    """Time stamps are wrong: what is said to be of now is of some time ago.

    Between steps the noise-free reading is interpolated; the noise stays that of the step."""

    kind: Annotated[Literal["stamps"], KIND]
    beforehand = True
    offset: Annotated[float, key("how long ago it is of (negative: later)", "s")] = 1.0

    def apply(self, random: RunRandom, readings: Readings) -> None:
        elements = readings.sensing.chosen(self.sensors)
        time = readings.time
        inside, _ = self.present(random, time)
        at = np.clip(time - self.offset, time[0], time[-1])
        right = np.clip(np.searchsorted(time, at), 1, len(time) - 1)
        span = time[right] - time[right - 1]
        share = ((at - time[right - 1]) / np.where(span > 0, span, 1.0))[:, None]  # a run of one step has no span
        for element in elements:
            y = readings.y[:, element]
            base = y if readings.clean is None else readings.clean[:, element]
            then = base[right - 1] + share * (base[right] - base[right - 1])
            readings.y[:, element] = np.where(inside, then + (0.0 if readings.clean is None else y - base), y)
        self.mark(readings, elements, inside)
