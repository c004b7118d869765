"""One recorded trip as a batch of runs hears it: readings, noise that was asked for, outages, and what is scored.

An estimate is never scored by a reading that its estimator was given: where the reference is a reading itself, only
what was withheld, or told with noise on top, is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import gcd
from typing import Any

import numpy as np

from ..aboard import Aboard, sense
from ..aboard.sensing import Trip
from ..arrays import Array, Index, Mask
from ..channels import Sent
from ..observation import faulted
from ..randomness import RunRandom, Streams
from ..sensors.wheel import rolled as rolled_variance
from ..world import Sensing, Step, Trajectory
from .config import Outage, RecordedConfig
from .recording import Recording
from .told import WheelKnowledge
from .wheels import WHEELS, counted, held, step_of, told

INPUTS = ("distance", "speed", "control", "acceleration")
"""The input's elements: by the odometer (or the integral of the speed), as told, share, m/s^2. With wheels, those of
the odometer's model stand behind them."""


@dataclass(frozen=True)
class Several(Trajectory):
    """Runs on trips of different times. each (K, S): length of the interval that ends at step k, s; 0 after a run's
    end."""

    each: Array = None  # pyright: ignore[reportAssignmentType]

    def step(self, k: int, mean: Array) -> Step:
        lengths = self.each[k]
        return replace(super().step(k, mean), start=self.each[:k].sum(axis=0), length=lengths)


def together(parts: Mapping[int, Trajectory], which: Index) -> Several:
    """The worlds of several trips, by their number, as one of all runs: which (S,) is each run's trip."""
    longest = max(parts.values(), key=lambda part: part.steps)
    K, runs = longest.steps, len(which)

    def joined(name: str, fill: float | bool) -> Any:
        pieces = {trip: getattr(part, name) for trip, part in parts.items()}
        first = next(iter(pieces.values()))
        out = np.full((K, *first.shape[1:-1], runs), fill, dtype=first.dtype)
        for trip, values in pieces.items():
            out[:len(values), ..., which == trip] = values
        return out

    each, start = np.zeros((K, runs)), np.zeros((len(longest.initial_mean), runs))
    for trip, part in parts.items():
        each[:part.steps, which == trip] = part.lengths[:, None]
        start[:, which == trip] = part.initial_mean
    told, late, faulty, reference, variance = (
        None if getattr(longest, name) is None else joined(name, fill) for name, fill in (
            ("covariance", np.nan), ("late", 0), ("faulty", False), ("reference", np.nan), ("variance", np.nan)))
    return Several(
        truth=joined("truth", np.nan), u=joined("u", 0.0), y=joined("y", 0.0), received=joined("received", False),
        active=joined("active", False), lengths=longest.lengths, initial_mean=start, covariance=told,
        late=late, faulty=faulty, reference=reference, variance=variance,
        extra={name: np.zeros((K, runs)) for name in longest.extra} | {"outage": _outages(parts, which, K)},
        windows=longest.windows, window=joined("window", -1), each=each)


def _outages(parts: Mapping[int, Trajectory], which: Index, steps: int) -> Array:
    out = np.zeros((steps, len(which)))
    for trip, part in parts.items():
        out[:part.steps, which == trip] = part.extra["outage"]
    return out


