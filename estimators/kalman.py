"""The extended Kalman filter and, as the same recursion on a linear model, the Kalman filter.

Missing measurements are masks; what all runs share (covariance, gains) is computed once until they differ."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ..scenarios.arrays import Array
from ..scenarios.compiled import Compiled, LinearSteps
from ..scenarios.measurement import Course, Interval, Measurement
from ..scenarios.model import DesignModel
from ..scenarios.randomness import RunRandom
from .interface import Estimate, Estimator, Innovation, Room, Status, Walk, flag
from .kernels.core import congruence, extended_predict, predict
from .kernels.kalman import kalman_update, shared_kalman_update
from .kernels.walks import walk_kalman, walk_linear

SINGULAR_INNOVATION = "an innovation covariance was not positive definite"


class ExtendedKalman(Estimator):
    """x- = f(x, u), P- = F P F' + Q; K = P- H'(H P- H' + R)^-1, x = x- + K (y - h(x-)), P by its factors.

    F and H are the Jacobians at the latest estimate. The update works on P = L D L' (Bierman, Factorization Methods
    for Discrete Sequential Estimation, 1977), so that no rounding makes a variance negative. Elements of y that are
    missing get no gain; correlated noise is decorrelated over the elements received. The covariance is kept as (nx, nx,
    1) as long as the Jacobians, Q and the reception are the same for all runs."""

    family = "EKF, Kalman"
    summary = "extended Kalman filter (first-order linearisation)"
    source = "Jazwinski, Stochastic Processes and Filtering Theory, 1970, theorem 8.1"
    needs: ClassVar[tuple[str, ...]] = (
        "transition_jacobian", "measurement_jacobian", "process_covariance", "measurement_covariance")
    claims = ("covariance",)
    honours = ("covariance",)

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        super().start(model, runs, random)
        self._mean = model.initial_mean.copy()
        self._covariance = model.initial_covariance.copy()
        self._estimate = Estimate(self._mean, covariance=self._covariance)
        self._failed, self._room = np.zeros(runs, dtype=bool), Room()
        self._residual, self._variance = np.zeros((model.ny, runs)), np.zeros((model.ny, runs))
        self._shared_variance = np.zeros((model.ny, 1))
        self._innovation = Innovation(self._residual, self._variance)
        f, F = model.transition, model.transition_jacobian
        self._compiled = (f, F) if isinstance(f, Compiled) and isinstance(F, Compiled) and f.given == F.given else None

    def predict(self, u: Array, interval: Interval) -> None:
        model, x = self.model, self._mean
        assert model.process_covariance is not None
        q = np.ascontiguousarray(model.process_covariance(x, u, interval))
        if self._compiled is not None:
            self._expand()
            f, F = self._compiled
            address, u, seconds, data = f.arguments(u, interval)
            extended_predict(address, F.address, u, seconds, data, q, x, self._covariance)
            return
        f, F = model.transition, model.transition_jacobian
        assert F is not None
        jacobian = np.ascontiguousarray(F(x, u, interval))
        if jacobian.shape[2] > 1 or q.shape[2] > 1:
            self._expand()
        if isinstance(f, Compiled):
            address, u, seconds, data = f.arguments(u, interval)
            predict(address, u, seconds, data, jacobian, q, x, self._covariance)
            return
        self._mean = np.ascontiguousarray(f(x, u, interval))
        congruence(jacobian, self._covariance, q, self._covariance)

    def update(self, measurement: Measurement) -> Innovation | None:
        model, x, (y, received, at, _, _, _) = self.model, self._mean, measurement
        assert model.measurement_jacobian is not None and model.measurement_covariance is not None
        h = np.ascontiguousarray(model.measurement_jacobian(x, at))
        r = np.ascontiguousarray(model.measurement_covariance(measurement))
        predicted = np.ascontiguousarray(model.measurement(x, at))
        shared = self._covariance.shape[2] == 1 < self.runs
        if shared and (h.shape[2] > 1 or r.shape[2] > 1 or _correlated(r) or (received != received[:, :1]).any()):
            self._expand()
            shared = False
        update = shared_kalman_update if shared else kalman_update
        variance = self._shared_variance if shared else self._variance
        if update(x, self._covariance, y, predicted, received, h, r, self._residual, variance, self._failed):
            flag(self, self._failed, Status.failed, SINGULAR_INNOVATION)
        return Innovation(self._residual, variance) if shared else self._innovation

    def walk(self, course: Course, early: bool) -> Walk | None:
        whole = self.model.over(course)
        if type(self) not in (ExtendedKalman, Kalman) or whole is None:
            return None
        linear = isinstance(whole, LinearSteps)
        if course.variance is not None if linear else early:
            return None
        walk, seconds = self._room_for(course), np.full(self.runs, course.period)
        own = self._mean, self._covariance, self._failed, walk.mean, walk.covariance, *walk.innovation[:2]
        if linear:
            failed = walk_linear(whole.transition.address, whole.data, whole.F, whole.Q, whole.H, whole.R, seconds,
                                 course.u, course.y, course.received, early, *own)
        else:
            failed = walk_kalman(*whole[:6], whole.noise, seconds, course.u, course.y, course.received, course.told,
                                 *own)
        if failed:
            flag(self, self._failed, Status.failed, SINGULAR_INNOVATION)
        return walk

    def _room_for(self, course: Course) -> Walk:
        """A walk to be filled; from now on the runs' covariances differ."""
        self._expand()
        return self._room.gaussian(len(course.y), self.model.nx, self.model.ny, self.runs)

    def estimate(self) -> Estimate:
        if self._estimate.mean is not self._mean or self._estimate.covariance is not self._covariance:
            self._estimate = Estimate(self._mean, covariance=self._covariance)
        return self._estimate

    def _expand(self) -> None:
        """From now on the runs' covariances differ."""
        if self._covariance.shape[2] < self.runs:
            self._covariance = np.repeat(self._covariance, self.runs, axis=2)


def _correlated(r: Array) -> bool:
    """Whether the noise covariance r (ny, ny, 1) has entries off its diagonal."""
    return bool(np.count_nonzero(r) > np.count_nonzero(r[:, :, 0].diagonal()))


class Kalman(ExtendedKalman):
    """The Kalman filter of a linear model x+ = A x + B u + h + w, y = C x + v, with intermittent observations."""

    summary = "Kalman filter of a linear model, with missing measurements"
    source = "Kalman, J. Basic Eng. 82, 1960; intermittent observations: Sinopoli et al., IEEE TAC 49(9), 2004"
    needs = ("linear", *ExtendedKalman.needs)
