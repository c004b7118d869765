"""The yardsticks that estimate next to nothing: held measurements, dead reckoning, and the truth itself.

They show what the others are worth, and the oracle shows what is the controller's share in a closed loop."""

from __future__ import annotations

import numpy as np

from ..scenarios.arrays import Array
from ..scenarios.errors import Unsupported
from ..scenarios.measurement import Course, Interval, Measurement
from ..scenarios.model import DesignModel, product
from ..scenarios.randomness import RunRandom
from .interface import Estimate, Estimator, Room, Walk
from .kernels.walks import walk_held


class _Mean(Estimator):
    """What they share: a mean that is all they say."""

    honours = ("covariance",)

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        super().start(model, runs, random)
        self._mean = model.initial_mean.copy()

    def estimate(self) -> Estimate:
        return Estimate(self._mean)


class Direct(_Mean):
    """The last received measurement, held: x = C^-1 y, with each element of y the last one received.

    Holds the start until a run's first packet; predicts nothing. Needs a constant, square, invertible C."""

    family = "No filter"
    summary = "the last received measurement, held (C must be invertible)"
    source = "the usual practice that Zou et al., IEEE T-ITS 2018, section V, compare with"
    needs = ("linear",)
    predicts = False

    @classmethod
    def require(cls, model: DesignModel) -> None:
        super().require(model)
        assert model.linear is not None
        c = model.linear.C(0)
        if c.shape[0] != c.shape[1]:
            raise Unsupported(f"Direct needs as many measurements as states, to solve y = C x for x; here C is "
                              f"{c.shape[0]} x {c.shape[1]}")
        if not model.linear.constant:
            raise Unsupported("Direct needs a constant C: elements of y of different steps are held side by side")
        if np.linalg.matrix_rank(c) < len(c):
            raise Unsupported("Direct needs an invertible C, to solve y = C x for x; here C is singular")

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        super().start(model, runs, random)
        assert model.linear is not None
        self._inverse: Array = np.ascontiguousarray(np.linalg.inv(model.linear.C(0)), dtype=float)
        self._held, self._room = product(model.linear.C(0), self._mean), Room()

    def predict(self, u: Array, interval: Interval) -> None:
        """Nothing: the measurement is held."""

    def update(self, measurement: Measurement) -> None:
        received = measurement.received
        self._held = np.where(received, measurement.y, self._held)
        self._mean = np.where(received.any(axis=0), product(self._inverse, self._held), self._mean)

    def walk(self, course: Course, early: bool) -> Walk | None:
        if early or type(self) is not Direct:
            return None
        means, = self._room.of(len(course.y), mean=self._mean.shape)
        walk_held(self._inverse, course.y, course.received, self._held, self._mean, means)
        return Walk(means)


class DeadReckoning(_Mean):
    """The design model run forward from the start; measurements are ignored."""

    family = "No filter"
    summary = "prediction only: the design model without measurements"
    source = "the first-principles baseline"

    def predict(self, u: Array, interval: Interval) -> None:
        self._mean = self.model.transition(self._mean, u, interval)

    def update(self, measurement: Measurement) -> None:
        """Nothing: measurements are ignored."""


class Truth(_Mean):
    """The oracle: the first nx entries of the truth vector. The design model's start before the first step, and what it
    was where a truth is not known."""

    summary = "oracle: the true state"
    source = "not an estimator: the bound that no estimator passes"
    oracle = True

    def reveal(self, truth: Array) -> None:
        known, own = truth[:self.model.nx], self._mean.copy()
        own[:len(known)] = np.where(np.isnan(known), own[:len(known)], known)
        self._mean = own

    def predict(self, u: Array, interval: Interval) -> None:
        """Nothing: `reveal` has told it all."""

    def update(self, measurement: Measurement) -> None:
        """Nothing: `reveal` has told it all."""
