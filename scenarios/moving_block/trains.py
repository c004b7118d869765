"""The closed loop of two trains, a world: what a scenario says of them, their noises, and the events of each step."""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Array, Index
from ..channels import Sent
from ..observation import faulted
from ..randomness import Streams
from ..world import Event, Sensing, Step
from .config import FixedBlockSignalling, MovingBlockConfig
from .control import Control
from .motion import Course, Memory, Records, drive, reading
from .track import StadiumTrack


class TwoTrains:
    """A batch of runs in closed loop with one estimator: a `World`. State: x, y of the leader A, of the follower B.

    lap_times (2, S): when each train had finished its laps, s, NaN while it has not. steering (2, S): along-track
    places by which the trains are driven, empty where they are the estimator's; then `estimate-s-a estimate-s-b` are
    these. extra: `records.along` by the names `s-a s-b gap kept-distance estimate-s-a estimate-s-b` and `records.plane`
    by `x-a y-a x-b y-b estimate-x-a ..`, each (K, S) in m; kept-distance is d_min(k) of (23)."""

    closed_loop = True

    def __init__(self, config: MovingBlockConfig, track: StadiumTrack, streams: Streams, sensing: Sensing) -> None:
        plant, sensors = config.plant, config.sensors
        trains, signalling, rules = plant.trains, plant.signalling, plant.control
        self.steps, self.period = config.time.steps, config.time.period
        self.lengths = np.full(self.steps, self.period)
        runs, length = len(streams.runs), track.length
        fixed = isinstance(signalling, FixedBlockSignalling)
        follow = rules.braking * (-1 + math.sqrt(1 + 4 * rules.leader_ratio)) / 2
        self.control = Control(rules.law == "R", rules.braking, rules.braking_limit, follow, rules.safe_gap,
                               rules.margin, rules.reserve, fixed,
                               min(trains.top_speed, signalling.line_speed) if fixed else trains.top_speed, self.period)
        leader = rules.leader_ratio * rules.braking
        self.line = Course(
            track.half, track.radius, length, length / plant.track.stations, signalling.overlap if fixed else 0.0,
            round(signalling.release_delay / self.period) if fixed else 0, trains.length,
            max(round(trains.dwell / self.period), 1), trains.stop_tolerance,
            (trains.start[0] + trains.laps * length, trains.start[1] + trains.laps * length), (leader, leader),
            sensors.encoder.pulse)
        self.stops = self._stops(config, length)

        truth, measurement = streams("truth"), streams("measurement")
        start = np.repeat(np.array(trains.start)[:, None], runs, axis=1)
        bias = sensors.encoder.bias_mean + sensors.encoder.bias_sd * truth.normal(2)
        x, y, _ = track.points(start + sensors.start_sd * truth.normal(2))
        self.initial_mean = np.stack([x[0], y[0], x[1], y[1]])
        passes = sensors.tags.count * (trains.laps + 4)
        self.tag_s, self.tag_x, self.tag_y = self._tags(config, track, start, passes)
        self.steering = start.copy() if rules.steered_by == "tags" else np.empty((0, runs))
        crossings = self.tag_s[:, :, None] + sensors.tags.sd * measurement.normal(2, passes)
        # A train whose run has gone wrong may go on for ever: beyond the last tag there is none.
        self.crossings = np.concatenate([crossings, np.full((2, 1, runs), np.inf)], axis=1)
        shape = (self.steps, 4, runs)
        readings = faulted(np.zeros(shape), np.ones(shape, dtype=bool), np.arange(1.0, self.steps + 1) * self.period,
                           streams, sensing, config.faults, following=False)
        arrived = config.channel.carry(streams, Sent(readings.y, readings.there, sensing.sd))
        self.heard, self.late = arrived.received, arrived.late
        self.off, self.faulty = readings.y, readings.faulty if config.faults else None
        self.read = measurement.uniform(0.0, 1.0, 2, passes) >= sensors.tags.missed
        noise_sd = sensors.encoder.noise_sd * math.sqrt(sensors.encoder.noise_period / self.period)
        self.factor = 1 + bias + noise_sd * measurement.normal(self.steps, 2)

        zeros = np.zeros_like(start)
        tails = np.full((self.line.delay + 1, runs), trains.start[0] - trains.length)
        self.memory = Memory(start.copy(), zeros.copy(), zeros.copy(), start.copy(), zeros.copy(), zeros.copy(),
                             zeros.copy(), np.full_like(start, -1, dtype=np.int64), zeros.astype(np.int64),
                             zeros.astype(np.int64), np.full_like(start, np.nan), tails)
        self.active = np.ones(runs, dtype=bool)
        self._before = self.initial_mean, np.zeros((4, runs), dtype=bool)
        self.records = Records(np.full((self.steps, 6, runs), np.nan), np.full((self.steps, 8, runs), np.nan),
                               np.zeros((4, runs)), np.zeros((4, runs)), np.zeros(runs), np.full(runs, np.inf),
                               np.zeros(runs, dtype=np.int64))
        names = ("s-a", "s-b", "gap", "kept-distance", "estimate-s-a", "estimate-s-b")
        axes = ("x-a", "y-a", "x-b", "y-b")
        self.extra = {name: self.records.along[:, i] for i, name in enumerate(names)}
        self.extra |= {name: self.records.plane[:, i] for i, name in enumerate((
            *axes, *(f"estimate-{axis}" for axis in axes)))}

    @staticmethod
    def _stops(config: MovingBlockConfig, length: float) -> Array:
        """Arc lengths (2, n) of the stops ahead of each train, well beyond the last lap; at the last one it stays."""
        plant = config.plant
        rows = [[(lap + station / plant.track.stations) * length
                 for lap in range(plant.trains.laps + 3) for station in stations] for stations in plant.trains.stops]
        ahead = [[stop for stop in row if stop > start + plant.trains.stop_tolerance and stop > 0]
                 for row, start in zip(rows, plant.trains.start, strict=True)]
        longest = max(map(len, ahead))
        return np.array([row + [row[-1]] * (longest - len(row)) for row in ahead])

    @staticmethod
    def _tags(config: MovingBlockConfig, track: StadiumTrack, start: Array, passes: int) -> tuple[Array, Array, Array]:
        """Arc lengths (2, passes) of the tags in the order each train meets them, and their map positions."""
        count = config.sensors.tags.count
        all_tags = (np.arange(-count, passes + count) + 0.5) * track.length / count
        met = np.stack([all_tags[all_tags > start[train, 0]][:passes] for train in range(2)])
        x, y, _ = track.points(met)
        return met, x, y

    @property
    def lap_times(self) -> Array:
        return self.memory.arrived

    def step(self, k: int, mean: Array) -> Step:
        """One sampling period under the control that follows from `mean` (4, S)."""
        runs = self.active.size
        u, share, tag = np.empty((2, runs)), np.empty((2, runs)), np.zeros((2, runs), dtype=np.int64)
        truth, under_way = np.empty((4, runs)), np.empty((4, runs), dtype=bool)
        readings = drive(k, np.ascontiguousarray(mean), self.memory, self.line, self.control, self.stops,
                         self.factor[k], (self.tag_s, self.crossings), self.heard[k, ::2], self.read, self.active,
                         self.steering, self.records, self._before, u, share, tag, truth, under_way)
        self._before = truth, under_way
        return Step(u, self._events(readings, share, tag, k), truth, self.active.copy(), under_way,
                    number=k + 1, start=k * self.period, length=self.period)

    def _events(self, readings: int, share: Array, tag: Index, k: int) -> tuple[Event, ...]:
        """Up to two readings, as far as they are heard, and the rest of the step.

        A run without a (second) reading goes through it with what is left of its step first and shares of exactly
        zero after, which change nothing."""
        runs = share.shape[1]
        rest = np.zeros((4, runs)), np.zeros((4, runs), dtype=bool)
        if readings == 0:
            return (Event(1.0, *rest),)
        events, gone = [], np.zeros(runs)
        for number in range(readings):
            until, y, received = np.ones(runs), np.zeros((4, runs)), np.zeros((4, runs), dtype=bool)
            reading(number, share, tag, self.tag_x, self.tag_y, until, y, received)
            late = None if self.late is None else np.where(received, self.late[k], 0)
            wrong = None if self.faulty is None else received & self.faulty[k]
            y = y + self.off[k] if wrong is not None else y
            events.append(Event(until - gone, y, received & self.heard[k], late=late, faulty=wrong))
            gone = until
        return (*events, Event(1.0 - gone, *rest))
