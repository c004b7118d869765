"""The braking setting: a train that brakes while its braking rate f drifts or drops (Zheng, Han, Kong, Wang 2015).

Truth is eq. (4) with exact zero-order hold; estimators are told a grid of f, or f as a random walk."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, NonNegativeFloat, PositiveFloat, model_validator

from .braking_plant import Told, Walk, augmented_model, discretise, grid_model, scheduled_model
from .channels import Channel, Ideal
from .model import DesignModel
from .randomness import Streams
from .schema import ScenarioConfig, Strict
from .setting import Quantity, Setting
from .world import Trajectory

Array = NDArray[np.float64]
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
    """White noise on the speed through E of eq. (4); variance per second, (m/s)^2/s."""

    speed_variance_rate: NonNegativeFloat


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
    rate_initial, rate_initial_variance, rate_variance_rate (1/s): f as a random walk; target_variance_rate: process
    noise on a_z in the two models with f appended. nominal: the f of the grid model's plain linear part."""

    model: Literal["grid", "augmented", "scheduled"] = "grid"
    grid: Annotated[list[NonNegativeFloat], Field(min_length=1)]
    initial_variance: Annotated[list[NonNegativeFloat], Field(min_length=4, max_length=4)]
    rate_initial: float = 1.0
    rate_initial_variance: PositiveFloat = 0.01
    rate_variance_rate: PositiveFloat = 1e-3
    target_variance_rate: NonNegativeFloat = 0.0
    nominal: NonNegativeFloat = 1.0

    @model_validator(mode="after")
    def _monotone(self) -> Knowledge:
        steps = np.diff(self.grid)
        if not (np.all(steps > 0) or np.all(steps < 0)):
            raise ValueError("grid needs its values in increasing or decreasing order, each once")
        return self


class BrakingConfig(ScenarioConfig):
    """The braking scenario, resolved for one variant."""

    plant: Plant  # pyright: ignore[reportIncompatibleVariableOverride]
    disturbance: Disturbance  # pyright: ignore[reportGeneralTypeIssues, reportIncompatibleVariableOverride]
    sensors: Sensors  # pyright: ignore[reportGeneralTypeIssues, reportIncompatibleVariableOverride]
    channel: Channel = Ideal()  # pyright: ignore[reportIncompatibleVariableOverride]
    knowledge: Knowledge  # pyright: ignore[reportGeneralTypeIssues, reportIncompatibleVariableOverride]

    @model_validator(mode="after")
    def _consistent(self) -> BrakingConfig:
        self.channel.check(len(self.sensors.rows()))
        least = float(self.plant.rates(self.time.period, self.time.steps).min())
        if least < 0:
            raise ValueError(f"plant.rate_drift and plant.rate_steps take the braking rate to {least:g}: it must stay "
                             "at 0 or above until the last step")
        return self


class Braking(Setting[BrakingConfig]):
    """Joint estimation of the braking rate f and the state (D, v, a^, a_z)."""

    kind: ClassVar[str] = "braking"
    Config = BrakingConfig
    files: ClassVar[tuple[str, ...]] = ("braking-rate.toml",)

    def __init__(self, config: BrakingConfig) -> None:
        super().__init__(config)
        plant = config.plant
        self.plant = discretise(plant.response_time, plant.pade_rate, config.time.period)
        self.targets = plant.targets(config.time.period, config.time.steps)
        self.rates = plant.rates(config.time.period, config.time.steps)

    def quantities(self) -> tuple[Quantity, ...]:
        return (Quantity("f", "1", ((4, 1.0),)), Quantity("displacement", "m", ((0, 1.0),)),
                Quantity("speed", "m/s", ((1, 1.0),)), Quantity("control-acceleration", "m/s^2", ((2, 1.0),)),
                Quantity("target-acceleration", "m/s^2", ((3, 1.0),)))

    def table(self) -> tuple[tuple[str, str], ...]:
        """Mean absolute errors, as the paper's tables; the error at the end of the run counts where a train stops."""
        return (*(("mae", item.name) for item in self.quantities()), ("final", "displacement"), ("nees", "state"))

    def world(self, streams: Streams) -> Trajectory:
        """Truth (K, 5, S) = (D, v, a^, a_z, f) at k = 1..K, measurements and what arrives of them.

        With `until_standstill` the run ends within the step in which the speed crosses zero, at the displacement that
        constant deceleration over that step gives; the train then stays there, and is scored no further."""
        config = self.config
        steps, period, runs = config.time.steps, config.time.period, len(streams.runs)
        noise = np.sqrt(config.disturbance.speed_variance_rate * period) * streams("truth").normal(steps)
        start = np.repeat(np.array(config.plant.initial)[:, None], runs, axis=1)
        truth, active = np.empty((steps, 5, runs)), np.ones((steps, runs), dtype=bool)
        x, moving = start, np.ones(runs, dtype=bool)
        for k in range(steps):
            moved = self.plant.step(x, self.rates[k], self.targets[k])
            moved[1] += noise[k]
            active[k] = moving
            if config.plant.until_standstill:
                stops = moved[1] <= 0
                share = np.where(stops, x[1] / np.where(stops, x[1] - moved[1], 1.0), 1.0)
                moved[0] = np.where(stops, x[0] + 0.5 * x[1] * share * period, moved[0])
                moved[1] = np.where(stops, 0.0, moved[1])
                moved = np.where(moving, moved, x)
                moving = moving & ~stops
            x = moved
            truth[k, :4], truth[k, 4] = x, self.rates[k]
        rows = config.sensors.rows()
        y = streams("measurement").normal(steps, len(rows))
        for row, (_, state, variance) in enumerate(rows):
            y[:, row] = truth[:, state] + np.sqrt(variance) * y[:, row]
        received = config.channel.draw(streams("channel"), steps, len(rows))
        u = np.repeat(self.targets[:, None, None], runs, axis=2)
        return Trajectory(truth, u, y, received, active, np.ones(steps), start)

    def design_model(self, knowledge: Mapping[str, Any], initial_mean: Array) -> DesignModel:
        """Four states with modes over the grid of f, or five with f appended, as `knowledge.model` says."""
        told_of = self.resolve_knowledge(knowledge)
        period = self.config.time.period
        rows = self.config.sensors.rows()
        C = np.zeros((len(rows), 4))
        for row, (_, state, _) in enumerate(rows):
            C[row, state] = 1.0
        told = Told(self.plant, period, initial_mean, np.array(told_of.initial_variance),
                    self.config.disturbance.speed_variance_rate * period, C,
                    np.diag([variance for *_, variance in rows]), tuple(name for name, *_ in rows))
        if told_of.model == "grid":
            return grid_model(told, np.array(told_of.grid), told_of.nominal)
        walk = Walk(told_of.rate_initial, told_of.rate_initial_variance, told_of.rate_variance_rate * period,
                    told_of.target_variance_rate * period)
        return augmented_model(told, walk) if told_of.model == "augmented" else scheduled_model(told, walk,
                                                                                                  self.targets)
