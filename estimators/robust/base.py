"""What the robust estimators share: prediction, missing measurements, statuses, and the contraction they are judged by.

Error: e+ = (I - K C)[(A + M Delta N) e + G w] - K v with |Delta| <= 1, |w_i| <= w_bar_i; subclasses find K."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, NonNegativeFloat, PositiveFloat

from ...scenarios.arrays import Array, Mask
from ...scenarios.errors import Unsupported
from ...scenarios.measurement import Interval, Measurement, untold
from ...scenarios.model import DesignModel, bounds_of
from ...scenarios.randomness import RunRandom
from ..interface import Estimator, Parameters, Status, flag
from .small import contraction

if TYPE_CHECKING:
    from .convex import Solution

SOURCE = "Liu et al., Measurement and Control 2025, doi 10.1177/00202940251368051"
REASONS = {
    1: "C S C' + R is singular: sensors without noise that repeat each other or see no uncertainty",
    2: "the bound is not finite: kappa, the bounds or the estimate left the range of numbers",
    3: "the constraint P << mu I of the problem F1 is active or cannot be met: the measurements received make the step "
       "no contraction by themselves; solver = \"cvxpy\" tells which",
}


class RobustParameters(Parameters):
    """What F1, F2 and F3 have in common."""

    solver: Annotated[Literal["fast", "cvxpy"], Field(
        description="compiled form, or the convex problem itself")] = "fast"
    kappa: Annotated[NonNegativeFloat | None, Field(
        description="constant factor of the linearisation error (unit of 1/N); default: the design model's")] = None


class SensorParameters(RobustParameters):
    """Parameters of F1 and F2, which need bounds of the measurement noise."""

    sigmas: Annotated[PositiveFloat | None, Field(
        description="bound of a sensor that has none (v_bar infinite), in standard deviations; F2's guarantee then "
                    "holds while the noise stays within it. Default: such sensors are not used")] = None


class Robust(Estimator):
    """Prediction x^- = f(x^, u), then x^ = x^- + K (y - h(x^-)); subclasses find K.

    Several predictions without a measurement, or a measurement without prediction, are steps of their own (K = 0;
    A = I and no disturbance). Elements of y that were not received, or whose sensor has no finite bound, get no gain.
    `stability` (S,): the largest |(I - K C)(A + M Delta N)|^2 (spectral norm) so far; the paper asks for < 1."""

    family = "Robust"
    source = SOURCE
    needs: ClassVar[tuple[str, ...]] = ("bounds", "transition_jacobian", "measurement_jacobian")
    sensors_bounded: ClassVar[bool] = True

    def design(self, model: DesignModel) -> dict[str, Any]:
        """Nothing to be found offline; refuses (Unsupported) what the problem cannot be written for."""
        bounds, name = bounds_of(model), type(self).__name__
        if self.sensors_bounded and not np.isfinite(self._sensor_bounds(model)).any():
            raise Unsupported(f"{name} needs a bound of the measurement noise, and no sensor of this scenario has one "
                              "(v_bar is infinite): set `sigmas` to bound it by standard deviations, or take "
                              "robust-mean-square, which uses its covariance")
        if not np.isfinite(bounds.w_bar).all():
            raise Unsupported(f"{name} needs finite disturbance bounds w_bar")
        if self.parameters.kappa is not None and bounds.M is None:
            raise Unsupported(f"{name}: kappa is given, but the design model has no linearisation error (M, N)")
        return {}

    def _sensor_bounds(self, model: DesignModel) -> Array:
        """v_bar (ny,), with `sigmas` standard deviations for a sensor that has no bound."""
        v_bar = bounds_of(model).v_bar
        if self.parameters.sigmas is None or model.measurement_covariance is None:
            return v_bar
        return np.where(np.isfinite(v_bar), v_bar, self.parameters.sigmas * np.sqrt(
            np.diagonal(model.measurement_covariance(untold(0, model.ny))[:, :, 0])))

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        super().start(model, runs, random)
        bounds, nx = bounds_of(model), model.nx
        self._x = model.initial_mean.copy()
        self._M = np.zeros(nx) if bounds.M is None else plain(bounds.M[:, 0])
        self._N = np.zeros(nx) if bounds.N is None else plain(bounds.N[0])
        self._whole = plain((bounds.G * bounds.w_bar)[:, :, None])
        self._usable, self._v = np.ones((model.ny, 1), dtype=bool), np.zeros(model.ny)
        if self.sensors_bounded:
            v_bar = self._sensor_bounds(model)
            self._usable[:, 0] = np.isfinite(v_bar)
            self._v = np.where(self._usable[:, 0], v_bar, 0.0)
        self._still = plain(np.diag(self._v**2)[:, :, None])
        self._none = np.zeros((model.ny, runs), dtype=bool)
        self._K = np.zeros((nx, model.ny, runs))
        self._verdict = np.zeros(runs, dtype=np.int64)
        self.stability = np.zeros(runs)
        self._convex: Any = None
        self._rest()

    def _rest(self) -> None:
        """No prediction is waiting: A = I, no disturbance, no linearisation error."""
        self._moved = np.zeros(self.runs, dtype=bool)
        self._A = np.eye(self.model.nx)[:, :, None]
        self._g, self._kappa = np.zeros_like(self._whole), np.zeros(self.runs)

    def predict(self, u: Array, interval: Interval) -> None:
        model, bounds, x = self.model, bounds_of(self.model), self._x
        assert model.transition_jacobian is not None
        if self._moved.any():
            assert model.measurement_jacobian is not None
            self._correct(plain(model.measurement_jacobian(x, interval.depart)), self._none, self._still)
        moved = interval.moving(self.runs).copy()
        part = moved & (np.asarray(interval.length) != model.period)
        A = plain(model.transition_jacobian(x, u, interval))
        kappa, g = self._factor(x, u), self._whole
        if part.any():
            if bounds.part is None or bounds.M is not None:
                flag(self, part, Status.infeasible, "the bounds hold for whole sampling periods only")
            else:
                g = plain(bounds.part(interval) * bounds.w_bar[:, None])
        after = plain(model.transition(x, u, interval))
        if not moved.all():
            after = np.where(moved, after, x)
            A = np.where(moved, A, np.eye(model.nx)[:, :, None])
            g, kappa = np.where(moved, g, 0.0), np.where(moved, kappa, 0.0)
        self._x, self._A, self._g, self._kappa, self._moved = after, A, g, kappa, moved

    def _factor(self, x: Array, u: Array) -> Array:
        """kappa (S,) of the step about to be predicted."""
        bounds = bounds_of(self.model)
        if self.parameters.kappa is not None:
            return np.full(self.runs, self.parameters.kappa)
        if bounds.M is None or bounds.kappa is None:
            return np.zeros(self.runs)
        return plain(bounds.kappa(x, u, self._region()))

    def update(self, measurement: Measurement) -> None:
        model, at = self.model, measurement.step
        assert model.measurement_jacobian is not None
        C = plain(model.measurement_jacobian(self._x, at))
        received = measurement.received & self._usable
        innovation = np.where(received, measurement.y - model.measurement(self._x, at), 0.0)
        self._correct(C, received, self._noise(measurement))
        x = self._x.copy()
        for j in range(model.ny):
            x += self._K[:, j] * innovation[j]
        self._x = x

    def _correct(self, C: Array, received: Mask, R: Array) -> None:
        """Find K (and the bound) of the waiting prediction and these measurements; flag runs without."""
        self._find(C, received, R)
        for verdict in np.unique(self._verdict[self._verdict > 0]):
            flag(self, self._verdict == verdict, Status.infeasible, REASONS[int(verdict)])
        self._rest()

    def _noise(self, measurement: Measurement) -> Array:
        """R (ny, ny, S or 1): diag(v_bar^2), or second moments of the noise (F3)."""
        return self._still

    @abstractmethod
    def _find(self, C: Array, received: Mask, R: Array) -> None:
        """K and the bound of each run, or a verdict why there are none."""

    @abstractmethod
    def _region(self) -> Array:
        """Pi (nx, nx, S), the error region in which kappa is sought."""

    def _of_run(self, C: Array, run: int) -> tuple[Array, Array, Array, Array]:
        """A (nx, nx), N with kappa (nx,), disturbance columns (nx, nw), C (ny, nx) of one run, for the convex forms."""
        A, g, H = (part[:, :, min(run, part.shape[2] - 1)] for part in (self._A, self._g, C))
        return A, self._kappa[run] * self._N, g, H

    def _note(self, run: int, C: Array, K: Array) -> None:
        """Write the gain of one run, found by cvxpy, and its contraction."""
        A, N, _, H = self._of_run(C, run)
        n = len(A)
        G = np.eye(n) - K @ H
        top = contraction(G, plain(A), self._M, N, np.empty((n, n)), np.empty((n, n)))
        self.stability[run] = max(self.stability[run], top)
        self._K[:, :, run] = K

    def _to_solve(self, received: Mask) -> Iterator[int]:
        """Runs that have a problem of their own, for the convex forms; the gains of all are none until it is solved."""
        self._K[:] = 0.0
        return (run for run in range(self.runs)
                if self.status[run] == Status.ok and (self._moved[run] or received[:, run].any()))

    def _solved(self, run: int, C: Array, solution: Solution) -> bool:
        """Whether a run's problem has a solution, whose gain is noted; the run is flagged where it has none."""
        if not np.isfinite(solution.objective):
            flag(self, np.arange(self.runs) == run, Status.infeasible,
                 f"the convex problem has no solution (solver: {solution.status})")
            return False
        self._note(run, C, solution.K)
        return True

    def extremes(self) -> dict[str, Array]:
        return {"contraction": self.stability}


def plain(values: Array) -> Array:
    """C-contiguous and writable, copied only if need be: one compiled version serves all models."""
    return np.require(values, dtype=float, requirements=["C", "W"])
