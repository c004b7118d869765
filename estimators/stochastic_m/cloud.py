"""The recursion that RBPF, SMA and GSMA share: a cloud of particles, each a grid value and a Gaussian.

Members (stochastic_m.py) say where a particle's children go and how many of them go on; kernels do the step."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from ...scenarios.arrays import Array, Index, Mask
from ...scenarios.errors import Unsupported
from ...scenarios.measurement import Interval, Measurement
from ...scenarios.model import DesignModel, Grid, grid_of, whole_steps
from ...scenarios.randomness import RunRandom
from ..interface import Estimate, Estimator, Innovation, Parameters, Status, flag
from ..mode_grid import VARIANCE_FLOOR, sensor_noise
from . import factorised, full

DRAWS = 256  # uniforms a run fetches at once, so that the call's cost is shared
CYCLE = 64  # pruning makes the number of particles periodic within far fewer steps


class CloudParameters(Parameters):
    """Common to the family."""

    form: Literal["factorised", "full"] = Field(
        "factorised", description="factorised: one gain per run (needs a parameter that acts through known states "
        "only); full: a Kalman filter per particle, the same estimates")


class GridParticles(Estimator):
    """Predict: remember the input. Update: expand each particle into its children, weigh them by
    log w' = log w + log p(theta'|theta) + log N(y; y^, S), normalise, estimate over all children (eqs. (19), (22)),
    prune. Inside the cloud particles are the innermost axis, since a run's particles are used together.

    kalman_updates (S,): Kalman updates so far as the textbook form does them (children weighed). Initial particles
    x(i) ~ N(x0, P0), each with covariance P0, and theta(i) from the modes' prior (the paper's steps 1 and 2)."""

    Parameters: ClassVar[type[Parameters]] = CloudParameters
    source = "Zheng, Han, Kong, Wang, Promet 27(1), 2015"
    needs = ("modes",)
    claims = ("parameter", "covariance", "diversity")
    honours = ("covariance",)
    optimal = False
    by_weight = False
    memoryless = False

    @classmethod
    def require(cls, model: DesignModel) -> None:
        super().require(model)
        grid_of(model, cls.__name__)

    @abstractmethod
    def offspring(self, modes: Grid) -> tuple[Index, Array]:
        """Children (m, g) of each grid value and their log prior (m, g)."""

    @abstractmethod
    def goes_on(self, children: int, g: int) -> int:
        """How many of `children` particles pruning leaves; 0: no pruning."""

    @abstractmethod
    def first(self) -> int:
        """Number of particles at the start."""

    def draws_per_step(self) -> int:
        """Uniforms one step of one run takes; the first one resamples."""
        return 1

    def move(self, draws: Array) -> None:
        """Draw parameters before the expansion (only filters that sample from a prior do); draws (S, d)."""

    def _sizes(self, g: int) -> list[int]:
        """Number of particles before each of the first steps."""
        sizes = [self.first()]
        for _ in range(CYCLE):
            made = sizes[-1] if self.optimal else sizes[-1] * g
            sizes.append(self.goes_on(made, g) or made)
        return sizes

    def design(self, model: DesignModel) -> dict[str, Any]:
        """The work a step takes (Table 2's times stand for it)."""
        g = self.offspring(grid_of(model, type(self).__name__))[0].shape[1]
        sizes = self._sizes(g)
        return {"particles": max(sizes), "kalman_updates_per_step": float(np.mean(sizes[:60])) * g}

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        """Raises Unsupported where the initial covariance is not diagonal, or the form does not fit the modes."""
        super().start(model, runs, random)
        modes = grid_of(model, type(self).__name__)
        variance = model.initial_covariance[:, :, 0]
        if np.count_nonzero(variance - np.diag(np.diag(variance))):
            raise Unsupported(f"{type(self).__name__} needs a diagonal initial covariance")
        m, n = len(modes.grid), self.first()
        self.moving = self.offspring(modes)
        self.waiting = np.arange(m)[:, None], np.zeros((m, 1))
        self.n, capacity = n, max(self._sizes(self.moving[0].shape[1]))
        self.known = factorised.known_states(modes, variance)
        # Exactly known states at the end of the vector would make the claimed covariance singular: they are left out.
        self.claimed = int(np.flatnonzero(~self.known).max(initial=-1)) + 1
        self.alive, self.diversity = np.ones(runs, dtype=bool), np.empty(runs)
        theta, logw = np.zeros((runs, capacity), dtype=np.int64), np.zeros((runs, capacity))
        drawn = random.uniform(0.0, 1.0, n)
        theta[:, :n] = np.searchsorted(np.cumsum(modes.prior)[:-1], drawn, side="right").T
        x = model.initial_mean[:, None, :] + np.sqrt(np.diag(variance))[:, None, None] * random.normal(model.nx, n)
        if self.parameters.form == "factorised":
            self._start_factorised(modes, variance, x, theta, logw)
        else:
            self._start_full(modes, variance, x, theta, logw)
        self.random, self.block, self.used = random, np.empty((0, runs, 0)), 0
        self.kalman_updates = np.zeros(runs)
        self.pending = self.computed = False
        self.inputs, self.uniforms = np.zeros((runs, modes.B.shape[2])), np.zeros((runs, self.draws_per_step()))
        R = np.ascontiguousarray(modes.R[:, :, None], dtype=float)
        self.nothing = np.zeros((runs, model.ny)), np.zeros((runs, model.ny), dtype=bool), R
        self.log_sum = float(np.log(n))

    def _start_factorised(self, modes: Grid, variance: Array, x: Array, theta: Index, logw: Array) -> None:
        runs, capacity = theta.shape
        u, k = ~self.known, self.known
        nu, nk = int(u.sum()), int(k.sum())
        self.kernel, self.model_moving = factorised.step, factorised.factors_of(modes, variance)
        self.model_waiting = factorised.still(self.model_moving)
        particles = np.zeros((runs, nu, capacity))
        particles[:, :, :self.n] = x[u].transpose(2, 0, 1)
        self.cloud = factorised.Cloud(particles, theta, logw, np.repeat(variance[np.ix_(u, u)][None], runs, axis=0),
                                      np.ascontiguousarray(self.model.initial_mean[k].T), self.alive)
        self.out = factorised.Moments(np.empty((nu, runs)), np.empty((nk, runs)), np.empty((1, runs)),
                                      np.empty((nu, nu, runs)), self.diversity, np.zeros(runs))

    def _start_full(self, modes: Grid, variance: Array, x: Array, theta: Index, logw: Array) -> None:
        runs, capacity = theta.shape
        nx = len(x)
        self.kernel, self.model_moving = full.step, full.full_modes(modes)
        self.model_waiting = full.still(self.model_moving)
        particles, P = np.zeros((runs, nx, capacity)), np.zeros((runs, nx, nx, capacity))
        particles[:, :, :self.n] = x.transpose(2, 0, 1)
        P[:] = variance[:, :, None]
        self.cloud = full.FullCloud(particles, P, theta, logw, self.alive)
        self.out = full.FullMoments(np.empty((nx, runs)), np.empty((1, runs)), np.empty((nx, nx, runs)),
                                    self.diversity, np.zeros(runs))

    def _draws(self) -> Array:
        """The step's uniforms, (S, d), in step for all runs whatever happens to them."""
        if self.used == len(self.block):
            width = self.draws_per_step()
            drawn = self.random.uniform(0.0, 1.0, max(1, DRAWS // width), width)
            self.block, self.used = np.ascontiguousarray(drawn.transpose(0, 2, 1)), 0
        self.used += 1
        return self.block[self.used - 1]

    def _run(self, y: Array, received: Mask, R: Array, commit: bool) -> None:
        """The compiled step, with the prediction that is pending or at the same instant. y, received (S, ny), R (ny,
        ny, S or 1)."""
        pending = self.pending
        children, prior = self.moving if pending else self.waiting
        optimal, g = self.optimal and pending, children.shape[1]
        keep = self.goes_on(self.n if optimal else self.n * g, g) if commit and pending else 0
        n = self.kernel(self.model_moving if pending else self.model_waiting, children, prior, self.cloud, self.n,
                        self.inputs, y, received, R, self.uniforms, keep, self.by_weight, self.memoryless and pending,
                        optimal, commit, self.out)
        if commit:
            self.n, self.pending = n, False
            self.log_sum = float(np.log(n)) if keep else 0.0  # of the weights: equal after resampling, else normalised
        self.computed = True
        flag(self, ~self.alive, Status.failed, "the weights of all particles vanished")

    def predict(self, u: Array, interval: Interval) -> None:
        """Whole sampling periods only, since the modes are discrete: raises Unsupported otherwise."""
        whole_steps(interval, type(self).__name__)
        if self.pending:
            self._run(*self.nothing, True)
        self.inputs, self.uniforms = np.array(u.T, order="C"), self._draws()
        self.move(self.uniforms)
        self.pending, self.computed = True, False

    def update(self, measurement: Measurement) -> Innovation | None:
        self.kalman_updates += self.n * (self.moving[0].shape[1] if self.pending else 1)
        before = self.log_sum
        self._run(np.array(measurement.y.T, order="C"), np.array(measurement.received.T, order="C"),
                  sensor_noise(self.model, measurement), True)
        if self.memoryless or self.by_weight:  # their weights are no posterior
            return None
        return Innovation(log_likelihood=self.out.log_likelihood - before)

    def estimate(self) -> Estimate:
        if not self.computed:
            self._run(*self.nothing, False)
        out, c = self.out, self.claimed
        if isinstance(out, factorised.Moments):
            mean, covariance = np.empty((self.model.nx, self.runs)), np.zeros((c, c, self.runs))
            u = np.flatnonzero(~self.known)
            mean[u], mean[self.known], covariance[np.ix_(u, u)] = out.mean, out.known, out.covariance
        else:
            mean, covariance = out.mean, out.covariance[:c, :c].copy()
        for i in range(c):
            covariance[i, i] += VARIANCE_FLOOR
        return Estimate(mean, parameter=out.parameter, covariance=covariance, diversity=self.diversity)

    def counters(self) -> dict[str, Array]:
        return {"kalman-updates": self.kalman_updates}

    def extremes(self) -> dict[str, Array]:
        """How many values of the parameter are left among the particles at the end (section 3.3's degeneration)."""
        return {"distinct-values": self.diversity.astype(float)}
