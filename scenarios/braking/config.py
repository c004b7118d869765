"""What a braking setting's file may say."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, NonNegativeFloat, PositiveFloat, model_validator

from ..arrays import Array
from ..channels import Channel, Ideal
from ..faults import Faults
from ..schema import TABLES, ScenarioConfig, Strict
from ..strict import KIND, key

Point = Annotated[list[float], Field(min_length=2, max_length=2)]


class Plant(Strict):
    """Eq. (4) and the run's course."""

    kind: Annotated[Literal["braking"], KIND]
    response_time: Annotated[PositiveFloat, key("tau of the brake", "s")]
    pade_rate: Annotated[PositiveFloat, key("lambda = 2 / delay of the Pade approximation", "1/s")]
    initial: Annotated[list[float], Field(min_length=4, max_length=4), key(
        "D, v, a^, a_z at the start", "[m, m/s, m/s^2, m/s^2]")]
    target: Annotated[list[Point], Field(min_length=1), key(
        "target deceleration a_t: points joined by straight lines, held at the ends", "[s, m/s^2]")]
    rate_start: Annotated[NonNegativeFloat, key("braking rate f at the start", "1")]
    rate_drift: Annotated[float, key("its constant drift", "1/s")] = 0.0
    rate_steps: Annotated[list[Point], key("its jumps: [time, change]", "[s, 1]")] = Field(default_factory=list)
    until_standstill: Annotated[bool, key(
        "whether a run ends when the speed reaches zero (else it turns negative, as eq. (4) says)")] = False

    @model_validator(mode="after")
    def _in_order(self) -> Plant:
        times = [time for time, _ in self.target]
        if any(later <= earlier for earlier, later in pairwise(times)):
            raise ValueError("target needs its [time, value] points in the order of time, each time once")
        return self

    def targets(self, period: float, steps: int) -> Array:
        """a_t over the step into k = 1..steps, held at its value at the step's beginning, shape (steps,)."""
        times, values = np.array(self.target).T
        return np.interp(period * np.arange(steps), times, values)

    def rates(self, period: float, steps: int) -> Array:
        """f over the step into k = 1..steps: its value at the step's end, shape (steps,)."""
        time = period * np.arange(1, steps + 1)
        out = np.full(steps, self.rate_start)
        out += self.rate_drift * time
        for when, change in self.rate_steps:
            out += np.where(time >= when - 1e-9, change, 0.0)
        return out


class Disturbance(Strict):
    """White noise on the speed through E of eq. (4)."""

    speed_variance_rate: Annotated[NonNegativeFloat, key("its variance per second", "(m/s)^2/s")]
    hold: Annotated[Literal["impulse", "held"], key(
        "impulse: on the speed alone at a step's end; held: an acceleration constant over the step (Gamma of eq. "
        "(6))")] = "impulse"

    def entry(self, period: float) -> Array:
        """What a change of speed by one does to (D, v, a^, a_z) within its step, (4,)."""
        return np.array([period / 2 if self.hold == "held" else 0.0, 1.0, 0.0, 0.0])


class Sensors(Strict):
    """Variances of the measurements."""

    displacement_variance: Annotated[PositiveFloat, key("of the displacement", "m^2")]
    speed_variance: Annotated[PositiveFloat, key("of the speed", "(m/s)^2")]
    target_acceleration_variance: Annotated[PositiveFloat, key("of the target acceleration a_z", "(m/s^2)^2")]
    control_acceleration_variance: Annotated[PositiveFloat | None, key(
        "of the control acceleration a^; none: not measured", "(m/s^2)^2")] = None

    def rows(self) -> list[tuple[str, int, float]]:
        """(name, state index, variance) of each measurement."""
        rows = [("displacement", 0, self.displacement_variance), ("speed", 1, self.speed_variance)]
        if self.control_acceleration_variance is not None:
            rows.append(("control-acceleration", 2, self.control_acceleration_variance))
        return [*rows, ("target-acceleration", 3, self.target_acceleration_variance)]


