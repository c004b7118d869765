"""The compiled step of two trains: control from the estimates, motion, encoders and tags, what is noted of the runs.

Runs never touch each other, so a run's numbers do not depend on the batch it stands in."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..arrays import Array, Index
from ..machine_code import njit
from .control import authority_end, follow_acceleration, kept_distance, next_speed
from .track import place, project


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


class Records(NamedTuple):
    """What is kept of the runs; trains first, runs last.

    along (K, 6, S): along-track positions of A and B, gap, `kept_distance`, estimated positions, m; plane (K, 8, S): x,
    y of A and B, then as estimated, m; both at the end of step k, NaN once a run is over. squared, counted (4, S):
    squared errors (m^2) summed while each train is under way, and how many. gap_sum, gap_least (S,): of the true gap
    over a run's steps, m; driven (S,): their number."""

    along: Array
    plane: Array
    squared: Array
    counted: Array
    gap_sum: Array
    gap_least: Array
    driven: Index


@njit(cache=True, inner=True)
def _judge(k, mean, truth, under_way, active, records):
    """Note the estimates of the end of step k and their errors."""
    for i in range(4):
        for run in range(mean.shape[1]):
            if active[run]:
                records.plane[k, 4 + i, run] = mean[i, run]
            if under_way[i, run]:
                error = mean[i, run] - truth[i, run]
                records.squared[i, run] += error * error
                records.counted[i, run] += 1.0


@njit(cache=True, inner=True)
def _locate(mean, memory, line, k, time, active, along):
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
            if k > 0:
                along[k - 1, 4 + train, run] = known
            if math.isnan(memory.arrived[train, run]) and known >= line.goal[train] - line.tolerance:
                memory.arrived[train, run] = time
        active[run] = math.isnan(memory.arrived[0, run]) or math.isnan(memory.arrived[1, run])


@njit(cache=True, inner=True)
def _move(memory, line, control, stops, factor, crossings, read, active, u, share, tag):
    """The trains of all active runs go on by a step, and read tags. Returns the most that a run has read."""
    most = 0
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
        most = max(most, (1 if share[0, run] >= 0 else 0) + (1 if share[1, run] >= 0 else 0))
    return most


@njit(cache=True, inner=True)
def _place_all(s, half, radius, out):
    for train in range(2):
        for run in range(s.shape[1]):
            out[2 * train, run], out[2 * train + 1, run], _, _ = place(s[train, run], half, radius)


@njit(cache=True, inner=True)
def _record(k, memory, line, control, active, records, truth, under_way):
    """Note where the trains are at the end of step k, fill truth and under_way (4, S): which are still under way."""
    _place_all(memory.s, line.half, line.radius, truth)
    for run in range(active.shape[0]):
        for train in range(2):
            going = math.isnan(memory.arrived[train, run])
            under_way[2 * train, run] = going
            under_way[2 * train + 1, run] = going
        if not active[run]:
            continue
        gap = memory.s[0, run] - line.train - memory.s[1, run]
        records.gap_sum[run] += gap
        records.gap_least[run] = min(records.gap_least[run], gap)
        records.driven[run] += 1
        records.along[k, 0, run] = memory.s[0, run]
        records.along[k, 1, run] = memory.s[1, run]
        records.along[k, 2, run] = gap
        records.along[k, 3, run] = kept_distance(memory.v[1, run], control)
        for i in range(4):
            records.plane[k, i, run] = truth[i, run]


@njit(cache=True)
def drive(k, mean, memory, line, control, stops, factor, tags, heard, read, active, steering, records, before, u, share,
          tag, truth, under_way):
    """One step of all runs under the control that follows from `mean`, or from `steering` (2, S) if that is not empty.

    stops (2, n); factor (2, S): 1 + b + w; tags: the places met (2, m) and where they are passed (2, m, S); heard
    (2, S); read (2, m, S); before: truth and under_way after the last step. Fills u (2, S) the measured distances,
    share (2, S) of the step's way at which a tag was read (-1: none), tag (2, S) its number, truth and under_way
    (4, S). Returns the most tags that a run has read."""
    if k > 0:
        _judge(k - 1, mean, before[0], before[1], active, records)
    if steering.size:
        mean = np.empty_like(mean)
        _place_all(steering, line.half, line.radius, mean)
    _locate(mean, memory, line, k, k * control.period, active, records.along)
    most = _move(memory, line, control, stops, factor, tags[1], read, active, u, share, tag)
    if steering.size:
        for train in range(2):
            for run in range(active.shape[0]):
                if share[train, run] >= 0 and heard[train, run]:
                    steering[train, run] = tags[0][train, tag[train, run]] + (1 - share[train, run]) * u[train, run]
                else:
                    steering[train, run] += u[train, run]
    _record(k, memory, line, control, active, records, truth, under_way)
    return most


@njit(cache=True)
def reading(number, share, tag, tag_x, tag_y, until, y, received):
    """The first (number 0) or second tag that each run has read in a step: until (S,) the share of the step by then, 1
    where there is none, y and received (4, S)."""
    for run in range(until.shape[0]):
        leader, follower = share[0, run] >= 0, share[1, run] >= 0
        leader_first = not follower or (leader and share[0, run] <= share[1, run])
        train = 0 if leader_first == (number == 0) else 1
        if follower if train else leader:
            until[run] = share[train, run]
            received[2 * train, run] = received[2 * train + 1, run] = True
            y[2 * train, run] = tag_x[train, tag[train, run]]
            y[2 * train + 1, run] = tag_y[train, tag[train, run]]
