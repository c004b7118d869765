"""A train of coupled cars that reports over a shared radio channel (Zou et al. 2018, IEEE T-ITS), and its headway.

The truth feels a resistive force of which the estimators know a bound only; every car reports position and speed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt, model_validator

from .channels import Channel, Csma, RandomAccess
from .coupled_cars_plant import Matrices, largest_force, matrices, simulate
from .model import Bounds, DesignModel, Linear, Reception, linear_model, product
from .randomness import Streams
from .schema import ScenarioConfig, Strict
from .setting import Outcome, Quantity, Setting
from .world import Trajectory

Array = NDArray[np.float64]


class Command(Strict):
    """Driving forces in N of the end cars and of the cars between them, from step `start` on (Table II)."""

    start: Annotated[int, Field(ge=0)]
    end: float
    middle: float


class Plant(Strict):
    """n cars coupled by springs (eqs. (1), (2)).

    cars: n; masses: kg of each car, front first, where they are not end_mass for the end cars and middle_mass for the
    others. stiffness N/m, slack m, car_length m. drive: `distributed`, every car has a driving force (DD), or
    `push-pull`, the end cars only (PPD). commands in the order of their steps."""

    kind: Literal["coupled-cars"]
    cars: Annotated[int, Field(ge=2, le=64)] = 6
    end_mass: PositiveFloat
    middle_mass: PositiveFloat
    masses: list[PositiveFloat] | None = None
    stiffness: PositiveFloat
    slack: NonNegativeFloat
    car_length: PositiveFloat
    drive: Literal["distributed", "push-pull"] = "distributed"
    commands: Annotated[list[Command], Field(min_length=1)]

    @model_validator(mode="after")
    def _consistent(self) -> Plant:
        if self.masses is not None and len(self.masses) != self.cars:
            raise ValueError(f"masses has {len(self.masses)} entries for cars = {self.cars}: one each is needed")
        starts = [command.start for command in self.commands]
        if starts[0] != 0 or starts != sorted(set(starts)):
            raise ValueError("commands must start at step 0 and follow each other in time")
        return self

    @property
    def mass(self) -> Array:
        """Mass of each car (n,), kg."""
        if self.masses is not None:
            return np.array(self.masses)
        return np.array([self.end_mass, *[self.middle_mass] * (self.cars - 2), self.end_mass])

    @property
    def driven(self) -> list[int]:
        """The cars with a driving force."""
        return list(range(self.cars)) if self.drive == "distributed" else [0, self.cars - 1]

    def forces(self, steps: int) -> Array:
        """Driving forces (steps, nu) over the interval that *ends* at each step; zero before step 0."""
        out = np.zeros((steps, len(self.driven)))
        for command in self.commands:
            force = [command.end if car in (0, self.cars - 1) else command.middle for car in self.driven]
            out[command.start + 1:] = force
        return out


class Disturbance(Strict):
    """Resistive force (Remark 2), all of it unknown to the estimators: c0 N/kg, c1 N s/(m kg), c2 N s^2/(m^2 kg), all
    three times `scale`; ramp: largest ramp force on a car in N, alternating over ramp_length metres of line, from a
    place that is random per run."""

    c0: NonNegativeFloat
    c1: NonNegativeFloat
    c2: NonNegativeFloat
    scale: NonNegativeFloat = 1.0
    ramp: NonNegativeFloat = 0.0
    ramp_length: PositiveFloat = 4000.0

    @property
    def law(self) -> tuple[float, float, float]:
        """The coefficients c0, c1, c2 in force."""
        return self.scale * self.c0, self.scale * self.c1, self.scale * self.c2


class Sensors(Strict):
    """y = C x + w (eq. (4)): weights c~1, c~2 of position and speed in C, standard deviations of w in that scale."""

    position_weight: PositiveFloat
    speed_weight: PositiveFloat
    position_noise: PositiveFloat
    speed_noise: PositiveFloat


class CarAccess(Strict):
    """Random access among the cars: each step exactly one car's position and speed arrive, all equally likely."""

    kind: Literal["random-access-cars"]

    def of(self, cars: int) -> RandomAccess:
        """The channel for a train of that many cars."""
        return RandomAccess(kind="random-access", p=[1 / cars] * cars, nodes=[[i, cars + i] for i in range(cars)])


AnyChannel = Annotated[Channel | CarAccess, Field(discriminator="kind")]


class Knowledge(Strict):
    """What the estimators are told.

    speed_limit m/s: delta_i is the resistive law at this speed (Remark 2). delta: sqrt(sum delta_i^2) in N, to which
    the delta_i are scaled. trains: range of N(k) the estimators reckon with, the channel's own where left out. theta,
    varpi: decay asked of `ultimate-bound`, bound asked of `fastest-decay`. force_share: standard deviation of the
    white process noise force that a Kalman filter takes for the resistive force, as a share of delta_i."""

    speed_limit: PositiveFloat
    delta: NonNegativeFloat | None = None
    trains: Annotated[list[PositiveInt], Field(min_length=2, max_length=2)] | None = None
    theta: Annotated[float, Field(gt=0, lt=1)] = 0.98
    varpi: PositiveFloat
    force_share: NonNegativeFloat

    @model_validator(mode="after")
    def _consistent(self) -> Knowledge:
        if self.trains is not None and self.trains[0] > self.trains[1]:
            raise ValueError("trains = [least, most] needs least <= most")
        return self


