"""The recorded setting: real trips as truth, their sensors' readings as measurements, with outages.

One recording makes as many runs as wanted; what separates them is the trip, where the outage falls, losses, and noise
where it is asked for."""

# pyright: reportIncompatibleVariableOverride=false
from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ..aboard import hearing
from ..arrays import Array, Index
from ..errors import InputError, Unsupported
from ..model import DesignModel
from ..railway.dynamics import slope_grid
from ..railway.odometer import Odometer, slip_modes
from ..randomness import Streams
from ..schema import ScenarioConfig
from ..setting import Outcome, Quantity, Setting
from ..world import Sensing, Trajectory, World
from .config import RecordedConfig
from .recording import Recording
from .ride import INPUTS, ride, together
from .told import Drive, Kinematics, Knowledge, WheelKnowledge
from .wheels import WHEELS

SCALE_WALK = 0.0005
"""Random walk of the scales of simulated wheels and radar, per sqrt(s), for models that are told none."""


class Recorded(Setting[RecordedConfig]):
    """Truth [position m, speed m/s], NaN where there is no reference."""

    kind: ClassVar[str] = "recorded"
    Config: ClassVar[type[ScenarioConfig]] = RecordedConfig
    files: ClassVar[tuple[str, ...]] = ("recorded.toml", "recorded-odometry.toml")
    user_files: ClassVar[tuple[str, ...]] = ("recording", "track", "line", "train", "balises")
    references: ClassVar[bool] = True
    needs_file: ClassVar[str] = "plant.recording"

    @cached_property
    def trips(self) -> tuple[Recording, ...]:
        """The trips. Raises InputError where the scenario names none."""
        if self.config.plant.recording is None:
            raise InputError(f"{self.config.name}: needs a recorded trip: pass --recording trip.csv --map time=t_s,"
                             "position=s_m,.. (railstate inspect trip.csv says which) or set plant.recording and "
                             "plant.map")
        return self.config.plant.recorded()

    @property
    def sensors(self) -> tuple[str, ...]:
        """The measurements in their order: the sensors that are used and recorded, and the simulated ones."""
        return *self.config.heard(self.trips[0]), *self.config.added

    @property
    def notes(self) -> list[str]:
        """How the recordings were read, what the reference is, what is odd, and where outages are tried."""
        if self.config.plant.recording is None:
            return self.config.notes
        notes, outage, several = list(self.config.notes), self.config.sensors.outage, len(self.trips) > 1
        for trip in self.trips:
            name = f"{trip.path.rpartition('/')[2]}: " if several else ""
            notes += [f"{name}{text[0].upper()}{text[1:]}." for text in trip.said]
            notes += [f"{name}Odd: {item.text}." for item in trip.findings
                      if item.grade == "odd" or item.reading]
        if several and isinstance(self.config.knowledge, Knowledge):
            notes.append("Filters of a linear form (kalman, robust-mean-square) take one trip, whose times their "
                         "matrices are; ekf with knowledge = { shortfall = \"told\" } is the same Kalman filter.")
        trip = self.trips[0]
        if self.config.sensors.simulated:
            notes.append(f"Simulated on the recording's reference: {', '.join(self.config.sensors.simulated)}; a "
                         "balise is told at the end of its row, the way since added.")
        notes.append(f"Reference of this recording: {trip.reference}.")
        if not all(trip.apart.values()):
            notes.append("Where the reference is a reading, errors are of what was withheld from the estimators alone: "
                         "in outages, or where readings are left out.")
        if trip.own not in trip.measured:
            notes.append("No position is recorded as a sensor: the start is the reference's.")
        if "balise" in trip.measured:
            passed = np.isfinite(trip.measured["balise"])
            late = passed & np.any([np.isfinite(trip.measured[name]) for name in trip.measured if name != "balise"],
                                   axis=0)
            notes.append(f"{int(passed.sum())} balises are passed" + (
                f", {int(late.sum())} of them told in a row of other readings: passed somewhere since the row before."
                if late.any() else ", each with a time of its own."))
        if outage.place == "sweep":
            count = sum(len(outage.starts(one.time[1:])) for one in self.trips)
            notes.append(f"The outage of {outage.duration:g} s can begin at {count} samples: {count} runs try each "
                         "once.")
        if "odometer" in trip.measured and self.odometer_step(trip):
            notes.append(f"The odometer counts in steps of {self.odometer_step(trip):g} m: it lags by half of one on "
                         "average.")
        if "acceleration" in trip.measured and isinstance(self.config.knowledge, Knowledge):
            notes.append("An accelerometer is recorded: --estimators ekf-accelerometer,.. uses it.")
        return notes

    def odometer_step(self, trip: Recording) -> float:
        """A trip's odometer's step in m, as told or as found; 0 for a fine one."""
        told = self.config.sensors.odometer_step
        return trip.odometer_step if told is None else told

    @property
    def sampling_period(self) -> float:
        return float(np.median(np.diff(self.trips[0].time)))

    def quantities(self) -> tuple[Quantity, ...]:
        """Errors where there is something to score by: a reference of its own, or readings that are withheld."""
        placed = timed = True
        if self.config.plant.recording is not None:
            placed, timed = (self.config.judged(self.trips[0], name) for name in ("position", "speed"))
        return (Quantity("position", "m", ((0, 1.0),), referenced=placed),
                Quantity("speed", "m/s", ((1, 1.0),), referenced=timed))

    def table(self) -> tuple[tuple[str, str], ...]:
        ends = (("rmse", "position-outage-end"),) if self.config.sensors.outage.place != "none" else ()
        if not self.quantities()[0].referenced:
            return ("nis", "innovation"), ("whiteness", "innovation"), ("log-likelihood", "innovation"), *ends
        apart = self.config.plant.recording is None or self.trips[0].apart["position"]
        return *super().table(), *([("final", "position")] if apart else []), *ends

    def batch_bytes(self) -> int:
        return max(len(trip.time) for trip in self.trips) * 8 * 20

    def trip_of(self, streams: Streams) -> Index:
        """The number of each run's trip (S,)."""
        count = len(self.trips)
        if self.config.plant.trips == "draw" and count > 1:
            return streams("trip").integers(0, count - 1)
        return np.array(streams.runs) % count

    def world(self, streams: Streams) -> Trajectory:
        """See `ride`; runs on several trips go on until the longest has ended."""
        count, which = len(self.trips), self.trip_of(streams)
        if count == 1:
            return ride(self.trips[0], self.config, streams, self.odometer_step(self.trips[0]), self.sensing())
        turns = count if self.config.plant.trips == "turn" else 1
        parts = {}
        for number in np.unique(which).tolist():
            runs = [run for run, taken in zip(streams.runs, which, strict=True) if taken == number]
            trip, own = self.trips[number], Streams(streams.seed, streams.scenario, streams.variant, runs)
            parts[number] = ride(trip, self.config, own, self.odometer_step(trip), self.sensing(), turns, shared=False)
        return together(parts, which)

    def sensing(self) -> Sensing:
        told: Knowledge | WheelKnowledge = self.resolve_knowledge({})
        along = np.array([float(name in ("position", "odometer", "balise", "gnss")) for name in self.sensors])
        return Sensing(self.sensors, np.array([*self._worth(told).values()]),
                       (np.array([1.0, 0.0]), along))

    def _worth(self, told: Knowledge | WheelKnowledge) -> dict[str, float]:
        """Each measurement's standard deviation."""
        fitted, sensors = self.config.added, self.config.sensors
        return {name: sensors.worth(name) if name in fitted else told.worth(name) for name in self.sensors}

    def design_model(self, knowledge: Mapping[str, Any], initial_mean: Array) -> DesignModel:
        """See `Kinematics`, or `Odometer` where the knowledge is that of wheels. Raises Unsupported where the recording
        lacks what the motion told needs."""
        told: Knowledge | WheelKnowledge = self.resolve_knowledge(knowledge)
        plant, trip = self.config.plant, self.trips[0]
        if isinstance(told, WheelKnowledge):
            return self._odometer(told, initial_mean)
        if told.motion == "odometer" and not {"odometer", "speed"} & set(trip.measured):
            raise Unsupported("dead reckoning needs an odometer or a speed in plant.map")
        if told.motion == "accelerometer" and not self._accelerometer:
            raise Unsupported("motion = \"accelerometer\" needs an acceleration in plant.map")
        if told.motion == "train" and (plant.line is None or plant.train is None or trip.control is None):
            raise Unsupported("motion = \"train\" needs the control in plant.map (control=u_share), and the line and "
                              "the train (--line, --train, or plant.line and plant.train)")
        drive = (Drive(plant.train.forces, plant.line.slope(plant.train.rotating)) if plant.train and plant.line
                 else None)
        kinematics = Kinematics(told, "odometer" in self.sensors, self.config.time.period, drive)
        model = kinematics.model(self.config.heard(trip), initial_mean, self.trips)
        return hearing(model, self.config.added, self.config.sensors, SCALE_WALK)

    @property
    def _accelerometer(self) -> bool:
        """Whether there is one, recorded or simulated."""
        return "acceleration" in self.trips[0].measured or "accelerometer" in self.config.sensors.simulated

    def _odometer(self, told: WheelKnowledge, initial_mean: Array) -> DesignModel:
        """The model of `odometry` with this recording's sensors, flat where no line is given."""
        plant, trip = self.config.plant, self.trips[0]
        wheels = {name for name in WHEELS if name in trip.measured or name in self.config.added}
        need = {"wheels": wheels, "minmax": {"wheel-a", "wheel-b"}}.get(told.motion, {told.motion})
        lacking = sorted((need or {"wheel-a"}) - wheels)
        if lacking:
            raise Unsupported(f"motion = \"{told.motion}\" needs {' and '.join(lacking)} in plant.map")
        if told.motion == "wheels" and not self._accelerometer:
            raise Unsupported("motion = \"wheels\" needs an acceleration in plant.map")
        slope = (plant.line.slope(plant.train.rotating if plant.train else 0.0) if plant.line
                 else slope_grid(np.zeros(1), np.zeros(1), 0.0))
        odometer = Odometer(told, self._worth(told), self.config.time.period, slope, len(INPUTS))
        tells = () if told.counting else tuple(
            name for name in self.sensors if name in (*WHEELS, "balise") or any(name in one.told for one in self.trips))
        return odometer.model(initial_mean[:2], tells, modes=slip_modes(odometer, initial_mean[:2], tells))

    def split(self, training: bool) -> dict[str, Any]:
        """The first `plant.split` trips, or the others."""
        first, paths = self.config.plant.split, self.config.plant.paths
        taken = paths[:first] if training else paths[first:]
        return {"plant.split": None, "plant.recording": taken} if first else {}

    def outcomes(self, world: World, metrics: Mapping[tuple[str, str], Array]) -> dict[Outcome, Array]:
        """Where the run's outage begins, s after the recording's first row; NaN without one."""
        assert isinstance(world, Trajectory)
        if not world.windows:
            return {}
        out = world.extra["outage"] > 0
        each = getattr(world, "each", world.lengths[:, None])
        since = np.broadcast_to(np.cumsum(each, axis=0), out.shape)
        began = np.take_along_axis(since, out.argmax(axis=0)[None], axis=0)[0] + self.trips[0].time[0]
        return {("begin", "outage", "s"): np.where(out.any(axis=0), began, np.nan)}
