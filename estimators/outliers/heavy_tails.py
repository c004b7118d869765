"""Noise that is not Gaussian, or not of the told size: Student-t filters and filters that learn R as they go.

The variational iterations are scalar: residual, h P h' and R are all they see of an element."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, PositiveInt

from ...scenarios.arrays import Array
from ...scenarios.measurement import Interval, Measurement
from ...scenarios.model import DesignModel
from ...scenarios.randomness import RunRandom
from ..interface import Estimate, Innovation, Parameters
from ..kernels.core import congruence
from .base import ElementwiseKalman, Judgement, Reading, Weighed
from .kernels import student


class StudentKalman(ElementwiseKalman):
    """Measurement noise of each element is Student's t with the told variance's scale, by variational Bayes:

    R / lambda, lambda = (dof + 1) / (dof + (residual+^2 + h P+ h') / R), residual+ and P+ after the update with it."""

    class Parameters(Parameters):
        dof: Annotated[float, Field(gt=0)] = Field(3.0, description="degrees of freedom of the noise")
        iterations: PositiveInt = Field(5, description="of the fixed point, from lambda = 1 on")

    summary = "EKF with Student-t measurement noise, variational"
    source = "Agamennoni, Nieto and Nebot, IEEE TSP 60(10), 2012; Piche, Sarkka and Hartikainen, MLSP 2012"

    def judgement(self) -> Judgement | None:
        ny, p = self.model.ny, self.parameters
        if type(self) is not StudentKalman:
            return None
        return Judgement(np.inf, np.zeros(ny, dtype=bool), np.eye(ny, dtype=bool), np.full((ny, self.runs), np.inf),
                         np.inf, p.dof, p.iterations)

    def weigh(self, reading: Reading) -> Weighed:
        precision = np.empty_like(reading.residual)
        student(reading.residual, reading.spread, reading.noise, self.parameters.dof, self.parameters.iterations,
                precision)
        return Weighed(reading.noise / precision, np.ones_like(precision), precision < 0.5)


class RothStudent(ElementwiseKalman):
    """State, process and measurement noise are Student's t of common degrees of freedom, moments as told.

    P scales by (dof + Delta^2) / (dof + n) with the n elements received and Delta^2 their squared normalised residuals;
    the degrees of freedom gained are given back by matching the covariance."""

    class Parameters(Parameters):
        dof: Annotated[float, Field(gt=2)] = Field(3.0, description="common degrees of freedom, above 2")

    summary = "Student-t filter of Roth: state and noises share heavy tails"
    source = "Roth, Ozkan and Gustafsson, ICASSP 2013"

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        super().start(model, runs, random)
        self._scale = (self.parameters.dof - 2) / self.parameters.dof
        self._covariance *= self._scale
        self._square, self._count = np.zeros(runs), np.zeros(runs)

    def predict(self, u: Array, interval: Interval) -> None:
        model, x = self.model, self._mean
        assert model.transition_jacobian is not None and model.process_covariance is not None
        f = np.ascontiguousarray(model.transition_jacobian(x, u, interval))
        q = np.ascontiguousarray(self._scale * model.process_covariance(x, u, interval))
        self._mean = np.ascontiguousarray(model.transition(x, u, interval))
        congruence(f, self._covariance, q, self._covariance)

    def weigh(self, reading: Reading) -> Weighed:
        noise = reading.noise * self._scale
        ratio = reading.residual * reading.residual / (reading.spread + noise)
        self._square += np.where(reading.received, ratio, 0.0)
        self._count += reading.received
        return Weighed(noise, np.ones_like(noise), ratio > 9.0)

    def update(self, measurement: Measurement) -> Innovation | None:
        self._square[:], self._count[:] = 0.0, 0.0
        innovation = super().update(measurement)
        dof, gained = self.parameters.dof, self.parameters.dof + self._count
        factor = (dof + self._square) / gained * (gained * (dof - 2)) / ((gained - 2) * dof)
        self._covariance *= np.where(self._count > 0, factor, 1.0)
        return innovation

    def estimate(self) -> Estimate:
        return Estimate(self._mean, covariance=self._covariance / self._scale)


class AdaptiveNoise(ElementwiseKalman):
    """The noise variance of each element is learned, from the told one on.

    variational: inverse gamma (alpha, beta) forgetting by rho each reading, alpha += 1/2, R = beta / alpha, beta = rho
    beta- + (residual+^2 + h P+ h') / 2, iterated. sage-husa: R = (1 - d) R + d (residual^2 - h P h'), at least a
    thousandth of the told one, d = 1 - rho."""

    class Parameters(Parameters):
        method: Literal["variational", "sage-husa"] = Field("variational", description="how R is learned")
        rho: Annotated[float, Field(gt=0, lt=1)] = Field(0.98, description="what a reading leaves of the memory")
        iterations: PositiveInt = Field(3, description="of the variational fixed point")

    summary = "EKF that learns the sensors' noise variances (variational, or Sage-Husa)"
    source = "Sarkka and Nummenmaa, IEEE TAC 54(3), 2009; Sage and Husa, JACC 1969"

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        super().start(model, runs, random)
        self._learned = np.full((model.ny, runs), np.nan)

    def weigh(self, reading: Reading) -> Weighed:
        p, j = self.parameters, reading.element
        learned = np.where(np.isnan(self._learned[j]), reading.noise, self._learned[j])
        if p.method == "sage-husa":
            found = p.rho * learned + (1 - p.rho) * (reading.residual**2 - reading.spread)
            noise = np.maximum(found, 1e-3 * reading.noise)
        else:
            alpha = 0.5 * p.rho / (1 - p.rho) + 0.5
            before = p.rho * 0.5 / (1 - p.rho) * learned
            noise = (before + 0.5 * learned) / alpha
            for _ in range(p.iterations):
                share = noise / (reading.spread + noise)
                left = (reading.residual * share) ** 2 + reading.spread * share
                noise = (before + 0.5 * left) / alpha
        self._learned[j] = np.where(reading.received, noise, self._learned[j])
        return Weighed(noise, np.ones_like(noise), noise > 2 * reading.noise)