def ride(trip: Recording, config: RecordedConfig, streams: Streams, odometer_step: float, sensing: Sensing,
         trips: int = 1, *, shared: bool = True) -> Trajectory:
    """The world of the runs that take this trip, in turn with others where there are several; shared: what sensors tell
    is the same for all runs. u (K, 4 or 11, S): see `INPUTS`; y (K, ny, S): the sensors' readings in m and m/s, of a
    wheel what it rolled since it was last read; truth (K, 2, S): position and speed, NaN where there is no
    reference."""
    sensors, runs, lengths = config.heard(trip), len(streams.runs), np.diff(trip.time)
    steps, random = len(lengths), streams("measurement")
    readings = {name: _reading(values, config.sensors.noise.get(name, 0.0), random, runs)  # pyright: ignore
                for name, values in trip.measured.items()}
    out = _outage(config.sensors.outage, trip.time[1:], streams, trips)
    start = np.zeros((5, runs))
    start[0], start[1] = begin(trip, readings, runs)
    aboard = _aboard(trip, config, streams)
    rolled = {name: counted(trip.time, trip.measured[name]) for name in WHEELS if name in trip.measured}
    for name, (distance, ends, _) in rolled.items():  # a count before is needed too
        readings[name] = np.concatenate([[np.nan], np.where(ends, distance, np.nan)])[:, None].repeat(runs, axis=1)
    kept = {name: np.isfinite(values[1:]) & _sampled(trip.time, config.sensors.period.get(name, 0.0))  # pyright: ignore
            for name, values in readings.items()}
    for name in set(config.sensors.outage.sensors) & set(kept):
        kept[name] &= ~out
    truth = np.repeat(np.stack([trip.position[1:], trip.speed[1:]], axis=1)[:, :, None], runs, axis=2)
    shape = steps, 1, runs
    parts = [np.nan_to_num(readings[name][1:]).reshape(shape) for name in sensors]
    there = [np.broadcast_to(kept[name], (steps, runs)).reshape(shape) for name in sensors]
    if aboard:
        parts, there = [*parts, aboard.y], [*there, aboard.there]
    sensed = faulted(np.concatenate(parts, axis=1), np.concatenate(there, axis=1), np.cumsum(lengths), streams, sensing,
                     config.faults, truth=truth)
    arrived = config.channel.carry(streams, Sent(sensed.y, sensed.there, sensing.sd))
    clean = dict(kept)
    for i, name in enumerate(sensors):
        clean[name] = kept[name] = arrived.received[:, i]
        if config.faults:
            clean[name] = kept[name] & ~sensed.faulty[:, i]
        if name in rolled:  # faults of a count stay in it
            readings[name][1:] = np.where(rolled[name][1][:, None], sensed.y[:, i], np.nan)
            continue
        readings[name] = np.concatenate([readings[name][:1], np.where(kept[name], arrived.y[:, i], np.nan)])
    y, received = arrived.y.copy(), arrived.received
    late = np.zeros_like(received) if arrived.late is None else arrived.late > 0
    scored = _scored(trip, config, sensors, clean, runs)
    truth = np.where(scored, truth if sensed.truth is None else sensed.truth, np.nan)
    if "odometer" in sensors:
        count = trip.measured["odometer"]
        begun = int(np.isfinite(count).argmax())
        place = start[0] if "position" not in readings else held(readings["position"])[begun]
        y[:, sensors.index("odometer")] += 0.5 * odometer_step - count[begun] + place
    ends = out & ~np.concatenate([out[1:], np.zeros((1, runs), dtype=bool)])
    window = np.where(out, 0, -1)
    window[ends] = 1
    named = config.sensors.outage.place != "none"
    u = _told(trip, {name: values for name, values in readings.items() if name not in rolled}, kept, lengths, runs)
    if "accelerometer" in config.sensors.simulated and aboard:
        u[:, INPUTS.index("acceleration")] = aboard.inputs[:, 0]
    if aboard and not rolled:
        u = np.concatenate([u, aboard.inputs], axis=1)
    if rolled:
        there = np.isfinite(trip.measured[next(iter(rolled))])
        counts = [np.cumsum(np.nan_to_num(readings[name]), axis=0) for name in rolled]
        heard = [np.concatenate([np.repeat(there[:1, None], runs, axis=1), kept[name]]) for name in rolled]
        u = np.concatenate([u, told(trip.time, counts, heard, there, u[:, 3], trip.control)], axis=1)
    said = _said(trip, sensors, config, rolled, 1 if shared else runs)
    passed = _passed(trip, kept["balise"]) if "balise" in sensors else None
    if aboard and "balise" in aboard.names:
        passed = aboard.references(received[:, len(sensors) + aboard.names.index("balise")])
    return Trajectory(
        truth=truth, u=u, y=np.where(received | late, y, 0.0), received=received,
        late=arrived.late, faulty=sensed.faulty if config.faults else None, active=np.ones((steps, runs), dtype=bool),
        lengths=lengths, initial_mean=start, extra={"outage": out.astype(float)},
        windows=("outage", "outage-end") if named else (), window=window.astype(np.int16),
        covariance=None if aboard else said, reference=passed,
        variance=_variances(said, aboard, len(sensors)) if aboard else None)


