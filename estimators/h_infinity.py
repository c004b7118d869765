"""The H-infinity filter: the Kalman recursion for disturbances of bounded energy, its level theta and its condition.

Lives apart from `kalman` because its matrix P is no covariance and its condition can fail."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import Field, NonNegativeFloat

from ..scenarios.arrays import Array
from ..scenarios.errors import Unsupported
from ..scenarios.measurement import Interval, Measurement
from ..scenarios.model import DesignModel
from ..scenarios.randomness import RunRandom
from .interface import Estimate, Parameters, Status, flag
from .kalman import ExtendedKalman

REASON = "P^-1 - theta S is not positive definite: no filter keeps this level theta"


class HInfinityParameters(Parameters):
    """Parameters of the H-infinity filter."""

    theta: Annotated[NonNegativeFloat, Field(
        description="level: the weighted squared errors stay under 1/theta times the energy of start, disturbance and "
                    "noise (unit of 1/S); 0 is the Kalman filter")] = 0.1
    weights: Annotated[tuple[NonNegativeFloat, ...] | None, Field(
        description="S_ii of the setting's own states; default 1/P0_ii (0 where that is infinite): errors in units of "
                    "the start's standard deviations")] = None


class HInfinity(ExtendedKalman):
    """x^- = f(x, u), P^- = F (P^-1 - theta S)^-1 F' + Q; x = x^- + K (y - h(x^-)), K = P^- H'(H P^- H' + R)^-1,
    P = (P^-^-1 + H' R^-1 H)^-1.

    The filter of the updated estimate, whose P^- obey Simon's (11.89). It exists as long as P^-1 - theta S > 0; a run
    where that fails is infeasible. Errors count from the first step on, not the start, a part of a step by its share:

    sum e_k' S e_k < (1/theta) (|e_0|^2 in P0^-1 + sum |w_k|^2 in Q^-1 + sum |v_k|^2 in R^-1).

    Of a nonlinear model by its Jacobians, without that guarantee. P is a bound on no single error, so none is
    claimed."""

    family = "Robust"
    summary = "H-infinity filter: bounded energy of disturbance and noise, level theta"
    source = ("Nagpal, Khargonekar, IEEE TAC 36(2), 1991; Simon, Optimal State Estimation, 2006, section 11.3; "
              "extended: Einicke, White, IEEE TSP 47(9), 1999")
    claims = ()
    Parameters = HInfinityParameters

    def design(self, model: DesignModel) -> dict[str, Any]:
        """Nothing to be found offline; refuses (Unsupported) weights of another number of states."""
        weights = self.parameters.weights
        if weights is not None and len(weights) != model.own:
            raise Unsupported(f"HInfinity: weights has {len(weights)} elements, the setting {model.own} states")
        return {}

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        super().start(model, runs, random)
        given, own = self.parameters.weights, np.diagonal(model.initial_covariance).T[:model.own]
        with np.errstate(divide="ignore"):
            self._weights = np.where(own > 0.0, 1.0 / own, 0.0) if given is None else np.array(given)[:, None]

    def predict(self, u: Array, interval: Interval) -> None:
        if interval.step > 1 and self.parameters.theta > 0.0:
            self._weigh(np.asarray(interval.share, dtype=float))
        super().predict(u, interval)

    def _weigh(self, share: Array) -> None:
        """P := (P^-1 - theta share S)^-1, state by state: each adds its column's square, nothing cancels."""
        P, lost = self._covariance, np.zeros(1, dtype=bool)
        for i, weight in enumerate(self._weights):
            level = self.parameters.theta * weight * share
            left = 1.0 - level * P[i, i]
            lost = lost | ~(left > 0.0)
            column = P[:, i]
            with np.errstate(divide="ignore", invalid="ignore"):
                P = P + (level / left) * column[:, None] * column[None]
        lost = np.broadcast_to(lost, (self.runs,))
        if lost.any():
            flag(self, lost, Status.infeasible, REASON)
            P = np.where(lost, np.nan, P)
        self._covariance = np.ascontiguousarray(P)

    def update(self, measurement: Measurement) -> None:
        super().update(measurement)

    def estimate(self) -> Estimate:
        return Estimate(self._mean)
