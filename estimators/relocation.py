"""Dead reckoning with relocation: the design model run forward, its position taken over from whatever tells the place.

What railways do without a filter: count wheel turns, set the count at every balise."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from ..scenarios.arrays import Array
from ..scenarios.compiled import WholeSteps, call
from ..scenarios.errors import Unsupported
from ..scenarios.measurement import Course, Interval, Measurement
from ..scenarios.model import DesignModel
from ..scenarios.randomness import RunRandom
from .interface import Estimate, Estimator, Innovation, Parameters, Room, Walk
from .kernels.core import kernel
from .kernels.walks import copy2, noises


class RelocationParameters(Parameters):
    """Which measurements relocate, and how fast the claim grows between them."""

    by: list[str] = Field(["balise"], min_length=1, description="measurements that set the first state")
    scale: float = Field(0.00577, ge=0, description="claimed standard deviation of what is travelled since, as a share "
                         "of it (0.00577: uniform within 1 %)")


class Relocation(Estimator):
    """x = f(x, u); at a relocating measurement the first state becomes what is measured.

    Claims for the first state sd^2 = r + (scale d)^2, with r the measurement's own variance (the start's before the
    first) and d what was travelled since by the model's own count."""

    Parameters = RelocationParameters
    family = "No filter"
    summary = "dead reckoning, set anew by every measurement of the place"
    source = "the usual practice of train odometry (SUBSET-026, 3.6.4: location by the last balise group)"
    claims = ("covariance",)
    honours = ("covariance",)
    needs: ClassVar[tuple[str, ...]] = ("measurement_covariance",)

    def design(self, model: DesignModel) -> dict[str, Any]:
        """Raises Unsupported where the model measures nothing of `by`."""
        strays = [name for name in self.parameters.by if name not in model.measurements]
        if strays:
            raise Unsupported(f"by = {strays}: not among this scenario's measurements "
                              f"({', '.join(model.measurements)})")
        return {}

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        super().start(model, runs, random)
        self.rows = [model.measurements.index(name) for name in self.parameters.by]
        self._mean = model.initial_mean.copy()
        self._fixed = np.repeat(model.initial_covariance[0, 0], runs // model.initial_covariance.shape[2])
        self._gone, self._room = np.zeros(runs), Room()
        self._covariance = np.empty((1, 1, runs))

    def predict(self, u: Array, interval: Interval) -> None:
        before = self._mean[0]
        self._mean = self.model.transition(self._mean, u, interval)
        self._gone = self._gone + np.abs(self._mean[0] - before)

    def update(self, measurement: Measurement) -> Innovation | None:
        if not measurement.received[self.rows].any():
            return None
        assert self.model.measurement_covariance is not None
        R = self.model.measurement_covariance(measurement)
        for row in self.rows:
            got = measurement.received[row]
            self._mean[0] = np.where(got, measurement.y[row], self._mean[0])
            self._fixed = np.where(got, R[row, row], self._fixed)
            self._gone = np.where(got, 0.0, self._gone)
        return None

    def walk(self, course: Course, early: bool) -> Walk | None:
        whole = self.model.over(course)
        if early or not isinstance(whole, WholeSteps) or type(self) is not Relocation:
            return None
        mean, covariance = self._room.of(len(course.y), mean=self._mean.shape, covariance=(1, 1, self.runs))
        _walk(whole.transition, whole.data, whole.noise, np.full(self.runs, course.period), course.u, course.y,
              course.received, course.told, np.array(self.rows), self.parameters.scale, self._mean, self._fixed,
              self._gone, mean, covariance)
        return Walk(mean, covariance)

    def estimate(self) -> Estimate:
        self._covariance[0, 0] = self._fixed + (self.parameters.scale * self._gone) ** 2
        return Estimate(self._mean, covariance=self._covariance)


@kernel
def _walk(f, data, noise, seconds, u, y, received, variance, rows, scale, mean, fixed, gone, means, covariances):
    """Over whole periods: mean (nx, S), fixed, gone (S,) in place; u, y, received, variance (B, .., S) as `Course`."""
    (nx, runs), ny = mean.shape, y.shape[1]
    moved, r = np.empty((nx, runs)), np.zeros((ny, ny, runs))
    for b in range(y.shape[0]):
        call(f, mean, u[b], seconds, data, 1, runs, runs, moved)
        noises(variance[b], noise, 0, r)
        for s in range(runs):
            gone[s] += abs(moved[0, s] - mean[0, s])
        copy2(moved, mean)
        for row in rows:
            for s in range(runs):
                if received[b, row, s]:
                    mean[0, s], fixed[s], gone[s] = y[b, row, s], r[row, row, s], 0.0
        for s in range(runs):
            far = scale * gone[s]
            covariances[b, 0, 0, s] = fixed[s] + far * far
        copy2(mean, means[b])
