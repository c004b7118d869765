"""What a recorded setting's file may say."""

# pyright: reportIncompatibleVariableOverride=false
from __future__ import annotations

from collections.abc import Mapping
from math import nan
from typing import Annotated, Literal

from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt, field_validator, model_validator

from ..arrays import Array
from ..channels import Channel, Ideal
from ..faults import Faults
from ..railway.line import LineOrFile, TrainOrFile
from ..schema import ScenarioConfig, Strict
from .columns import ROLES
from .recording import MEASURED, Meaning, Recording, read_recording
from .times import Duplicates, Order
from .told import Knowledge, WheelKnowledge

Name = Literal["position", "speed", "odometer", "wheel-a", "wheel-b", "balise"]
Read = Literal["position", "speed", "odometer"]
Span = Annotated[list[NonNegativeFloat], Field(min_length=2, max_length=2)]


class Plant(Strict):
    """recording: path of a recorded trip, CSV or another of the formats that are read, or a list of several trips'
    paths, of which `trips` says whether a run draws one or the runs go through them in turn; tuning takes the first
    `split` of them and shows what it found on the others. map: role -> column with
    its unit (`t_s`, `t [s]`, `t (s)`); roles: time, position (or latitude and longitude), speed, odometer,
    acceleration, control (the share of the greatest force asked for from that time on), wheel-a, wheel-b (what each
    axle's sensor has counted), balise (the place of the one passed, or its name), reference_position, reference_speed,
    and position_sd, speed_sd, odometer_sd, balise_sd (how good the sensor says its reading is). A minus before a column
    turns its sign. line, train: tables, or paths of TTOBench files, for the model of the train that `control` drives,
    and for the gradient that an accelerometer feels. balises: places in m by name, or a file of two columns.

    missing: numbers or texts that stand for no value. quality: class of a _sd column -> standard deviation in SI, or
    "missing" for no reading. order: of rows that are not in order of time. duplicates: of rows with the same time.
    wrap: m after which the odometer begins anew. track: GeoJSON file of the line that latitude and longitude run along;
    none: the recording's own path. span: [from, to] and without: [[from, to], ..], rows taken and left out, in s after
    the first row."""

    kind: Literal["recorded"]
    recording: str | Annotated[list[str], Field(min_length=1)] | None = None
    trips: Literal["turn", "draw"] = "turn"
    split: PositiveInt | None = None
    map: dict[str, str] = {}
    missing: list[float | str] = []
    quality: dict[str, PositiveFloat | Literal["missing"]] = {}
    order: Order = "refuse"
    duplicates: Duplicates = "refuse"
    wrap: PositiveFloat | None = None
    track: str | None = None
    span: Span | None = None
    without: list[Span] = []
    balises: str | dict[str, float] = {}
    line: LineOrFile | None = None
    train: TrainOrFile | None = None

    @field_validator("map")
    @classmethod
    def _roles(cls, named: dict[str, str]) -> dict[str, str]:
        for role in named:
            if role not in ROLES:
                raise ValueError(f"map.{role}: no such role; allowed: {', '.join(ROLES)}")
        return named

    @property
    def meaning(self) -> Meaning:
        """What the columns of the recording are to mean."""
        return Meaning(
            map=tuple(sorted(self.map.items())), missing=tuple(self.missing),
            quality=tuple((name, nan if sd == "missing" else sd) for name, sd in self.quality.items()),
            order=self.order, duplicates=self.duplicates, wrap=self.wrap, track=self.track,
            span=(self.span[0], self.span[1]) if self.span else None,
            without=tuple((begin, end) for begin, end in self.without),
            balises=self.balises if isinstance(self.balises, str) else tuple(self.balises.items()))

    def recorded(self) -> tuple[Recording, ...]:
        """The trips. Raises ValueError where one cannot be read."""
        return tuple(read_recording(path, self.meaning) for path in self.paths)

    @property
    def paths(self) -> list[str]:
        """The files of the trips."""
        return [self.recording] if isinstance(self.recording, str) else self.recording or []

    @model_validator(mode="after")
    def _readable(self) -> Plant:
        if any(begin >= end for begin, end in [*self.without, *([self.span] if self.span else [])]):
            raise ValueError("span = [from, to] and without = [[from, to], ..] need from < to")
        if self.split and self.split >= len(self.paths):
            raise ValueError(f"split = {self.split} leaves none of the {len(self.paths)} recordings to show on")
        for trip in self.recorded():
            wrong = [item.text for item in trip.findings if item.grade == "impossible" and not item.reading]
            if wrong:
                more = f"; and {len(wrong) - 2} more: railstate inspect" if len(wrong) > 2 else ""
                raise ValueError(f"{trip.path}: {'; '.join(wrong[:2])}{more}")
        return self


