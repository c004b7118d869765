"""The design model of a recorded trip, kinematic or that of the train, discretised for each step's own interval.

States: position s, speed v; with an odometer its shortfall b (m) and excess e, b growing by e per metre the odometer
counts (true distance = (1 + e) x counted); with white jerk the acceleration, with an accelerometer its bias. Dead
reckoning takes s and v as told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, NonNegativeFloat, PositiveFloat

from ..arrays import Array
from ..measurement import Interval, PerRun
from ..measurement import told as told_covariance
from ..model import Bounds, DesignModel, Linear, product
from ..railway import dynamics as metro_plant
from ..railway.dynamics import Forces, Slope
from ..railway.odometer import OdometerKnowledge
from ..schema import Strict
from ..strict import key
from .recording import Recording
from .wheels import WHEELS

LAST = {"jerk": "acceleration", "accelerometer": "bias"}
"""The last state of a motion that has one more."""


class Initial(Strict):
    """Standard deviations of the start."""

    position: Annotated[PositiveFloat, key("of the position", "m")]
    speed: Annotated[PositiveFloat, key("of the speed", "m/s")]
    shortfall: Annotated[PositiveFloat, key("of the odometer's shortfall", "m")]
    excess: Annotated[PositiveFloat, key("of its excess", "1")]
    acceleration: Annotated[PositiveFloat, key("of the acceleration", "m/s^2")]
    bias: Annotated[PositiveFloat, key("of the accelerometer's bias", "m/s^2")] = 0.1


class Knowledge(Strict):
    """What the estimators of a recorded trip are told; bounds are three times the sensors' standard deviations."""

    motion: Annotated[Literal["acceleration", "jerk", "train", "accelerometer", "odometer"], key(
        "white acceleration or jerk; train: what the recorded control asks of the train on its line, and white "
        "acceleration; accelerometer: its reading less a bias that walks, and white noise; odometer: the distance "
        "and speed told as input, nothing else (dead reckoning)")]
    shortfall: Annotated[Literal["told", "modelled"], key(
        "of the odometer: told, grown by its own count (linear in the state), or modelled, by the state's speed "
        "(nonlinear)")]
    density: Annotated[PositiveFloat, key("spectral density of the white acceleration or jerk", "m^2/s^3 or m^2/s^5")]
    shortfall_density: Annotated[float, Field(ge=0), key("random walk of the shortfall", "m^2/s")]
    excess_density: Annotated[float, Field(ge=0), key("random walk of the excess", "1/s")]
    bias_density: Annotated[float, Field(ge=0), key("random walk of the accelerometer's bias", "m^2/s^5")] = 1e-6
    w_bar: Annotated[PositiveFloat, key("bound of the acceleration", "m/s^2")]
    position: Annotated[PositiveFloat, key("standard deviation of the position sensor", "m")]
    speed: Annotated[PositiveFloat, key("of the speed sensor", "m/s")]
    odometer: Annotated[PositiveFloat, key("of the odometer", "m")]
    balise: Annotated[PositiveFloat, key("of a balise's place", "m")] = 1.0
    initial: Annotated[Initial, key("standard deviations of the start")]

    def worth(self, sensor: str) -> float:
        """A sensor's standard deviation. Raises ValueError for those of `WheelKnowledge`."""
        if sensor in WHEELS:
            raise ValueError(f"motion = \"{self.motion}\" knows no {sensor}: leave it out of sensors.use, or run "
                              "recorded-odometry")
        return getattr(self, sensor)


class WheelKnowledge(OdometerKnowledge):
    """The model of `odometry` on a recorded trip."""

    motion: Annotated[Literal["wheels", "wheel-a", "wheel-b", "minmax"], key(  # pyright: ignore[reportIncompatibleVariableOverride]
        "wheels (accelerometer as in `odometry`), or dead reckoning by a wheel's count: wheel-a, wheel-b, minmax")]
    position: Annotated[PositiveFloat, key("standard deviation of the position sensor, where it tells none", "m")]
    speed: Annotated[PositiveFloat, key("of the speed sensor, where it tells none", "m/s")]
    balise: Annotated[PositiveFloat, key("of a balise's place, where none is told", "m")]
    wheel: Annotated[PositiveFloat, key("of a count, beside the step that it counts in", "m")]
    creep: Annotated[NonNegativeFloat, key("micro-slip as a share of the distance", "1")]

    def worth(self, sensor: str) -> float:
        """A sensor's standard deviation. Raises ValueError for those of `Knowledge`."""
        if sensor == "odometer":
            raise ValueError("the odometer's model knows wheels alone: map the odometer as wheel-a")
        return getattr(self, sensor.removesuffix("-a").removesuffix("-b"))


