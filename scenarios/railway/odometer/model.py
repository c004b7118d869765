"""What odometry estimators are told: motion by the accelerometer or by wheel counts, and what each sensor is worth.

Dead reckoning takes distance and speed from the counts it hears; the others carry bias and scales as states."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from pydantic import NonNegativeFloat, PositiveFloat

from ...arrays import Array, Index, Mask
from ...compiled import WholeSteps
from ...measurement import Interval, Measurement, PerRun, told
from ...model import DesignModel
from ...schema import Strict
from ...strict import key
from ..dynamics import Slope
from . import motion as compiled
from .motion import (
    BEGINS,
    BIAS,
    DISTANCE_A,
    DISTANCE_B,
    EFFORT,
    READING,
    SPEED_A,
    SPEED_B,
    TRAVELLED,
    S,
    V,
)

PLACES = ("position", "balise", "gnss")
"""Measurements of the position; `wheel-..` is what a wheel has rolled since it was last read, m, the others speeds."""


class Initial(Strict):
    """Standard deviations of the start."""

    position: Annotated[PositiveFloat, key("of the position", "m")]
    speed: Annotated[PositiveFloat, key("of the speed", "m/s")]
    bias: Annotated[PositiveFloat, key("of the accelerometer's bias", "m/s^2")]
    scale: Annotated[PositiveFloat, key("of the scale of each wheel", "1")]
    radar: Annotated[PositiveFloat, key("of the scale of the radar", "1")] = 0.005


class Slip(Strict):
    """Each axle's slip as a mode."""

    enter: Annotated[PositiveFloat, key("rate at which slip begins", "1/s")]
    leave: Annotated[PositiveFloat, key("rate at which it ends", "1/s")]
    sd: Annotated[PositiveFloat, key("standard deviation of a slipping axle's reading", "m/s")]


class OdometerKnowledge(Strict):
    """What a model of wheels that slip is told."""

    motion: Annotated[str, key(
        "accelerometer (or what else a setting calls it), or dead reckoning by a wheel's count: wheel-a, wheel-b, "
        "or minmax: braking the faster, in traction the slower, else their mean")]
    acceleration: Annotated[PositiveFloat, key("standard deviation of the reading's noise over 0.1 s", "m/s^2")]
    bias_walk: Annotated[NonNegativeFloat, key("random walk of its bias", "m/s^2 per sqrt(s)")]
    scale_walk: Annotated[NonNegativeFloat, key("random walk of the scales", "1 per sqrt(s)")]
    gnss_inflation: Annotated[PositiveFloat, key(
        "factor on the standard deviation that a satellite receiver tells", "1")] = 1.0
    slip: Annotated[Slip, key("slip as modes, for filters of modes")]
    initial: Annotated[Initial, key("standard deviations of the start")]

    @property
    def counting(self) -> bool:
        """Whether it is dead reckoning."""
        return self.motion in ("wheel-a", "wheel-b", "minmax")


