"""What an odometry scenario's file may say of plant and sensors; what estimators are told is in `told`."""

# pyright: reportIncompatibleVariableOverride=false
from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, NonNegativeFloat, PositiveFloat, field_validator, model_validator

from ..aboard.config import Places
from ..channels import Channel, Ideal
from ..railway.adhesion import Adhesion, Span, spans
from ..railway.dynamics import GRAVITY
from ..railway.line import LineOrFile, TrainOrFile
from ..schema import TABLES, ScenarioConfig, Strict
from ..sensors import Accelerometer, Balises, Gnss, Radar, Wheel
from ..strict import KIND, key
from .told import Knowledge

Range = Annotated[list[PositiveFloat], Field(min_length=2, max_length=2)]
MEASURED = ("wheel-a", "wheel-b", "balise", "gnss", "radar")
Sensor = Literal["wheel-a", "wheel-b", "balise", "gnss", "radar"]


class Driver(Strict):
    """Follows min(c limit, sqrt(2 b distance to the stop)), and lower limits ahead alike."""

    courage: Annotated[Range, key("least and greatest c, drawn per run", "1")]
    braking: Annotated[Range, key("least and greatest b, drawn per run", "m/s^2")]
    gain: Annotated[PositiveFloat, key("on the speed error", "1/s")]
    asked: Annotated[list[float], Field(min_length=2, max_length=2), key(
        "least and greatest acceleration asked of the train", "m/s^2")]
    lag: Annotated[PositiveFloat, key("with which the train follows", "s")]
    near: Annotated[PositiveFloat, key("a stop is reached by standing within this of it", "m")]
    dwell: Annotated[list[NonNegativeFloat], Field(min_length=2, max_length=2), key(
        "least and greatest stand, drawn per stop", "s")]
    first: Annotated[NonNegativeFloat, key("stand before the first departure", "s")]

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


class Elsewhere(Strict):
    """What stands for balises, tunnels and low stretches where the line is a file of the user's."""

    balises: Annotated[PositiveFloat, key("one every so many metres, and one at each platform", "m")]
    tunnels: Annotated[list[Span], key("tunnels: [[from, to], ..]", "m")] = []
    low: Annotated[list[Span] | Literal["stops"], key(
        "stretches of low friction: [[from, to], ..], or stops", "m")] = "stops"


class Plant(Strict):
    """A train with wheels that slip on a line with tunnels and balises."""

    kind: Annotated[Literal["odometry"], KIND]
    line: Annotated[LineOrFile, key("the line: a table, or the path of a TTOBench file")]
    train: Annotated[TrainOrFile, key("the train: a table, or the path of a TTOBench file")]
    tunnels: Annotated[list[Span], key("tunnels: [[from, to], ..]", "m")] = []
    balises: Annotated[Places, key("where balises lie")]
    adhesion: Annotated[Adhesion, key("friction of the rail and what slip does")]
    driver: Annotated[Driver, key("how the train is driven")]
    elsewhere: Annotated[Elsewhere, key("what stands for places of the built-in line on a line of the user's")]

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
    """The wheels' counts, the accelerometer's reading and what the train is asked for are inputs told in any case."""

    use: Annotated[list[Sensor], Field(min_length=1), key("what estimators get to measure with")]
    gradient: Annotated[NonNegativeFloat, key("standard deviation of the map's gradient per section", "m/m")]
    wheel: Annotated[Wheel, key("each axle's counter")]
    accelerometer: Annotated[Accelerometer, key("along the train")]
    balise: Annotated[Balises, key("places read on the way")]
    gnss: Annotated[Gnss, key("satellite receiver")]
    radar: Annotated[Radar, key("Doppler radar")]

    @property
    def measured(self) -> tuple[str, ...]:
        """Names of the measurements in their order."""
        return tuple(name for name in MEASURED if name in self.use)


class OdometryConfig(ScenarioConfig):
    """The odometry scenario, resolved for one variant."""

    plant: Annotated[Plant, TABLES["plant"]]
    sensors: Annotated[Sensors, TABLES["sensors"]]  # pyright: ignore[reportGeneralTypeIssues]
    channel: Annotated[Channel, TABLES["channel"]] = Ideal()
    knowledge: Annotated[Knowledge, TABLES["knowledge"]]  # pyright: ignore[reportGeneralTypeIssues]

    @model_validator(mode="after")
    def _fits(self) -> OdometryConfig:
        self.channel.check(len(self.sensors.measured))
        return self
