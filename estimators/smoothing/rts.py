"""The Rauch-Tung-Striebel smoother over an EKF or UKF, of a whole trip and of a fixed lag.

The filter runs as it is and every event of it is kept; the way back needs its means, covariances and the
cross-covariance of neighbouring events."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from ...scenarios.arrays import Array, Mask
from ...scenarios.measurement import Interval, Measurement
from ...scenarios.model import DesignModel
from ...scenarios.randomness import RunRandom
from ..interface import Estimate, Estimator, Innovation, Parameters
from ..kalman import ExtendedKalman
from ..kernels.unscented import sigma_points
from ..sigma_point import UnscentedKalman
from .kernels import linear_cross, point_cross, step_back

FILTERS: dict[str, type[ExtendedKalman | UnscentedKalman]] = {"ekf": ExtendedKalman, "ukf": UnscentedKalman}


@dataclass
class _Event:
    """The filter at one event: what it predicted, how that hangs together with the event before, and what it then
    knew. step: that it belongs to. still (S,): runs for which no time passed since the event before."""

    step: int
    predicted_mean: Array
    predicted: Array
    cross: Array
    still: Mask
    mean: Array
    covariance: Array


class RauchTungStriebel(Estimator):
    """Backwards from the last event: G = C (P-)^-1, xs = x + G (xs' - x-'), Ps = P + G (Ps' - P-') G' with
    C = cov(x, x'), which is P F' for the EKF and the sigma points' for the UKF.

    What steers a closed loop, and its innovations, are the filter's. Keeps every event: (4 n^2 + 3 n) numbers of each
    run and event for n states."""

    class Parameters(Parameters):
        filter: Literal["ekf", "ukf"] = Field("ekf", description="the filter whose events are smoothed")

    family = "Smoothers"
    summary = "Rauch-Tung-Striebel smoother over the EKF or UKF: each state by all measurements of the trip"
    source = ("Rauch, Tung, Striebel, AIAA J. 3(8), 1965; for sigma points: Sarkka, IEEE TAC 53(3), 2008")
    needs: ClassVar[tuple[str, ...]] = ("process_covariance", "measurement_covariance")
    claims = ("covariance",)
    honours = ("covariance",)
    lag = None

    @classmethod
    def memory(cls, states: int, steps: int) -> int:
        return 8 * (4 * states**2 + 3 * states) * steps

    def design(self, model: DesignModel) -> dict[str, Any]:
        kind = FILTERS[self.parameters.filter]
        kind.require(model)
        self._filter = kind()
        return self._filter.design(model)

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        super().start(model, runs, random)
        self._filter = FILTERS[self.parameters.filter]()
        self._filter.start(model, runs, random)
        self.status, self.reasons = self._filter.status, self._filter.reasons
        nothing, n = np.zeros((model.nx, 0)), model.nx
        self._events = [_Event(0, nothing, np.zeros((n, n, 0)), np.zeros((n, n, 0)), np.zeros(0, dtype=bool), nothing,
                               nothing)]
        if isinstance(self._filter, UnscentedKalman):
            _, self._weights, self._scale = self._filter.weights(n)
            self._points = np.empty((n, len(self._weights), runs))
            self._deviations = np.empty_like(self._points)

    def predict(self, u: Array, interval: Interval) -> None:
        last = self._settled()
        cross, moved = np.empty((self.model.nx, self.model.nx, self.runs)), None
        if isinstance(self._filter, UnscentedKalman):
            whole = np.array(np.broadcast_to(last.covariance, cross.shape), order="C")
            sigma_points(last.mean, whole, self._scale, self._points, self._deviations, np.zeros(self.runs, dtype=bool))
            moved = np.ascontiguousarray(self.model.transition(self._points, u, interval))
        else:
            assert self.model.transition_jacobian is not None
            jacobian = np.ascontiguousarray(self.model.transition_jacobian(last.mean, u, interval))
            linear_cross(last.covariance, jacobian, cross)
        self._filter.predict(u, interval)
        found = self._filter.estimate()
        assert found.covariance is not None
        if moved is not None:
            point_cross(self._deviations, moved, found.mean, self._weights, cross)
        self._events.append(_Event(interval.step, found.mean.copy(), found.covariance.copy(), cross,
                                   ~interval.moving(self.runs), found.mean, found.covariance))

    def update(self, measurement: Measurement) -> Innovation | None:
        return self._filter.update(measurement)

    def estimate(self) -> Estimate:
        return self._filter.estimate()

    def finish(self) -> Iterator[tuple[int, Estimate]]:
        yield from self._back()

    def _settled(self) -> _Event:
        """The latest event, with what the filter knows now."""
        found, last = self._filter.estimate(), self._events[-1]
        assert found.covariance is not None
        last.mean, last.covariance = found.mean.copy(), found.covariance.copy()
        return last

    def _back(self) -> Iterator[tuple[int, Estimate]]:
        """(step, smoothed estimate) at the end of each step that is kept, from the latest down."""
        last = self._settled()
        shape = (self.model.nx, self.model.nx, self.runs)
        mean, covariance = last.mean.copy(), np.array(np.broadcast_to(last.covariance, shape), order="C")
        yield last.step, Estimate(mean, covariance=covariance)
        for later, event in zip(self._events[:0:-1], self._events[-2::-1], strict=True):
            before = mean, covariance
            mean, covariance = event.mean.copy(), np.array(np.broadcast_to(event.covariance, shape), order="C")
            step_back(*before, later.predicted_mean, later.predicted, later.cross, later.still, mean, covariance)
            for step in range(later.step - 1, event.step - 1, -1):  # more than one where steps had no event at all
                yield step, Estimate(mean, covariance=covariance)


class FixedLag(RauchTungStriebel):
    """The same with what came up to `steps` steps later: an answer that is late by a fixed time, as an interlocking or
    a maintenance log can wait for. The last `steps` steps of a trip are revised by what there is."""

    class Parameters(RauchTungStriebel.Parameters):
        steps: Annotated[int, Field(ge=1, le=1000)] = Field(10, description="the lag, in sampling periods")

    summary = "fixed-lag smoother over the EKF or UKF: each state by the measurements up to some steps later"
    source = "Rauch, Tung, Striebel, AIAA J. 3(8), 1965, over a window; Moore, Automatica 9(2), 1973"
    lag = 10

    def __init__(self, parameters: Any = None) -> None:
        super().__init__(parameters)
        self.lag = self.parameters.steps

    @classmethod
    def memory(cls, states: int, steps: int) -> int:
        return 0

    def past(self) -> Estimate | None:
        wanted = self._events[-1].step - self.parameters.steps
        found = None
        if wanted >= self._events[0].step:
            found = next(estimate for step, estimate in self._back() if step == wanted)
            while self._events[1].step <= wanted:
                del self._events[0]
        return found