class Performance(Strict):
    """Weights of z = M x, M = diag(position I, speed I)."""

    position: PositiveFloat
    speed: PositiveFloat


def headway_name(speed: float) -> str:
    """The quantity of the headway at a speed in m/s."""
    return f"headway-{3.6 * speed:.0f}"


class Headway(Strict):
    """Headway time (L_train + L_error + v reaction_time + v braking_time + L_safe) / v at the speeds v (m/s).

    train_length, safe_distance m; reaction_time s; braking_time s: braking distance over speed."""

    train_length: NonNegativeFloat
    safe_distance: NonNegativeFloat
    reaction_time: NonNegativeFloat
    braking_time: NonNegativeFloat
    speeds: Annotated[list[PositiveFloat], Field(min_length=1)]

    @model_validator(mode="after")
    def _apart(self) -> Headway:
        if len({headway_name(speed) for speed in self.speeds}) < len(self.speeds):
            raise ValueError("speeds must differ by 1 km/h or more")
        return self


class CoupledCarsConfig(ScenarioConfig):
    """A scenario with `plant.kind = "coupled-cars"`."""

    plant: Plant  # pyright: ignore[reportIncompatibleVariableOverride, reportGeneralTypeIssues]
    disturbance: Disturbance  # pyright: ignore[reportIncompatibleVariableOverride, reportGeneralTypeIssues]
    sensors: Sensors  # pyright: ignore[reportIncompatibleVariableOverride, reportGeneralTypeIssues]
    channel: AnyChannel  # pyright: ignore[reportIncompatibleVariableOverride, reportGeneralTypeIssues]
    knowledge: Knowledge  # pyright: ignore[reportIncompatibleVariableOverride, reportGeneralTypeIssues]
    performance: Performance
    headway: Headway

    @model_validator(mode="after")
    def _nodes_fit(self) -> CoupledCarsConfig:
        if not isinstance(self.channel, CarAccess):
            self.channel.check(2 * self.plant.cars)
        return self


class CoupledCars(Setting[CoupledCarsConfig]):
    """State [x_1 .. x_n, v_1 .. v_n], car 1 in front; start at rest, couplers unstrained, estimators at the truth.

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
        )

    def table(self) -> tuple[tuple[str, str], ...]:
        return (("sum-squared", "weighted"), ("rmse", "position"), ("rmse", "speed"), ("max", "position-front"),
                ("bound", "performance"), ("mean-square", "performance"), ("nees", "state"),
                *(("headway", name) for name, _ in self._headways()))

    def world(self, streams: Streams) -> Trajectory:
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
        for rows, weight, noise in ((slice(0, n), sensors.position_weight, sensors.position_noise),
                                    (slice(n, None), sensors.speed_weight, sensors.speed_noise)):
            y[:, rows] *= noise
            y[:, rows] += weight * truth[:, rows]
        received = self._channel().draw(streams("channel"), steps, 2 * n)
        return Trajectory(
            truth=truth,
            u=np.repeat(force[:, :, None], runs, axis=2),
            y=y,
            received=received,
            active=np.ones((steps, runs), dtype=bool),
            portions=np.concatenate([[0.0], np.ones(steps - 1)]),
            initial_mean=truth[0].copy(),
            extra={"received": received.any(axis=1).astype(float)},
        )

    def design_model(self, knowledge: Mapping[str, Any], initial_mean: Array) -> DesignModel:
        told: Knowledge = self.resolve_knowledge(knowledge)
        n, sensors, weight = self.cars, self.config.sensors, self.config.performance
        plant, delta = self._matrices(), self._delta(told)
        C = np.diag([sensors.position_weight] * n + [sensors.speed_weight] * n)
        R = np.diag([sensors.position_noise**2] * n + [sensors.speed_noise**2] * n)
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
            initial_covariance=np.zeros((2 * n, 2 * n, 1)),
            bounds=Bounds(G=plant.E, w_bar=delta, v_bar=np.full(2 * n, np.inf)),
            reception=self._reception(told),
            performance=np.diag([weight.position] * n + [weight.speed] * n),
            details={"theta": told.theta, "varpi": told.varpi, "mirror": (both, both, both[:n])},
        )

    def outcomes(self, world: Any, metrics: Mapping[tuple[str, str], Array]) -> dict[Outcome, Array]:
        """Headway time in seconds and trains per hour at each speed.

        L_error is the largest absolute error of car 1's position over the run, of the estimate that is scored (x^(k)
        before the packet of step k is used): that is what the zone controller has at hand between packets, and the
        paper's own L_error of 1.7 .. 2.05 m fits no other reading."""
        headway = self.config.headway
        error = metrics["max", "position-front"]
        out: dict[Outcome, Array] = {}
        for name, speed in self._headways():
            distance = headway.train_length + headway.safe_distance + error
            time = distance / speed + headway.reaction_time + headway.braking_time
            out["headway", name, "s"] = time
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

    def _channel(self) -> Any:
        channel = self.config.channel
        return channel.of(self.cars) if isinstance(channel, CarAccess) else channel

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
