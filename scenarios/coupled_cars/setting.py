"""A train of coupled cars that reports over a shared radio channel (Zou et al. 2018, IEEE T-ITS), and its headway.

The truth feels a resistive force of which the estimators know a bound only; every car reports position and speed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from ..arrays import Array
from ..augmented import Extra
from ..channels import Csma
from ..measurement import Interval
from ..model import Bounds, DesignModel, Linear, Reception, linear_model, product, whole_steps
from ..observation import observe
from ..randomness import Streams
from ..setting import Outcome, Quantity, Setting
from ..world import Sensing, Trajectory
from .config import CoupledCarsConfig, Knowledge, headway_name, of_cars
from .plant import Matrices, largest_force, matrices, simulate


class CoupledCars(Setting[CoupledCarsConfig]):
    """State [x_1 .. x_n, v_1 .. v_n], car 1 in front; start at rest, couplers unstrained, estimators at
    the truth unless plant.start or plant.start_error says otherwise.

    `details` of the design model: `theta` and `varpi` of the knowledge; `mirror`, the orders of states, measurements
    and forces of the train turned around. `bounds`: G = E, w_bar = delta_i; the
    measurement noise is Gaussian and has no bound (infinite v_bar)."""

    kind = "coupled-cars"
    Config = CoupledCarsConfig
    files = ("cbtc-csma.toml",)

    @property
    def cars(self) -> int:
        return self.config.plant.cars

    def quantities(self) -> tuple[Quantity, ...]:
        n, weight = self.cars, self.config.performance
        cars = range(n)
        return (
            Quantity("position", "m", tuple((i, 1.0) for i in cars)),
            Quantity("speed", "m/s", tuple((n + i, 1.0) for i in cars)),
            Quantity("weighted", "1", (*((i, weight.position) for i in cars), *((n + i, weight.speed) for i in cars)),
                     mean=False),
            Quantity("position-front", "m", ((0, 1.0),)),
            Quantity("speed-front", "m/s", ((n, 1.0),)),
        )

    def table(self) -> tuple[tuple[str, str], ...]:
        return (("sum-squared", "weighted"), ("rmse", "position"), ("rmse", "speed"), ("max", "position-front"),
                ("bound", "performance"), ("mean-square", "performance"), ("nees", "state"),
                *(("headway", name) for name, _ in self._headways()))

    def world(self, streams: Streams) -> Trajectory:
        """u (K, driven cars, S) in N; y (K, 2n, S) in the sensors' own scale; the first step is the start itself."""
        steps, runs, n = self.config.time.steps, len(streams.runs), self.cars
        disturbance, sensors = self.config.disturbance, self.config.sensors
        plant = self._matrices()
        truth = np.empty((steps, 2 * n, runs))
        truth[0] = self._start()[:, None]
        phase = streams("truth").uniform(0.0, 1.0) if disturbance.ramp else np.zeros(runs)
        force = self.config.plant.forces(steps)
        c0, c1, c2 = disturbance.law
        simulate(plant.A, plant.B, plant.E, plant.h, force, self.config.plant.mass, c0, c1, c2, disturbance.ramp,
                 disturbance.ramp_length, phase, truth)
        y = streams("measurement").normal(steps, 2 * n)
        weight, noise = (np.repeat(pair, n)[:, None] for pair in (
            (sensors.position_weight, sensors.speed_weight), (sensors.position_noise, sensors.speed_noise)))
        for reading, state in zip(y, truth, strict=True):  # step by step they stay in the cache
            reading *= noise
            reading += weight * state
        trajectory = Trajectory(
            truth=truth,
            u=np.repeat(force[:, :, None], runs, axis=2),
            y=y,
            received=np.ones(y.shape, dtype=bool),
            active=np.ones((steps, runs), dtype=bool),
            lengths=np.concatenate([[0.0], np.full(steps - 1, self.config.time.period)]),
            initial_mean=self._believed(streams),
        )
        heard = observe(trajectory, streams, self.sensing(), self._channel(), self.config.faults,
                        weight * truth if self.config.faults else None)
        return replace(heard, extra={"received": heard.received.any(axis=1).astype(float)})

    def sensing(self) -> Sensing:
        n, sensors = self.cars, self.config.sensors
        names = [f"{what} {i + 1}" for what in ("position", "speed") for i in range(n)]
        ahead = np.repeat([1.0, 0.0], n)
        return Sensing(tuple(names), np.repeat([sensors.position_noise, sensors.speed_noise], n),
                       (ahead, sensors.position_weight * ahead))

    def design_model(self, knowledge: Mapping[str, Any], initial_mean: Array) -> DesignModel:
        """Linear; E f as a bounded force for bounds, as white noise of a share of the bound for covariances."""
        told: Knowledge = self.resolve_knowledge(knowledge)
        n, sensors, weight = self.cars, self.config.sensors, self.config.performance
        plant, delta = self._matrices(), self._delta(told)
        C = np.diag([sensors.position_weight] * n + [sensors.speed_weight] * n)
        R = np.diag([(told.position_noise or sensors.position_noise)**2] * n
                    + [(told.speed_noise or sensors.speed_noise)**2] * n)
        noisy = plant.E * (told.force_share * delta)
        Q = product(noisy, np.ascontiguousarray(noisy.T))
        linear = Linear(A=lambda k: plant.A, B=lambda k: plant.B, h=lambda k: plant.h, C=lambda k: C, Q=lambda k: Q,
                        R=lambda k: R)
        names = [str(i + 1) for i in range(n)]
        both = (*range(n - 1, -1, -1), *range(2 * n - 1, n - 1, -1))
        return linear_model(
            linear,
            states=(*(f"x{i}" for i in names), *(f"v{i}" for i in names)),
            measurements=(*(f"position {i}" for i in names), *(f"speed {i}" for i in names)),
            period=self.config.time.period,
            initial_mean=initial_mean,
            initial_covariance=np.diag(np.repeat(np.square(told.initial_sd), n))[:, :, None],
            bounds=Bounds(G=plant.E, w_bar=delta, v_bar=np.full(2 * n, np.inf)),
            reception=self._reception(told),
            performance=np.diag([weight.position] * n + [weight.speed] * n),
            details={"theta": told.theta, "varpi": told.varpi, "mirror": (both, both, both[:n])},
        )

    def extras(self, knowledge: Mapping[str, Any]) -> dict[str, tuple[Extra, ...]]:
        """The resistive force of each car in units of its delta_i, in place of white noise; it is smooth in truth."""
        delta = self._delta(self.resolve_knowledge(knowledge))

        @cache
        def columns() -> Array:  # not before a model asks: a file is read with every entry's extras
            return np.ascontiguousarray((self._matrices().E * delta).T)[:, :, None]

        def entering(car: int) -> Callable[[Interval], Array]:
            def gain(interval: Interval) -> Array:
                whole_steps(interval, "the force of a car")
                return columns()[car]

            return gain

        return {"force": tuple(Extra(f"force {i + 1}", "delta_i", "walk", 0.01, start_sd=0.2, instead=1.0,
                                     gain=entering(i)) for i in range(self.cars))}

    def outcomes(self, world: Any, metrics: Mapping[tuple[str, str], Array]) -> dict[Outcome, Array]:
        """Headway time in seconds, headway distance H_D in metres and trains per hour at each speed; the train's safety
        envelope l_S = L_train + L_error in metres (section II-B, H_D with l_S in place of L_train).

        L_error is the largest absolute error of car 1's position over the run, of the estimate that is scored (x^(k)
        before the packet of step k is used): that is what the zone controller has at hand between packets, and the
        paper's own L_error of 1.7 .. 2.05 m fits no other reading."""
        headway = self.config.headway
        error = metrics["max", "position-front"]
        envelope = headway.train_length + error
        out: dict[Outcome, Array] = {("envelope", "train", "m"): envelope}
        for name, speed in self._headways():
            time = (headway.safe_distance + envelope) / speed + headway.reaction_time + headway.braking_time
            out["headway", name, "s"] = time
            out["distance", name, "m"] = time * speed
            out["trains-per-hour", name, "1/h"] = 3600.0 / time
        return out

    def batch_bytes(self) -> int:
        n, driven = self.cars, len(self.config.plant.driven)
        return self.config.time.steps * (8 * (4 * n + driven + 2) + 2 * n + 1)

    def _headways(self) -> list[tuple[str, float]]:
        return [(headway_name(speed), speed) for speed in self.config.headway.speeds]

    def _matrices(self) -> Matrices:
        plant = self.config.plant
        return matrices(plant.mass, plant.stiffness, plant.slack + plant.car_length, plant.driven,
                        self.config.time.period)

    def _start(self) -> Array:
        plant = self.config.plant
        spacing = plant.slack + plant.car_length
        return np.array([*(spacing * (plant.cars - 1 - i) for i in range(plant.cars)), *[0.0] * plant.cars])

    def _believed(self, streams: Streams) -> Array:
        """The estimators' start (2n, S)."""
        plant, n = self.config.plant, self.cars
        mean = np.repeat(self._start()[:, None] if plant.start == "truth" else np.zeros((2 * n, 1)), len(streams.runs),
                         axis=1)
        if any(plant.start_error):
            mean += np.repeat(plant.start_error, n)[:, None] * streams("start").uniform(-1.0, 1.0, 2 * n)
        return mean

    def _channel(self) -> Any:
        return of_cars(self.config.channel, self.cars)

    def _reception(self, told: Knowledge) -> Reception:
        channel = self._channel()
        if told.trains is None or not isinstance(channel, Csma):
            return channel.reception()
        return Csma(kind="csma", p=channel.p, trains=told.trains, traffic="uniform").reception()

    def _delta(self, told: Knowledge) -> Array:
        """delta_i in N (n,)."""
        c0, c1, c2 = self.config.disturbance.law
        delta = largest_force(self.config.plant.mass, c0, c1, c2, self.config.disturbance.ramp, told.speed_limit)
        if told.delta is None:
            return delta
        if not delta.any():
            delta = np.ones(self.cars)
        return delta * (told.delta / float(np.linalg.norm(delta)))