class Outage(Strict):
    """No readings of `sensors`: during `windows` [[from, to], ..] (s after the recording's first row), or for
    `duration` seconds from a start that is drawn per run (`random`) or goes over all samples where it fits
    (`sweep`: as many runs have each of them once, fewer are spread evenly)."""

    place: Literal["none", "windows", "random", "sweep"] = "none"
    sensors: list[Name] = Field(default=["position"], min_length=1)
    duration: PositiveFloat = 30.0
    windows: list[Span] = Field(default=[])

    @model_validator(mode="after")
    def _consistent(self) -> Outage:
        if self.place == "windows" and not self.windows:
            raise ValueError("place = \"windows\" needs windows = [[from, to], ..]")
        if any(begin >= end for begin, end in self.windows):
            raise ValueError("windows = [[from, to], ..] need from < to")
        return self

    def starts(self, time: Array) -> Array:
        """The instants of time (K,) at which an outage can begin and end within them."""
        return time[time <= time[-1] - self.duration + 1e-9]


class Sensors(Strict):
    """use: the sensors estimators get, those the recording has. noise: standard deviations added to the readings in m,
    m/s, m; none where nothing is said. period s: of a sensor's readings only the first in each such time is heard.
    odometer_step m: it counts in such steps, so that its reading is half of one late on average; where left
    out, taken from the readings."""

    use: Annotated[list[Name], Field(min_length=1)]
    noise: dict[Read, NonNegativeFloat] = {}
    period: dict[Read, NonNegativeFloat] = {}
    odometer_step: NonNegativeFloat | None = None
    outage: Outage = Outage()


class RecordedConfig(ScenarioConfig):
    """The recorded scenario, resolved for one variant."""

    plant: Plant
    sensors: Sensors  # pyright: ignore[reportGeneralTypeIssues]
    channel: Channel = Ideal()
    faults: Faults = ()
    knowledge: Annotated[Knowledge | WheelKnowledge, Field(  # pyright: ignore[reportGeneralTypeIssues]
        discriminator="motion")]

    @model_validator(mode="after")
    def _fits_the_recording(self) -> RecordedConfig:
        outage = self.sensors.outage
        for name in self.sensors.use:
            self.knowledge.worth(name)
        for trip in self.plant.recorded():
            found = self.heard(trip)
            if not found:
                raise ValueError(f"sensors.use has {', '.join(self.sensors.use)}, but plant.map has "
                                 f"{', '.join(trip.measured) or 'no sensor'}: map one of them, or run another variant")
            self.channel.check(len(found))
            if outage.place != "none" and not set(outage.sensors) & set(found):
                raise ValueError(f"sensors.outage.sensors has {', '.join(outage.sensors)}, but what is heard is "
                                 f"{', '.join(found)}")
            if len(trip.time) - 1 > self.time.steps:
                raise ValueError(f"time.steps: {trip.path} has {len(trip.time)} rows, more than {self.time.steps} "
                                 "steps: take a part (--from, --to, or plant.span) or more steps (--set time.steps="
                                 f"{len(trip.time)})")
            time = trip.time[1:]
            if outage.place in ("random", "sweep") and not len(outage.starts(time)):
                raise ValueError(f"sensors.outage.duration: {outage.duration:g} s do not fit into the recording of "
                                 f"{time[-1] - trip.time[0]:g} s")
            jumps = [item.text for item in trip.findings if item.grade == "impossible" and item.reading]
            if jumps and not trip.apart["position"] and self.judged(trip, "position"):
                raise ValueError(f"{trip.path}: the reference of what is withheld is the reading itself, and "
                                 f"{jumps[0]}")
        return self

    def heard(self, trip: Recording) -> tuple[str, ...]:
        """The sensors that are used and recorded, in the order of the measurements."""
        return tuple(name for name in MEASURED if name in self.sensors.use and name in trip.measured)

    def judged(self, trip: Recording, quantity: str) -> bool:
        """Whether estimates of the position or the speed are scored anywhere: by a reference of its own, or by readings
        that are withheld from the estimators or told with noise added. A speed in no column goes with the position."""
        if trip.apart[quantity]:
            return True
        if quantity == "speed" and "speed" not in trip.measured:
            quantity = "position"
        if quantity == "position":
            quantity = trip.own
        sensors: Mapping[str, float] = self.sensors.noise  # pyright: ignore[reportAssignmentType]
        periods: Mapping[str, float] = self.sensors.period  # pyright: ignore[reportAssignmentType]
        outage = self.sensors.outage
        return bool(sensors.get(quantity, 0.0) > 0 or periods.get(quantity, 0.0) > 0 or (
            quantity == trip.own and quantity not in self.sensors.use) or (
            outage.place != "none" and quantity in outage.sensors) or self.channel != Ideal())
