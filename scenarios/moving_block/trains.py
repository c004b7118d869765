"""The closed loop of two trains: control from the estimates, motion, encoders and tags, one compiled step over runs.

Runs never touch each other, so a run's numbers do not depend on the batch it stands in."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..arrays import Array, Index
from ..channels import Sent
from ..machine_code import njit
from ..observation import faulted
from ..randomness import Streams
from ..world import Event, Sensing, Step
from .config import FixedBlockSignalling, MovingBlockConfig
from .control import Control, authority_end, follow_acceleration, kept_distance, next_speed
from .track import StadiumTrack, place, project


class Course(NamedTuple):
    """Track and trains as the compiled step needs them, SI units. accelerate: the leader's and the follower's."""

    half: float
    radius: float
    length: float
    block: float
    overlap: float
    delay: int
    train: float
    dwell: int
    tolerance: float
    goal: tuple[float, float]
    accelerate: tuple[float, float]
    pulse: float


class Memory(NamedTuple):
    """What a run carries from step to step. Along-track m, m/s, unwrapped over laps; trains first, runs last.

    s, v: true. heard: measured speeds. known: estimated along-track position. moved: the last measured distances.
    counted: pulses so far. measured: encoder distance so far. waits: steps of dwell left (-1: under way). stop: index
    of the next stop. passed: tags passed. arrived: time of the laps' end (NaN before). tails: leader's tail, latest
    first."""

    s: Array
    v: Array
    heard: Array
    known: Array
    moved: Array
    counted: Array
    measured: Array
    waits: Index
    stop: Index
    passed: Index
    arrived: Array
    tails: Array


@njit(cache=True)
def _locate(mean, memory, line, time, active):
    """Project the estimates on the track, unwrap them to where the encoder expects the trains, note finished laps."""
    half_length = line.length / 2
    for run in range(mean.shape[1]):
        if not active[run]:
            continue
        for train in range(2):
            expected = memory.known[train, run] + memory.moved[train, run]
            off = project(mean[2 * train, run], mean[2 * train + 1, run], line.half, line.radius) - expected
            known = expected + off - line.length * math.floor((off + half_length) / line.length)
            memory.known[train, run] = known
            if math.isnan(memory.arrived[train, run]) and known >= line.goal[train] - line.tolerance:
                memory.arrived[train, run] = time
        active[run] = math.isnan(memory.arrived[0, run]) or math.isnan(memory.arrived[1, run])


@njit(cache=True)
def _move(memory, line, control, stops, factor, crossings, read, active, u, share, tag):
    """One step of all active runs. stops (2, n), factor (2, S): 1 + b + w, crossings (2, m, S), read (2, m, S).

    Fills u (2, S) the measured distances, share (2, S) of the step's way at which a tag was read (-1: none), tag (2, S)
    its number."""
    for run in range(u.shape[1]):
        share[0, run] = share[1, run] = -1.0
        u[0, run] = u[1, run] = 0.0
        if not active[run]:
            continue
        memory.tails[1:, run] = memory.tails[:-1, run].copy()
        memory.tails[0, run] = memory.s[0, run] - line.train
        limit = math.inf
        follower = line.accelerate[1]
        if control.fixed:
            limit = authority_end(memory.tails[line.delay, run], line.block, line.overlap) - memory.known[1, run]
        else:
            gap = memory.known[0, run] - line.train - memory.known[1, run]
            follower = follow_acceleration(gap, memory.heard[0, run], memory.heard[1, run], control)
        for train in range(2):
            to_stop = stops[train, memory.stop[train, run]] - memory.known[train, run]
            before = memory.v[train, run]
            if memory.waits[train, run] < 0 and before == 0 and to_stop < line.tolerance:
                memory.waits[train, run] = line.dwell
            if memory.waits[train, run] > 0:
                memory.waits[train, run] -= 1
                after = 0.0
            else:
                if memory.waits[train, run] == 0:
                    memory.waits[train, run] = -1
                    memory.stop[train, run] = min(memory.stop[train, run] + 1, stops.shape[1] - 1)
                    to_stop = stops[train, memory.stop[train, run]] - memory.known[train, run]
                after = next_speed(before, line.accelerate[0] if train == 0 else follower, to_stop,
                                   math.inf if train == 0 else limit, control)
            way = (before + after) / 2 * control.period
            start = memory.s[train, run]
            memory.s[train, run] = start + way
            memory.v[train, run] = after
            memory.heard[train, run] = after * factor[train, run]
            # Pulses are counted on the run of the wheel, so rounding does not pile up from step to step.
            memory.measured[train, run] += way * factor[train, run]
            pulses = math.floor(memory.measured[train, run] / line.pulse)
            u[train, run] = (pulses - memory.counted[train, run]) * line.pulse
            memory.counted[train, run] = pulses
            memory.moved[train, run] = u[train, run]
            number = memory.passed[train, run]
            if crossings[train, number, run] <= start + way:
                memory.passed[train, run] = number + 1
                if read[train, number, run]:
                    share[train, run] = max((crossings[train, number, run] - start) / way, 0.0) if way > 0 else 0.0
                    tag[train, run] = number


@njit(cache=True)
def _place_all(s, half, radius, out):
    for train in range(2):
        for run in range(s.shape[1]):
            out[2 * train, run], out[2 * train + 1, run], _, _ = place(s[train, run], half, radius)


class TwoTrains:
    """A batch of runs in closed loop with one estimator: a `World`. State: x, y of the leader A, of the follower B.

    gap_sum, gap_least (S,): of the true gap over a run's steps, m; driven (S,): their number; lap_times (2, S): when
    each train had finished its laps, s, NaN while it has not. squared, counted (4, S): squared errors (m^2) summed
    while each train is under way, and how many. steering (2, S): along-track places by which the trains are driven,
    where they are not the estimator's; then `estimate-s-a estimate-s-b` are these. extra: along-track positions `s-a
    s-b`, their estimates `estimate-s-a estimate-s-b`, `gap`, `kept-distance` d_min(k) of (23), and map positions `x-a
    y-a x-b y-b estimate-x-a ..`, each (K, S) in m, NaN once a run is over; index k: the end of step k."""

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
        self.crossings, self.tag_x, self.tag_y = self._tags(config, track, start, passes)
        self.tag_s = self.crossings
        self.steering = start.copy() if rules.steered_by == "tags" else None
        self.crossings = self.crossings[:, :, None] + sensors.tags.sd * measurement.normal(2, passes)
        # A train whose run has gone wrong may go on for ever: beyond the last tag there is none.
        self.crossings = np.concatenate([self.crossings, np.full((2, 1, runs), np.inf)], axis=1)
        shape = (self.steps, 4, runs)
        readings = faulted(np.zeros(shape), np.ones(shape, dtype=bool), np.arange(1.0, self.steps + 1) * self.period,
                           streams, sensing, config.faults, following=False)
        arrived = config.channel.carry(streams, Sent(readings.y, readings.there, sensing.sd))
        self.heard, self.late = arrived.received, arrived.late
        self.off, self.faulty = readings.y, readings.faulty if config.faults else None
        self.read = measurement.uniform(0.0, 1.0, 2, passes) >= sensors.tags.missed
        noise_sd = sensors.encoder.noise_sd * math.sqrt(sensors.encoder.noise_period / self.period)
        self.factor = 1 + bias + noise_sd * measurement.normal(self.steps, 2)

        zeros = np.zeros((2, runs))
        tails = np.full((self.line.delay + 1, runs), trains.start[0] - trains.length)
        self.memory = Memory(start.copy(), zeros.copy(), zeros.copy(), start.copy(), zeros.copy(), zeros.copy(),
                             zeros.copy(), np.full((2, runs), -1), np.zeros((2, runs), dtype=np.int64),
                             np.zeros((2, runs), dtype=np.int64), np.full((2, runs), np.nan), tails)
        self.active = np.ones(runs, dtype=bool)
        self.driven = np.zeros(runs, dtype=np.int64)
        self.squared, self.counted = np.zeros((4, runs)), np.zeros((4, runs))
        self._truth, self._under_way = self.initial_mean, np.zeros((4, runs), dtype=bool)
        self.gap_sum, self.gap_least = np.zeros(runs), np.full(runs, np.inf)
        self._along = np.full((self.steps, 6, runs), np.nan)
        self._map = np.full((self.steps, 8, runs), np.nan)
        names = ("s-a", "s-b", "gap", "kept-distance", "estimate-s-a", "estimate-s-b")
        axes = ("x-a", "y-a", "x-b", "y-b")
        self.extra = {name: self._along[:, i] for i, name in enumerate(names)}
        self.extra |= {name: self._map[:, i] for i, name in enumerate((*axes, *(f"estimate-{axis}" for axis in axes)))}

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
        all_tags = (np.arange(-count, passes) + 0.5) * track.length / count
        met = np.stack([all_tags[all_tags > start[train, 0]][:passes] for train in range(2)])
        x, y, _ = track.points(met)
        return met, x, y

    @property
    def lap_times(self) -> Array:
        return self.memory.arrived

    def step(self, k: int, mean: Array) -> Step:
        """One sampling period under the control that follows from `mean` (4, S)."""
        memory, line, runs = self.memory, self.line, self.active.size
        if k > 0:
            self._map[k - 1, 4:] = np.where(self.active, mean, np.nan)
            self.squared += np.where(self._under_way, (mean - self._truth) ** 2, 0.0)
            self.counted += self._under_way
        was_active = self.active.copy()
        if self.steering is not None:
            mean = np.empty((4, runs))
            _place_all(self.steering, line.half, line.radius, mean)
        _locate(np.ascontiguousarray(mean), memory, line, k * self.period, self.active)
        if k > 0:
            self._along[k - 1, 4:] = np.where(was_active, memory.known, np.nan)
        u, share, tag = np.empty((2, runs)), np.empty((2, runs)), np.zeros((2, runs), dtype=np.int64)
        _move(memory, line, self.control, self.stops, self.factor[k], self.crossings, self.read, self.active, u, share,
              tag)
        if self.steering is not None:
            seen = (share >= 0) & self.heard[k, ::2]
            at = np.take_along_axis(self.tag_s, tag, axis=1)
            self.steering = np.where(seen, at + (1 - share) * u, self.steering + u)
        truth = np.empty((4, runs))
        _place_all(memory.s, line.half, line.radius, truth)
        gap = memory.s[0] - line.train - memory.s[1]
        self.gap_sum += np.where(self.active, gap, 0.0)
        self.gap_least = np.where(self.active, np.minimum(self.gap_least, gap), self.gap_least)
        self.driven += self.active
        kept = kept_distance.py_func(memory.v[1], self.control)
        self._along[k, :4] = np.where(self.active, np.stack([memory.s[0], memory.s[1], gap, kept]), np.nan)
        self._map[k, :4] = np.where(self.active, truth, np.nan)
        self._truth, self._under_way = truth, np.repeat(np.isnan(self.lap_times), 2, axis=0)
        return Step(u, self._events(share, tag, k), truth, self.active.copy(), self._under_way,
                    number=k + 1, start=k * self.period, length=self.period)

    def _events(self, share: Array, tag: Index, k: int) -> tuple[Event, ...]:
        """Up to two readings, as far as they are heard, and the rest of the step.

        A run without a (second) reading goes through it with what is left of its step first and shares of exactly
        zero after, which change nothing."""
        runs = share.shape[1]
        seen = share >= 0
        readings = int(seen.sum(axis=0).max())
        nothing = np.zeros((4, runs), dtype=bool)
        if readings == 0:
            return (Event(1.0, np.zeros((4, runs)), nothing),)
        leader_first = ~seen[1] | (seen[0] & (share[0] <= share[1]))
        events, gone = [], np.zeros(runs)
        for number in range(readings):
            of_leader = leader_first if number == 0 else ~leader_first
            due = np.where(of_leader, seen[0], seen[1])
            until = np.where(due, np.where(of_leader, share[0], share[1]), 1.0)
            y, received = np.zeros((4, runs)), nothing.copy()
            for train, of_train in enumerate((of_leader, ~of_leader)):
                here = due & of_train
                received[2 * train:2 * train + 2] = here
                y[2 * train] = np.where(here, self.tag_x[train, tag[train]], 0.0)
                y[2 * train + 1] = np.where(here, self.tag_y[train, tag[train]], 0.0)
            late = None if self.late is None else np.where(received, self.late[k], 0)
            wrong = None if self.faulty is None else received & self.faulty[k]
            y = y + self.off[k] if wrong is not None else y
            events.append(Event(until - gone, y, received & self.heard[k], late=late, faulty=wrong))
            gone = until
        events.append(Event(1.0 - gone, np.zeros((4, runs)), nothing))
        return tuple(events)
