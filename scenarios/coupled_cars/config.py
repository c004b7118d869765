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
from ..schema import TABLES, ScenarioConfig, Strict
from ..strict import KIND, key


class Command(Strict):
    """Driving forces from a step on (Table II)."""

    start: Annotated[int, Field(ge=0), key("step from which on they hold", "1")]
    end: Annotated[float, key("force of each end car", "N")]
    middle: Annotated[float, key("force of each car between them", "N")]


class Plant(Strict):
    """n cars coupled by springs (eqs. (1), (2))."""

    kind: Annotated[Literal["coupled-cars"], KIND]
    cars: Annotated[int, Field(ge=2, le=64), key("number of cars n", "1")] = 6
    end_mass: Annotated[PositiveFloat, key("mass of the end cars", "kg")]
    middle_mass: Annotated[PositiveFloat, key("mass of the others", "kg")]
    masses: Annotated[list[PositiveFloat] | None, key("mass of each car, front first, in place of these", "kg")] = None
    start: Annotated[Literal["truth", "zero"], key(
        "what the estimators believe the start to be: the truth, or zero in every state")] = "truth"
    start_error: Annotated[list[NonNegativeFloat], Field(min_length=2, max_length=2), key(
        "their first errors are uniform within +- of that", "[m, m/s]")] = [0.0, 0.0]
    stiffness: Annotated[PositiveFloat, key("of a coupling", "N/m")]
    slack: Annotated[NonNegativeFloat, key("of a coupling", "m")]
    car_length: Annotated[PositiveFloat, key("length of a car", "m")]
    drive: Annotated[Literal["distributed", "push-pull"], key(
        "distributed: every car has a driving force (DD); push-pull: the end cars only (PPD)")] = "distributed"
    commands: Annotated[list[Command], Field(min_length=1), key("driving forces, in the order of their steps")]

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
    """Resistive force (Remark 2), all of it unknown to the estimators."""

    c0: Annotated[NonNegativeFloat, key("constant part", "N/kg")]
    c1: Annotated[NonNegativeFloat, key("part that grows with the speed", "N s/(m kg)")]
    c2: Annotated[NonNegativeFloat, key("part that grows with its square", "N s^2/(m^2 kg)")]
    scale: Annotated[NonNegativeFloat, key("factor on all three", "1")] = 1.0
    ramp: Annotated[NonNegativeFloat, key(
        "largest ramp force on a car, alternating along the line from a place that is random per run", "N")] = 0.0
    ramp_length: Annotated[PositiveFloat, key("length of line over which it alternates", "m")] = 4000.0

    @property
    def law(self) -> tuple[float, float, float]:
        """The coefficients c0, c1, c2 in force."""
        return self.scale * self.c0, self.scale * self.c1, self.scale * self.c2


class Sensors(Strict):
    """y = C x + w (eq. (4))."""

    position_weight: Annotated[PositiveFloat, key("c~1, weight of a position in C", "1")]
    speed_weight: Annotated[PositiveFloat, key("c~2, weight of a speed in C", "1")]
    position_noise: Annotated[PositiveFloat, key("standard deviation of w, in that scale", "m")]
    speed_noise: Annotated[PositiveFloat, key("standard deviation of w, in that scale", "m/s")]


class CarAccess(Strict):
    """Random access among the cars: each step exactly one car's position and speed arrive, all equally likely."""

    kind: Annotated[Literal["random-access-cars"], KIND]

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
    """What the estimators are told."""

    speed_limit: Annotated[PositiveFloat, key("delta_i is the resistive law at this speed (Remark 2)", "m/s")]
    delta: Annotated[NonNegativeFloat | None, key(
        "sqrt(sum delta_i^2), to which the delta_i are scaled; none: as they are", "N")] = None
    trains: Annotated[Annotated[list[PositiveInt], Field(min_length=2, max_length=2)] | None, key(
        "range of N(k) that the estimators reckon with; none: the channel's own", "1")] = None
    theta: Annotated[float, Field(gt=0, lt=1), key("decay asked of `ultimate-bound`", "1")] = 0.98
    varpi: Annotated[PositiveFloat, key("bound asked of `fastest-decay`", "1")]
    force_share: Annotated[NonNegativeFloat, key(
        "standard deviation of the white force that a Kalman filter takes for the resistive one, over delta_i", "1")]
    initial_sd: Annotated[list[NonNegativeFloat], Field(min_length=2, max_length=2), key(
        "standard deviations of the start, for covariances", "[m, m/s]")] = [0.0, 0.0]
    position_noise: Annotated[PositiveFloat | None, key("standard deviation of w; none: the sensors' own", "m")] = None
    speed_noise: Annotated[PositiveFloat | None, key("standard deviation of w; none: the sensors' own", "m/s")] = None

    @model_validator(mode="after")
    def _consistent(self) -> Knowledge:
        if self.trains is not None and self.trains[0] > self.trains[1]:
            raise ValueError("trains = [least, most] needs least <= most")
        return self


class Performance(Strict):
    """z = M x, M = diag(position I, speed I)."""

    position: Annotated[PositiveFloat, key("weight of positions", "1")]
    speed: Annotated[PositiveFloat, key("weight of speeds", "1")]


def headway_name(speed: float) -> str:
    """The quantity of the headway at a speed in m/s."""
    return f"headway-{3.6 * speed:.0f}"


class Headway(Strict):
    """Headway time (L_train + L_error + v reaction_time + v braking_time + L_safe) / v."""

    train_length: Annotated[NonNegativeFloat, key("L_train", "m")]
    safe_distance: Annotated[NonNegativeFloat, key("L_safe", "m")]
    reaction_time: Annotated[NonNegativeFloat, key("before the brakes act", "s")]
    braking_time: Annotated[NonNegativeFloat, key("braking distance over speed", "s")]
    speeds: Annotated[list[PositiveFloat], Field(min_length=1), key("v for which it is told", "m/s")]

    @model_validator(mode="after")
    def _apart(self) -> Headway:
        if len({headway_name(speed) for speed in self.speeds}) < len(self.speeds):
            raise ValueError("speeds must differ by 1 km/h or more")
        return self


class CoupledCarsConfig(ScenarioConfig):
    """A scenario with `plant.kind = "coupled-cars"`."""

    plant: Annotated[Plant, TABLES["plant"]]
    disturbance: Annotated[Disturbance, TABLES["disturbance"]]
    sensors: Annotated[Sensors, TABLES["sensors"]]
    channel: Annotated[AnyChannel, TABLES["channel"]]
    faults: Annotated[Faults, TABLES["faults"]] = ()
    knowledge: Annotated[Knowledge, TABLES["knowledge"]]
    performance: Annotated[Performance, key("what the certified bounds are about")]
    headway: Annotated[Headway, key("the headway that position errors cost")]

    @model_validator(mode="after")
    def _nodes_fit(self) -> CoupledCarsConfig:
        of_cars(self.channel, self.plant.cars).check(2 * self.plant.cars)
        return self
