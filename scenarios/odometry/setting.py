"""The odometry setting: what the truth is, what the sensors read of it, what the estimators are told.

The draws are the same in all variants of a scenario: dry and wet rail are compared on one driver and his sensors."""

# pyright: reportIncompatibleVariableOverride=false
from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ..arrays import Array, Mask
from ..errors import InputError
from ..model import DesignModel
from ..railway.dynamics import GRAVITY
from ..railway.odometer import Odometer, slip_modes
from ..randomness import Streams
from ..schema import ScenarioConfig
from ..sensors.balise import Passages
from ..setting import Outcome, Quantity, Setting
from ..world import World
from .config import OdometryConfig
from .inclusion import Intervals
from .plant import Drawn, Ride, simulate
from .told import Knowledge
from .world import OdometryWorld

MOVING = 0.05
"""Under this speed (m/s) a train counts as standing: neither errors nor requirements are scored."""


class Odometry(Setting[OdometryConfig]):
    """Truth [position m, speed m/s, accelerometer's bias m/s^2, way in the step m, scale of each measured wheel, that
    of the radar (where there is one)]. Scored from the first balise on while the train moves."""

    kind: ClassVar[str] = "odometry"
    Config: ClassVar[type[ScenarioConfig]] = OdometryConfig
    files: ClassVar[tuple[str, ...]] = ("odometry.toml",)
    user_files: ClassVar[tuple[str, ...]] = ("line", "train")
    references: ClassVar[bool] = True

    def quantities(self) -> tuple[Quantity, ...]:
        return Quantity("position", "m", ((0, 1.0),)), Quantity("speed", "m/s", ((1, 1.0),))

    @cached_property
    def steps(self) -> int:
        """Steps of the world: time.steps, or what the slowest driver needs.

        Raises InputError where he does not arrive."""
        plant, period = self.config.plant, self.config.time.period
        longest = (plant.line.stops[-1] - plant.line.stops[0]) / 1.0 + 60.0 * len(plant.line.stops) + 100.0
        slow = plant.driver.model_copy(update={
            "courage": [plant.driver.courage[0]] * 2, "braking": [plant.driver.braking[0]] * 2,
            "dwell": [plant.driver.dwell[1]] * 2})
        ride = self._ride(plant.model_copy(update={"driver": slow}), Streams(0, self.config.name, "", (0,)),
                          math.ceil(longest / period))[0]
        if ride.active[-1, 0]:
            raise InputError(f"{self.config.name}: the train does not reach its last stop: after {longest:.0f} s it is "
                             f"at {ride.state[-1, 0, 0]:.0f} m of {plant.line.stops[-1]:.0f} m")
        return max(self.config.time.steps, math.ceil(1.05 * float(ride.duration[0])))

    def batch_bytes(self) -> int:
        return self.steps * 8 * 48

    def _ride(self, plant: Any, common: Streams, steps: int) -> tuple[Ride, Passages]:
        """What is driven, and the balises of each run."""
        driver, line, balise = plant.driver, plant.line, self.config.sensors.balise
        random, runs = common("driver"), len(common.runs)
        courage, braking = random.uniform(*driver.courage), random.uniform(*driver.braking)
        dwell = np.full((len(line.stops) - 1, runs), driver.first)
        dwell[1:] = random.uniform(*driver.dwell, len(line.stops) - 2)
        place = common("reader").uniform(-1.0, 1.0, len(plant.places))
        rail = plant.adhesion.rail(line.stops, plant.tunnels, common("adhesion"))
        ride = simulate(plant, Drawn(courage, braking, dwell, rail, place), (balise.reader[0], balise.reader[1]),
                        self.config.time.period, steps)
        return ride, balise.draw(plant.places, plant.platforms, common("balise"))

    def world(self, streams: Streams) -> OdometryWorld:
        """u: see `INPUTS` of `told`; y: the sensors in use, in the order of `Sensors.measured`."""
        config, period = self.config, self.config.time.period
        plant, sensors, steps = config.plant, config.sensors, self.steps
        common = Streams(streams.seed, streams.scenario, "", streams.runs)
        ride, passages = self._ride(plant, common, steps)
        position, speed = ride.state[:, 0], ride.state[:, 1]
        counts, wheel_scale = sensors.wheel.count(ride.wheel, common("wheel"))
        distance = sensors.wheel.travelled(counts)
        reading, bias = sensors.accelerometer.read(ride.acceleration, self._climb(position, common), period,
                                                   common("accelerometer"))
        smooth = sensors.wheel.speed(counts, period)
        u = np.stack([reading, ride.force, np.ones_like(reading), distance[:, 0], distance[:, 1], smooth[:, 0],
                      smooth[:, 1], ride.standing.astype(float), *self._calm(reading, ride)], axis=1)
        worth = sensors.wheel.variance(distance, ride.standing, period)
        everywhere = np.ones(position.shape, dtype=bool)
        fixed, seen = sensors.gnss.read(position, plant.tunnels, period, common("gnss"))
        doppler, heard, radar_scale = sensors.radar.read(speed, common("radar"))
        readings: dict[str, tuple[Array, Mask, Array]] = {
            "wheel-a": (distance[:, 0], everywhere, worth[:, 0]),
            "wheel-b": (distance[:, 1], everywhere, worth[:, 1]),
            "balise": (np.zeros_like(position), ~everywhere, np.ones_like(position)),
            "gnss": (fixed, seen, np.full_like(position, sensors.gnss.told**2)),
            "radar": (doppler, heard, np.full_like(position, sensors.radar.noise**2))}
        names = sensors.measured
        y, variance = (np.stack([readings[name][i] for name in names], axis=1).astype(float) for i in (0, 2))
        there = np.stack([readings[name][1] for name in names], axis=1)
        arrived = config.channel.draw(streams("channel"), steps, len(names))
        way = np.diff(position, axis=0, prepend=np.full((1, len(streams.runs)), plant.line.stops[0]))
        scales = {"wheel-a": wheel_scale[0], "wheel-b": wheel_scale[1], "radar": radar_scale}
        truth = np.stack([position, speed, bias, way, *(np.repeat(scales[name][None], steps, axis=0)
                                                        for name in names if name in scales)], axis=1)
        return OdometryWorld(
            truth=truth, u=u, y=y, received=there & arrived, variance=variance, active=ride.active, period=period,
            balise=names.index("balise") if "balise" in names else -1, heard=arrived, passages=passages, ride=ride,
            balise_variance=sensors.balise.variance(passages.sd), start=plant.line.stops[0], moving=MOVING)

    def _calm(self, reading: Array, ride: Ride) -> tuple[Array, Array, Array]:
        """Inputs `free`, `still-mean` and `still-count`, (K, S) each."""
        steps = np.arange(len(reading))[:, None]
        braking = ride.force < -self.config.knowledge.limits.braking
        braked = np.maximum.accumulate(np.where(braking, steps, -10**9), axis=0)
        moved = np.maximum.accumulate(np.where(ride.standing, -1, steps), axis=0)
        count = np.where(ride.standing, steps - moved, 0)
        total = np.concatenate([np.zeros((1, reading.shape[1])), np.cumsum(reading, axis=0)])
        mean = (total[1:] - np.take_along_axis(total, moved + 1, axis=0)) / np.maximum(count, 1)
        since = np.asarray((steps - braked) * self.config.time.period, dtype=np.float64)
        return since, np.asarray(mean, dtype=np.float64), count.astype(np.float64)

    def _climb(self, position: Array, common: Streams) -> Array:
        """The gradient's pull as the accelerometer feels it (K, S), m/s^2: the map's, with an error per section."""
        pairs = np.array(self.config.plant.line.gradients)
        off = self.config.sensors.gradient * common("gradient").normal(len(pairs))
        section = np.clip(np.searchsorted(pairs[:, 0], position, side="right") - 1, 0, None)
        rotating = self.config.plant.train.rotating
        return GRAVITY / (1 + rotating) * (pairs[section, 1] + np.take_along_axis(off, section, axis=0))

    def design_model(self, knowledge: Mapping[str, Any], initial_mean: Array) -> DesignModel:
        """See `Odometer`; with slip modes where the motion is the accelerometer's and wheels are measured."""
        told: Knowledge = self.resolve_knowledge(knowledge)
        sensors, plant, period = self.config.sensors, self.config.plant, self.config.time.period
        names = sensors.measured
        location = float(sensors.balise.variance(np.array([sensors.balise.location[0]]))[0])
        own = {"wheel-a": sensors.wheel.pulse / 6**0.5, "wheel-b": sensors.wheel.pulse / 6**0.5,
               "gnss": sensors.gnss.told, "radar": sensors.radar.noise, "balise": location**0.5}
        odometer = Odometer(told, {name: own[name] for name in names}, period, plant.line.slope(plant.train.rotating))
        tells = names if told.motion == "accelerometer" else ()
        bounded = Intervals(told.limits, odometer.slope, sensors.wheel.pulse, period,
                            names.index("balise") if "balise" in names else -1)
        return odometer.model(initial_mean, tells, inclusion=bounded.inclusion(plant.line.stops[0]),
                              modes=slip_modes(odometer, initial_mean, tells))

    def outcomes(self, world: World, metrics: Mapping[tuple[str, str], Array]) -> dict[Outcome, Array]:
        """The trip's time, s, and seconds that each axle slid."""
        assert isinstance(world, OdometryWorld)
        return {("time", "trip", "s"): world.ride.duration * self.config.time.period,
                ("time", "slide-a", "s"): world.ride.slides[0], ("time", "slide-b", "s"): world.ride.slides[1]}
