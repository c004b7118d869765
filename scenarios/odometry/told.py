"""What odometry estimators are told: motion by the accelerometer or by wheel counts, and what each sensor is worth.

Dead reckoning takes distance and speed from the counts it hears; the others carry bias and scales as states."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from pydantic import NonNegativeFloat, PositiveFloat

from ..arrays import Array, Mask
from ..measurement import Interval, Measurement, told
from ..model import DesignModel
from ..railway.dynamics import Slope
from ..schema import Strict
from . import motion as compiled
from .inclusion import Limits
from .motion import MEAN, RADAR, SCALE_A, SCALE_B, S, V

INPUTS = ("reading", "effort", "standing", "distance-a", "distance-b", "speed-a", "speed-b", "free", "still-mean",
          "still-count")
"""The inputs told of each step: the accelerometer's reading m/s^2 (the gradient's pull in it), the force of drive or
brakes over the mass m/s^2, whether the train stands, distance m of each wheel in the step, its mean speed of late m/s;
the last three see `inclusion`."""
READING, EFFORT, STANDING, DISTANCE_A, DISTANCE_B, SPEED_A, SPEED_B = range(7)


class Initial(Strict):
    """Standard deviations of the start: position m, speed m/s, accelerometer's bias m/s^2, the scale of each wheel and
    of the radar."""

    position: PositiveFloat
    speed: PositiveFloat
    bias: PositiveFloat
    scale: PositiveFloat
    radar: PositiveFloat


class Slip(Strict):
    """Each axle's slip as a mode: enter, leave 1/s; sd m/s of a slipping axle's reading."""

    enter: PositiveFloat
    leave: PositiveFloat
    sd: PositiveFloat


class Knowledge(Strict):
    """motion: `accelerometer`, or dead reckoning by a wheel's count: `wheel-a`, `wheel-b`, or `minmax`: braking the
    faster, in traction the slower, else their mean.

    acceleration m/s^2: standard deviation of the reading's noise over 0.1 s. bias_walk m/s^2, scale_walk: random walks,
    per sqrt(s). limits: bounds, for set-membership. gnss_inflation: factor on the standard deviation that the receiver
    tells. slip: for filters of modes."""

    motion: Literal["accelerometer", "wheel-a", "wheel-b", "minmax"]
    limits: Limits
    acceleration: PositiveFloat
    bias_walk: NonNegativeFloat
    scale_walk: NonNegativeFloat
    gnss_inflation: PositiveFloat = 1.0
    slip: Slip
    initial: Initial


@dataclass(frozen=True)
class Odometer:
    """The model's functions for given knowledge. sensors: names of the measurements; variances (ny,): what each is
    worth where it tells nothing itself. whole: what `_clock` says of whole steps, by the number of runs."""

    told: Knowledge
    sensors: tuple[str, ...]
    variances: Array
    period: float
    slope: Slope
    whole: dict[int, tuple[Array, Mask, Mask]] = field(default_factory=dict)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states in their order."""
        if self.told.motion != "accelerometer":
            return "position", "speed"
        radar = ("scale-radar",) if "radar" in self.sensors else ()
        return "position", "speed", "bias", "scale-a", "scale-b", "mean-speed", *radar

    def _clock(self, interval: Interval, runs: int) -> tuple[Array, Mask, Mask]:
        """Length s, whether it begins its step, whether it is the whole of it; (S,) each."""
        if isinstance(interval.length, float) and interval.share == 1.0:
            if runs not in self.whole:
                self.whole[runs] = np.full(runs, self.period), np.ones(runs, dtype=bool), np.ones(runs, dtype=bool)
            return self.whole[runs]
        length = np.broadcast_to(np.asarray(interval.length, dtype=float), (runs,))
        since = np.asarray(interval.start) - interval.depart * self.period
        fresh = np.broadcast_to(since < 1e-6 * self.period, (runs,))
        whole = np.broadcast_to(np.asarray(interval.share) == 1.0, (runs,))
        return np.ascontiguousarray(length), np.ascontiguousarray(fresh), np.ascontiguousarray(whole)

    def transition(self, x: Array, u: Array, interval: Interval) -> Array:
        """x+ (nx, .., S) at the end of the interval; u (10, S): see `INPUTS`."""
        if self.told.motion != "accelerometer":
            return self._counted(x, u, interval)
        points = np.ascontiguousarray(x, dtype=float).reshape(x.shape[0], -1, x.shape[-1])
        out = np.empty_like(points)
        length, fresh, _ = self._clock(interval, x.shape[-1])
        compiled.transition(points, np.ascontiguousarray(u[READING]), length, fresh, self.period, self.slope, out)
        return out.reshape(x.shape)

    def _counted(self, x: Array, u: Array, interval: Interval) -> Array:
        """Position and speed by the wheels' counts."""
        out = np.array(x, dtype=float)
        a, b, motion = u[SPEED_A], u[SPEED_B], self.told.motion
        counted = np.asarray(u[DISTANCE_A]), np.asarray(u[DISTANCE_B])
        if motion == "minmax":
            effort = u[EFFORT]
            first = np.where(effort < 0, a >= b, a <= b)
            speed = np.where(effort == 0, 0.5 * (a + b), np.where(first, a, b))
            distance = np.where(effort == 0, 0.5 * (counted[0] + counted[1]), np.where(first, *counted))
        else:
            speed, distance = (a, counted[0]) if motion == "wheel-a" else (b, counted[1])
        share = np.asarray(interval.share, dtype=float)
        out[0] = np.where(share > 0, out[0] + share * distance, out[0])
        out[1] = np.where(share > 0, speed, out[1])
        return out

    def jacobian(self, x: Array, u: Array, interval: Interval) -> Array:
        """df/dx (nx, nx, S), (nx, nx, 1) over whole steps."""
        runs = 1 if isinstance(interval.length, float) and interval.share == 1.0 else x.shape[1]
        length, fresh, _ = self._clock(interval, runs)
        out = np.empty((len(self.states), len(self.states), runs))
        if self.told.motion != "accelerometer":
            out[:] = np.eye(2)[:, :, None]
            out[1, 1] = np.where(length > 0, 0.0, 1.0)
            return out
        compiled.jacobian(length, fresh, self.period, out)
        return out

    def covariance(self, x: Array, u: Array, interval: Interval) -> Array:
        """Q (nx, nx, S or 1)."""
        if self.told.motion != "accelerometer":
            return np.zeros((2, 2, 1))
        one = not np.ndim(interval.length)
        length, _, whole = self._clock(interval, 1 if one else x.shape[1])
        out = np.empty((len(self.states), len(self.states), len(length)))
        sd = self.told.acceleration * (0.1 / self.period) ** 0.5
        compiled.covariance(length, whole, self.period, sd, self.told.bias_walk, self.told.scale_walk, out)
        return out

    def measurement(self, x: Array, step: int) -> Array:
        """What the sensors would read (ny, .., S); a wheel its mean speed over the step."""
        if self.told.motion != "accelerometer":
            return np.stack([x[S] if name in ("balise", "gnss") else x[V] for name in self.sensors])
        rows = {"wheel-a": lambda: (1 + x[SCALE_A]) * x[MEAN], "wheel-b": lambda: (1 + x[SCALE_B]) * x[MEAN],
                "balise": lambda: x[S], "gnss": lambda: x[S], "radar": lambda: (1 + x[RADAR]) * x[V]}
        return np.stack([rows[name]() for name in self.sensors])

    def measurement_jacobian(self, x: Array, step: int) -> Array:
        """dh/dx (ny, nx, S)."""
        out = np.zeros((len(self.sensors), len(self.states), x.shape[1]))
        counted = self.told.motion != "accelerometer"
        for row, name in zip(out, self.sensors, strict=True):
            if name in ("balise", "gnss"):
                row[S] = 1.0
            elif counted:
                row[V] = 1.0
            else:
                moved, scale = (V, RADAR) if name == "radar" else (MEAN, SCALE_A if name == "wheel-a" else SCALE_B)
                row[moved], row[scale] = 1 + x[scale], x[moved]
        return out

    def noise(self, slipping: tuple[str, ...] = ()) -> Any:
        """R(measurement): as told; of slipping axles that of the mode, of satellites with the inflation."""
        own = np.diag(self.variances)[:, :, None]
        plain = told(lambda step: own)
        factor = {i: self.told.gnss_inflation**2 for i, name in enumerate(self.sensors) if name == "gnss"}
        slip = {i: self.told.slip.sd**2 for i, name in enumerate(self.sensors) if name in slipping}

        def covariance(measurement: Measurement) -> Array:
            R = plain(measurement)
            if slip or any(f != 1.0 for f in factor.values()):
                R = R.copy()
                for i, f in factor.items():
                    R[i, i] *= f
                for i, variance in slip.items():
                    R[i, i] = variance
            return R

        return covariance

    def model(self, initial_mean: Array, tells: tuple[str, ...], slipping: tuple[str, ...] = (),
              **parts: Any) -> DesignModel:
        """The design model; slipping: the axles that slip in it."""
        start = self.told.initial
        sd = {"position": start.position, "speed": start.speed, "bias": start.bias, "scale-a": start.scale,
              "scale-b": start.scale, "mean-speed": start.speed, "scale-radar": start.radar}
        return DesignModel(
            states=self.states, measurements=self.sensors, period=self.period, transition=self.transition,
            measurement=self.measurement, transition_jacobian=self.jacobian,
            measurement_jacobian=self.measurement_jacobian, process_covariance=self.covariance,
            measurement_covariance=self.noise(slipping),
            initial_mean=np.ascontiguousarray(initial_mean[:len(self.states)]),
            initial_covariance=np.diag([sd[name] ** 2 for name in self.states])[:, :, None], tells=tells, **parts)