class Knowledge(Strict):
    """What an estimator is told."""

    model: Annotated[Literal["grid", "augmented", "scheduled"], key(
        "grid: four states, one mode per value of f; augmented: f appended, bilinear; scheduled: f appended, a_z "
        "taken as known, linear")] = "grid"
    grid: Annotated[list[NonNegativeFloat], Field(min_length=1), key("values of f, in order", "1")]
    initial_variance: Annotated[list[NonNegativeFloat], Field(min_length=4, max_length=4), key(
        "of D, v, a^, a_z", "[m^2, (m/s)^2, (m/s^2)^2, (m/s^2)^2]")]
    rate_prior: Annotated[Literal["uniform", "normal"], key(
        "over the grid: uniform, or normal with the next two")] = "uniform"
    rate_initial: Annotated[float, key("mean of f at the start", "1")] = 1.0
    rate_initial_variance: Annotated[PositiveFloat, key("its variance", "1")] = 0.01
    rate_variance_rate: Annotated[PositiveFloat, key("of f as a random walk", "1/s")] = 1e-3
    target_variance_rate: Annotated[NonNegativeFloat, key(
        "process noise on a_z in the two models with f appended", "(m/s^2)^2/s")] = 0.0
    nominal: Annotated[NonNegativeFloat, key("f of the grid model's plain linear part", "1")] = 1.0
    speed_variance_rate: Annotated[NonNegativeFloat | None, key(
        "variance per second of the noise on the speed; none: the truth's own", "(m/s)^2/s")] = None
    displacement_variance: Annotated[PositiveFloat | None, key(
        "of the displacement's sensor; none: the truth's own", "m^2")] = None
    speed_variance: Annotated[PositiveFloat | None, key("of the speed's; none: the truth's own", "(m/s)^2")] = None
    target_acceleration_variance: Annotated[PositiveFloat | None, key(
        "of a_z's; none: the truth's own", "(m/s^2)^2")] = None
    control_acceleration_variance: Annotated[PositiveFloat | None, key(
        "of a^'s; none: the truth's own", "(m/s^2)^2")] = None

    @model_validator(mode="after")
    def _monotone(self) -> Knowledge:
        steps = np.diff(self.grid)
        if not (np.all(steps > 0) or np.all(steps < 0)):
            raise ValueError("grid needs its values in increasing or decreasing order, each once")
        return self

    @property
    def prior(self) -> Array:
        """Probabilities of the grid's values (m,)."""
        weight = np.ones(len(self.grid))
        if self.rate_prior == "normal":
            weight = np.exp(-0.5 * (np.array(self.grid) - self.rate_initial) ** 2 / self.rate_initial_variance)
        return weight / weight.sum()


class BrakingConfig(ScenarioConfig):
    """The braking scenario, resolved for one variant."""

    plant: Annotated[Plant, TABLES["plant"]]  # pyright: ignore[reportIncompatibleVariableOverride]
    disturbance: Annotated[Disturbance, TABLES["disturbance"]]  # pyright: ignore[reportGeneralTypeIssues, reportIncompatibleVariableOverride]
    sensors: Annotated[Sensors, TABLES["sensors"]]  # pyright: ignore[reportGeneralTypeIssues, reportIncompatibleVariableOverride]
    channel: Annotated[Channel, TABLES["channel"]] = Ideal()  # pyright: ignore[reportIncompatibleVariableOverride]
    faults: Annotated[Faults, TABLES["faults"]] = ()  # pyright: ignore[reportIncompatibleVariableOverride]
    knowledge: Annotated[Knowledge, TABLES["knowledge"]]  # pyright: ignore[reportGeneralTypeIssues, reportIncompatibleVariableOverride]

    @model_validator(mode="after")
    def _consistent(self) -> BrakingConfig:
        self.channel.check(len(self.sensors.rows()))
        least = float(self.plant.rates(self.time.period, self.time.steps).min())
        if least < 0:
            raise ValueError(f"plant.rate_drift and plant.rate_steps take the braking rate to {least:g}: it must stay "
                             "at 0 or above until the last step")
        return self
