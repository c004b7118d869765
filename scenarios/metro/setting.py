"""The metro setting: a train under bounded disturbance on one section or a whole line (Ningbo Line 7, Liu et al. 2025).

Truth: `metro_trip`; what estimators are told: the same acceleration law without the disturbance, and its bounds."""

# pyright: reportIncompatibleVariableOverride=false
from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ..aboard import Aboard, hearing, sense
from ..aboard.sensing import Trip as Ridden
from ..arrays import Array
from ..augmented import Extra, augmented
from ..compiled import Compiled
from ..densities import uniform
from ..errors import InputError, Unsupported
from ..faults import Jump
from ..measurement import Interval
from ..measurement import told as told_covariance
from ..model import Bounds, DesignModel
from ..observation import observe
from ..railway import dynamics
from ..railway.curvature import pieces, slope_change
from ..railway.odometer import INPUTS, Odometer, slip_modes
from ..railway.trip import Reference, Trip, simulate
from ..randomness import Streams
from ..schema import ScenarioConfig
from ..setting import Matched, Outcome, Quantity, Setting
from ..world import Later, Sensing, Trajectory, World
from .config import Knowledge, MetroConfig
from .disturbance import UNTOUCHED
from .inclusion import Rectangles


class Metro(Setting[MetroConfig]):
    """State [position m, speed m/s], input u in [-1, 1]: share of the greatest traction or braking force."""

    kind: ClassVar[str] = "metro"
    Config: ClassVar[type[ScenarioConfig]] = MetroConfig
    files: ClassVar[tuple[str, ...]] = ("ningbo-metro.toml",)
    user_files: ClassVar[tuple[str, ...]] = ("line", "train")

    def quantities(self) -> tuple[Quantity, ...]:
        return Quantity("position", "m", ((0, 1.0),)), Quantity("speed", "m/s", ((1, 1.0),))

    @cached_property
    def steps(self) -> int:
        """Steps of the world: time.steps, or more where the slowest trip over the line (w = -w_bar) needs them.

        Raises InputError where that trip does not end."""
        plant, time = self.config.plant, self.config.time
        line, w_bar = plant.line, self.config.disturbance.w_bar
        longest = (line.stops[-1] - line.stops[0]) / 1.0 + plant.controller.dwell * len(line.stops) + 100.0
        w = np.full((max(time.steps, math.ceil(longest / time.period)), 1), -w_bar)
        trip = self._simulate(w, UNTOUCHED, False)
        if trip.active[-1, 0]:
            raise InputError(f"{self.config.name}: the train does not reach its last stop: after {longest:.0f} s of "
                             f"w = -w_bar it is at {trip.state[-1, 0, 0]:.0f} m of {line.stops[-1]:.0f} m")
        return max(time.steps, math.ceil(1.05 * float(trip.active.sum())))

    def _simulate(self, w: Array, factors: Array, physical: bool) -> Trip:
        plant = self.config.plant
        plan = Reference.of(plant.line, plant.heaviest, plant.controller, self.config.disturbance.w_bar)
        return simulate(plant.line, plant.train, plant.controller, plan, plant.ease, self.start,
                        self.config.time.period, w, factors, self.config.disturbance.w_bar, physical)

    @property
    def sections(self) -> tuple[str, ...]:
        """Names of the sections of a trip with stops on the way; none where there is only the one."""
        count = len(self.config.plant.line.stops) - 1
        return tuple(f"section-{i + 1:02d}" for i in range(count)) if count > 1 else ()

    def outcomes(self, world: World, metrics: Mapping[tuple[str, str], Array]) -> dict[Outcome, Array]:
        """Of a trip with stops on the way: how far the train stayed under its speed limits, at the least."""
        if not self.sections or not isinstance(world, Trajectory):
            return {}
        room = np.where(world.active, world.extra["speed-limit"] - world.truth[:, 1], np.inf)
        return {("least", "room-under-limit", "m/s"): room.min(axis=0)}

    @property
    def start(self) -> tuple[float, float]:
        """True position (m) and speed (m/s) at the start."""
        return self.config.plant.line.stops[0], self.config.plant.start_speed

    def batch_bytes(self) -> int:
        return self.steps * 8 * (12 if not self.config.sensors.aboard else 60)

    def world(self, streams: Streams) -> Trajectory:
        """u (K, 1, S) in shares of the greatest force; y (K, 2, S): position m, speed m/s."""
        config, plant = self.config, self.config.plant
        steps, period = self.steps, config.time.period
        random, sensed = streams("truth"), streams("measurement")
        error = random.uniform(-1.0, 1.0, 2) * np.array(plant.start_error)[:, None]
        factors = config.disturbance.factors(random)
        w = config.disturbance.draw(random, steps, period)
        trip = self._simulate(w, factors, config.disturbance.form == "physical")
        y = config.sensors.draw(sensed, steps, period)
        y += trip.state
        own, state = config.sensors.own, trip.state
        if len(own) < 2:
            y, state = y[:, own], state[:, own]
        there, u = np.ones(y.shape, dtype=bool), trip.u
        aboard = self._aboard(trip, streams)
        if aboard:
            y, there, state = aboard.beside(y, state)
            u = np.concatenate([u, aboard.inputs], axis=1)

        def extra() -> dict[str, Array]:
            position = trip.state[:, 0]
            return {"disturbance": trip.w, "reference-speed": trip.reference,
                    "speed-limit": plant.line.limit(position), "gradient": plant.line.gradient(position),
                    **({f"slide-{axle}": aboard.slides[:, j].astype(float) for j, axle in enumerate("ab")}
                       if aboard and plant.adhesion else {})}

        trajectory = Trajectory(
            truth=trip.state, u=u, y=y, received=there,
            active=trip.active, lengths=np.full(steps, period), initial_mean=np.array(self.start)[:, None] + error,
            windows=self.sections, window=trip.section if self.sections else None,
            extra=Later(extra))
        heard = observe(trajectory, streams, self.sensing(), config.channel, config.faults, state)
        return aboard.heard(heard) if aboard else heard

    @property
    def references(self) -> bool:
        """Whether balises are read on the way."""
        return "balise" in self.config.sensors.use

    def _aboard(self, trip: Trip, streams: Streams) -> Aboard | None:
        """What sensors aboard read; None where none is used."""
        plant, sensors = self.config.plant, self.config.sensors
        if not sensors.aboard:
            return None
        start = np.repeat(np.array(self.start)[:, None], trip.state.shape[2], axis=1)
        position, speed = (np.concatenate([start[i:i + 1], trip.state[:, i]]) for i in range(2))
        ridden = Ridden(position, speed, np.full(len(trip.state), self.config.time.period), plant.line, plant.train)
        return sense(ridden, sensors.fitted, sensors, plant, plant.balises.on(plant.line), streams)

    def matched(self, runs: int) -> Matched | None:
        """Disturbance and noise that are fresh each step, or a constant disturbance as a state, by their moments; the
        start by those of its uniform errors, which the first seconds outweigh."""
        form, noise, start = self.config.disturbance.form, self.config.sensors.noise, np.array(self.start)
        if form not in ("gaussian", "white", "constant") or noise == "biased" or self.config.plant.loads or (
                set(self.config.sensors.use) != {"position", "speed"}):
            return None
        bar = self.config.disturbance.w_bar
        told = {"sigma_w": bar / {"gaussian": 3.0, "white": 3.0**0.5, "constant": 1.0}[form],
                "sigma_v": self.config.sensors.sd.tolist(),
                "initial_sd": [error / 3.0**0.5 for error in self.config.plant.start_error]}
        model = self.design_model(told, np.repeat(start[:, None], runs, axis=1))
        if form == "constant":
            model = augmented(model, [replace(self.extras(told)["disturbance"][0], kind="constant")])
        return Matched(model, "floor" if form == noise == "gaussian" else "linear optimum")

    def sensing(self) -> Sensing:
        sensors = self.config.sensors
        along = np.array([float(name in ("position", "balise", "gnss")) for name in sensors.measured])
        return Sensing(sensors.measured, np.concatenate([sensors.sd[sensors.own], sensors.deviations(sensors.fitted)]),
                       (np.array([1.0, 0.0]), along))

    def resolve_knowledge(self, knowledge: Mapping[str, Any]) -> Any:
        """An entry's own w_bar and v_bar are bounds alone: its standard deviations stay those of the scenario, unless
        it says other `moments`. Raises pydantic's ValidationError."""
        told: Knowledge = self.config.knowledge
        kept = {} if "moments" in knowledge else {"sigma_w": told.process_sd, "sigma_v": told.sensor_sd.tolist()}
        return super().resolve_knowledge({**kept, **knowledge})

    def design_model(self, knowledge: Mapping[str, Any], initial_mean: Array) -> DesignModel:
        """The plant without its disturbance; for bounds the linearisation error of M = [T/2, 1]', N = [0, kappa]. With
        sensors aboard see `hearing`, and `Odometer` where the motion told is not the force's. Raises Unsupported where
        sensors lack that a motion needs."""
        told: Knowledge = self.resolve_knowledge(knowledge)
        if told.odometry.motion != "force":
            return self._odometer(told, initial_mean)
        sensors = self.config.sensors
        train, line, period = self.config.plant.train, self.config.plant.line, self.config.time.period
        forces, slope, curves = train.forces, line.slope(train.rotating), pieces(train.forces)
        whole = np.full(initial_mean.shape[1], period)

        def seconds(interval: Interval, runs: int) -> Array:
            if isinstance(interval.share, float) and interval.share == 1.0 and runs == len(whole):
                return whole
            return np.broadcast_to(np.asarray(interval.length, dtype=float), (runs,)).copy()

        jumps = [fault for fault in self.config.faults if isinstance(fault, Jump) and fault.truth]

        law = dynamics.constants(forces, slope)

        def given(interval: Interval, runs: int) -> tuple[Array, Array]:
            return law, seconds(interval, runs)

        inputs = 1 if not sensors.aboard else 1 + len(INPUTS)
        driven = Compiled(dynamics.driven, inputs, given)

        def jumping(x: Array, u: Array, interval: Interval) -> Array:
            """The vehicle has jumped: so have the coordinates of the line under it."""
            moved = sum((jump.shift(interval.start) for jump in jumps), np.zeros(1))
            out = driven(np.stack([x[0] - moved, x[1]]), u, interval)
            out[0] += moved
            return out

        transition = jumping if jumps else driven
        gamma = np.array([[0.5 * period * period], [period]]) * told.process_sd
        once = (gamma * gamma.T)[:, :, None]
        density = period * told.process_sd**2

        def process_covariance(x: Array, u: Array, interval: Interval) -> Array:
            """A disturbance held over the whole step, gamma gamma', as the page has it. No covariance that adds up over
            parts of a step equals that one: parts take white acceleration, whose speed variance adds up to the same."""
            if isinstance(interval.share, float) and interval.share == 1.0:
                return once
            h = np.atleast_1d(np.asarray(interval.length, dtype=float))
            parts = density * np.array([[h * h * h / 3, h * h / 2], [h * h / 2, h]])
            return np.where(np.asarray(interval.share) == 1.0, once, parts)

        def kappa(x: Array, u: Array, Pi: Array) -> Array:
            out = np.full(x.shape[1], told.kappa or 0.0)
            if told.kappa is None:
                slope_change(x[1], u[0], Pi, period, forces, curves, out)
            return out

        gain = np.array([[0.5 * period**2], [period]])
        own = sensors.own
        rows, noise = np.eye(2)[own][:, :, None], np.diag(told.sensor_sd[own]**2)[:, :, None]
        both, v_bar = len(own) == 2, np.array(told.v_bar)
        model = DesignModel(
            states=("position", "speed"), measurements=sensors.measured[:len(own)], period=period,
            transition=transition, measurement=lambda x, step: x if both else x[own],
            transition_jacobian=Compiled(dynamics.driven_jacobian, inputs, given, square=True),
            measurement_jacobian=lambda x, step: rows, linear_measurement=True,
            process_covariance=process_covariance, measurement_covariance=told_covariance(lambda step: noise),
            initial_mean=initial_mean, initial_covariance=np.diag(np.square(told.initial_sd))[:, :, None],
            bounds=Bounds(G=gain, w_bar=np.array([told.w_bar]), v_bar=v_bar[own],
                          M=np.array([[0.5 * period], [1.0]]), N=np.array([[0.0, 1.0]]), kappa=kappa),
            reception=self.config.channel.reception(),
            densities=uniform(lambda interval: _entering(interval)[:, None], np.array([told.w_bar]),
                              v_bar) if told.densities == "uniform" else None)
        if told.densities == "uniform" and (sensors.fitted or not both):
            raise Unsupported("densities = \"uniform\" needs the sensors of position and speed, and no other")
        reads = (*((i, float(v_bar[i])) for i in own), *((0, sensors.bound(name)) for name in sensors.fitted))
        surely = Rectangles(transition, told.w_bar, reads).inclusion(initial_mean,
                                                                     np.array(self.config.plant.start_error))
        return replace(hearing(model, sensors.fitted, sensors, told.odometry.scale_walk), inclusion=surely)

    def _odometer(self, told: Knowledge, initial_mean: Array) -> DesignModel:
        """The model of `odometry` with this train's sensors. Raises Unsupported where the motion lacks one."""
        sensors, plant = self.config.sensors, self.config.plant
        lacking = told.odometry.lacks(sensors.use)
        if lacking:
            raise Unsupported(lacking)
        own = dict(zip(("position", "speed"), told.sensor_sd.tolist(), strict=True))
        worth = {name: own[name] if name in own else sensors.worth(name) for name in sensors.measured}
        odometer = Odometer(told.odometry, worth, self.config.time.period, plant.line.slope(plant.train.rotating), 1)
        tells = () if told.odometry.counting else tuple(
            name for name in sensors.fitted if name.startswith("wheel-"))
        return odometer.model(initial_mean, tells, modes=slip_modes(odometer, initial_mean, tells),
                              reception=self.config.channel.reception())

    def extras(self, knowledge: Mapping[str, Any]) -> dict[str, tuple[Extra, ...]]:
        """The acceleration disturbance in place of white noise, and a slowly varying bias of either sensor."""
        told: Knowledge = self.resolve_knowledge(knowledge)
        sensors = self.config.sensors
        biases = {f"{name}-bias": (Extra(f"{name}-bias", unit, "gauss-markov", float(sd), time_constant=20.0,
                                         column=np.array([float(other == name) for other in sensors.measured])),)
                  for name, unit, sd in zip(("position", "speed"), ("m", "m/s"), told.sensor_sd, strict=True)
                  if name in sensors.use}
        states = ("position", "speed")
        with suppress(Unsupported):  # it is told where the model is made
            states = self.design_model(knowledge, np.zeros((2, 1))).states

        def gain(interval: Interval) -> Array:
            moved = _entering(interval)
            return np.stack([moved[0] if name == "travelled" else moved[i] if i < 2 else 0.0 * moved[0]
                             for i, name in enumerate(states)])

        return {"disturbance": (Extra("disturbance", "m/s^2", "gauss-markov", told.process_sd, time_constant=8.0,
                                      gain=_entering if len(states) == 2 else gain, instead=1.0),), **biases}


def _entering(interval: Interval) -> Array:
    """What a disturbing acceleration does to position and speed within an interval, (2, S or 1)."""
    h = np.atleast_1d(np.asarray(interval.length, dtype=float))
    return np.array([0.5 * h * h, h])
