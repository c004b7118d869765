"""The interval observer: the design model's inclusion run forward, its middle the estimate, its width the claim."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from ...scenarios.measurement import Interval, Measurement
from ...scenarios.model import DesignModel
from ...scenarios.randomness import RunRandom
from ..interface import Estimate, Estimator, Innovation


class IntervalObserver(Estimator):
    """low, high: intervals of the states that the inclusion speaks of; the others keep their start.

    Claims the first state's interval, as an ellipsoid of one dimension. Judge it by width and misses: where one side is
    bounded better than the other, its middle is no good estimate."""

    family = "Set membership"
    summary = "interval observer: what surely holds, by the model's inclusion"
    source = "Gouze, Rapaport, Hadj-Sadok, Ecological Modelling 133, 2000 (the idea)"
    needs: ClassVar[tuple[str, ...]] = ("inclusion",)
    claims = ("ellipsoid",)
    honours = ("covariance",)

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        super().start(model, runs, random)
        assert model.inclusion is not None
        self.inclusion = model.inclusion
        self.low, self.high = (np.broadcast_to(side, (len(side), runs)).copy()
                               for side in (model.inclusion.low, model.inclusion.high))
        self._mean = model.initial_mean.copy()
        self._shape = np.empty((1, 1, runs))

    def predict(self, u: Any, interval: Interval) -> None:
        self.low, self.high = self.inclusion.predict(self.low, self.high, u, interval)

    def update(self, measurement: Measurement) -> Innovation | None:
        self.low, self.high = self.inclusion.observe(self.low, self.high, measurement)
        return None

    def estimate(self) -> Estimate:
        n = len(self.low)
        self._mean[:n] = 0.5 * (self.low + self.high)
        self._shape[0, 0] = (0.5 * (self.high[0] - self.low[0])) ** 2
        return Estimate(self._mean, ellipsoid=self._shape)
