"""What an odometry scenario's file may say of plant and sensors; what estimators are told is in `told`."""

# pyright: reportIncompatibleVariableOverride=false
from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, NonNegativeFloat, PositiveFloat, field_validator, model_validator

from ..channels import Channel, Ideal
from ..railway.adhesion import Adhesion, Span, spans
from ..railway.dynamics import GRAVITY
from ..railway.line import Line, LineOrFile, TrainOrFile
from ..schema import ScenarioConfig, Strict
from ..sensors import Accelerometer, Balises, Gnss, Radar, Wheel
from .told import Knowledge

Range = Annotated[list[PositiveFloat], Field(min_length=2, max_length=2)]
MEASURED = ("wheel-a", "wheel-b", "balise", "gnss", "radar")
Sensor = Literal["wheel-a", "wheel-b", "balise", "gnss", "radar"]


class Driver(Strict):
    """Follows min(c limit, sqrt(2 b distance to the stop)), and lower limits ahead alike: c within `courage`, b m/s^2
    within `braking`, drawn per run. gain 1/s on the speed error; asked m/s^2: least and greatest acceleration asked of
    the train, which follows with `lag` s. near m: a stop is reached by standing within this of it. dwell s: drawn per
    stop; first s: before the first departure."""

    courage: Range
    braking: Range
    gain: PositiveFloat
    asked: Annotated[list[float], Field(min_length=2, max_length=2)]
    lag: PositiveFloat
    near: PositiveFloat
    dwell: Annotated[list[NonNegativeFloat], Field(min_length=2, max_length=2)]
    first: NonNegativeFloat

    @field_validator("courage", "braking", "dwell")
    @classmethod
    def _ordered(cls, pair: list[float]) -> list[float]:
        if pair[0] > pair[1]:
            raise ValueError("[least, most] needs least <= most")
        return pair

    @model_validator(mode="after")
    def _both_ways(self) -> Driver:
        if not self.asked[0] < 0 < self.asked[1]:
            raise ValueError("asked = [least, greatest] needs least < 0 (braking) < greatest (traction)")
        if -self.asked[0] <= self.braking[1]:
            raise ValueError(f"asked[0] = {self.asked[0]:g} must be under -{self.braking[1]:g}, the hardest braking")
        return self


class Places(Strict):
    """Where balises lie: `positions` m in order, or one every so many metres with one `platform` m before each stop.

    platforms: those of the positions that are surveyed as platform balises."""

    positions: list[float] = []
    platforms: list[float] = []
    every: PositiveFloat | None = None
    platform: PositiveFloat = 15.0
    begin: PositiveFloat = 10.0

    @model_validator(mode="after")
    def _consistent(self) -> Places:
        if bool(self.positions) == (self.every is not None):
            raise ValueError("either positions = [..] or every = .. (m) says where balises lie")
        if any(b - a < 2.0 for a, b in pairwise(self.positions)):
            raise ValueError("positions must lie in order, at least 2 m apart")
        strays = [p for p in self.platforms if p not in self.positions]
        if strays:
            raise ValueError(f"platforms: {strays[0]:g} m is none of the positions")
        return self

    def on(self, line: Line) -> tuple[list[float], list[float]]:
        """(all places, those at platforms) on a line."""
        if self.every is None:
            return self.positions, self.platforms
        platforms = [stop - self.platform for stop in line.stops[1:]]
        grid = np.arange(line.stops[0] + self.begin, line.stops[-1], self.every)
        free = [float(p) for p in grid if min(abs(p - q) for q in platforms) > 30.0]
        return sorted([*free, *platforms]), platforms


class Elsewhere(Strict):
    """What stands for balises, tunnels and low stretches where the line is a file of the user's: they cannot be those
    of the built-in one. balises: one every so many metres and one at each platform."""

    balises: PositiveFloat
    tunnels: list[Span] = []
    low: list[Span] | Literal["stops"] = "stops"


class Plant(Strict):
    """line, train: tables, or paths of TTOBench files. tunnels [[from m, to m], ..]."""

    kind: Literal["odometry"]
    line: LineOrFile
    train: TrainOrFile
    tunnels: list[Span] = []
    balises: Places
    adhesion: Adhesion
    driver: Driver
    elsewhere: Elsewhere

    @model_validator(mode="before")
    @classmethod
    def _own_line(cls, table: Any) -> Any:
        """With a line from a file, what belongs to the built-in line is replaced by the rules of `elsewhere`."""
        if not isinstance(table, dict) or not isinstance(table.get("line"), str):
            return table
        other = table.get("elsewhere")
        if not isinstance(other, dict) or not isinstance(table.get("adhesion"), dict):
            return table
        low = other.get("low", "stops") if table["adhesion"].get("low") else []
        return {**table, "balises": {"every": other.get("balises")}, "tunnels": other.get("tunnels", []),
                "adhesion": {**table["adhesion"], "low": low}}

    @model_validator(mode="after")
    def _consistent(self) -> Plant:
        spans(self.tunnels, "tunnels")
        forces, g = self.train.forces, GRAVITY / (1 + self.train.rotating)
        for position, rise in self.line.gradients:
            if position < self.line.stops[-1] and g * rise >= min(forces.drive, self.driver.asked[1]):
                raise ValueError(f"the train cannot climb {1e3 * rise:.1f} per mille from {position:g} m on")
        return self

    @property
    def places(self) -> list[float]:
        """Where balises lie, m."""
        return self.balises.on(self.line)[0]

    @property
    def platforms(self) -> list[float]:
        """Those of them that are surveyed as platform balises, m."""
        return self.balises.on(self.line)[1]


class Sensors(Strict):
    """use: what estimators get to measure with; gradient: standard deviation of the map's gradient per section (m/m).
    The wheels' counts, the accelerometer's reading and what the train is asked for are inputs told in any case."""

    use: Annotated[list[Sensor], Field(min_length=1)]
    gradient: NonNegativeFloat
    wheel: Wheel
    accelerometer: Accelerometer
    balise: Balises
    gnss: Gnss
    radar: Radar

    @property
    def measured(self) -> tuple[str, ...]:
        """Names of the measurements in their order."""
        return tuple(name for name in MEASURED if name in self.use)


class OdometryConfig(ScenarioConfig):
    """The odometry scenario, resolved for one variant."""

    plant: Plant
    sensors: Sensors  # pyright: ignore[reportGeneralTypeIssues]
    channel: Channel = Ideal()
    knowledge: Knowledge  # pyright: ignore[reportGeneralTypeIssues]

    @model_validator(mode="after")
    def _fits(self) -> OdometryConfig:
        self.channel.check(len(self.sensors.measured))
        return self
