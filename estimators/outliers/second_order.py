"""The second-order extended Kalman filter: the curvature of the model enters means and covariances."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...scenarios.arrays import Array
from ...scenarios.measurement import Interval, Measurement
from ..interface import Innovation, Status, flag
from ..kalman import SINGULAR_INNOVATION, ExtendedKalman
from ..kernels.core import congruence
from ..kernels.kalman import kalman_update

STEP = 1e-4
"""Of the central differences of the Jacobian, in units of the state or of its size where that is larger."""


class SecondOrderKalman(ExtendedKalman):
    """x- = f + 1/2 sum_i e_i tr(F_i P), P- = F P F' + 1/2 sum_ij e_i e_j' tr(F_i P F_j P) + Q with the Hessians F_i of
    f; the measurement likewise. Hessians are central differences of the model's Jacobians."""

    summary = "second-order extended Kalman filter (Hessians by differences of the Jacobians)"
    source = "Athans, Wishner and Bertolini, IEEE TAC 13(5), 1968; Roth and Gustafsson, FUSION 2011"

    def predict(self, u: Array, interval: Interval) -> None:
        model, x = self.model, self._mean
        assert model.transition_jacobian is not None and model.process_covariance is not None
        jacobian = model.transition_jacobian
        self._expand()
        shift, spread = self._curvature(lambda at: jacobian(at, u, interval), len(x))
        f = np.ascontiguousarray(jacobian(x, u, interval))
        q = np.ascontiguousarray(model.process_covariance(x, u, interval) + spread)
        self._mean = np.ascontiguousarray(model.transition(x, u, interval)) + shift
        congruence(f, self._covariance, q, self._covariance)

    def update(self, measurement: Measurement) -> Innovation | None:
        model, x, (y, received, at, *_) = self.model, self._mean, measurement
        assert model.measurement_jacobian is not None and model.measurement_covariance is not None
        jacobian = model.measurement_jacobian
        self._expand()
        h = np.ascontiguousarray(jacobian(x, at))
        shift, spread = self._curvature(lambda there: jacobian(there, at), len(y))
        predicted = np.ascontiguousarray(model.measurement(x, at)) + shift
        r = np.ascontiguousarray(model.measurement_covariance(measurement))
        if spread.any():
            r = np.ascontiguousarray(r + spread)
        if kalman_update(x, self._covariance, y, predicted, received, h, r, self._residual, self._variance,
                         self._failed):
            flag(self, self._failed, Status.failed, SINGULAR_INNOVATION)
        return Innovation(self._residual, self._variance)

    def _curvature(self, jacobian: Callable[[Array], Array], rows: int) -> tuple[Array, Array]:
        """1/2 tr(H_i P) (rows, S) and 1/2 tr(H_i P H_j P) (rows, rows, S) of the function with that Jacobian of x."""
        x, P, n = self._mean, self._covariance, len(self._mean)
        hessian = np.zeros((rows, n, n, self.runs))
        for c in range(n):
            step = STEP * np.maximum(np.abs(x[c]), 1.0)
            ahead, behind = x.copy(), x.copy()
            ahead[c] += step
            behind[c] -= step
            there, back = jacobian(ahead), jacobian(behind)
            hessian[:, :, c] = (there - back) / (ahead[c] - behind[c])
        if not hessian.any():
            return np.zeros((rows, self.runs)), np.zeros((rows, rows, self.runs))
        weighed = np.zeros_like(hessian)
        for a in range(n):
            for b in range(n):
                for c in range(n):
                    weighed[:, a, b] += hessian[:, a, c] * P[c, b]
        shift, spread = np.zeros((rows, self.runs)), np.zeros((rows, rows, self.runs))
        for a in range(n):
            shift += 0.5 * weighed[:, a, a]
            for b in range(n):
                spread += 0.5 * weighed[:, None, a, b] * weighed[None, :, b, a]
        return shift, spread
