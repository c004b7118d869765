"""What a braking setting's file may say."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, NonNegativeFloat, PositiveFloat, model_validator

from ..arrays import Array
from ..channels import Channel, Ideal
from ..faults import Faults
from ..schema import ScenarioConfig, Strict

Point = Annotated[list[float], Field(min_length=2, max_length=2)]


class Plant(Strict):
    """Eq. (4) and the run's course.

    response_time tau (s); pade_rate lambda = 2 / delay (1/s); initial (D, v, a^, a_z); target: a_t as [time, value]
    points joined by straight lines and held at the ends (m/s^2); rate_start, rate_drift (1/s), rate_steps [time,
    change]: the braking rate f(t). until_standstill: the run ends when the speed reaches zero (else it turns
    negative, as eq. (4) says)."""

    kind: Literal["braking"]
    response_time: PositiveFloat
    pade_rate: PositiveFloat
    initial: Annotated[list[float], Field(min_length=4, max_length=4)]
    target: Annotated[list[Point], Field(min_length=1)]
    rate_start: NonNegativeFloat
    rate_drift: float = 0.0
    rate_steps: list[Point] = Field(default_factory=list)
    until_standstill: bool = False

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
    """White noise on the speed through E of eq. (4); variance per second, (m/s)^2/s.

    hold: how it enters a step: `impulse`, the speed alone at its end; `held`, as an acceleration constant over the step
    (Gamma of eq. (6) by exact hold of E: half of the step's change of speed counts for the way)."""

    speed_variance_rate: NonNegativeFloat
    hold: Literal["impulse", "held"] = "impulse"

    def entry(self, period: float) -> Array:
        """What a change of speed by one does to (D, v, a^, a_z) within its step, (4,)."""
        return np.array([period / 2 if self.hold == "held" else 0.0, 1.0, 0.0, 0.0])


class Sensors(Strict):
    """Measurement variances: displacement (m^2), speed ((m/s)^2), target acceleration a_z and, where given, control
    acceleration a^ ((m/s^2)^2)."""

    displacement_variance: PositiveFloat
    speed_variance: PositiveFloat
    target_acceleration_variance: PositiveFloat
    control_acceleration_variance: PositiveFloat | None = None

    def rows(self) -> list[tuple[str, int, float]]:
        """(name, state index, variance) of each measurement."""
        rows = [("displacement", 0, self.displacement_variance), ("speed", 1, self.speed_variance)]
        if self.control_acceleration_variance is not None:
            rows.append(("control-acceleration", 2, self.control_acceleration_variance))
        return [*rows, ("target-acceleration", 3, self.target_acceleration_variance)]


class Knowledge(Strict):
    """What an estimator is told.

    model: `grid` (four states, one mode per value of f), `augmented` (f appended, bilinear) or `scheduled` (f
    appended, a_z taken as known: linear). grid: values of f, in order. initial_variance of (D, v, a^, a_z).
    rate_prior: over the grid, `uniform`, or `normal` with the mean and variance of the next two. rate_initial,
    rate_initial_variance, rate_variance_rate (1/s): f as a random walk; target_variance_rate: process
    noise on a_z in the two models with f appended. nominal: the f of the grid model's plain linear part.
    speed_variance_rate ((m/s)^2/s) and the variances of the measurements: the truth's own where left out."""

    model: Literal["grid", "augmented", "scheduled"] = "grid"
    grid: Annotated[list[NonNegativeFloat], Field(min_length=1)]
    initial_variance: Annotated[list[NonNegativeFloat], Field(min_length=4, max_length=4)]
    rate_prior: Literal["uniform", "normal"] = "uniform"
    rate_initial: float = 1.0
    rate_initial_variance: PositiveFloat = 0.01
    rate_variance_rate: PositiveFloat = 1e-3
    target_variance_rate: NonNegativeFloat = 0.0
    nominal: NonNegativeFloat = 1.0
    speed_variance_rate: NonNegativeFloat | None = None
    displacement_variance: PositiveFloat | None = None
    speed_variance: PositiveFloat | None = None
    target_acceleration_variance: PositiveFloat | None = None
    control_acceleration_variance: PositiveFloat | None = None

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

    plant: Plant  # pyright: ignore[reportIncompatibleVariableOverride]
    disturbance: Disturbance  # pyright: ignore[reportGeneralTypeIssues, reportIncompatibleVariableOverride]
    sensors: Sensors  # pyright: ignore[reportGeneralTypeIssues, reportIncompatibleVariableOverride]
    channel: Channel = Ideal()  # pyright: ignore[reportIncompatibleVariableOverride]
    faults: Faults = ()  # pyright: ignore[reportIncompatibleVariableOverride]
    knowledge: Knowledge  # pyright: ignore[reportGeneralTypeIssues, reportIncompatibleVariableOverride]

    @model_validator(mode="after")
    def _consistent(self) -> BrakingConfig:
        self.channel.check(len(self.sensors.rows()))
        least = float(self.plant.rates(self.time.period, self.time.steps).min())
        if least < 0:
            raise ValueError(f"plant.rate_drift and plant.rate_steps take the braking rate to {least:g}: it must stay "
                             "at 0 or above until the last step")
        return self