@dataclass(frozen=True)
class Odometer:
    """The model's functions for given knowledge. deviations: by measurement in their order, what each is worth where it
    tells nothing itself. period s: in which modes change and slip counts; parts of a step need steps of just this
    length. inputs: how many inputs stand before `INPUTS`. whole: what `_clock` says of steps of a period, by the number
    of runs."""

    told: OdometerKnowledge
    deviations: Mapping[str, float]
    period: float
    slope: Slope
    inputs: int = 0
    whole: dict[int, tuple[Array, Mask]] = field(default_factory=dict)

    @cached_property
    def sensors(self) -> tuple[str, ...]:
        """Names of the measurements in their order."""
        return tuple(self.deviations)

    @cached_property
    def wheels(self) -> tuple[str, ...]:
        """The wheels among them."""
        return tuple(name for name in self.deviations if name.startswith("wheel-"))

    @cached_property
    def states(self) -> tuple[str, ...]:
        """Names of the states in their order."""
        if self.told.counting:
            return "position", "speed"
        return "position", "speed", "bias", "travelled", *self._scales

    @property
    def _scales(self) -> tuple[str, ...]:
        scaled = (*self.wheels, *(["radar"] if "radar" in self.deviations else []))
        return tuple(f"scale-{name.removeprefix('wheel-')}" for name in scaled)

    def _clock(self, interval: Interval, runs: int) -> tuple[Array, Mask]:
        """Length s, whether it is the whole of its step; (S,) each."""
        usual = self._usual(interval)
        if usual and runs in self.whole:
            return self.whole[runs]
        length, whole = _each(interval.length, runs), _each(interval.share, runs) == 1.0
        if usual:
            self.whole[runs] = length, whole
        return length, whole

    def _fresh(self, u: Array, interval: Interval, whole: Mask) -> Mask:
        """Whether what wheels have rolled starts anew where the interval begins (S,)."""
        begins = u[BEGINS, :len(whole)] > 0
        if isinstance(interval.share, float) and interval.share == 1.0:
            return begins
        since = np.asarray(interval.start) - interval.depart * self.period
        return begins & (whole | (since < 1e-6 * self.period))

    def transition(self, x: Array, u: Array, interval: Interval) -> Array:
        """x+ (nx, .., S) at the end of the interval; u (nu, S): see `INPUTS`."""
        u = u[self.inputs:]
        if self.told.counting:
            return self._counted(x, u, interval)
        points = np.ascontiguousarray(x, dtype=float).reshape(x.shape[0], -1, x.shape[-1])
        out = np.empty_like(points)
        length, whole = self._clock(interval, x.shape[-1])
        compiled.transition(points, np.ascontiguousarray(u[READING]), length, self._fresh(u, interval, whole),
                            self.slope, out)
        return out.reshape(x.shape)

    def _counted(self, x: Array, u: Array, interval: Interval) -> Array:
        """Position and speed by the wheels' counts."""
        points = np.ascontiguousarray(x, dtype=float).reshape(x.shape[0], -1, x.shape[-1])
        out, runs, u = np.empty_like(points), x.shape[-1], np.ascontiguousarray(u)
        length, _ = self._clock(interval, runs)
        compiled.counted(points, u[EFFORT], u[DISTANCE_A:DISTANCE_B + 1], u[SPEED_A:SPEED_B + 1], self._motion,
                         _each(interval.share, runs), length, out)
        return out.reshape(x.shape)

    @property
    def _motion(self) -> int:
        """How wheels' counts move it, see `motion.counted`; -1 where they do not."""
        return ("wheel-a", "wheel-b", "minmax").index(self.told.motion) if self.told.counting else -1

    def _whole(self, functions: tuple[Any, ...], slipping: tuple[str, ...]) -> WholeSteps:
        """These functions over whole periods, in machine code."""
        data = compiled.packed(len(self.states), self.inputs, self._motion, self._rows, self.slope)
        Q = np.zeros((2, 2, 1)) if self.told.counting else self._steady
        return WholeSteps(*compiled.addresses(), data, Q, np.array(self._noise(slipping)), functions)

    def jacobian(self, x: Array, u: Array, interval: Interval) -> Array:
        """df/dx (nx, nx, S), (nx, nx, 1) over whole steps that all runs share."""
        runs = 1 if isinstance(interval.length, float) and interval.share == 1.0 else x.shape[1]
        length, whole = self._clock(interval, runs)
        out = np.empty((len(self.states), len(self.states), runs))
        if self.told.counting:
            out[:] = np.eye(2)[:, :, None]
            out[1, 1] = np.where(length > 0, 0.0, 1.0)
            return out
        compiled.jacobian(length, self._fresh(u[self.inputs:], interval, whole), out)
        return out

    def covariance(self, x: Array, u: Array, interval: Interval) -> Array:
        """Q (nx, nx, S or 1)."""
        if self.told.counting:
            return np.zeros((2, 2, 1))
        return self._steady if self._usual(interval) else self._covariance(interval, x.shape[1])

    @cached_property
    def _steady(self) -> Array:
        """Q of a whole step."""
        return self._covariance(Interval(1, 0.0, self.period, 1.0), 1)

    def _covariance(self, interval: Interval, runs: int) -> Array:
        length, whole = self._clock(interval, runs if np.ndim(interval.length) else 1)
        out = np.empty((len(self.states), len(self.states), len(length)))
        compiled.covariance(length, whole, 0.1 * self.told.acceleration**2, self._walks, out)
        return out

    def _usual(self, interval: Interval) -> bool:
        """Whether it is a whole step of a period, in all runs."""
        return isinstance(interval.length, float) and interval.share == 1.0 and interval.length == self.period

    @cached_property
    def _walks(self) -> Array:
        """Random walks of the states (nx,), per sqrt(s)."""
        walks = np.zeros(len(self.states))
        walks[BIAS], walks[TRAVELLED + 1:TRAVELLED + 1 + len(self.wheels)] = self.told.bias_walk, self.told.scale_walk
        return walks

    @cached_property
    def _rows(self) -> Index:
        """For each sensor (ny, 2) the state that it reads, and that of its scale, -1 for none. Dead reckoning reads no
        wheels: their counts are its inputs."""
        def row(name: str) -> tuple[int, int]:
            scale = f"scale-{name.removeprefix('wheel-')}"
            wheel = name in self.wheels and not self.told.counting
            return (S if name in PLACES else TRAVELLED if wheel else V,
                    self.states.index(scale) if scale in self.states else -1)

        return np.array([row(name) for name in self.sensors], dtype=np.int64).reshape(-1, 2)

    def measurement(self, x: Array, step: int) -> Array:
        """What the sensors would read (ny, .., S)."""
        points = np.ascontiguousarray(x, dtype=float).reshape(x.shape[0], -1, x.shape[-1])
        out = np.empty((len(self._rows), *points.shape[1:]))
        compiled.readings(points, self._rows, out)
        return out.reshape(-1, *x.shape[1:])

    def measurement_jacobian(self, x: Array, step: int) -> Array:
        """dh/dx (ny, nx, S)."""
        out = np.empty((len(self._rows), len(self.states), x.shape[1]))
        compiled.reading_jacobian(np.ascontiguousarray(x, dtype=float), self._rows, out)
        return out

    def _noise(self, slipping: tuple[str, ...]) -> tuple[Array, Array, Array]:
        """Of each sensor (ny,): its own variance where it tells none, a factor on either (of satellites the inflation),
        and what it is whatever it tells (of slipping axles the mode's), NaN of others."""
        names, slip = self.sensors, (self.told.slip.sd * self.period) ** 2
        return (np.array([*self.deviations.values()]) ** 2,
                np.array([self.told.gnss_inflation**2 if name in ("gnss", "position") else 1.0 for name in names]),
                np.array([slip if name in slipping else np.nan for name in names]))

    def noise(self, slipping: tuple[str, ...] = ()) -> Any:
        """R(measurement): as told; of slipping axles that of the mode, of satellites with the inflation."""
        own, factor, fixed = self._noise(slipping)
        untold = np.diag(own)[:, :, None]
        plain, given = told(lambda step: untold), np.isfinite(fixed)[:, None]
        if not given.any() and (factor == 1.0).all():
            return plain
        each, scale, instead = np.arange(len(own)), factor[:, None], fixed[:, None]

        def covariance(measurement: Measurement) -> Array:
            R = np.array(plain(measurement))
            R[each, each] = np.where(given, instead, scale * R[each, each])
            return R

        return covariance

    def model(self, initial_mean: Array, tells: tuple[str, ...], slipping: tuple[str, ...] = (),
              **parts: Any) -> DesignModel:
        """The design model; initial_mean (2 or more, S): position and speed, then all else, 0 where it ends; slipping:
        the axles that slip in it."""
        start = self.told.initial
        sd = {"position": start.position, "speed": start.speed, "bias": start.bias,
              "travelled": start.speed * self.period, "scale-radar": start.radar}
        mean = np.zeros((len(self.states), initial_mean.shape[1]))
        known = min(len(mean), len(initial_mean))
        mean[:known] = initial_mean[:known]
        noise = self.noise(slipping)
        return DesignModel(
            states=self.states, measurements=self.sensors, period=self.period, transition=self.transition,
            measurement=self.measurement, transition_jacobian=self.jacobian,
            measurement_jacobian=self.measurement_jacobian, process_covariance=self.covariance,
            linear_measurement=bool((self._rows[:, 1] < 0).all()), measurement_covariance=noise, initial_mean=mean,
            whole=self._whole((self.transition, self.jacobian, self.measurement, self.measurement_jacobian,
                               self.covariance, noise), slipping),
            initial_covariance=np.diag([sd.get(name, start.scale) ** 2 for name in self.states])[:, :, None],
            tells=tells, **parts)


def _each(value: PerRun, runs: int) -> Array:
    """A number for each run (S,)."""
    return value if isinstance(value, np.ndarray) and value.shape == (runs,) else np.full(runs, value, dtype=float)
