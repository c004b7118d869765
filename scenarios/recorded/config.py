"""What a recorded setting's file may say."""

# pyright: reportIncompatibleVariableOverride=false
from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, NonNegativeFloat, PositiveFloat, model_validator

from ..arrays import Array
from ..channels import Channel, Ideal
from ..faults import Faults
from ..railway.line import LineOrFile, TrainOrFile
from ..schema import ScenarioConfig, Strict
from .readers.table import Recording, read_recording
from .told import Knowledge

SENSORS = ("position", "speed", "odometer")
Name = Literal["position", "speed", "odometer"]
Span = Annotated[list[NonNegativeFloat], Field(min_length=2, max_length=2)]


class Plant(Strict):
    """recording: path of a CSV or Parquet file. map: role -> column with its unit (`t_s` or `t [s]`); roles: time,
    position, speed, odometer, control (the share of the greatest force asked for from that time on),
    reference_position, reference_speed. line, train: tables, or paths of TTOBench files, for the model of the train
    that `control` drives."""

    kind: Literal["recorded"]
    recording: str | None = None
    map: dict[str, str] = {}
    line: LineOrFile | None = None
    train: TrainOrFile | None = None

    @model_validator(mode="after")
    def _readable(self) -> Plant:
        if self.recording is not None:
            read_recording(self.recording, self.map)
        return self


class Outage(Strict):
    """No readings of `sensors`: during `windows` [[from, to], ..] (seconds after the start), or for `duration` seconds
    from a start that is drawn per run (`random`) or goes over all samples where it fits (`sweep`: as many runs have
    each of them once, fewer are spread evenly)."""

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
    m/s, m. odometer_step m: it counts in such steps, so that its reading is half of one late on average; where left
    out, taken from the readings."""

    use: Annotated[list[Name], Field(min_length=1)]
    noise: dict[Name, NonNegativeFloat]
    odometer_step: NonNegativeFloat | None = None
    outage: Outage = Outage()


class RecordedConfig(ScenarioConfig):
    """The recorded scenario, resolved for one variant."""

    plant: Plant
    sensors: Sensors  # pyright: ignore[reportGeneralTypeIssues]
    channel: Channel = Ideal()
    faults: Faults = ()
    knowledge: Knowledge  # pyright: ignore[reportGeneralTypeIssues]

    @model_validator(mode="after")
    def _fits_the_recording(self) -> RecordedConfig:
        if self.plant.recording is None:
            return self
        recording, outage = read_recording(self.plant.recording, self.plant.map), self.sensors.outage
        found = self.heard(recording)
        if not found:
            raise ValueError(f"sensors.use has {', '.join(self.sensors.use)}, but plant.map has "
                             f"{', '.join(recording.measured) or 'no sensor'}: map one of them, or run another variant")
        self.channel.check(len(found))
        time = recording.time[1:self.time.steps + 1]
        if outage.place in ("random", "sweep") and not len(outage.starts(time)):
            raise ValueError(f"sensors.outage.duration: {outage.duration:g} s do not fit into the recording of "
                             f"{time[-1] - recording.time[0]:g} s")
        return self

    def heard(self, recording: Recording) -> tuple[str, ...]:
        """The sensors that are used and recorded, in the order of the measurements."""
        return tuple(name for name in SENSORS if name in self.sensors.use and name in recording.measured)
