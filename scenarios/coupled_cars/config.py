"""Schema of coupled-cars scenario files: train, resistance, sensors, channel, what estimators know, headway.

What each number means stands here; where it comes from stands in the scenario file."""

# Each setting narrows the types of the common tables, which are frozen: pyright takes them for mutable.
# pyright: reportIncompatibleVariableOverride=false, reportGeneralTypeIssues=false

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt, model_validator

from ..arrays import Array
from ..channels import Channel, Delay, OneAtATime, RandomAccess
from ..faults import Faults
from ..schema import ScenarioConfig, Strict


class Command(Strict):
    """Driving forces in N of the end cars and of the cars between them, from step `start` on (Table II)."""

    start: Annotated[int, Field(ge=0)]
    end: float
    middle: float


class Plant(Strict):
    """n cars coupled by springs (eqs. (1), (2)).

    cars: n; masses: kg of each car, front first, where they are not end_mass for the end cars and middle_mass for the
    others. start: what the estimators believe it to be, the truth or zero in every state;
    start_error: their first errors are uniform within +-[m, m/s] of that. stiffness N/m, slack m, car_length m.
    drive: `distributed`, every car has a driving force (DD), or `push-pull`, the end cars only (PPD).
    commands in the order of their steps."""

    kind: Literal["coupled-cars"]
    cars: Annotated[int, Field(ge=2, le=64)] = 6
    end_mass: PositiveFloat
    middle_mass: PositiveFloat
    masses: list[PositiveFloat] | None = None
    start: Literal["truth", "zero"] = "truth"
    start_error: Annotated[list[NonNegativeFloat], Field(min_length=2, max_length=2)] = [0.0, 0.0]
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


def of_cars(channel: AnyChannel, cars: int) -> Channel:
    """The channel as it is for a train of that many cars: each car is a node where no nodes are given."""
    if isinstance(channel, CarAccess):
        return channel.of(cars)
    nodes = {"nodes": [[i, cars + i] for i in range(cars)]}
    if isinstance(channel, OneAtATime) and not channel.nodes:
        return channel.model_copy(update=nodes)
    if isinstance(channel, Delay) and isinstance(channel.loss, OneAtATime) and not channel.loss.nodes:
        return channel.model_copy(update={"loss": channel.loss.model_copy(update=nodes)})
    return channel


class Knowledge(Strict):
    """What the estimators are told.

    speed_limit m/s: delta_i is the resistive law at this speed (Remark 2). delta: sqrt(sum delta_i^2) in N, to which
    the delta_i are scaled. trains: range of N(k) the estimators reckon with, the channel's own where left out. theta,
    varpi: decay asked of `ultimate-bound`, bound asked of `fastest-decay`. force_share: standard deviation of the
    white process noise force that a Kalman filter takes for the resistive force, as a share of delta_i. initial_sd
    [m, m/s]: standard deviations of the start, for covariances. position_noise, speed_noise: standard deviations of w,
    the sensors' own where left out."""

    speed_limit: PositiveFloat
    delta: NonNegativeFloat | None = None
    trains: Annotated[list[PositiveInt], Field(min_length=2, max_length=2)] | None = None
    theta: Annotated[float, Field(gt=0, lt=1)] = 0.98
    varpi: PositiveFloat
    force_share: NonNegativeFloat
    initial_sd: Annotated[list[NonNegativeFloat], Field(min_length=2, max_length=2)] = [0.0, 0.0]
    position_noise: PositiveFloat | None = None
    speed_noise: PositiveFloat | None = None

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

    plant: Plant
    disturbance: Disturbance
    sensors: Sensors
    channel: AnyChannel
    faults: Faults = ()
    knowledge: Knowledge
    performance: Performance
    headway: Headway

    @model_validator(mode="after")
    def _nodes_fit(self) -> CoupledCarsConfig:
        of_cars(self.channel, self.plant.cars).check(2 * self.plant.cars)
        return self
