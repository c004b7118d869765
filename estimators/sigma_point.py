"""Sigma-point Kalman filters: unscented (scaled or Julier's points) and cubature, one transform with given weights.

Between calls live mean and covariance alone; where the model is compiled, points never leave the cache."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from ..scenarios.arrays import Array
from ..scenarios.compiled import Compiled, WholeSteps
from ..scenarios.errors import Infeasible
from ..scenarios.measurement import Course, Interval, Measurement
from ..scenarios.model import DesignModel
from ..scenarios.randomness import RunRandom
from .interface import Estimate, Estimator, Innovation, Parameters, Room, Status, Walk, flag
from .kernels.kalman import kalman_update
from .kernels.unscented import linearised, sigma_points, unscented_predict
from .kernels.walks import walk_points

NOT_DEFINITE = "a covariance was not positive definite"
Weights = tuple[Array, Array, float]
"""Mean weights (m,), covariance weights (m,), and the points' distance from the mean in standard deviations."""


class SigmaPointKalman(Estimator):
    """Points X = x, x +- c L_i with P = L L'; moments of f(X) plus Q; moments of h(X) plus R; K = Pxy S^-1.

    Where h is linear the points would give H P H' and P H' exactly, so the update is the Kalman filter's; any other h
    is replaced by its regression over the points (Lefebvre, Bruyninckx and De Schutter, IEEE TAC 47(8), 2002), with
    h = Pyx P^-1 and the noise R + Pyy - h P h', which gives the same S, Pxy and so the same K. Missing elements get no
    gain."""

    needs = ("process_covariance", "measurement_covariance")
    claims = ("covariance",)
    honours = ("covariance",)
    redraw: bool = True

    @abstractmethod
    def weights(self, n: int) -> Weights:
        """The transform for n states; without a centre point m = 2 n, with one m = 2 n + 1 and it comes first.

        Raises Infeasible where the parameters give no spread."""

    def design(self, model: DesignModel) -> dict[str, Any]:
        mean, covariance, scale = self.weights(model.nx)
        return {"mean_weights": mean.tolist(), "covariance_weights": covariance.tolist(), "scale": scale}

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        super().start(model, runs, random)
        n, ny = model.nx, model.ny
        *weights, self._scale = self.weights(n)
        self._weights = np.array(weights)
        self._mean = model.initial_mean.copy()
        self._covariance = np.array(np.broadcast_to(model.initial_covariance, (n, n, runs)), order="C")
        self._estimate = Estimate(self._mean, covariance=self._covariance)
        self._failed = np.zeros(runs, dtype=bool)
        self._residual, self._variance = np.zeros((ny, runs)), np.zeros((ny, runs))
        self._innovation, self._room = Innovation(self._residual, self._variance), Room()
        self._everyone, self._none = np.arange(runs), np.empty((n, 0, 0))
        self._linear = self.redraw and model.linear_measurement and model.measurement_jacobian is not None
        self._propagated: Array | None = None

    def predict(self, u: Array, interval: Interval) -> None:
        model, transition = self.model, self.model.transition
        assert model.process_covariance is not None
        q = np.ascontiguousarray(model.process_covariance(self._mean, u, interval))
        # Points drawn anew would change the last bits of runs that stand still.
        moving = self._everyone if isinstance(interval.length, float) else np.flatnonzero(interval.length)
        if isinstance(transition, Compiled) and self.redraw:
            arguments, moved = transition.arguments(u, interval), self._none
        else:
            arguments = (0, self._mean, self._weights[0], self._weights[0])
            moved = np.ascontiguousarray(transition(self._draw()[0], u, interval))
        address, u, seconds, data = arguments
        self._flag(unscented_predict(address, u, seconds, data, moving, self._weights, self._scale, q, self._mean,
                                     self._covariance, moved, self._failed))
        if not self.redraw:
            if self._propagated is not None and len(moving) < self.runs:
                still = np.setdiff1d(self._everyone, moving)
                moved[:, :, still] = self._propagated[:, :, still]
            self._propagated = moved

    def update(self, measurement: Measurement) -> Innovation | None:
        y, received, _, _, _, _ = measurement
        predicted, h, r = self._linearised(measurement)
        self._flag(kalman_update(self._mean, self._covariance, y, predicted, received, h, r, self._residual,
                                 self._variance, self._failed))
        return self._innovation

    def walk(self, course: Course, early: bool) -> Walk | None:
        whole = self.model.over(course)
        if early or not isinstance(whole, WholeSteps) or self._linear or not self.redraw or type(self) not in (
                UnscentedKalman, CubatureKalman):
            return None
        walk = self._room.gaussian(len(course.y), self.model.nx, self.model.ny, self.runs)
        self._flag(walk_points(whole.transition, whole.measurement, whole.data, whole.Q, whole.noise,
                               np.full(self.runs, course.period), self._weights, self._scale, course.u, course.y,
                               course.received, course.told, self._mean, self._covariance, self._failed,
                               walk.mean, walk.covariance, *walk.innovation[:2]))
        return walk

    def estimate(self) -> Estimate:
        return self._estimate

    def _linearised(self, measurement: Measurement) -> tuple[Array, Array, Array]:
        """The measurement as a linear one: its mean (ny, S), h (ny, nx, S or 1), R (ny, ny, S or 1)."""
        model, at = self.model, measurement.step
        assert model.measurement_covariance is not None
        r = np.ascontiguousarray(model.measurement_covariance(measurement))
        if not self._linear:
            return self._regress(r, at)
        assert model.measurement_jacobian is not None
        h = np.ascontiguousarray(model.measurement_jacobian(self._mean, at))
        return np.ascontiguousarray(model.measurement(self._mean, at)), h, r

    def _regress(self, r: Array, step: int) -> tuple[Array, Array, Array]:
        """The measurement as a linear one with more noise: its mean (ny, S), h (ny, nx, S), R (ny, ny, S)."""
        if self._propagated is None:
            points, deviations = self._draw()
        else:
            points, self._propagated = self._propagated, None
            deviations = points - self._mean[:, None]
        n, ny, runs = self.model.nx, self.model.ny, self.runs
        images = np.array(self.model.measurement(points, step), order="C")  # a copy even of the state itself
        predicted, h, noise = np.empty((ny, runs)), np.empty((ny, n, runs)), np.empty((ny, ny, runs))
        self._flag(linearised(deviations, images, self._weights, self._covariance, r, predicted, h, noise,
                              self._failed))
        return predicted, h, noise

    def _draw(self) -> tuple[Array, Array]:
        """Points of every run from its mean and covariance, and their deviations (nx, m, S)."""
        points = np.empty((self.model.nx, self._weights.shape[1], self.runs))
        deviations = np.empty_like(points)
        self._flag(sigma_points(self._mean, self._covariance, self._scale, points, deviations, self._failed))
        return points, deviations

    def _flag(self, failed: int) -> None:
        if failed:
            flag(self, self._failed, Status.failed, NOT_DEFINITE)


