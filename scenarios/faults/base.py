"""What every fault has: its sensors, its window or episodes, whether it is told; and the readings it works on.

Arrays are those of whole runs, (K, .., S): K steps, S runs."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from pydantic import ConfigDict, Field, NonNegativeFloat, PositiveFloat, model_validator

from ..arrays import Array, Mask
from ..randomness import RunRandom
from ..schema import Name, Strict
from ..strict import key
from ..world import Sensing


@dataclass
class Readings:
    """The readings of a batch on their way through the faults, changed in place.

    time (K,) s since the start; y (K, ny, S) and there (K, ny, S): the readings and which of them there are; clean
    (K, ny, S): what they would be without noise, None where that is unknown; truth (K, nt, S), None where it cannot be
    changed (closed loop). faulty, told (K, ny, S): readings that a fault has made wrong, and that estimators are told
    of. following: whether readings follow from each other (False where each comes from the loop as it goes)."""

    sensing: Sensing
    time: Array
    y: Array
    there: Mask
    clean: Array | None
    truth: Array | None
    faulty: Mask
    told: Mask
    following: bool = True

    @property
    def sd(self) -> Array:
        """Standard deviations (K, ny)."""
        return np.broadcast_to(self.sensing.sd, self.y.shape[:2])


class Base(Strict):
    """One entry of [[faults]]. beforehand: whether it needs readings that follow from each other beforehand."""

    model_config = ConfigDict(populate_by_name=True)
    beforehand: ClassVar[bool] = False

    name: Annotated[Name | None, key("what it is called where its kind stands twice")] = None
    sensors: Annotated[tuple[str, ...], key(
        "names of measurement elements (position means position 1, .. too); none: all")] = ()
    from_: Annotated[NonNegativeFloat, key("beginning, after the start", "s")] = Field(0.0, alias="from")
    to: Annotated[PositiveFloat | None, key("end, after the start; none: never", "s")] = None
    every: Annotated[PositiveFloat | None, key(
        "only in episodes that begin at random, once in this time on average", "s")] = None
    lasts: Annotated[PositiveFloat, key("length of an episode", "s")] = 10.0
    told: Annotated[bool, key("whether estimators are told which readings are faulty (they get none of them)")] = False

    @model_validator(mode="after")
    def _in_order(self) -> Base:
        if self.to is not None and self.to <= self.from_:
            raise ValueError(f"needs from < to, has from = {self.from_:g} and to = {self.to:g}")
        if "lasts" in self.model_fields_set and self.every is None:
            raise ValueError("lasts is used with every only: leave it out, or give every")
        return self

    @property
    def label(self) -> str:
        """What the entry is called."""
        return self.name or str(getattr(self, "kind", ""))

    def check(self, sensing: Sensing, following: bool = True) -> None:
        """Raise ValueError where the fault does not fit a setting."""
        sensing.chosen(self.sensors)
        if self.beforehand and not following:
            raise ValueError(f"{getattr(self, 'kind', '')} is not offered where readings are made as the loop goes")

    @abstractmethod
    def apply(self, random: RunRandom, readings: Readings) -> None:
        """Make the readings faulty, drawing from the entry's own stream."""

    def ends(self) -> float:
        """When it is over for good, s; infinite where it never is."""
        return np.inf if self.to is None else self.to

    def present(self, random: RunRandom, time: Array) -> tuple[Mask, Array]:
        """Whether there is the fault at each step (K, S), and for how long by then, s (K, S)."""
        runs = len(random.runs)
        within = (time >= self.from_ - 1e-9) & (time < self.ends() - 1e-9)
        if self.every is None:
            return np.repeat(within[:, None], runs, axis=1), np.repeat((time - self.from_)[:, None], runs, axis=1)
        length = np.diff(time, prepend=time[0] - (time[1] - time[0] if len(time) > 1 else 1.0))
        begins = (random.uniform(0.0, 1.0, len(time)) < -np.expm1(-length / self.every)[:, None]) & within[:, None]
        since = np.full((len(time), runs), np.inf)
        began = np.full(runs, -np.inf)
        for k in range(len(time)):
            over = time[k] - began >= self.lasts - 1e-9
            began = np.where(begins[k] & over, time[k], began)
            since[k] = time[k] - began
        inside = (since < self.lasts - 1e-9) & within[:, None]
        return inside, np.where(inside, since, 0.0)

    def mark(self, readings: Readings, elements: list[int], where: Mask) -> None:
        """Note the readings of `elements` that are wrong, where (K, S) or (K, n, S)."""
        wrong = where if where.ndim == 3 else np.repeat(where[:, None, :], len(elements), axis=1)
        readings.faulty[:, elements] |= wrong
        if self.told:
            readings.told[:, elements] |= wrong
