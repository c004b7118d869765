"""The interacting multiple model filter over whole design models: an extended Kalman filter for each of the modes.

Modes may differ in anything but their states and measurements: an axle's noise, a jump, a motion."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from pydantic import Field

from ...scenarios.arrays import Array, read_only
from ...scenarios.errors import Unsupported
from ...scenarios.measurement import Interval, Measurement
from ...scenarios.model import DesignModel
from ...scenarios.randomness import RunRandom
from .. import mode_grid
from ..interface import Estimate, Estimator, Innovation, Parameters, Status, flag
from ..kalman import ExtendedKalman
from ..kernels.mixing import log_density, mix, moments, weigh
from .stacked import interval_of, measurement_of, noise_of, power_of, stacked


class HypothesesParameters(Parameters):
    """p(mode'|mode) where the design model does not say."""

    stay: float = Field(0.9, gt=0, le=1, description="probability of staying in a mode over a step, else one up or "
                        "down the list: used where the design model has no transition matrix of its own")


class InteractingModels(Estimator):
    """IMM: mix the modes' Gaussians by the transition matrix, filter each with its model, weigh, combine.

    An interval of p sampling periods mixes by the transition matrix to the power p."""

    Parameters = HypothesesParameters
    family = "IMM"
    summary = "interacting multiple model filter over whole design models (an EKF each)"
    source = "Blom, Bar-Shalom, IEEE Transactions on Automatic Control 33(8), 1988"
    needs = ("modes", *ExtendedKalman.needs)
    claims = ("covariance",)
    honours = ("covariance",)

    def design(self, model: DesignModel) -> dict[str, Any]:
        """Raises Unsupported where the modes' transition matrix has no powers."""
        assert model.modes is not None
        try:
            power_of(self._transition(model))
        except ValueError as error:
            raise Unsupported(str(error)) from None
        return {"modes": len(model.modes.modes)}

    def _transition(self, model: DesignModel) -> Array:
        assert model.modes is not None
        if model.modes.transition is not None:
            return model.modes.transition
        return mode_grid.tridiagonal(len(model.modes.modes), self.parameters.stay)

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        super().start(model, runs, random)
        assert model.modes is not None
        self.modes = model.modes.modes
        self.m = len(self.modes)
        self.power = power_of(self._transition(model))
        self.bank = ExtendedKalman()
        self.noise = np.empty((model.ny, model.ny, self.m * runs))
        bank = replace(stacked(self.modes, runs), measurement_covariance=lambda measurement: self.noise)
        self.bank.start(bank, self.m * runs, random)
        self.bank._expand()
        self.weight = np.repeat(np.asarray(model.modes.prior, dtype=float)[:, None], runs, axis=1)
        self.lost = np.zeros(runs, dtype=bool)
        self._mean, self._covariance = np.empty((model.nx, runs)), np.empty((model.nx, model.nx, runs))

    def predict(self, u: Array, interval: Interval) -> None:
        moving = np.ascontiguousarray(interval.moving(self.runs))
        periods = np.asarray(interval.length) / self.model.period
        mix(self.power(periods), self.weight, moving, self.bank._mean, self.bank._covariance)
        self.bank.predict(read_only(np.tile(u, self.m)), interval_of(interval, self.m))

    def update(self, measurement: Measurement) -> Innovation | None:
        heard = measurement.received.any(axis=0)
        if not heard.any():
            return None
        self.noise = noise_of(self.modes, measurement, self.runs)
        innovation = self.bank.update(measurement_of(measurement, self.m))
        assert innovation is not None and innovation.residual is not None and innovation.variance is not None
        total = log_density(innovation.residual, innovation.variance, np.ascontiguousarray(measurement.received))
        loglik = weigh(self.weight, total, heard, self.lost)
        flag(self, self.lost, Status.failed, "all modes became impossible")
        return Innovation(log_likelihood=loglik)

    def estimate(self) -> Estimate:
        moments(self.weight, self.bank._mean, self.bank._covariance, self._mean, self._covariance)
        return Estimate(self._mean, covariance=self._covariance)

    def snapshot(self) -> Any:
        return self.bank.snapshot(), self.weight.copy(), self.lost.copy()

    def restore(self, snapshot: Any) -> None:
        bank, weight, lost = snapshot
        self.bank.restore(bank)
        self.weight, self.lost = weight.copy(), lost.copy()
