"""The interacting multiple model filter over whole design models: an extended Kalman filter for each of the modes.

Modes may differ in anything but their states and measurements: an axle's noise, a jump, a motion."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from pydantic import Field, PositiveFloat, model_validator

from ...scenarios.arrays import Array, read_only
from ...scenarios.compiled import WholeSteps
from ...scenarios.errors import Unsupported
from ...scenarios.measurement import Course, Interval, Measurement
from ...scenarios.model import DesignModel
from ...scenarios.randomness import RunRandom
from .. import mode_grid
from ..interface import Estimate, Estimator, Innovation, Parameters, Room, Status, Walk, flag
from ..kalman import ExtendedKalman
from ..kernels.mixing import log_density, mix, moments, weigh
from ..outliers.base import Reading, ratio_limit
from ..outliers.kernels import look
from ..outliers.reopening import Memory, Reopening
from .stacked import interval_of, measurement_of, noise_of, power_of, stacked
from .walks import walk_modes

IMPOSSIBLE = "all modes became impossible"


class HypothesesParameters(Parameters):
    """p(mode'|mode) where the design model does not say, and a gate in front of the modes."""

    stay: float = Field(0.9, gt=0, le=1, description="probability of staying in a mode over a step, else one up or "
                        "down the list: used where the design model has no transition matrix of its own")
    gate: tuple[str, ...] = Field((), description="sensors whose readings are rejected where they lie too far from "
                                  "what all modes together predict; none: every reading is taken")
    level: float = Field(0.999, gt=0, lt=1, description="gate: share of good readings let through")
    after: PositiveFloat = Field(20.0, description="gate: s of rejections after which it opens")

    @model_validator(mode="after")
    def _used(self) -> HypothesesParameters:
        if not self.gate and {"level", "after"} & self.model_fields_set:
            raise ValueError("level and after are used with a gate only: name its sensors, or leave them out")
        return self


class InteractingModels(Estimator):
    """IMM: mix the modes' Gaussians by the transition matrix, filter each with its model, weigh, combine.

    An interval of p sampling periods mixes by the transition matrix to the power p. A gate judges a reading before any
    other of its measurement is taken in, by the moments of the mixture, and opens after a time of rejections."""

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
        self._limit = ratio_limit(self.parameters.level)
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
        self.lost, self._room = np.zeros(runs, dtype=bool), Room()
        self._mean, self._covariance = np.empty((model.nx, runs)), np.empty((model.nx, model.nx, runs))
        p = self.parameters
        rule = Reopening.model_validate({"reopen": "time", "after": p.after, "sensors": p.gate})
        self._closed = Memory(rule, model, runs, "gate") if p.gate else None
        self.rejected = np.zeros((model.ny, runs), dtype=bool) if p.gate else None

    def predict(self, u: Array, interval: Interval) -> None:
        moving = np.ascontiguousarray(interval.moving(self.runs))
        periods = np.asarray(interval.length) / self.model.period
        mix(self.power(periods), self.weight, moving, self.bank._mean, self.bank._covariance)
        self.bank.predict(read_only(np.concatenate([u] * self.m, axis=1)), interval_of(interval, self.m))

    def _gated(self, measurement: Measurement, memory: Memory) -> Measurement:
        """The measurement without what the gate rejects."""
        model, runs, at = self.model, self.runs, measurement.step
        assert model.measurement_jacobian is not None and model.measurement_covariance is not None
        self.rejected = rejected = np.zeros(measurement.received.shape, dtype=bool)
        if not measurement.received[memory.judged].any():
            return measurement
        self.estimate()
        x, P = self._mean, self._covariance
        h, predicted = model.measurement_jacobian(x, at), model.measurement(x, at)
        R = model.measurement_covariance(measurement)
        residual, spread, product = np.empty(runs), np.empty(runs), np.empty_like(x)
        for j in memory.judged:
            got = np.ascontiguousarray(measurement.received[j])
            look(x, x, P, np.ascontiguousarray(h[j]), np.ascontiguousarray(measurement.y[j]),
                 np.ascontiguousarray(predicted[j]), got, residual, spread, product)
            reading = Reading(j, residual, spread, np.broadcast_to(R[j, j], runs), got, measurement.time)
            rejected[j] = got & memory.rejected(reading, reading.ratio > self._limit)
        return measurement._replace(received=read_only(measurement.received & ~rejected))

    def update(self, measurement: Measurement) -> Innovation:
        if self._closed is not None:
            measurement = self._gated(measurement, self._closed)
        heard = measurement.received.any(axis=0)
        if not heard.any():  # all that arrived is rejected, or nothing did
            return Innovation(log_likelihood=np.zeros(self.runs))
        self.noise = noise_of(self.modes, measurement, self.runs)
        innovation = self.bank.update(measurement_of(measurement, self.m))
        assert innovation is not None and innovation.residual is not None and innovation.variance is not None
        total = log_density(innovation.residual, innovation.variance, np.ascontiguousarray(measurement.received))
        loglik = weigh(self.weight, total, heard, self.lost)
        if self.lost.any():
            flag(self, self.lost, Status.failed, IMPOSSIBLE)
        return Innovation(log_likelihood=loglik)

    def walk(self, course: Course, early: bool) -> Walk | None:
        found, whole, gate = [mode.model.over(course) for mode in self.modes], self.model.over(course), self._closed
        if early or not isinstance(whole, WholeSteps) or type(self) is not InteractingModels:
            return None
        each = [one for one in found if isinstance(one, WholeSteps) and one.of[:-1] == whole.of[:-1]]
        if len(each) < len(found):
            return None
        noise, ny = np.array([one.noise for one in each]), self.model.ny
        judged, since = (np.zeros(ny, dtype=bool), np.zeros((ny, self.runs))) if gate is None else (
            gate.is_judged, gate.since)
        bank, runs, nx = self.bank, self.runs, self.model.nx
        mean, covariance, likelihood = self._room.of(len(course.y), mean=(nx, runs), covariance=(nx, nx, runs),
                                                     likelihood=(runs,))
        walk_modes(*whole[:6], noise, np.full(self.m * runs, course.period), self.power(np.asarray(1.0)), course.u,
                   course.y, course.received, course.told, bank._mean, bank._covariance, self.weight, bank._failed,
                   self.lost, course.times, whole.noise, self._limit, judged, since, self.parameters.after - 1e-9, mean,
                   covariance, likelihood)
        if self.lost.any():
            flag(self, self.lost, Status.failed, IMPOSSIBLE)
        return Walk(mean, covariance, Innovation(log_likelihood=likelihood))

    def estimate(self) -> Estimate:
        moments(self.weight, self.bank._mean, self.bank._covariance, self._mean, self._covariance)
        return Estimate(self._mean, covariance=self._covariance)
