"""Robust estimators for disturbances that are bounded and otherwise unknown: F1 (the paper's), F2 and F3.

The gain of every step solves a convex problem: compiled in `fast` (F2, F3) and `memoryless` (F1), in
cvxpy in `robust_convex`."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field, PositiveFloat

from ...scenarios.arrays import Array, Mask
from ...scenarios.measurement import Measurement
from ...scenarios.model import DesignModel
from ...scenarios.randomness import RunRandom
from ..interface import Estimate
from .base import Robust, RobustParameters, SensorParameters, plain
from .fast import recursive_step
from .memoryless import bound_step, memoryless_step


class RecursiveParameters(RobustParameters):
    """Parameters of F2 and F3."""

    initial_scale: Annotated[PositiveFloat | None, Field(
        description="first bound Pi as a multiple of P0; default 1 (F3), or the number of states (F2: then the "
                    "ellipsoid holds the box of half-widths sqrt(P0_ii))")] = None


class EllipsoidParameters(RecursiveParameters, SensorParameters):
    """Parameters of F2."""


class BoundedParameters(SensorParameters):
    """Parameters of F1."""

    mu: Annotated[float, Field(gt=0, lt=1, description="P << mu I, the paper's stability condition")] = 0.9999


class _Recursive(Robust):
    """F2 and F3: the last bound Pi goes into the next problem, whose P it becomes."""

    Parameters = RecursiveParameters
    ellipsoid: ClassVar[bool]

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        super().start(model, runs, random)
        scale = self.parameters.initial_scale or (model.nx if self.ellipsoid else 1.0)
        self._Pi = plain(np.broadcast_to(scale * model.initial_covariance, (model.nx, model.nx, runs)))
        self._P = self._Pi.copy()

    def _region(self) -> Array:
        return self._Pi

    def _find(self, C: Array, received: Mask, R: Array) -> None:
        if self.parameters.solver == "cvxpy":
            self._find_convex(C, received, R)
        else:
            recursive_step(self._Pi, self._moved, self._A, self._M, self._N, self._kappa, self._g, C, R,
                           received, self.ellipsoid, self._K, self._P, self.stability, self._verdict)
        self._Pi, self._P = self._P, self._Pi

    def _find_convex(self, C: Array, received: Mask, R: Array) -> None:
        from .convex import RecursiveProblem

        nx, ny = self.model.nx, self.model.ny
        if self._convex is None:
            self._convex = RecursiveProblem(nx, self._whole.shape[1], ny, self.ellipsoid)
        self._P[:] = self._Pi
        for run in self._to_solve(received):
            A, N, g, H = self._of_run(C, run)
            mine = R[:, :, min(run, R.shape[2] - 1)]
            solution = self._convex.solve(self._Pi[:, :, run], A, self._M, N, g, H, mine, received[:, run])
            if self._solved(run, C, solution):
                self._P[:, :, run] = solution.P

    def _bound(self) -> Array:
        """Pi (nx, nx, S) as it stands, of a waiting prediction too (its step with K = 0)."""
        if not self._moved.any():
            return self._Pi
        nx, ny = self.model.nx, self.model.ny
        P, C, R = np.empty_like(self._Pi), np.zeros((ny, nx, 1)), np.eye(ny)[:, :, None]
        recursive_step(self._Pi, self._moved, self._A, self._M, self._N, self._kappa, self._g, C, R, self._none,
                       self.ellipsoid, self._K.copy(), P, np.zeros(self.runs), self._verdict.copy())
        return P


class RobustEllipsoid(_Recursive):
    """F2: e' Pi^-1 e <= 1 for every admissible disturbance and noise, of least tr Pi.

    Sources (the last error's ellipsoid, each disturbance channel, each sensor) have their own multipliers, whose sum is
    at most one. The least trace tends to K = C^-1, the raw measurements: a guarantee rather than an accurate estimate.
    Truths outside the bounds (Gaussian tails, a gradient step between estimate and truth) are outside the guarantee."""

    summary = "guaranteed error ellipsoid for bounded disturbance and noise (F2)"
    Parameters = EllipsoidParameters
    claims = ("ellipsoid",)
    ellipsoid = True

    def estimate(self) -> Estimate:
        return Estimate(self._x, ellipsoid=self._bound())


class RobustMeanSquare(_Recursive):
    """F3: worst case over disturbance and linearisation error, second moments of the measurement noise; least tr P.

    Claims `bound` where the design model has a `performance` M: E |M e|^2 <= tr M P M'. It holds for zero-mean noise
    with the second moments told, white and independent of the disturbance, and Delta independent of the error. P is an
    upper bound and no covariance: NEES would only measure its slack, so none is claimed."""

    summary = "mean-square error bound: bounded disturbance, noise by its second moments (F3)"
    claims = ("bound",)
    needs = (*Robust.needs, "measurement_covariance")
    honours = ("covariance",)
    sensors_bounded = False
    ellipsoid = False

    def _noise(self, measurement: Measurement) -> Array:
        assert self.model.measurement_covariance is not None
        return plain(self.model.measurement_covariance(measurement))

    def estimate(self) -> Estimate:
        M = self.model.performance
        if M is None:
            return Estimate(self._x)
        P, weight = self._bound(), M.T @ M
        bound = np.zeros(self.runs)
        for i, j in zip(*np.nonzero(weight), strict=True):
            bound += weight[i, j] * P[i, j]
        return Estimate(self._x, bound=bound)


class RobustBounded(Robust):
    """F1, the paper's family: memoryless, min tr P + tr Th per step with P << mu I.

    The P and Th of a step bound its growth, |e+|^2 <= (sqrt(e' P e) + sqrt(u' Th u))^2 for inputs u of size one. The
    paper's theorem follows: r+ = sqrt(lambda_max P) r + sqrt(n tr Th) bounds the error, from the box of P0 on. Claimed
    as the ball e' e <= r^2 (in the state's units as they are). kappa is sought within one P0 (ellipsoid
    e' P0^-1 e <= 1) around the estimate: where it grows beyond that, outside, the theorem is no guarantee. Where
    P << mu I is active the compiled form does not apply and the run is infeasible (cvxpy solves it where it can be
    solved). A step without any measurement has K = 0 and no such constraint."""

    summary = "memoryless robust estimator, a convex problem per step (F1, Liu et al. 2025)"
    Parameters = BoundedParameters
    claims = ("ellipsoid",)

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        super().start(model, runs, random)
        nx = model.nx
        self._P0 = plain(np.broadcast_to(model.initial_covariance, (nx, nx, runs)))
        self._P, self._objective = np.zeros((nx, nx, runs)), np.zeros(runs)
        self._radius = np.sqrt(np.einsum("iis->s", self._P0))

    def _region(self) -> Array:
        return self._P0

    def _find(self, C: Array, received: Mask, R: Array) -> None:
        if self.parameters.solver == "fast":
            memoryless_step(self._moved, self._A, self._M, self._N, self._kappa, self._g, self._v, C, received,
                            self.parameters.mu, self._K, self._P, self._objective, self.stability, self._verdict)
        else:
            self._find_convex(C, received)
        bound_step(self._P, self._objective, self._inputs(received), self._radius)

    def _inputs(self, received: Mask) -> Array:
        """How many inputs the waiting step has with these measurements (S,)."""
        heard = received.sum(axis=0)
        return np.where(self._moved, self._whole.shape[1] + heard, heard).astype(float)

    def _find_convex(self, C: Array, received: Mask) -> None:
        from .convex import BoundedProblem

        if self._convex is None:
            self._convex = BoundedProblem(self.model.nx, self._whole.shape[1], self.model.ny, self.parameters.mu)
        self._P, self._objective = self._unheard()
        for run in self._to_solve(received):
            if not received[:, run].any():
                self._note(run, C, self._K[:, :, run])
                continue
            A, N, g, H = self._of_run(C, run)
            solution = self._convex.solve(A, self._M, N, g, self._v, H, received[:, run])
            if self._solved(run, C, solution):
                self._P[:, :, run], self._objective[run] = solution.P, solution.objective

    def _unheard(self) -> tuple[Array, Array]:
        """P and objective of the waiting step without a measurement (K = 0)."""
        nx, ny = self.model.nx, self.model.ny
        P, objective = np.zeros_like(self._P), np.zeros(self.runs)
        memoryless_step(self._moved, self._A, self._M, self._N, self._kappa, self._g, self._v, np.zeros((ny, nx, 1)),
                        self._none, self.parameters.mu, self._K.copy(), P, objective, np.zeros(self.runs),
                        self._verdict.copy())
        return P, objective

    def estimate(self) -> Estimate:
        radius = self._radius
        if self._moved.any():
            radius = radius.copy()
            bound_step(*self._unheard(), self._inputs(self._none), radius)
        return Estimate(self._x, ellipsoid=np.eye(self.model.nx)[:, :, None] * radius**2)
