"""The bootstrap particle filter on any design model with process and measurement covariances.

A run at a time, in the cache. Weights are logarithms throughout, so that none is ever floored."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field, PositiveInt

from ..scenarios.arrays import Array, Mask
from ..scenarios.compiled import Compiled
from ..scenarios.measurement import Interval, Measurement
from ..scenarios.model import DesignModel
from ..scenarios.randomness import RunRandom
from .interface import Estimate, Estimator, Innovation, Parameters, Status, flag
from .kernels.core import HALF_LOG_TURN, cholesky
from .kernels.particles import advance, take


class BootstrapParticle(Estimator):
    """x_i ~ N(f(x_i, u), Q), w_i *= N(y; h(x_i), R) over the received elements, systematic resampling where the
    effective sample size 1 / sum w^2 falls below a share of N. Where the model has densities of its noise, these draw
    and weigh instead.

    Q is taken at the mean. The estimate is the weighted mean and covariance, before the resampling of that step. A
    run fails where no particle has a finite likelihood, or a Q is indefinite."""

    class Parameters(Parameters):
        particles: PositiveInt = Field(500, description="number of particles N (chosen: RMSE within a few per cent of "
                                                        "the Kalman filter's for two states)")
        resample_below: Annotated[float, Field(ge=0, le=1)] = Field(
            0.5, description="share of N below which the effective sample size triggers resampling (Liu and Chen 1998)")
        roughening: Annotated[float, Field(ge=0)] = Field(
            0.0, description="K: resampled particles get noise of sd K E N^(-1/nx) in each state, E the spread of the "
                             "particles in it (Gordon, Salmond and Smith 1993, section 5; they take 0.2)")

    family = "Particle"
    summary = "bootstrap particle filter, systematic resampling"
    source = "Gordon, Salmond and Smith, IEE Proc. F 140(2), 1993; systematic resampling: Kitagawa, JCGS 5(1), 1996"
    needs = ("process_covariance", "measurement_covariance")
    claims = ("covariance",)
    honours = ("covariance",)

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        super().start(model, runs, random)
        nx, count = model.nx, self.parameters.particles
        self._random, self._log_likelihood = random, np.zeros(runs)
        self._failed, self._degenerate = np.zeros(runs, dtype=bool), np.zeros(runs)
        self._particles = np.repeat(model.initial_mean.T[:, :, None], count, axis=2)
        self._logs, self._weights = np.zeros((runs, count)), np.full((runs, count), 1 / count)
        self._mean, self._covariance = np.empty((nx, runs)), np.empty((nx, nx, runs))
        self._none = np.zeros((1, runs)), np.zeros(runs), np.zeros(1)
        self._advance(0, *self._none, model.initial_covariance, np.ones(runs, dtype=bool))

    def predict(self, u: Array, interval: Interval) -> None:
        model, transition = self.model, self.model.transition
        assert model.process_covariance is not None
        moving = interval.moving(self.runs)
        if model.densities is not None:
            z = self._random.uniform(0.0, 1.0, model.densities.drawn, self.parameters.particles, which=moving)
            moved = transition(self._laid_out(), u, interval) + model.densities.process(z, interval)
            self._particles = np.ascontiguousarray(np.where(moving, moved, self._laid_out()).transpose(2, 0, 1))
            self._advance(0, *self._none, np.zeros((model.nx, model.nx, 1)), moving)
            return
        q = model.process_covariance(self._mean, u, interval)
        if isinstance(transition, Compiled):
            self._advance(*transition.arguments(u, interval), q, moving)
        else:
            self._particles = np.ascontiguousarray(transition(self._laid_out(), u, interval).transpose(2, 0, 1))
            self._advance(0, *self._none, q, moving)

    def update(self, measurement: Measurement) -> Innovation | None:
        model, (y, received, at, *_) = self.model, measurement
        assert model.measurement_covariance is not None
        r = np.ascontiguousarray(model.measurement_covariance(measurement))
        images, predicted, h = np.empty((0, 0, 0)), self._none[0], np.empty((0, 0, 0))
        if model.densities is not None:
            y, r, images = self._weighed(measurement)
        elif model.linear_measurement and model.measurement_jacobian is not None:
            predicted = np.ascontiguousarray(model.measurement(self._mean, at))
            h = np.ascontiguousarray(model.measurement_jacobian(self._mean, at))
        else:
            images = np.array(model.measurement(self._laid_out(), at).transpose(2, 0, 1), order="C")
        # Drawn whether used or not, but only where something arrived: other runs' events must not move a run's stream.
        places = self._random.counted(np.asarray(received.any(axis=0), dtype=bool))
        if take(images, predicted, h, y, received, r, *places, self.parameters.resample_below, self._particles,
                self._logs, self._weights, self._mean, self._covariance, self._log_likelihood, self._degenerate,
                self._failed):
            flag(self, self._failed, Status.failed, "no particle has a finite likelihood")
        if model.densities is not None:
            self._log_likelihood += HALF_LOG_TURN * received.sum(axis=0)
        if self.parameters.roughening:
            self._roughen(received.any(axis=0) & (self._logs == 0.0).all(axis=1) & ~self._failed)
        return Innovation(log_likelihood=self._log_likelihood)

    def _weighed(self, measurement: Measurement) -> tuple[Array, Array, Array]:
        """The model's log-density, put on the weights beforehand; y, R and images of standard normal residuals of 0,
        whose constant the likelihood is to be freed of."""
        model, x = self.model, self._laid_out()
        assert model.densities is not None
        ny, count = model.ny, self.parameters.particles
        v = measurement.y[:, None] - model.measurement(x, measurement.step)
        self._logs += model.densities.log_measurement(v, measurement).T
        return np.zeros((ny, self.runs)), np.eye(ny)[:, :, None], np.zeros((self.runs, ny, count))

    def _roughen(self, resampled: Mask) -> None:
        """Jitter of the runs `resampled` (S,), whose estimate stays that from before."""
        x, kept = self._particles, (self._mean.copy(), self._covariance.copy())
        sd = self.parameters.roughening * np.ptp(x, axis=2).T * x.shape[2] ** (-1 / x.shape[1])
        self._advance(0, *self._none, np.eye(x.shape[1])[:, :, None] * sd**2, resampled)
        self._mean[:], self._covariance[:] = kept

    def estimate(self) -> Estimate:
        return Estimate(self._mean, covariance=self._covariance)

    def counters(self) -> dict[str, Array]:
        """Measurements that left fewer effective particles than it takes to span the state: their covariance is the
        accident of a few points, whatever the status says."""
        return {"degenerate": self._degenerate}

    def _advance(self, address: int, u: Array, seconds: Array, data: Array, covariance: Array, moving: Mask) -> None:
        """Particles of the runs `moving` (S,) through a compiled model (0: none), plus noise of this covariance."""
        covariance = np.array(np.broadcast_to(covariance, (*covariance.shape[:2], self.runs)), order="C")
        factor = np.empty_like(covariance)
        if cholesky(covariance, factor, self._failed):
            flag(self, self._failed, Status.failed, "a process noise covariance is indefinite")
        advance(address, u, seconds, data, self._particles, self._weights, factor, *self._random.counted(moving),
                np.ascontiguousarray(moving), self._mean, self._covariance)

    def _laid_out(self) -> Array:
        """The particles as models take them, (nx, N, S)."""
        return np.ascontiguousarray(self._particles.transpose(1, 2, 0))