def _aboard(trip: Recording, config: RecordedConfig, streams: Streams) -> Aboard | None:
    """The simulated sensors on the trip's reference; None where there are none."""
    if not config.sensors.simulated:
        return None
    position, speed = (np.repeat(values[:, None], len(streams.runs), axis=1) for values in (trip.position, trip.speed))
    ridden = Trip(position, speed, np.diff(trip.time), config.plant.line, config.plant.train)
    return sense(ridden, config.sensors.simulated, config.sensors, config.plant, config.plant.laid(trip),
                 streams).carried(position)


def _variances(said: Array | None, aboard: Aboard, count: int) -> Array:
    """What the `count` recorded sensors and those aboard tell of each element, (K, ny, S)."""
    steps, _, runs = aboard.variance.shape
    own = np.full((steps, count, 1), np.nan) if said is None else np.einsum("kiis->kis", said)
    return np.concatenate([np.broadcast_to(own, (steps, count, runs)), aboard.variance], axis=1)


def _passed(trip: Recording, heard: Mask) -> Array:
    """Where the last balise heard (K, S) lies as told and by the reference (K, 2, S), NaN before the first."""
    last = np.maximum.accumulate(np.where(heard, np.arange(len(heard))[:, None], -1), axis=0)
    places = np.stack([trip.measured["balise"][1:], trip.position[1:]])
    return np.where(last >= 0, places[:, last], np.nan).swapaxes(0, 1)


def begin(trip: Recording, readings: Mapping[str, Array], runs: int) -> tuple[Array, Array]:
    """Position and speed (S,) at the start, from the readings (N, S): the first position (the reference's where none is
    recorded), the first speed, or the pace of the odometer or of the first two positions."""
    place = readings[trip.own][0] if trip.own in readings else np.full(runs, np.nan)
    place = np.where(np.isfinite(place), place, trip.position[0])
    for name in ("speed", "odometer", "wheel-a", "position"):
        there = np.flatnonzero(np.isfinite(trip.measured[name]))[:2] if name in trip.measured else []
        if name == "speed" and len(there):
            return place, readings[name][there[0]]
        if len(there) == 2 and name in readings:
            a, b = there
            return place, (readings[name][b] - readings[name][a]) / (trip.time[b] - trip.time[a])
    return place, np.zeros(runs) if trip.measured else np.full(runs, trip.speed[0])


def _scored(trip: Recording, config: RecordedConfig, sensors: tuple[str, ...], kept: Mapping[str, Mask],
            runs: int) -> Mask:
    """Where an estimate may be scored by the reference of position and speed (K, 2, S). kept: readings that are heard
    as they were."""
    noise: Mapping[str, float] = config.sensors.noise  # pyright: ignore[reportAssignmentType]
    given = {name: kept[name] if noise.get(name, 0.0) == 0.0 else np.zeros_like(kept[name])
             for name in (trip.own, "speed") if name in kept and (name in sensors or name == "speed")}
    scored = {}
    for name in ("position", "speed"):
        source = "speed" if name == "speed" and "speed" in trip.measured else trip.own
        free = trip.apart[name] | ~given.get(source, np.zeros((len(trip.time) - 1, runs), dtype=bool))
        scored[name] = trip.known[name][1:, None] & free
    return np.stack([scored["position"], scored["speed"]], axis=1)