class UnscentedKalman(SigmaPointKalman):
    """Unscented Kalman filter. With lambda = alpha^2 (n + kappa) - n: c^2 = n + lambda, W0 = lambda / c^2,
    Wc0 = W0 + 1 - alpha^2 + beta, all others 1 / (2 c^2).

    The defaults alpha = 1, beta = 0, kappa = max(3 - n, 0) have no negative weight, so covariances stay positive, and
    their points stay within sqrt(max(3, n)) standard deviations; up to n = 3 they match the Gaussian's fourth moment
    along each axis. alpha = 1e-3, beta = 2, kappa = 0 is common in print, but its centre weight of about -1e6 turns
    rounding, and any kink of the model within 1e-3 standard deviations, into errors of the mean."""

    class Parameters(Parameters):
        points: Literal["scaled", "julier"] = Field(
            "scaled", description="scaled points (van der Merwe 2004) or Julier's (2000), which know kappa alone")
        alpha: Annotated[float, Field(gt=0)] = Field(
            1.0, description="spread of the scaled points, without unit (van der Merwe 2004)")
        beta: float = Field(0.0, description="extra weight of the centre point in covariances, without unit; 2 is "
                                             "right for a Gaussian as alpha tends to 0 (van der Merwe 2004)")
        kappa: float | None = Field(None, description="second spread parameter, without unit; default max(3 - n, 0) "
                                                      "for n states (Julier and Uhlmann 1997, kept from negative)")
        redraw: bool = Field(True, description="draw new points from the predicted moments for the measurement; false "
                                               "reuses the propagated ones, which do not carry Q")

        @model_validator(mode="after")
        def _consistent(self) -> UnscentedKalman.Parameters:
            """alpha and beta belong to the scaled points."""
            if self.points == "julier" and (self.alpha, self.beta) != (1.0, 0.0):
                raise ValueError('points = "julier" has no alpha and beta: leave them out, or use points = "scaled"')
            return self

        def kappa_for(self, n: int) -> float:
            """kappa for n states."""
            return max(3.0 - n, 0.0) if self.kappa is None else self.kappa

    family = "UKF, CKF"
    summary = "unscented Kalman filter (scaled or Julier's points)"
    source = "Julier and Uhlmann, Proc. IEEE 92(3), 2004; van der Merwe, thesis, OHSU 2004"

    def __init__(self, parameters: Any = None) -> None:
        super().__init__(parameters)
        self.redraw = self.parameters.redraw

    def weights(self, n: int) -> Weights:
        p = self.parameters
        kappa = p.kappa_for(n)
        spread = p.alpha**2 * (n + kappa)
        if spread <= 0:
            raise Infeasible(f"kappa = {kappa:g} leaves {n} states without sigma points: it must be above {-n}")
        mean = np.full(2 * n + 1, 0.5 / spread)
        mean[0] = (spread - n) / spread
        covariance = mean.copy()
        covariance[0] += 1 - p.alpha**2 + p.beta
        return mean, covariance, float(np.sqrt(spread))


class CubatureKalman(SigmaPointKalman):
    """Cubature Kalman filter: 2 n points at sqrt(n) standard deviations, equal weights, drawn anew for the update."""

    family = "UKF, CKF"
    summary = "cubature Kalman filter (third-degree spherical-radial rule)"
    source = "Arasaratnam and Haykin, IEEE TAC 54(6), 2009, eqs. (22) to (56)"

    def weights(self, n: int) -> Weights:
        equal = np.full(2 * n, 0.5 / n)
        return equal, equal, float(np.sqrt(n))
