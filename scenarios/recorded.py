"""The recorded setting: a real trip as truth, its sensors' readings as measurements, with outages and noise on top.

One recording makes as many runs as wanted; what separates them is added noise, losses and where the outage falls."""

# Each setting narrows the types of the common tables, which are frozen: pyright takes them for mutable.
# pyright: reportIncompatibleVariableOverride=false

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, NonNegativeFloat, PositiveFloat, model_validator

from .channels import Channel, Ideal
from .errors import InputError
from .model import DesignModel
from .randomness import RunRandom, Streams
from .recorded_file import Recording, read_recording
from .recorded_model import Kinematics, Knowledge
from .schema import ScenarioConfig, Strict
from .setting import Quantity, Setting
from .world import Trajectory

Array = NDArray[np.float64]
SENSORS = ("position", "speed", "odometer")
Name = Literal["position", "speed", "odometer"]
Span = Annotated[list[NonNegativeFloat], Field(min_length=2, max_length=2)]


class Plant(Strict):
    """recording: path of a CSV or Parquet file. map: role -> column with its unit (`t_s` or `t [s]`); roles: time,
    position, speed, odometer, reference_position, reference_speed."""

    kind: Literal["recorded"]
    recording: str | None = None
    map: dict[str, str] = {}

    @model_validator(mode="after")
    def _readable(self) -> Plant:
        if self.recording is not None:
            read_recording(self.recording, self.map)
        return self


class Outage(Strict):
    """No readings of `sensors`: during `windows` [[from, to], ..] (seconds after the start), or for `duration` seconds
    from a start that is drawn per run (`random`) or moves on by one sample from run to run (`sweep`)."""

    place: Literal["none", "windows", "random", "sweep"] = "none"
    sensors: list[Name] = Field(default=["position"], min_length=1)
    duration: PositiveFloat = 30.0
    windows: list[Span] = Field(default=[])


class Sensors(Strict):
    """use: the sensors estimators get, those the recording has. noise: standard deviations added to the readings in m,
    m/s, m. odometer_step m: it counts in such steps, so that its reading is half of one late on average."""

    use: Annotated[list[Name], Field(min_length=1)]
    noise: dict[Name, NonNegativeFloat]
    odometer_step: NonNegativeFloat
    outage: Outage = Outage()


class RecordedConfig(ScenarioConfig):
    """The recorded scenario, resolved for one variant."""

    plant: Plant
    sensors: Sensors  # pyright: ignore[reportGeneralTypeIssues]
    channel: Channel = Ideal()
    knowledge: Knowledge  # pyright: ignore[reportGeneralTypeIssues]

    @model_validator(mode="after")
    def _outage_fits(self) -> RecordedConfig:
        outage = self.sensors.outage
        if self.plant.recording is not None and outage.place in ("random", "sweep"):
            time = read_recording(self.plant.recording, self.plant.map).time
            if outage.duration >= time[-1] - time[0]:
                raise ValueError(f"sensors.outage.duration: {outage.duration:g} s do not fit into the recording of "
                                 f"{time[-1] - time[0]:g} s")
        return self