def _told(trip: Recording, readings: Mapping[str, Array], kept: Mapping[str, Mask], lengths: Array, runs: int
          ) -> Array:
    """The input (K, 4, S) of each interval: distance and speed by the odometer and the speed sensor, as far as they are
    heard, each from the other where there is only one; the control; the acceleration.

    A speed is integrated by the trapezoid rule from one reading to the next: between them it is held, and what the next
    one shows to be missing is added with it."""
    heard = {name: np.concatenate([values[:1], np.where(kept[name], values[1:], np.nan)])
             for name, values in readings.items() if name not in ("position", "balise")}
    steps = len(lengths)
    length = lengths[:, None]
    distance, speed = np.zeros((steps, runs)), np.zeros((steps, runs))
    if "speed" in heard:
        values = held(heard["speed"])
        speed = values[1:]
        there = np.isfinite(heard["speed"])
        at = np.where(there, trip.time[:, None], -np.inf)
        at[0] = trip.time[0]
        since = trip.time[1:, None] - np.maximum.accumulate(at, axis=0)[:-1]
        distance = values[:-1] * length + np.where(there[1:], 0.5 * (values[1:] - values[:-1]) * since, 0.0)
    if "odometer" in heard:
        distance = np.diff(held(heard["odometer"]), axis=0)
        speed = speed if "speed" in heard else distance / length
    control = np.zeros(steps) if trip.control is None else trip.control[:-1]
    force = np.zeros((steps, runs))
    if "acceleration" in heard:
        values = held(heard["acceleration"])
        force = 0.5 * (values[1:] + values[:-1])
    return np.stack([distance, speed, np.repeat(control[:, None], runs, axis=1), force], axis=1)


def _said(trip: Recording, sensors: tuple[str, ...], config: RecordedConfig, wheels: Mapping[str, Any],
          runs: int) -> Array | None:
    """The covariance (K, ny, ny, S or 1) that sensors tell with their readings, NaN where one does not; of wheels what
    the step of their count and micro-slip leave open. A balise in a row of other readings was passed within the way
    d since the row before: d^2 / 3 about its end."""
    variances = {name: trip.told[name][1:] ** 2 for name in sensors if name in trip.told}
    known = config.knowledge
    if isinstance(known, WheelKnowledge):
        for name in set(sensors) & set(wheels):
            variances[name] = known.wheel**2 + rolled_variance(wheels[name][0], step_of(trip.measured[name]),
                                                               known.creep)
        if "balise" in sensors and wheels:
            way, own = next(iter(wheels.values()))[0], variances.get("balise", np.nan)
            variances["balise"] = np.where(np.isnan(own), known.balise**2, own) + way**2 / 3
    if not variances:
        return None
    out = np.full((len(trip.time) - 1, len(sensors), len(sensors), runs), np.nan)
    for name, variance in variances.items():
        i = sensors.index(name)
        out[:, i, i] = variance[:, None]
        for other in variances:
            j = sensors.index(other)
            if i != j:
                out[:, i, j] = np.where(np.isnan(variances[other] * variance), np.nan, 0.0)[:, None]
    return out


def _reading(recorded: Array, noise: float, random: RunRandom, runs: int) -> Array:
    """The readings of one sensor (N, S), the recording's with noise added; NaN where there is none."""
    values = np.repeat(recorded[:, None], runs, axis=1)
    return values + noise * random.normal(len(recorded)) if noise else values


def _sampled(time: Array, period: float) -> Mask:
    """Which of the samples after the start (K, 1) are taken where there shall be one in `period` s: the first in each;
    0: all."""
    if period <= 0:
        return np.ones((len(time) - 1, 1), dtype=bool)
    return (np.diff(np.floor((time - time[0]) / period + 1e-6)) > 0)[:, None]


def _outage(outage: Outage, time: Array, streams: Streams, trips: int) -> Mask:
    """Whether each step lies in an outage (K, S)."""
    at, runs = time[:, None], len(streams.runs)
    out = np.zeros((len(time), runs), dtype=bool)
    if outage.place == "windows":
        for begin, end in outage.windows:
            out |= (at >= begin) & (at <= end)
    elif outage.place != "none":
        starts = outage.starts(time)
        chosen = (np.array(streams.runs) // trips * _stride(len(starts)) % len(starts) if outage.place == "sweep"
                  else streams("outage").integers(0, len(starts) - 1))
        out = (at >= starts[chosen]) & (at < starts[chosen] + outage.duration - 1e-9)
    return out


def _stride(count: int) -> int:
    """A step through `count` places that meets each of them once, any few evenly spread (golden section)."""
    near = range(1, count + 1)
    return min((step for step in near if gcd(step, count) == 1), key=lambda step: abs(step - 0.618 * count))