@dataclass(frozen=True)
class Drive:
    """The train and its line as the compiled acceleration law wants them."""

    forces: Forces
    slope: Slope


@dataclass(frozen=True)
class Kinematics:
    """The model's functions for given knowledge; `odometer`: whether shortfall and excess are states; drive: for motion
    `train`."""

    told: Knowledge
    odometer: bool
    period: float
    drive: Drive | None = None

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states in their order."""
        if self.told.motion == "odometer":
            return "position", "speed"
        return ("position", "speed", *(("shortfall", "excess") if self.odometer else ()),
                *((LAST[self.told.motion],) if self.told.motion in LAST else ()))

    def transition(self, x: Array, u: Array, interval: Interval) -> Array:
        """x+ (nx, .., S) at the end of the interval; u (4, S): distance by the odometer over the whole step m, speed
        m/s, control, acceleration m/s^2."""
        out, h, counted = np.array(x, dtype=float), np.asarray(interval.length), u[0] * interval.share
        if self.told.motion == "odometer":
            out[0] += counted
            out[1] = np.where(h > 0, u[1], x[1])
            return out
        sign = self._sign
        pull = sign * x[-1] + (u[3] if sign < 0 else 0.0) if sign else None
        if self.told.motion == "train":
            moved = self._driven(x, u, h)
            travelled = moved[0] - x[0]
            out[:2] = moved
        else:
            travelled = h * x[1] + (0.0 if pull is None else 0.5 * h * h * pull)
            out[0] += travelled
        if pull is not None:
            out[1] += h * pull
        if self.odometer:
            out[2] += x[3] * counted if self.told.shortfall == "told" else travelled * x[3] / (1 + x[3])
        return out

    @property
    def _sign(self) -> float:
        """How the last state adds to the acceleration: itself, or as the bias of what the accelerometer says; 0: there
        is none."""
        return {"jerk": 1.0, "accelerometer": -1.0}.get(self.told.motion, 0.0)

    def _driven(self, x: Array, u: Array, h: Array) -> Array:
        """Position and speed (2, .., S) by the train's own law."""
        assert self.drive is not None
        points = np.ascontiguousarray(x[:2]).reshape(2, -1, x.shape[-1])
        out, seconds = np.empty_like(points), np.broadcast_to(h, x.shape[-1:]).copy()
        metro_plant.transition(points, np.ascontiguousarray(u[2]), seconds, self.drive.forces, self.drive.slope,
                               points.shape[2], out)
        return out.reshape(2, *x.shape[1:])

    def jacobian(self, x: Array, u: Array, interval: Interval) -> Array:
        """df/dx (nx, nx, S)."""
        nx, runs = len(self.states), x.shape[1]
        out, h = np.zeros((nx, nx, runs)), np.asarray(interval.length)
        if self.told.motion == "odometer":
            out[0, 0], out[1, 1] = 1.0, np.where(h > 0, 0.0, 1.0)
            return out
        for i in range(nx):
            out[i, i] = 1.0
        sign = self._sign
        out[0, 1] = h
        if self.told.motion == "train":
            assert self.drive is not None
            block = np.empty((2, 2, runs))
            metro_plant.transition_jacobian(np.ascontiguousarray(x[1]), np.ascontiguousarray(u[2]),
                                            np.broadcast_to(h, (runs,)).copy(), self.drive.forces, runs, block)
            out[:2, :2] = block
        if sign:
            out[0, nx - 1], out[1, nx - 1] = sign * 0.5 * h * h, sign * h
        if self.odometer and self.told.shortfall == "told":
            out[2, 3] = u[0] * interval.share
        elif self.odometer:
            travelled = h * x[1]
            if sign:
                travelled = travelled + 0.5 * h * h * (sign * x[nx - 1] + (u[3] if sign < 0 else 0.0))
            if self.told.motion == "train":
                travelled = self._driven(x, u, h)[0] - x[0]
            out[2, 1] = out[0, 1] * x[3] / (1 + x[3])
            out[2, 3] = travelled / (1 + x[3]) ** 2
            if sign:
                out[2, nx - 1] = sign * 0.5 * h * h * x[3] / (1 + x[3])
        return out

    def covariance(self, length: PerRun) -> Array:
        """Process noise covariance (nx, nx, S or 1) over `length` seconds, exactly for white acceleration or jerk."""
        nx, h = len(self.states), np.atleast_1d(np.asarray(length, dtype=float))
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
        if self.told.motion == "accelerometer":
            out[nx - 1, nx - 1] = self.told.bias_density * h
        if self.odometer and nx > 2:
            out[2, 2], out[3, 3] = self.told.shortfall_density * h, self.told.excess_density * h
        return out

    def gain(self, length: PerRun) -> Array:
        """G (nx, 1, S or 1) of a bounded acceleration, constant over `length` seconds."""
        h = np.atleast_1d(np.asarray(length, dtype=float))
        out = np.zeros((len(self.states), 1, len(h)))
        out[0, 0], out[1, 0] = 0.5 * h * h, h
        return out

    def model(self, sensors: Sequence[str], initial_mean: Array, trips: Sequence[Recording]) -> DesignModel:
        """The design model for these sensors. The matrices of the linear form are those of one trip's intervals and
        its odometer's own distances: several trips have none."""
        states, told = self.states, self.told
        nx = len(states)
        C = np.zeros((len(sensors), nx))
        for row, name in zip(C, sensors, strict=True):
            row[1 if name == "speed" else 0] = 1.0
            if name == "odometer" and "shortfall" in states:
                row[states.index("shortfall")] = -1.0
        deviations = np.array([told.worth(name) for name in sensors])
        R, start = np.diag(deviations**2), np.array([getattr(told.initial, name) for name in states])
        start[1] = max(start[1], *(_pace_sd(trip, told.position) for trip in trips))
        observe = C[:, :, None]

        parts: dict[str, Any] = {}
        if told.motion in ("acceleration", "jerk"):
            parts["bounds"] = Bounds(self.gain(self.period)[:, :, 0], np.array([told.w_bar]), 3 * deviations,
                                     part=lambda interval: self.gain(interval.length))
        if told.motion in ("acceleration", "jerk", "accelerometer") and len(trips) == 1 and (
                told.shortfall == "told" or not self.odometer):
            parts["linear"] = self._linear(trips[0], C, R)
        return DesignModel(
            states=states, measurements=tuple(sensors), period=self.period, transition=self.transition,
            measurement=lambda x, step: product(C, x), transition_jacobian=self.jacobian,
            measurement_jacobian=lambda x, step: observe,
            linear_measurement=True,
            process_covariance=lambda x, u, interval: self.covariance(interval.length),
            measurement_covariance=told_covariance(lambda step: R[:, :, None]),
            initial_mean=np.ascontiguousarray(initial_mean[:nx]), initial_covariance=np.diag(start**2)[:, :, None],
            tells=tuple(name for name in sensors if any(name in trip.told for trip in trips)), **parts)

    def _linear(self, trip: Recording, C: Array, R: Array) -> Linear:
        """The linear form on one trip: with its odometer's own distance over each interval, as far as it is told."""
        nx, lengths = len(self.states), np.diff(trip.time)
        last = len(lengths) - 1
        counted = np.zeros(len(lengths))
        if "odometer" in trip.measured:
            there = np.isfinite(trip.measured["odometer"])
            values = trip.measured["odometer"][there]
            at = np.clip(np.cumsum(there) - 1, 0, None)  # held until the next reading
            counted = np.diff(values[at])

        def A(k: int) -> Array:
            i = min(k, last)
            whole, told = Interval(k + 1, 0.0, float(lengths[i])), np.array([[counted[i]], [0.0], [0.0], [0.0]])
            return self.jacobian(np.zeros((nx, 1)), told, whole)[:, :, 0]

        def B(k: int) -> Array:
            out, h = np.zeros((nx, 4)), float(lengths[min(k, last)])
            if self.told.motion == "accelerometer":
                out[0, 3], out[1, 3] = 0.5 * h * h, h
            return out

        return Linear(A=A, B=B, h=lambda k: np.zeros(nx), C=lambda k: C,
                      Q=lambda k: self.covariance(float(lengths[min(k, last)]))[:, :, 0], R=lambda k: R, constant=False)


def _pace_sd(trip: Recording, position: float) -> float:
    """Standard deviation of a start speed that comes from the first two positions, m/s; 0 where a sensor tells it."""
    if {"speed", "odometer"} & set(trip.measured) or "position" not in trip.measured:
        return 0.0
    a, b = np.flatnonzero(np.isfinite(trip.measured["position"]))[:2]
    sd = trip.told.get("position", np.full(len(trip.time), np.nan))[[a, b]]
    return float(np.hypot(*np.where(np.isnan(sd), position, sd)) / (trip.time[b] - trip.time[a]))
