"""The recorded setting: a real trip as truth, its sensors' readings as measurements, with outages and noise on top.

One recording makes as many runs as wanted; what separates them is added noise, losses and where the outage falls."""

# pyright: reportIncompatibleVariableOverride=false
from __future__ import annotations

from collections.abc import Mapping
from math import gcd
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..channels import Sent
from ..errors import InputError, Unsupported
from ..model import DesignModel
from ..observation import faulted
from ..randomness import RunRandom, Streams
from ..schema import ScenarioConfig
from ..setting import Outcome, Quantity, Setting
from ..world import Sensing, Trajectory, World
from .config import RecordedConfig
from .readers.table import Recording, read_recording
from .told import Drive, Kinematics, Knowledge


class Recorded(Setting[RecordedConfig]):
    """Truth [position m, speed m/s, odometer's shortfall m and excess (with an odometer), acceleration m/s^2]."""

    kind: ClassVar[str] = "recorded"
    Config: ClassVar[type[ScenarioConfig]] = RecordedConfig
    files: ClassVar[tuple[str, ...]] = ("recorded.toml",)
    user_files: ClassVar[tuple[str, ...]] = ("recording", "line", "train")
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
        """The sensors that are used and recorded, in the order of the measurements."""
        return self.config.heard(self.recording)

    @property
    def notes(self) -> list[str]:
        """What the reference is, and where outages are tried."""
        if self.config.plant.recording is None:
            return self.config.notes
        recording, outage = self.recording, self.config.sensors.outage
        notes = [*self.config.notes, f"Reference of this recording: {recording.reference}."]
        if outage.place == "sweep":
            count = len(outage.starts(recording.time[1:self.config.time.steps + 1]))
            notes.append(f"The outage of {outage.duration:g} s can begin at {count} samples: {count} runs try each "
                         "once.")
        if "odometer" in recording.measured and self.odometer_step:
            notes.append(f"The odometer counts in steps of {self.odometer_step:g} m: it lags by half of one on "
                         "average.")
        return notes

    @property
    def odometer_step(self) -> float:
        """The odometer's step in m, as told or as found; 0 for a fine one."""
        told = self.config.sensors.odometer_step
        return self.recording.odometer_step if told is None else told

    @property
    def sampling_period(self) -> float:
        return float(np.median(self.lengths))

    @property
    def lengths(self) -> Array:
        """Length of each interval, s, (K,)."""
        steps = min(len(self.recording.time) - 1, self.config.time.steps)
        return np.diff(self.recording.time)[:steps]

    def quantities(self) -> tuple[Quantity, ...]:
        """Errors against a reference of its own: a reading that is its own reference is no truth, and its derivative
        neither."""
        roles = self.config.plant.map
        placed = "reference_position" in roles or not roles
        timed = "reference_speed" in roles or ("speed" not in roles and placed)
        return (Quantity("position", "m", ((0, 1.0),), referenced=placed),
                Quantity("speed", "m/s", ((1, 1.0),), referenced=timed))

    def table(self) -> tuple[tuple[str, str], ...]:
        ends = (("rmse", "position-outage-end"),) if self.config.sensors.outage.place != "none" else ()
        if not self.quantities()[0].referenced:
            return ("nis", "innovation"), ("whiteness", "innovation"), ("log-likelihood", "innovation"), *ends
        return *super().table(), ("final", "position"), *ends

    def batch_bytes(self) -> int:
        return len(self.lengths) * 8 * 16

    def world(self, streams: Streams) -> Trajectory:
        """u (K, 2 or 3, S): distance m, speed m/s, control; y (K, ny, S): the sensors' readings in m, m/s, m."""
        recording, lengths, runs = self.recording, self.lengths, len(streams.runs)
        steps, random = len(lengths), streams("measurement")
        readings = {name: self._reading(name, random, steps) for name in recording.measured}
        out = self._outage(streams, steps)
        kept = {name: np.isfinite(values[1:]) for name, values in readings.items()}
        for name in set(self.config.sensors.outage.sensors) & set(kept):
            kept[name] &= ~out
        truth = np.repeat(self._truth(steps)[:, :, None], runs, axis=2)
        sensed = faulted(
            np.stack([np.nan_to_num(readings[name][1:]) for name in self.sensors], axis=1),
            np.stack([kept[name] for name in self.sensors], axis=1), np.cumsum(lengths), streams,
            self.sensing(), self.config.faults, truth=truth)
        arrived = self.config.channel.carry(streams, Sent(sensed.y, sensed.there, self.sensing().sd))
        for i, name in enumerate(self.sensors):
            kept[name] = arrived.received[:, i]
            readings[name] = np.concatenate([readings[name][:1], arrived.y[:, i]])
        y, received = arrived.y.copy(), arrived.received
        late = np.zeros_like(received) if arrived.late is None else arrived.late > 0
        if "odometer" in self.sensors:
            first = int(np.isfinite(recording.measured["odometer"]).argmax())
            begun = recording.measured["odometer"][first] - recording.position[first]
            y[:, self.sensors.index("odometer")] += 0.5 * self.odometer_step - begun
        truth = truth if sensed.truth is None else sensed.truth
        start = np.zeros((truth.shape[1], runs))
        start[0], start[1] = recording.position[0], recording.speed[0]
        ends = out & ~np.concatenate([out[1:], np.zeros((1, runs), dtype=bool)])
        window = np.where(out, 0, -1)
        window[ends] = 1
        return Trajectory(
            truth=truth, u=self._told(readings, kept), y=np.where(received | late, y, 0.0), received=received,
            late=arrived.late, faulty=sensed.faulty if self.config.faults else None,
            active=np.ones((steps, runs), dtype=bool), lengths=lengths, initial_mean=start,
            extra={"outage": out.astype(float)},
            windows=("outage", "outage-end") if self.config.sensors.outage.place != "none" else (),
            window=window.astype(np.int16))

    def sensing(self) -> Sensing:
        told: Knowledge = self.resolve_knowledge({})
        along = np.array([float(name != "speed") for name in self.sensors])
        truth = np.zeros(5 if "odometer" in self.sensors else 3)
        truth[0] = 1.0
        return Sensing(self.sensors, np.array([getattr(told, name) for name in self.sensors]), (truth, along))

    def design_model(self, knowledge: Mapping[str, Any], initial_mean: Array) -> DesignModel:
        """See `Kinematics`. Raises Unsupported where the recording lacks what the motion told needs."""
        told: Knowledge = self.resolve_knowledge(knowledge)
        plant, recording, lengths = self.config.plant, self.recording, self.lengths
        if told.motion == "odometer" and not {"odometer", "speed"} & set(recording.measured):
            raise Unsupported("dead reckoning needs an odometer or a speed in plant.map")
        if told.motion == "train" and (plant.line is None or plant.train is None or recording.control is None):
            raise Unsupported("motion = \"train\" needs the control in plant.map (control=u_share), and the line and "
                              "the train (--line, --train, or plant.line and plant.train)")
        drive = (Drive(plant.train.forces, plant.line.slope(plant.train.rotating)) if plant.train and plant.line
                 else None)
        kinematics = Kinematics(told, "odometer" in self.sensors, self.config.time.period, drive)
        counted = np.diff(_held(self.recording.measured.get("odometer", np.zeros(len(lengths) + 1))[:, None])[:, 0])
        return kinematics.model(self.sensors, initial_mean, lengths, counted)

    def outcomes(self, world: World, metrics: Mapping[tuple[str, str], Array]) -> dict[Outcome, Array]:
        """Where the run's outage begins, s after the start of the trip; NaN without one."""
        assert isinstance(world, Trajectory)
        if not world.windows:
            return {}
        out = world.extra["outage"] > 0
        began = (self.recording.time[1:] - self.recording.time[0])[out.argmax(axis=0)]
        return {("begin", "outage", "s"): np.where(out.any(axis=0), began, np.nan)}

    def _told(self, readings: Mapping[str, Array], kept: Mapping[str, NDArray[np.bool_]]) -> Array:
        """The input (K, 2 or 3, S) of each interval: distance and speed by the odometer and the speed sensor, as far as
        they are heard (the last reading until the next), each from the other where there is only one; the control."""
        heard = {name: _held(np.concatenate([values[:1], np.where(kept[name], values[1:], np.nan)]))
                 for name, values in readings.items() if name != "position"}
        steps, runs = next(iter(kept.values())).shape
        length = self.lengths[:, None]
        distance, speed = np.zeros((steps, runs)), np.zeros((steps, runs))
        if "speed" in heard:
            speed = heard["speed"][1:]
            distance = speed * length
        if "odometer" in heard:
            distance = np.diff(heard["odometer"], axis=0)
            speed = speed if "speed" in heard else distance / length
        control = self.recording.control
        asked = [] if control is None else [np.repeat(control[:steps, None], runs, axis=1)]
        return np.stack([distance, speed, *asked], axis=1)

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
            starts = outage.starts(time[:, 0])
            chosen = (np.array(streams.runs) * _stride(len(starts)) % len(starts) if outage.place == "sweep"
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
            counted = counted - counted[there][0] + 0.5 * self.odometer_step
            slope, offset = np.polyfit(counted[there], travelled[there], 1)
            parts += [travelled - (travelled - offset) / slope, np.full(len(travelled), slope - 1)]
        parts.append(np.gradient(recording.speed, recording.time))
        return np.stack(parts, axis=1)[1:steps + 1]


def _stride(count: int) -> int:
    """A step through `count` places that meets each of them once, any few evenly spread (golden section)."""
    near = range(1, count + 1)
    return min((step for step in near if gcd(step, count) == 1), key=lambda step: abs(step - 0.618 * count))


def _held(values: Array) -> Array:
    """Missing readings (K + 1, S) filled with the last one before them, or with the first one there is."""
    there = np.isfinite(values)
    last = np.maximum.accumulate(np.where(there, np.arange(len(values))[:, None], there.argmax(axis=0)), axis=0)
    return np.nan_to_num(np.take_along_axis(values, last, axis=0))
