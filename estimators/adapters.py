"""The per-run adapters: any single-run filter, or any `step(y, u)` function, becomes an estimator in ten lines.

One filter object per run, plain vectors and matrices without the runs axis; one that raises costs its run alone."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..scenarios.arrays import Array
from ..scenarios.errors import Unsupported
from ..scenarios.measurement import Interval, Measurement, untold
from ..scenarios.model import DesignModel
from ..scenarios.randomness import RunRandom
from .interface import Estimate, Estimator, Innovation, Status, flag

Indices = NDArray[np.intp]


class RunModel:
    """The design model as one run sees it: vectors (nx,) and matrices, no runs axis. `model` is the whole of it.

    nx, ny: dimensions. x0 (nx,), P0 (nx, nx): the start. interval, step: of the prediction or measurement at hand;
    f, F and Q go over that interval where they are given none."""

    def __init__(self, model: DesignModel, run: int, random: RunRandom) -> None:
        self.model, self.nx, self.ny, self.step = model, model.nx, model.ny, 0
        self.x0: Array = model.initial_mean[:, run].copy()
        self.P0: Array = model.initial_covariance[:, :, 0].copy()
        self.interval = Interval(1, 0.0, model.period)
        self._run, self._random, self._at = run, random, untold(0, model.ny)

    @property
    def random(self) -> np.random.Generator:
        """This run's own random stream, the only one its filter may use."""
        return self._random.generators[self._run]

    def f(self, x: Array, u: Array, interval: Interval | None = None) -> Array:
        """The state (nx,) at the end of the interval, from x (nx,) under the step's input u (nu,)."""
        return self.model.transition(_column(x), _column(u), interval or self.interval)[:, 0]

    def h(self, x: Array) -> Array:
        """The measurement (ny,) of x (nx,) at `step`."""
        return self.model.measurement(_column(x), self.step)[:, 0]

    def F(self, x: Array, u: Array, interval: Interval | None = None) -> Array:
        """Jacobian of f (nx, nx). Raises Unsupported where the design model has none, as the next three do."""
        return _given(self.model.transition_jacobian)(_column(x), _column(u), interval or self.interval)[:, :, 0]

    def H(self, x: Array) -> Array:
        """Jacobian of h (ny, nx) at `step`."""
        return _given(self.model.measurement_jacobian)(_column(x), self.step)[:, :, 0]

    def Q(self, x: Array, u: Array, interval: Interval | None = None) -> Array:
        """Process noise covariance (nx, nx) of the interval from x."""
        return _given(self.model.process_covariance)(_column(x), _column(u), interval or self.interval)[:, :, 0]

    @property
    def R(self) -> Array:
        """Noise covariance (ny, ny) of the measurement at hand: what its sensors tell, else the model's own."""
        return _given(self.model.measurement_covariance)(self._at)[:, :, 0]

    def go(self, interval: Interval) -> Interval:
        """Have this run's part of an interval at hand."""
        self.step, self.interval = interval.step, interval.of_run(self._run)
        return self.interval

    def take(self, measurement: Measurement) -> None:
        """Have this run's part of a measurement at hand."""
        run, told = slice(self._run, self._run + 1), measurement.covariance
        if told is not None and told.shape[2] > 1:
            told = told[:, :, run]
        self.step = measurement.step
        self._at = measurement._replace(y=measurement.y[:, run], received=measurement.received[:, run], covariance=told)


def _column(x: Array) -> Array:
    return np.asarray(x, dtype=float).reshape(-1, 1)


def _given(part: Callable[..., Array] | None) -> Callable[..., Array]:
    if part is None:
        raise Unsupported("the design model of this scenario lacks a Jacobian or covariance that the filter asks for")
    return part


