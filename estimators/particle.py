"""The bootstrap particle filter on any design model with process and measurement covariances.

Particles are the middle axis: (nx, N, S). Weights are logarithms throughout, so that none is ever floored."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field, PositiveInt

from ..scenarios.arrays import Array, Mask
from ..scenarios.measurement import Interval, Measurement
from ..scenarios.model import DesignModel
from ..scenarios.randomness import RunRandom
from .interface import Estimate, Estimator, Innovation, Parameters, Status, flag
from .kernels.core import HALF_LOG_TURN, cholesky, factorise, forward, kernel


class BootstrapParticle(Estimator):
    """x_i ~ N(f(x_i, u), Q), w_i *= N(y; h(x_i), R) over the received elements, systematic resampling where the
    effective sample size 1 / sum w^2 falls below a share of N.

    Q is taken at the mean. The estimate is the weighted mean and covariance, before the resampling of that step. A
    run fails where no particle has a finite likelihood, or a Q is indefinite."""

    class Parameters(Parameters):
        particles: PositiveInt = Field(500, description="number of particles N (chosen: RMSE within a few per cent of "
                                                        "the Kalman filter's for two states)")
        resample_below: Annotated[float, Field(ge=0, le=1)] = Field(
            0.5, description="share of N below which the effective sample size triggers resampling (Liu and Chen 1998)")

    family = "Particle"
    summary = "bootstrap particle filter, systematic resampling"
    source = "Gordon, Salmond and Smith, IEE Proc. F 140(2), 1993; systematic resampling: Kitagawa, JCGS 5(1), 1996"
    needs = ("process_covariance", "measurement_covariance")
    claims = ("covariance",)
    honours = ("covariance",)

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        super().start(model, runs, random)
        self._random, self._log_likelihood = random, np.zeros(runs)
        self._failed, self._degenerate = np.zeros(runs, dtype=bool), np.zeros(runs)
        self._particles = np.repeat(model.initial_mean[:, None, :], self.parameters.particles, axis=1)
        everyone = np.ones(runs, dtype=bool)
        self._diffuse(model.initial_covariance, everyone)
        self._logs = np.zeros((self.parameters.particles, runs))
        self._weights = np.full((self.parameters.particles, runs), 1 / self.parameters.particles)
        self._mean, self._covariance = np.empty((model.nx, runs)), np.empty((model.nx, model.nx, runs))
        self._moments(everyone)

    def predict(self, u: Array, interval: Interval) -> None:
        model = self.model
        assert model.process_covariance is not None
        q = model.process_covariance(self._mean, u, interval)
        self._particles = np.ascontiguousarray(model.transition(self._particles, u, interval))
        moving = interval.moving(self.runs)
        self._diffuse(q, moving)
        self._moments(moving)

    def update(self, measurement: Measurement) -> Innovation | None:
        model, (y, received, at, *_) = self.model, measurement
        assert model.measurement_covariance is not None
        images = np.array(model.measurement(self._particles, at), order="C")  # a copy even of the state itself
        # Drawn whether used or not, but only where something arrived: other runs' events must not move a run's stream.
        told = np.asarray(received.any(axis=0), dtype=bool)
        offset = self._random.uniform(0.0, 1.0, which=told)
        r = np.ascontiguousarray(model.measurement_covariance(measurement))
        if _weigh(images, y, received, r, self._logs, self._weights, self._log_likelihood, self._failed):
            flag(self, self._failed, Status.failed, "no particle has a finite likelihood")
        _count_degenerate(self._weights, told, model.nx + 1, self._degenerate)
        self._moments(told)
        _resample(self._particles, self._logs, self._weights, offset, self.parameters.resample_below)
        return Innovation(log_likelihood=self._log_likelihood)

    def estimate(self) -> Estimate:
        return Estimate(self._mean, covariance=self._covariance)

    def counters(self) -> dict[str, Array]:
        """Measurements that left fewer effective particles than it takes to span the state: their covariance is the
        accident of a few points, whatever the status says."""
        return {"degenerate": self._degenerate}

    def _diffuse(self, covariance: Array, moving: Mask) -> None:
        """Add normal noise of this covariance (nx, nx, S or 1) to the particles of the runs `moving` (S,)."""
        noise = self._random.normal(*self._particles.shape[:2], which=moving)
        covariance = np.array(np.broadcast_to(covariance, (*covariance.shape[:2], self.runs)), order="C")
        factor = np.empty_like(covariance)
        if cholesky(covariance, factor, self._failed):
            flag(self, self._failed, Status.failed, "a process noise covariance is indefinite")
        _add_noise(self._particles, factor, noise)

    def _moments(self, which: Mask) -> None:
        """Weighted mean and covariance of the runs `which` (S,). Those of the others are from before they resampled."""
        mean, covariance = np.empty_like(self._mean), np.empty_like(self._covariance)
        _weighted(self._particles, self._weights, mean, covariance)
        self._mean = np.where(which, mean, self._mean)
        self._covariance = np.where(which, covariance, self._covariance)


@kernel
def _count_degenerate(weights, told, least, count):
    """count (S,) += 1 for runs of `told` (S,) with fewer effective particles, 1 / sum w^2, than `least`."""
    for s in range(weights.shape[1]):
        square = 0.0
        for i in range(weights.shape[0]):
            square += weights[i, s] * weights[i, s]
        if told[s] and square * least > 1.0:
            count[s] += 1.0


@kernel
def _add_noise(particles, factor, noise):
    """particles (nx, N, S) += factor (nx, nx, S), lower triangular, times noise (nx, N, S)."""
    nx, count, runs = particles.shape
    for a in range(nx):
        for b in range(a + 1):
            for i in range(count):
                for s in range(runs):
                    particles[a, i, s] += factor[a, b, s] * noise[b, i, s]


@kernel
def _weighted(particles, weights, mean, covariance):
    """Weighted mean (nx, S) and covariance (nx, nx, S) of particles (nx, N, S), weights (N, S) summing to one."""
    nx, count, runs = particles.shape
    for a in range(nx):
        for s in range(runs):
            mean[a, s] = 0.0
        for i in range(count):
            for s in range(runs):
                mean[a, s] += weights[i, s] * particles[a, i, s]
    for a in range(nx):
        for b in range(a + 1):
            for s in range(runs):
                covariance[a, b, s] = 0.0
            for i in range(count):
                for s in range(runs):
                    covariance[a, b, s] += (weights[i, s] * (particles[a, i, s] - mean[a, s])
                                            * (particles[b, i, s] - mean[b, s]))
            for s in range(runs):
                covariance[b, a, s] = covariance[a, b, s]


@kernel
def _weigh(images, y, received, r, logs, weights, log_likelihood, failed):
    """Add the log-likelihoods to logs (N, S), greatest log 0 in each run; weights (N, S) := exp(logs), normalised.

    images (ny, N, S): measurements of the particles, overwritten. r (ny, ny, S or 1). log_likelihood (S,) := log sum_i
    w_i N(y; h(x_i), R) with the weights from before. Where no particle's likelihood is finite, failed (S,) is set and
    the weights are NaN. Returns how many runs failed here."""
    ny, count, runs = images.shape
    masked, factor, inverse = np.empty((ny, ny, runs)), np.empty((ny, ny, runs)), np.empty((ny, runs))
    for j in range(ny):
        for k in range(ny):
            for s in range(runs):
                both = received[j, s] and received[k, s]
                value = r[j, k, 0] if r.shape[2] == 1 else r[j, k, s]
                masked[j, k, s] = value if both else (1.0 if j == k else 0.0)
        for i in range(count):
            for s in range(runs):
                images[j, i, s] = y[j, s] - images[j, i, s] if received[j, s] else 0.0
    lost = np.zeros(runs, np.bool_)
    factorise(masked, factor, inverse, lost, True, runs)
    forward(factor, inverse, images, runs)
    for i in range(count):
        for j in range(ny):
            for s in range(runs):
                logs[i, s] -= 0.5 * images[j, i, s] * images[j, i, s]
    bad = 0
    for s in range(runs):
        heaviest = 0.0
        for i in range(count):
            heaviest = max(heaviest, weights[i, s])
        constant = np.log(heaviest)
        for j in range(ny):
            constant += np.log(inverse[j, s]) - HALF_LOG_TURN if received[j, s] else 0.0
        top = -np.inf
        for i in range(count):
            if np.isnan(logs[i, s]):
                logs[i, s] = -np.inf
            top = max(top, logs[i, s])
        lost[s] |= top == -np.inf
        total = 0.0
        for i in range(count):
            logs[i, s] -= top
            weights[i, s] = np.exp(logs[i, s])
            total += weights[i, s]
        for i in range(count):
            weights[i, s] = np.nan if lost[s] else weights[i, s] / total
        log_likelihood[s] = top + np.log(total) + constant
        failed[s] |= lost[s]
        bad += lost[s]
    return bad


@kernel
def _resample(particles, logs, weights, offset, share):
    """Systematic resampling in place of the runs whose effective sample size is under `share` of N.

    Particle i of the new set is the one at which the summed weights pass (i + offset) / N; offset (S,) in [0, 1)."""
    nx, count, runs = particles.shape
    chosen, old = np.empty(count, np.int64), np.empty((nx, count))
    for s in range(runs):
        squares = 0.0
        for i in range(count):
            squares += weights[i, s] * weights[i, s]
        if not share * count * squares > 1.0:  # a failed run's NaN too
            continue
        source, passed = 0, weights[0, s]
        for i in range(count):
            while passed < (i + offset[s]) / count and source < count - 1:
                source += 1
                passed += weights[source, s]
            chosen[i] = source
        for a in range(nx):
            for i in range(count):
                old[a, i] = particles[a, i, s]
            for i in range(count):
                particles[a, i, s] = old[a, chosen[i]]
        for i in range(count):
            logs[i, s] = 0.0
            weights[i, s] = 1.0 / count
