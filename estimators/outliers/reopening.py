"""How a gate opens again: never, by the median of what it rejects, or after a time of rejections.

Without a way back a gate that has closed on the truth stays closed: the estimate then runs away for good."""

from __future__ import annotations

import json
from typing import Literal

import numpy as np
from pydantic import Field, PositiveFloat, PositiveInt, model_validator

from ...scenarios.arrays import Array, Mask
from ...scenarios.errors import InputError
from ...scenarios.model import DesignModel
from ..interface import Parameters, used_with
from .base import Reading
from .kernels import close


class Reopening(Parameters):
    """What a gate with a way back is asked for."""

    sensors: tuple[str, ...] = Field((), description="those that are judged; none: all")
    reopen: Literal["never", "median", "time"] = Field("median", description="how the gate opens again")
    memory: PositiveInt = Field(20, description="median: received readings looked back on")
    needed: PositiveInt = Field(14, description="median: how many of them must be rejected, near their median")
    near: PositiveFloat = Field(3.0, description="median: how near, in standard deviations of the sensor")
    after: PositiveFloat = Field(20.0, description="time: s of rejections after which it opens")
    together: tuple[str, ...] = Field((), description="time: opens only when all of these sensors have been rejected "
                                                      "for that long; none: each on its own")

    @model_validator(mode="after")
    def _consistent(self) -> Reopening:
        for name in ("memory", "needed", "near"):
            used_with(self, name, "reopen", "median")
        for name in ("after", "together"):
            used_with(self, name, "reopen", "time")
        if self.sensors and not {*self.together} <= {*self.sensors}:
            raise ValueError(f"together must be among sensors = {json.dumps(self.sensors)}: others are never rejected")
        if self.needed > self.memory:
            raise ValueError(f"needed = {self.needed} cannot be more than memory = {self.memory}")
        return self


def _elements(what: str, names: tuple[str, ...], model: DesignModel) -> list[int]:
    """Places of the measurements called so. Raises InputError naming those that there are not."""
    unknown = [name for name in names if name not in model.measurements]
    if unknown:
        raise InputError(f"{what}: there is no measurement {', '.join(unknown)}; allowed: "
                         f"{', '.join(model.measurements)}")
    return [model.measurements.index(name) for name in names]


class Memory:
    """The rejections of a batch, element by element: a ring of the last residuals for `median` (NaN: was accepted), the
    time of the first of an unbroken row of rejections for `time`."""

    def __init__(self, parameters: Reopening, model: DesignModel, runs: int, asked: str = "sensors") -> None:
        """asked: what `sensors` is called where a user gives them."""
        self.parameters = parameters
        self.ring = np.full((parameters.memory if parameters.reopen == "median" else 0, model.ny, runs), np.nan)
        self.since = np.full((model.ny, runs), np.inf)
        self.judged = _elements(asked, parameters.sensors, model) or list(range(model.ny))
        together = _elements("together", parameters.together, model)
        self._with = [np.array(together if j in together else [j]) for j in range(model.ny)]
        self.is_judged = np.isin(np.arange(model.ny), self.judged)
        self.together = np.array([[k in each for k in range(model.ny)] for each in self._with])

    def rejected(self, reading: Reading, outside: Mask) -> Mask:
        """Which of the readings (S,) outside the gate are rejected, all but where it stands open (`time`); that
        the received ones fell outside or inside is kept in mind."""
        j, got = reading.element, reading.received
        if self.parameters.reopen == "time":
            return close(outside, got, np.atleast_1d(np.asarray(reading.time, dtype=float)), self.since, j,
                         self._with[j], self.parameters.after - 1e-9)
        if self.parameters.reopen == "median":
            ring = self.ring[:, j]
            ring[:, got] = np.concatenate([ring[1:, got], np.where(outside, reading.residual, np.nan)[None, got]])
        return outside

    def found(self, reading: Reading) -> tuple[Mask, Array, Array]:
        """`median`: runs (S,) in which enough of the rejected residuals agree, their mean and their number."""
        runs = len(reading.residual)
        agreed, mean, count = np.zeros(runs, dtype=bool), np.zeros(runs), np.zeros(runs)
        ring = self.ring[:, reading.element]
        for s in np.flatnonzero(np.isfinite(ring).sum(axis=0) >= self.parameters.needed):
            rejected = ring[:, s][np.isfinite(ring[:, s])]
            near = rejected[np.abs(rejected - np.median(rejected)) <= self.parameters.near * np.sqrt(reading.noise[s])]
            if len(near) >= self.parameters.needed:
                agreed[s], mean[s], count[s] = True, near.mean(), len(near)
                ring[:, s] = np.nan
        return agreed, mean, count