class Recorded(Setting[RecordedConfig]):
    """Truth [position m, speed m/s, odometer's shortfall m and excess (with an odometer), acceleration m/s^2]."""

    kind: ClassVar[str] = "recorded"
    Config: ClassVar[type[ScenarioConfig]] = RecordedConfig
    files: ClassVar[tuple[str, ...]] = ("recorded.toml",)
    user_files: ClassVar[tuple[str, ...]] = ("recording",)
    needs_file: ClassVar[str] = "plant.recording"

    @property
    def recording(self) -> Recording:
        """The trip. Raises InputError where the scenario names none."""
        plant = self.config.plant
        if plant.recording is None:
            raise InputError(f"{self.config.name}: needs a recorded trip: pass --recording trip.csv --map time=t_s,"
                             "position=s_m,.. or set plant.recording and plant.map")
        return read_recording(plant.recording, plant.map)

    @property
    def sensors(self) -> tuple[str, ...]:
        """The sensors that are used and recorded, in the order of the measurements. Raises InputError for none."""
        used, recorded = self.config.sensors.use, self.recording.measured
        found = tuple(name for name in SENSORS if name in used and name in recorded)
        if not found:
            raise InputError(f"{self.config.name}: this variant uses {', '.join(used)}, but plant.map has "
                             f"{', '.join(recorded) or 'no sensor'}: map one of them, or run another variant")
        return found

    @property
    def portions(self) -> Array:
        """Length of each interval in sampling periods (K,)."""
        steps = min(len(self.recording.time) - 1, self.config.time.steps)
        return np.diff(self.recording.time)[:steps] / self.config.time.period

    def quantities(self) -> tuple[Quantity, ...]:
        return Quantity("position", "m", ((0, 1.0),)), Quantity("speed", "m/s", ((1, 1.0),))

    def table(self) -> tuple[tuple[str, str], ...]:
        ends = (("rmse", "position-outage-end"),) if self.config.sensors.outage.place != "none" else ()
        return *super().table(), ("final", "position"), *ends

    def batch_bytes(self) -> int:
        return len(self.portions) * 8 * 16

    def world(self, streams: Streams) -> Trajectory:
        recording, portions, runs = self.recording, self.portions, len(streams.runs)
        steps, random = len(portions), streams("measurement")
        readings = {name: self._reading(name, random, steps) for name in recording.measured}
        held = {name: _held(values) for name, values in readings.items()}
        speed = held.get("speed", np.repeat(recording.speed[:, None], runs, axis=1))[:steps + 1]
        told = np.diff(held["odometer"], axis=0) if "odometer" in held else (
            speed[1:] * portions[:, None] * self.config.time.period)
        y = np.stack([readings[name][1:] for name in self.sensors], axis=1)
        if "odometer" in self.sensors:
            half = 0.5 * self.config.sensors.odometer_step
            begun = _held(recording.measured["odometer"][:, None])[0, 0]
            y[:, self.sensors.index("odometer")] += recording.position[0] - begun + half
        out = self._outage(streams, steps)
        hit = np.array([name in self.config.sensors.outage.sensors for name in self.sensors])
        received = self.config.channel.draw(streams("channel"), steps, len(self.sensors))
        received &= np.isfinite(y) & ~(out[:, None, :] & hit[None, :, None])
        truth = self._truth(steps)
        start = np.zeros((truth.shape[1], runs))
        start[0], start[1] = recording.position[0], recording.speed[0]
        ends = out & ~np.concatenate([out[1:], np.zeros((1, runs), dtype=bool)])
        window = np.where(out, 0, -1)
        window[ends] = 1
        return Trajectory(
            truth=np.repeat(truth[:, :, None], runs, axis=2), u=np.stack([told, speed[1:]], axis=1),
            y=np.where(received, y, 0.0), received=received, active=np.ones((steps, runs), dtype=bool),
            portions=portions, initial_mean=start, extra={"outage": out.astype(float)},
            windows=("outage", "outage-end") if self.config.sensors.outage.place != "none" else (),
            window=window.astype(np.int16))

    def design_model(self, knowledge: Mapping[str, Any], initial_mean: Array) -> DesignModel:
        kinematics = Kinematics(self.resolve_knowledge(knowledge), "odometer" in self.sensors, self.config.time.period)
        portions = self.portions
        counted = np.diff(_held(self.recording.measured.get("odometer", np.zeros(len(portions) + 1))[:, None])[:, 0])
        return kinematics.model(self.sensors, initial_mean, portions, counted)

    def _reading(self, name: str, random: RunRandom, steps: int) -> Array:
        """The readings of one sensor (K + 1, S), the recording's with noise added; NaN where there is none."""
        noise = self.config.sensors.noise.get(name, 0.0)  # pyright: ignore[reportArgumentType,reportCallIssue]
        recorded = np.repeat(self.recording.measured[name][:steps + 1, None], len(random.runs), axis=1)
        return recorded + noise * random.normal(steps + 1) if noise else recorded

    def _outage(self, streams: Streams, steps: int) -> NDArray[np.bool_]:
        """Whether each step lies in an outage (K, S)."""
        outage, time = self.config.sensors.outage, self.recording.time[1:steps + 1, None] - self.recording.time[0]
        runs = len(streams.runs)
        out = np.zeros((steps, runs), dtype=bool)
        if outage.place == "windows":
            for begin, end in outage.windows:
                out |= (time >= begin) & (time <= end)
        elif outage.place != "none":
            starts = time[time[:, 0] <= time[-1, 0] - outage.duration + 1e-9, 0]
            chosen = (np.array(streams.runs) % len(starts) if outage.place == "sweep"
                      else streams("outage").integers(0, len(starts) - 1))
            out = (time >= starts[chosen]) & (time < starts[chosen] + outage.duration - 1e-9)
        return out

    def _truth(self, steps: int) -> Array:
        """The reference (K, nt): position, speed, shortfall and excess, acceleration.

        Shortfall and excess by the least-squares line of travelled distance over the odometer's count: its offset is
        where in a coarse step the trip happens to begin."""
        recording = self.recording
        travelled, parts = recording.position - recording.position[0], [recording.position, recording.speed]
        if "odometer" in self.sensors:
            counted = recording.measured["odometer"]
            there = np.isfinite(counted)
            counted = counted - counted[there][0] + 0.5 * self.config.sensors.odometer_step
            slope, offset = np.polyfit(counted[there], travelled[there], 1)
            parts += [travelled - (travelled - offset) / slope, np.full(len(travelled), slope - 1)]
        parts.append(np.gradient(recording.speed, recording.time))
        return np.stack(parts, axis=1)[1:steps + 1]


def _held(values: Array) -> Array:
    """Missing readings (K + 1, S) filled with the last one before them, or with the first one there is."""
    there = np.isfinite(values)
    last = np.maximum.accumulate(np.where(there, np.arange(len(values))[:, None], there.argmax(axis=0)), axis=0)
    return np.nan_to_num(np.take_along_axis(values, last, axis=0))
