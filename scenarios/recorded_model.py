"""The kinematic design model of a recorded trip, discretised for each step's own interval.

States: position s, speed v; with an odometer its shortfall b (m) and excess e, b growing by e per metre the odometer
counts (true distance = (1 + e) x counted); with white jerk the acceleration. Dead reckoning takes s and v as told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PositiveFloat

from .model import Bounds, DesignModel, Linear, Portion
from .schema import Strict

Array = NDArray[np.float64]
UNITS = {"position": "m", "speed": "m/s", "odometer": "m"}


class Initial(Strict):
    """Standard deviations of the start: position m, speed m/s, shortfall m, excess, acceleration m/s^2."""

    position: PositiveFloat
    speed: PositiveFloat
    shortfall: PositiveFloat
    excess: PositiveFloat
    acceleration: PositiveFloat


class Knowledge(Strict):
    """motion: white `acceleration` or `jerk` of spectral density `density` (m^2/s^3 or m^2/s^5), or `odometer`: the
    distance and speed told as input, nothing else (dead reckoning).

    shortfall: `told`, grown by the odometer's own count (linear in the state), or `modelled`, by the state's speed
    (nonlinear). shortfall_density m^2/s, excess_density 1/s: random walks. w_bar m/s^2: bound of the acceleration.
    position, speed, odometer: standard deviations of the sensors in m, m/s, m; bounds are three times as wide."""

    motion: Literal["acceleration", "jerk", "odometer"]
    shortfall: Literal["told", "modelled"]
    density: PositiveFloat
    shortfall_density: Annotated[float, Field(ge=0)]
    excess_density: Annotated[float, Field(ge=0)]
    w_bar: PositiveFloat
    position: PositiveFloat
    speed: PositiveFloat
    odometer: PositiveFloat
    initial: Initial


@dataclass(frozen=True)
class Kinematics:
    """The model's functions for given knowledge; `odometer`: whether shortfall and excess are states."""

    told: Knowledge
    odometer: bool
    period: float

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states in their order."""
        if self.told.motion == "odometer":
            return "position", "speed"
        return ("position", "speed", *(("shortfall", "excess") if self.odometer else ()),
                *(("acceleration",) if self.told.motion == "jerk" else ()))

    def transition(self, x: Array, u: Array, k: int, portion: Portion) -> Array:
        """x+ (nx, .., S) after `portion` periods; u (2, S): distance by the odometer over the interval m, speed m/s."""
        out, h = np.array(x, dtype=float), self.period * np.asarray(portion)
        if self.told.motion == "odometer":
            out[0] += u[0]
            out[1] = u[1]
            return out
        jerk = self.told.motion == "jerk"
        travelled = h * x[1] + (0.5 * h * h * x[-1] if jerk else 0.0)
        out[0] += travelled
        if jerk:
            out[1] += h * x[-1]
        if self.odometer:
            out[2] += x[3] * u[0] if self.told.shortfall == "told" else travelled * x[3] / (1 + x[3])
        return out

    def jacobian(self, x: Array, u: Array, k: int, portion: Portion) -> Array:
        """df/dx (nx, nx, S)."""
        nx, runs = len(self.states), x.shape[1]
        out, h = np.zeros((nx, nx, runs)), self.period * np.asarray(portion)
        if self.told.motion == "odometer":
            out[0, 0] = 1.0
            return out
        for i in range(nx):
            out[i, i] = 1.0
        jerk = self.told.motion == "jerk"
        out[0, 1] = h
        if jerk:
            out[0, nx - 1], out[1, nx - 1] = 0.5 * h * h, h
        if self.odometer and self.told.shortfall == "told":
            out[2, 3] = u[0]
        elif self.odometer:
            travelled = h * x[1] + (0.5 * h * h * x[nx - 1] if jerk else 0.0)
            out[2, 1] = h * x[3] / (1 + x[3])
            out[2, 3] = travelled / (1 + x[3]) ** 2
            if jerk:
                out[2, nx - 1] = 0.5 * h * h * x[3] / (1 + x[3])
        return out

    def covariance(self, portion: Portion) -> Array:
        """Process noise covariance (nx, nx, S or 1) over `portion` periods, exactly for white acceleration or jerk."""
        nx, h = len(self.states), np.atleast_1d(self.period * np.asarray(portion, dtype=float))
        out, q = np.zeros((nx, nx, len(h))), self.told.density
        if self.told.motion == "jerk":
            a = nx - 1
            out[0, 0], out[1, 1], out[a, a] = q * h**5 / 20, q * h**3 / 3, q * h
            out[0, 1] = out[1, 0] = q * h**4 / 8
            out[0, a] = out[a, 0] = q * h**3 / 6
            out[1, a] = out[a, 1] = q * h**2 / 2
        else:
            out[0, 0], out[1, 1] = q * h**3 / 3, q * h
            out[0, 1] = out[1, 0] = q * h**2 / 2
        if self.odometer and nx > 2:
            out[2, 2], out[3, 3] = self.told.shortfall_density * h, self.told.excess_density * h
        return out

    def gain(self, portion: Portion) -> Array:
        """G (nx, 1, S or 1) of a bounded acceleration, constant over the interval."""
        h = np.atleast_1d(self.period * np.asarray(portion, dtype=float))
        out = np.zeros((len(self.states), 1, len(h)))
        out[0, 0], out[1, 0] = 0.5 * h * h, h
        return out

    def model(self, sensors: Sequence[str], initial_mean: Array, portions: Array, counted: Array) -> DesignModel:
        """The design model for these sensors; portions (K,) and counted (K,), the odometer's own distance over each
        interval, make the matrices of the linear form."""
        states, told = self.states, self.told
        nx = len(states)
        C = np.zeros((len(sensors), nx))
        for row, name in zip(C, sensors, strict=True):
            row[1 if name == "speed" else 0] = 1.0
            if name == "odometer" and "shortfall" in states:
                row[states.index("shortfall")] = -1.0
        deviations = np.array([getattr(told, name) for name in sensors])
        R, start = np.diag(deviations**2), np.array([getattr(told.initial, name) for name in states])
        observe = C[:, :, None]

        def measurement(x: Array, k: int) -> Array:
            out = np.zeros((len(sensors), *x.shape[1:]))
            for i, row in enumerate(C):
                for j in np.flatnonzero(row):
                    out[i] += row[j] * x[j]
            return out

        parts: dict[str, Any] = {}
        if told.motion != "odometer":
            parts["bounds"] = Bounds(self.gain(1.0)[:, :, 0], np.array([told.w_bar]), 3 * deviations, part=self.gain)
        if told.motion != "odometer" and (told.shortfall == "told" or not self.odometer):
            last = len(portions) - 1

            def A(k: int) -> Array:
                i = min(k, last)
                return self.jacobian(np.zeros((nx, 1)), np.array([[counted[i]], [0.0]]), k, float(portions[i]))[:, :, 0]

            parts["linear"] = Linear(
                A=A, B=lambda k: np.zeros((nx, 2)), h=lambda k: np.zeros(nx), C=lambda k: C,
                Q=lambda k: self.covariance(float(portions[min(k, last)]))[:, :, 0], R=lambda k: R, constant=False)
        return DesignModel(
            states=states, measurements=tuple(sensors), period=self.period, transition=self.transition,
            measurement=measurement, transition_jacobian=self.jacobian, measurement_jacobian=lambda x, k: observe,
            process_covariance=lambda x, u, k, portion: self.covariance(portion),
            measurement_covariance=lambda k: R[:, :, None],
            initial_mean=np.ascontiguousarray(initial_mean[:nx]), initial_covariance=np.diag(start**2)[:, :, None],
            **parts)
