"""The covariance that does not depend on who transmits, step by step."""

from __future__ import annotations

import numpy as np

from ...scenarios.arrays import Array
from ...scenarios.model import DesignModel, Linear, Reception


def updated_covariance(linear: Linear, reception: Reception, P: Array, k: int) -> tuple[Array, Array]:
    """(11), (12): the gain K (nx, ny) and P(k|k) from P(k|k-1), (nx, nx). Sensors that no node owns get no gain.

    sum p_i Phi_i (C P C' + R) Phi_i of (12) is block diagonal over the nodes, so p cancels in the gain, whatever the
    number of sensors a node owns; (11), and with it the next gains, still depend on p."""
    C, R = linear.C(k), linear.R(k)
    K, updated = np.zeros((len(P), len(C))), np.zeros_like(P)
    for node, p in zip(reception.nodes, reception.p, strict=True):
        rows = list(node)
        c, r = C[rows], R[np.ix_(rows, rows)]
        gain = np.linalg.solve(c @ P @ c.T + r, c @ P).T
        left = np.eye(len(P)) - gain @ c
        updated += p * (left @ P @ left.T + gain @ r @ gain.T)
        K[:, rows] = gain
    return K, (updated + updated.T) / 2


class Covariance:
    """A covariance P (nx, nx), and those that follow from it by the matrices of a step, each computed once.

    They depend on the steps of the predictions and updates only, so they serve every batch of runs of one model."""

    def __init__(self, linear: Linear, reception: Reception, P: Array) -> None:
        self.linear, self.reception, self.P = linear, reception, P
        self._predicted: dict[int, Covariance] = {}
        self._spread: dict[int, Array] = {}
        self._updated: dict[int, tuple[Array, Covariance]] = {}

    def __deepcopy__(self, memo: object) -> Covariance:
        """Itself: nothing of it ever changes but what is known to follow, a chain as long as the trip."""
        return self

    def predicted(self, k: int) -> Covariance:
        """(10): from step k to k + 1."""
        if k not in self._predicted:
            A = self.linear.A(k)
            self._predicted[k] = Covariance(self.linear, self.reception, A @ self.P @ A.T + self.linear.Q(k))
        return self._predicted[k]

    def updated(self, k: int) -> tuple[Array, Covariance]:
        """The gain of the measurement of step k, and what it leads to."""
        if k not in self._updated:
            K, P = updated_covariance(self.linear, self.reception, self.P, k)
            self._updated[k] = K, Covariance(self.linear, self.reception, P)
        return self._updated[k]

    def spread(self, k: int) -> Array:
        """C P C' + R of the innovations of step k, (ny, ny, 1)."""
        if k not in self._spread:
            C = self.linear.C(k)
            self._spread[k] = np.ascontiguousarray((C @ self.P @ C.T + self.linear.R(k))[:, :, None])
        return self._spread[k]

    @classmethod
    def initial(cls, model: DesignModel) -> Covariance:
        assert model.linear is not None and model.reception is not None
        return cls(model.linear, model.reception, model.initial_covariance[:, :, 0])

    def sequence(self, horizon: int) -> tuple[list[Array], Array]:
        """See `covariance_sequence`."""
        now, gains, covariances = self, [], [self.P]
        for k in range(horizon):
            K, now = now.predicted(k).updated(k + 1)
            gains.append(K)
            covariances.append(now.P)
        return gains, np.array(covariances)


def covariance_sequence(model: DesignModel, horizon: int) -> tuple[list[Array], Array]:
    """Theorem 1's gains K_1 .. K_horizon (nx, ny each) and covariances P(k|k), k = 0 .. horizon, (horizon + 1, nx, nx).

    For tables and figures (the trace of P against its bounds)."""
    return Covariance.initial(model).sequence(horizon)
