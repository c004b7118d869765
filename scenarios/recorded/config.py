"""What a recorded setting's file may say."""

# pyright: reportIncompatibleVariableOverride=false
from __future__ import annotations

from collections.abc import Mapping
from math import nan
from typing import Annotated, Literal

from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt, field_validator, model_validator

from ..aboard import FITTED, Fitted, Instruments, Places, Route
from ..arrays import Array
from ..channels import Channel, Ideal
from ..faults import Faults
from ..railway.line import LineOrFile, TrainOrFile
from ..schema import TABLES, ScenarioConfig, Strict
from ..strict import KIND, key
from .columns import ROLES
from .recording import MEASURED, Meaning, Recording, read_recording, table_at
from .times import Duplicates, Order
from .told import Knowledge, WheelKnowledge
from .wheels import WHEELS, balises_in

Name = Literal["position", "speed", "odometer", "wheel-a", "wheel-b", "balise"]
Read = Literal["position", "speed", "odometer"]
Span = Annotated[list[NonNegativeFloat], Field(min_length=2, max_length=2)]


class Plant(Route):
    """One recorded trip or several, and what their columns mean."""

    kind: Annotated[Literal["recorded"], KIND]
    recording: Annotated[str | Annotated[list[str], Field(min_length=1)] | None, key(
        "path of a trip (CSV or another of the formats read), or a list of paths")] = None
    trips: Annotated[Literal["turn", "draw"], key(
        "of several: whether runs go through them in turn, or each draws one")] = "turn"
    split: Annotated[PositiveInt | None, key(
        "tuning takes so many of the first trips and shows what it found on the others", "1")] = None
    map: Annotated[dict[str, str], key(
        "role -> column with its unit (t_s, t [s]); roles: time, position (or latitude and longitude), speed, "
        "odometer, acceleration, control (share of the greatest force asked for from that time on), wheel-a, "
        "wheel-b (what each axle's sensor has counted), balise (place or name of the one passed), "
        "reference_position, reference_speed, position_sd, speed_sd, odometer_sd, balise_sd (how good a sensor "
        "says its reading is). A minus before a column turns its sign")] = {}
    missing: Annotated[list[float | str], key("numbers or texts that stand for no value", "the column's")] = []
    quality: Annotated[dict[str, PositiveFloat | Literal["missing"]], key(
        "class of a _sd column -> standard deviation, or missing for no reading", "SI")] = {}
    order: Annotated[Order, key("what becomes of rows that are not in order of time")] = "refuse"
    duplicates: Annotated[Duplicates, key("what becomes of rows with the same time")] = "refuse"
    wrap: Annotated[PositiveFloat | None, key("after which the odometer begins anew", "m")] = None
    track: Annotated[str | None, key(
        "GeoJSON file of the line that latitude and longitude run along; none: the recording's own path")] = None
    span: Annotated[Span | None, key("[from, to] after the first row: rows taken", "s")] = None
    without: Annotated[list[Span], key("[[from, to], ..] after the first row: rows left out", "s")] = []
    balises: Annotated[str | dict[str, float], key("places by name, or a file of two columns", "m")] = {}
    every: Annotated[PositiveFloat, key(
        "a balise that is simulated each so many metres, where balises names none", "m")] = 700.0
    line: Annotated[LineOrFile | None, key(
        "line of the train that `control` drives, and its gradient: a table, or a TTOBench file")] = None
    train: Annotated[TrainOrFile | None, key("train that `control` drives: a table, or a TTOBench file")] = None

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

    def laid(self, trip: Recording) -> tuple[list[float], list[float]]:
        """Where simulated balises lie on a trip, m, and which of them at platforms."""
        begin, end = float(trip.position.min()), float(trip.position.max())
        if not self.balises:
            return Places(every=self.every).along([begin, end])
        named = balises_in(table_at(self.balises)) if isinstance(self.balises, str) else self.balises
        return sorted(place for place in named.values() if begin <= place <= end), []

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
    """No readings of some sensors for a while."""

    place: Annotated[Literal["none", "windows", "random", "sweep"], key(
        "none; windows, as given; random: from a start drawn per run; sweep: from each sample where it fits, in "
        "turn")] = "none"
    sensors: Annotated[list[Name], key("those that are silent")] = Field(default=["position"], min_length=1)
    duration: Annotated[PositiveFloat, key("of a random or swept one", "s")] = 30.0
    windows: Annotated[list[Span], key("[[from, to], ..] after the first row", "s")] = Field(default=[])

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


class Sensors(Instruments):
    """What of a recording estimators hear, and what is simulated on its reference."""

    simulated: Annotated[list[Fitted], key(
        "sensors that the recording lacks, simulated on its reference: wheel-a, wheel-b, balise, gnss, radar, "
        "accelerometer")] = []

    use: Annotated[list[Name], Field(min_length=1), key("sensors that estimators get, those that the recording has")]
    noise: Annotated[dict[Read, NonNegativeFloat], key(
        "standard deviations of noise added to the readings, by sensor", "m, m/s, m")] = {}
    period: Annotated[dict[Read, NonNegativeFloat], key(
        "by sensor: only the first reading in each such time is heard", "s")] = {}
    odometer_step: Annotated[NonNegativeFloat | None, key(
        "it counts in such steps, so that its reading is half of one late on average; none: taken from the "
        "readings", "m")] = None
    outage: Annotated[Outage, key("when some of them are silent")] = Outage()


class RecordedConfig(ScenarioConfig):
    """The recorded scenario, resolved for one variant."""

    plant: Annotated[Plant, TABLES["plant"]]
    sensors: Annotated[Sensors, TABLES["sensors"]]  # pyright: ignore[reportGeneralTypeIssues]
    channel: Annotated[Channel, TABLES["channel"]] = Ideal()
    faults: Annotated[Faults, TABLES["faults"]] = ()
    knowledge: Annotated[Knowledge | WheelKnowledge, Field(  # pyright: ignore[reportGeneralTypeIssues]
        discriminator="motion"), TABLES["knowledge"]]

    @model_validator(mode="after")
    def _fits_the_recording(self) -> RecordedConfig:
        outage = self.sensors.outage
        for name in self.sensors.use:
            self.knowledge.worth(name)
        for trip in self.plant.recorded():
            found = (*self.heard(trip), *self.added)
            twice = sorted({"acceleration" if name == "accelerometer" else name for name in self.sensors.simulated}
                           & set(trip.measured))
            wheels = {*WHEELS} & set(trip.measured)
            if twice or (wheels and {*WHEELS} & {*self.added}):
                raise ValueError(f"sensors.simulated has {', '.join(twice or self.added)}, but {trip.path} has "
                                 f"{', '.join(twice or sorted(wheels))} of its own: leave one of them out")
            if not found:
                raise ValueError(f"sensors.use has {', '.join(self.sensors.use)}, but plant.map has "
                                 f"{', '.join(trip.measured) or 'no sensor'}: map one of them, or run another variant")
            self.channel.check(len(found))
            if outage.place != "none" and not set(outage.sensors) & set(self.heard(trip)):
                raise ValueError(f"sensors.outage.sensors has {', '.join(outage.sensors)}, but what is heard is "
                                 f"{', '.join(self.heard(trip)) or 'nothing that is recorded'}")
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

    @property
    def added(self) -> tuple[str, ...]:
        """The simulated measurements, in their order behind those recorded."""
        return tuple(name for name in FITTED if name in self.sensors.simulated)

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
