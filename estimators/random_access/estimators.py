"""Filters under the random access protocol: one sensor node transmits at each step (Zou, Wang, Han, Zhou).

`RandomAccess` averages over the nodes in its covariance, `ConditionalRandomAccess` uses the node that was heard."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import Field, PositiveFloat, PositiveInt, model_validator

from ...scenarios.arrays import Array
from ...scenarios.errors import Unsupported
from ...scenarios.measurement import Interval, Measurement
from ...scenarios.model import DesignModel, product, whole_steps
from ...scenarios.randomness import RunRandom
from ..interface import Estimate, Estimator, Innovation, Parameters, Status, flag
from ..kalman import Kalman
from ..kernels.kalman import in_turn
from .bounds import M_MAX, SIGMA_MAX, CovarianceBounds, critical_access
from .covariance import Covariance


def _require_nodes(estimator: type[Estimator], model: DesignModel) -> None:
    if model.reception is None or not model.reception.nodes:
        raise Unsupported(f"{estimator.__name__} needs a random access channel: channel.kind = \"random-access\"")


class RandomAccessParameters(Parameters):
    """What `design` analyses; the filter itself has nothing to tune."""

    horizon: int = Field(300, ge=4, description="steps the bounds are computed and checked over (the paper's "
                                            "example has 300)")
    sigma: PositiveFloat | None = Field(None, description="claimed bound P <= sigma I, in the state's squared "
                                               "units, to check by (30), (31)")
    m: PositiveInt | None = Field(None, description="window length of (30), in steps, that goes with sigma")

    @model_validator(mode="after")
    def _consistent(self) -> RandomAccessParameters:
        if (self.sigma is None) != (self.m is None):
            raise ValueError("sigma and m go together: give both or neither")
        if self.m is not None and self.m >= self.horizon:
            raise ValueError(f"m must be less than horizon = {self.horizon}")
        return self


class RandomAccessFilter(Estimator):
    """The recursive filter of Theorem 1: gain (12) and covariance (11) are expectations over the protocol.

    They depend on neither data nor the nodes heard, so all runs share them. The claim E e e' = P holds over runs, not
    given the nodes that were heard."""

    Parameters = RandomAccessParameters
    family = "Random access"
    summary = "recursive filter under the random access protocol, covariance averaged over it"
    source = "Zou, Wang, Han, Zhou: Recursive Filtering for Time-Varying Systems with Random Access Protocol, Theorem 1"
    needs = ("linear", "reception")
    claims = ("covariance",)

    _model: DesignModel | None = None

    @classmethod
    def require(cls, model: DesignModel) -> None:
        super().require(model)
        _require_nodes(cls, model)

    def design(self, model: DesignModel) -> dict[str, Any]:
        """The first gains, the range of P's eigenvalues over `horizon` steps, the bounds of Theorems 2 to 4, and
        Remark 8's threshold."""
        assert model.linear is not None and model.reception is not None
        P0 = model.initial_covariance[:, :, 0]
        self._model, self._initial = model, Covariance.initial(model)
        bounds = CovarianceBounds(model.linear, model.reception, P0, self.parameters.horizon)
        gains, P = self._initial.sequence(bounds.horizon)
        eigenvalues = np.linalg.eigvalsh(P)
        return {
            "gains": {f"K_{k + 1}": gain.tolist() for k, gain in enumerate(gains[:3])},
            "eigenvalues of P": {"least": float(eigenvalues.min()), "greatest": float(eigenvalues.max()),
                                 "greatest from k = 1": float(eigenvalues[1:].max()),
                                 "greatest in the last third": float(eigenvalues[-(len(eigenvalues) // 3):].max())},
            "assumption 1": {name: getattr(bounds, name) for name in (
                "q_low", "q_high", "r_low", "r_high", "c", "c_hat", "a_low", "a_high")},
            "lower bound (21)": bounds.lower,
            "upper bound (26)": {f"mu_{k}": float(bounds.mu[k]) for k in (0, 1, bounds.horizon)},
            "proposition 1": bounds.uniform if bounds.uniform is not None else "does not apply: a_high is not below 1",
            "critical share of the access probabilities": critical_access(model.linear, model.reception),
            **self._conditions(bounds),
        }

    def _conditions(self, bounds: CovarianceBounds) -> dict[str, Any]:
        found = bounds.search()
        out: dict[str, Any] = {}
        if self.parameters.sigma is not None and self.parameters.m >= bounds.horizon:
            out["claimed (30), (31)"] = f"not checked: m = {self.parameters.m} needs more than {bounds.horizon} steps"
        elif self.parameters.sigma is not None:
            claim = bounds.check(self.parameters.sigma, self.parameters.m)
            worst, failing = int(np.argmin(claim.least)), claim.steps[~claim.holds]
            out["claimed (30), (31)"] = {
                "sigma": claim.sigma, "m": claim.m, "verdict": "verified" if claim.verified else "not verified",
                "least eigenvalue in (30)": float(claim.least[worst]), "at k": int(claim.steps[worst]),
                "needed": 1 / claim.sigma, "steps": len(claim.steps), "steps where (30) fails": len(failing),
                "first k where (30) fails": int(failing[0]) if len(failing) else "none",
                "(31) holds": claim.mu_holds}
        out["valid (30), (31)"] = ({"least sigma": found[0], "m": found[1]} if found
                                   else f"none up to sigma = {SIGMA_MAX:g}, m = {M_MAX}")
        return out

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        super().start(model, runs, random)
        if model is not self._model:
            self._model, self._initial = model, Covariance.initial(model)
        self._now = self._initial
        self._mean = model.initial_mean

    def predict(self, u: Array, interval: Interval) -> None:
        whole_steps(interval, type(self).__name__)
        self._mean = self.model.transition(self._mean, u, interval)
        self._now = self._now.predicted(interval.depart)

    def update(self, measurement: Measurement) -> Innovation | None:
        """(6): the mean moves by K times the innovation of the elements received, whose covariance C P C' + R is, like
        P, an expectation over the protocol."""
        if not np.isfinite(self._now.P).all():
            flag(self, np.ones(self.runs, dtype=bool), Status.failed, "the covariance grew beyond all bounds")
            return None
        at = measurement.step
        innovation = np.where(measurement.received, measurement.y - self.model.measurement(self._mean, at), 0.0)
        spread = self._now.spread(at)
        K, self._now = self._now.updated(at)
        self._mean = self._mean + product(K, innovation)
        variance = np.empty_like(innovation)
        in_turn(spread, measurement.received, innovation, variance)
        return Innovation(innovation, variance)

    def estimate(self) -> Estimate:
        return Estimate(self._mean, covariance=self._now.P[:, :, None])


class ConditionalRandomAccess(Kalman):
    """The conditional filter of Remark 4: a Kalman filter with the rows of the node heard, the optimum of the problem.

    Its covariance depends on the nodes heard so far, so each run has its own (nx, nx, S)."""

    family = "Random access"
    summary = "Kalman filter given the node that was heard: the optimum under random access"
    source = "Zou, Wang, Han, Zhou: Recursive Filtering for Time-Varying Systems with Random Access Protocol, Remark 4"

    @classmethod
    def require(cls, model: DesignModel) -> None:
        super().require(model)
        _require_nodes(cls, model)
