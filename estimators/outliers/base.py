"""Kalman filters element by element, with a hook that weighs each reading before it is taken in.

`rejected` says which of the received readings were discounted (weight or precision under one half): the alarms."""

from __future__ import annotations

from abc import abstractmethod
from typing import NamedTuple

import numpy as np

from ...scenarios.arrays import Array, Mask
from ...scenarios.compiled import WholeSteps
from ...scenarios.errors import Unsupported
from ...scenarios.measurement import Course, Measurement, untold
from ...scenarios.model import DesignModel
from ...scenarios.randomness import RunRandom
from ..interface import Estimator, Innovation, Status, Walk, flag
from ..kalman import SINGULAR_INNOVATION, ExtendedKalman
from .kernels import correct, look, walk_elements


class Reading(NamedTuple):
    """One element of a measurement as the filter sees it: all (S,) but the numbers.

    residual: after the elements before it; spread = h P h'; noise: R of the element; received; time: of its
    stamp, s."""

    element: int
    residual: Array
    spread: Array
    noise: Array
    received: Mask
    time: float | Array

    @property
    def variance(self) -> Array:
        """Of the residual, were the noise as told."""
        return self.spread + self.noise

    @property
    def ratio(self) -> Array:
        """The squared normalised residual."""
        return self.residual * self.residual / self.variance


def ratio_limit(level: float) -> float:
    """What the ratio of a good reading exceeds with probability 1 - level: a chi-square quantile, one degree."""
    from scipy.special import chdtri

    return float(chdtri(1, 1 - level))


class Weighed(NamedTuple):
    """How a reading is taken in: with noise variance (S,) and weight (S,); rejected (S,): it raised an alarm."""

    noise: Array
    weight: Array
    rejected: Mask


class Elementwise(Estimator):
    """A Kalman update element after element; subclasses weigh each one that any run received. Needs uncorrelated
    sensor noise."""

    family = "Outlier-robust"
    bent: bool = False
    """Whether the measurement is made linear anew for each element, about what the elements before it left."""
    _mean: Array
    _covariance: Array
    _failed: Mask

    @classmethod
    def require(cls, model: DesignModel) -> None:
        super().require(model)
        assert model.measurement_covariance is not None
        R = model.measurement_covariance(untold(0, model.ny))
        if np.count_nonzero(R[:, :, 0]) > np.count_nonzero(R[:, :, 0].diagonal()):
            raise Unsupported(f"{cls.__name__} judges each sensor on its own and needs a diagonal R")

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        super().start(model, runs, random)
        self.rejected = np.zeros((model.ny, runs), dtype=bool)

    @abstractmethod
    def linear(self, measurement: Measurement) -> tuple[Array, Array, Array]:
        """The measurement as a linear one: what is predicted (ny, S), h (ny, nx, S or 1), R (ny, ny, S or 1)."""

    @abstractmethod
    def weigh(self, reading: Reading) -> Weighed:
        """What becomes of a reading. The plain Kalman filter takes each as it is told."""

    def taken(self, reading: Reading, weighed: Weighed) -> None:
        """After a reading has been taken in: for filters that change their state again."""

    def update(self, measurement: Measurement) -> Innovation | None:
        x, y = self._mean, np.ascontiguousarray(measurement.y)
        predicted, h, r = self.linear(measurement)
        predicted = predicted.copy()  # it may be the mean itself
        start, product = x.copy(), np.empty_like(x)
        residuals, variances = np.zeros(y.shape), np.ones(y.shape)
        self.rejected = rejected = np.zeros(y.shape, dtype=bool)
        bad = 0
        for j in range(len(y)):
            received = np.ascontiguousarray(measurement.received[j])
            if not received.any():
                continue
            residual, spread = np.empty(self.runs), np.empty(self.runs)
            if j and self.bent:
                predicted, h, r = self.linear(measurement)
                start = x.copy()
            look(x, start, self._covariance, h[j], y[j], predicted[j], received, residual, spread, product)
            noise = np.full(self.runs, r[j, j, 0]) if r.shape[2] == 1 else r[j, j]
            reading = Reading(j, residual, spread, noise, received, measurement.time)
            weighed = self.weigh(reading)
            bad += correct(x, self._covariance, h[j], product, residual, spread + weighed.noise, weighed.noise,
                           weighed.weight, received, self._failed)
            rejected[j] = weighed.rejected & received
            residuals[j], variances[j] = residual, reading.variance
            self.taken(reading, weighed)
        if bad:
            flag(self, self._failed, Status.failed, SINGULAR_INNOVATION)
        return Innovation(residuals, variances)


class Judgement(NamedTuple):
    """What `walk_elements` has to know of a filter: a gate's limit, whom it judges (ny,), together with whom (ny, ny),
    since when each is outside (ny, S), after how many s it opens; a Student noise's degrees of freedom and iterations
    (0: Gaussian)."""

    limit: float
    judged: Mask
    together: Mask
    since: Array
    after: float
    dof: float = 0.0
    iterations: int = 0


class ElementwiseKalman(Elementwise, ExtendedKalman):
    """The extended Kalman filter by elements in turn, linearised once."""

    def judgement(self) -> Judgement | None:
        """How readings are judged, where `walk` knows that."""
        return None

    def walk(self, course: Course, early: bool) -> Walk | None:
        whole, how = self.model.over(course), self.judgement()
        if early or not isinstance(whole, WholeSteps) or how is None:
            return None
        walk = self._room_for(course)
        seconds = np.full(self.runs, course.period)
        if walk_elements(*whole[:6], whole.noise, seconds, course.u, course.y, course.received, course.told,
                         course.times, *how, self._mean, self._covariance, self._failed, walk.mean, walk.covariance,
                         *walk.innovation[:2]):
            flag(self, self._failed, Status.failed, SINGULAR_INNOVATION)
        return walk

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        super().start(model, runs, random)
        self._expand()

    def linear(self, measurement: Measurement) -> tuple[Array, Array, Array]:
        model, x, at = self.model, self._mean, measurement.step
        assert model.measurement_jacobian is not None and model.measurement_covariance is not None
        h = np.ascontiguousarray(model.measurement_jacobian(x, at))
        return np.asarray(model.measurement(x, at)), h, model.measurement_covariance(measurement)
