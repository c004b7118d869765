"""Gates: readings too far from the prediction are rejected, or weighed by the probability that they are good ones.

Both have a way back (`reopen`), see `Reopening`."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated

import numpy as np
from pydantic import Field, PositiveFloat

from ...scenarios.model import DesignModel
from ...scenarios.randomness import RunRandom
from .base import ElementwiseKalman, Judgement, Reading, Weighed, ratio_limit
from .kernels import association
from .reopening import Memory, Reopening


class _Reopened(ElementwiseKalman):
    """A gate for some sensors or all, with a memory of what it rejects."""

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        super().start(model, runs, random)
        self._memory = Memory(self.parameters, model, runs)

    def weigh(self, reading: Reading) -> Weighed:
        if reading.element in self._memory.judged:
            return self.judge(reading)
        return Weighed(reading.noise, np.ones_like(reading.residual), np.zeros(len(reading.residual), dtype=bool))

    @abstractmethod
    def judge(self, reading: Reading) -> Weighed:
        """What becomes of a reading of a sensor that is judged."""

    def taken(self, reading: Reading, weighed: Weighed) -> None:
        """Where the rejected readings agree: the state's element that the reading speaks of goes there by their mean
        residual, its variance grows by R over their number, its covariances are cleared."""
        if self._memory.parameters.reopen != "median":
            return
        agreed, mean, count = self._memory.found(reading)
        if not agreed.any():
            return
        assert self.model.measurement_jacobian is not None
        row = np.broadcast_to(self.model.measurement_jacobian(self._mean, 0)[reading.element],
                              (self.model.nx, self.runs))
        for s in np.flatnonzero(agreed):
            a = int(np.argmax(np.abs(row[:, s])))
            variance = self._covariance[a, a, s] + reading.noise[s] / count[s] / row[a, s] ** 2
            self._mean[a, s] += mean[s] / row[a, s]
            self._covariance[a, :, s] = self._covariance[:, a, s] = 0.0
            self._covariance[a, a, s] = variance


class GatedKalman(_Reopened):
    """Readings with residual^2 / (h P h' + R) above the chi-square quantile of `level` (one degree) are rejected."""

    class Parameters(Reopening):
        level: Annotated[float, Field(gt=0, lt=1)] = Field(0.99, description="share of good readings let through")

    summary = "EKF with an innovation gate and a rule that opens it again"
    source = "Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, ch. 5"

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        super().start(model, runs, random)
        self._limit = ratio_limit(self.parameters.level)

    def judgement(self) -> Judgement | None:
        memory = self._memory
        if type(self) is not GatedKalman or memory.parameters.reopen != "time":
            return None
        return Judgement(self._limit, memory.is_judged, memory.together, memory.since, memory.parameters.after - 1e-9)

    def judge(self, reading: Reading) -> Weighed:
        rejected = self._memory.rejected(reading, reading.ratio > self._limit)
        return Weighed(reading.noise, np.where(rejected, 0.0, 1.0), rejected)


class SoftGateKalman(_Reopened):
    """Each reading counts by its probability beta of being a good one, against an outlier of `size` standard deviations
    more: mean += beta K residual, P -= beta S K K' - beta (1 - beta) residual^2 K K'."""

    class Parameters(Reopening):
        share: Annotated[float, Field(gt=0, lt=1)] = Field(0.05, description="share of readings taken for outliers")
        size: PositiveFloat = Field(20.0, description="standard deviation of an outlier, in that of the sensor")

    summary = "EKF with a soft gate: one-step probabilistic data association"
    source = "Bar-Shalom and Tse, Automatica 11(5), 1975, with at most one reading"

    def judge(self, reading: Reading) -> Weighed:
        p, beta = self.parameters, np.empty_like(reading.residual)
        association(reading.residual, reading.variance, reading.variance + p.size**2 * reading.noise, p.share, beta)
        rejected = self._memory.rejected(reading, beta < 0.5)
        return Weighed(reading.noise, np.where((beta < 0.5) & ~rejected, 1.0, beta), rejected)