class PerRun(Estimator):
    """Base of estimators that keep one filter object per run. Write `make`; overwrite the others where they differ.

    Filters are handed only what was received: `update_run` gets the elements' numbers `got` to take the rows of h, H,
    R by, and is not called where nothing came. An exception in a filter marks its run as failed, with NaN from there
    on. Set claims = ("covariance",) where `read_run` gives one, and honours = ("covariance",) where it takes model.R
    anew for every measurement."""

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        super().start(model, runs, random)
        self.models = [RunModel(model, run, random) for run in range(runs)]
        self._mean = model.initial_mean.copy()
        self._covariance = None
        if "covariance" in self.claims:
            self._covariance = np.repeat(model.initial_covariance, runs, axis=2)
        self.filters = [self.make(one) for one in self.models]

    @abstractmethod
    def make(self, model: RunModel) -> Any:
        """A new filter for one run, started at model.x0, model.P0."""

    def predict_run(self, filter: Any, model: RunModel, u: Array, interval: Interval) -> None:
        """To the end of an interval of some length with input u (nu,). As it stands: filter.predict(u)."""
        filter.predict(u)

    def update_run(self, filter: Any, model: RunModel, y: Array, got: Indices) -> None:
        """Use y (len(got),), the received elements, whose numbers are `got` (at least one). As it stands:
        filter.update(y) where all came, nothing otherwise."""
        if len(got) == model.ny:
            filter.update(y)

    def read_run(self, filter: Any) -> tuple[Array, Array | None]:
        """The filter's mean, (nx,) or (nx, 1), and covariance (nx, nx) or None. As it stands: filter.x and filter.P."""
        return filter.x, filter.P if "covariance" in self.claims else None

    def likelihood_run(self, filter: Any, y: Array, got: Indices) -> float | None:
        """log p(y | what came before) of the update just made, for scores without a truth; None where not known."""
        return None

    def predict(self, u: Array, interval: Interval) -> None:
        for run in np.flatnonzero(interval.moving(self.runs)).tolist():
            self._guard(run, self.predict_run, u[:, run], self.models[run].go(interval))

    def update(self, measurement: Measurement) -> Innovation | None:
        y, received = measurement.y, measurement.received
        said: dict[int, float] = {}
        for run in np.flatnonzero(received.any(axis=0)).tolist():
            got = np.flatnonzero(received[:, run])
            self.models[run].take(measurement)
            self._guard(run, self.update_run, y[got, run], got)
            likelihood = self.likelihood_run(self.filters[run], y[got, run], got) if not self.status[run] else np.nan
            if likelihood is not None:
                said[run] = likelihood
        if not said:
            return None
        return Innovation(log_likelihood=np.array([said.get(run, 0.0) for run in range(self.runs)]))

    def estimate(self) -> Estimate:
        return Estimate(self._mean, covariance=self._covariance)

    def _guard(self, run: int, act: Callable[..., None], *arguments: Any) -> None:
        """Call a method of one run's filter and read its estimate, unless the run has failed or fails now."""
        if self.status[run] != Status.ok:
            return
        try:
            act(self.filters[run], self.models[run], *arguments)
            mean, covariance = self.read_run(self.filters[run])
            self._mean[:, run] = np.reshape(mean, self._mean.shape[0])
            if self._covariance is not None:
                self._covariance[:, :, run] = covariance
        except Exception as error:
            flag(self, np.arange(self.runs) == run, Status.failed, f"{type(error).__name__}: {error}")
            self._mean[:, run] = np.nan
            if self._covariance is not None:
                self._covariance[:, :, run] = np.nan


class PerRunStep(PerRun):
    """Base of estimators made of one function per run: `make(model)` returns step(y, u) -> mean (nx,), or (mean,
    covariance) with claims = ("covariance",).

    step is called once per measurement: y (ny,) with NaN where nothing was received, u (nu,) the input since the last
    call, None for a measurement without a step before it. Whole steps only: scenarios with part steps raise
    Unsupported. Between a step and its measurement the estimate is the design model's prediction from the last one, so
    that scenarios which score predictions score one; the covariance needs the model's Jacobian and Q."""

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        super().start(model, runs, random)
        self._input: Array | None = None

    def predict(self, u: Array, interval: Interval) -> None:
        if not interval.whole or self._input is not None:
            raise Unsupported(f"{type(self).__name__} takes whole steps with a measurement each; this scenario has "
                              "part steps: write it as predict and update (PerRun) instead")
        self._input = u
        for run in np.flatnonzero(self.status == Status.ok).tolist():
            model, mean = self.models[run], self._mean[:, run].copy()
            model.go(interval)
            self._mean[:, run] = model.f(mean, u[:, run])
            if self._covariance is not None:
                F = model.F(mean, u[:, run])
                self._covariance[:, :, run] = F @ self._covariance[:, :, run] @ F.T + model.Q(mean, u[:, run])

    def update(self, measurement: Measurement) -> Innovation | None:
        y, received = measurement.y, measurement.received
        for run in range(self.runs):
            u = None if self._input is None else self._input[:, run]
            self.models[run].take(measurement)
            self._guard(run, self._step, np.where(received[:, run], y[:, run], np.nan), u)
        self._input = None
        return None

    def _step(self, step: Callable[[Array, Array | None], Any], model: RunModel, y: Array, u: Array | None) -> None:
        self._result = step(y, u)

    def read_run(self, filter: Any) -> tuple[Array, Array | None]:
        return self._result if isinstance(self._result, tuple) else (self._result, None)
