"""What the sensors aboard read on a true trip: measurements at the ends of steps, balises inside them, inputs told.

Each sensor draws from a stream of its own, so that fitting one leaves every other reading as it was."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import Array, Mask
from ..railway.dynamics import GRAVITY
from ..railway.line import Line, Train
from ..randomness import Streams
from ..sensors.balise import Passages
from ..world import Later, Trajectory
from .config import FITTED, Instruments, Route
from .rolling import roll

MOVING = 0.05
"""Under this speed, m/s, a train stands."""


@dataclass(frozen=True)
class Trip:
    """A true trip of S runs. position, speed (K + 1, S): at its start and at the ends of K steps; lengths (K,) s; line,
    train: for gradients and resistance, None: flat, none."""

    position: Array
    speed: Array
    lengths: Array
    line: Line | None
    train: Train | None

    @property
    def acceleration(self) -> Array:
        """Mean over each step (K, S), m/s^2."""
        return np.diff(self.speed, axis=0) / self.lengths[:, None]

    @property
    def rotating(self) -> float:
        """Share of the rotating parts' mass."""
        return self.train.rotating if self.train else 0.0

    def climb(self, error: Array | None = None) -> Array:
        """The gradient's pull (K, S) m/s^2 where steps end; error (sections, S): of the map's gradients."""
        if self.line is None:
            return np.zeros_like(self.position[1:])
        pairs = np.array(self.line.gradients)
        section = np.clip(np.searchsorted(pairs[:, 0], self.position[1:], side="right") - 1, 0, None)
        off = 0.0 if error is None else np.take_along_axis(error, section, axis=0)
        return GRAVITY / (1 + self.rotating) * (pairs[section, 1] + off)

    def pull(self) -> Array:
        """What drive and brakes do (K, S), m/s^2: the motion, the gradient and the resistance; 0 at a stand."""
        v, resistance = self.speed[1:], 0.0
        if self.train:
            r = self.train.forces
            resistance = r.r0 + 3.6 * v * (r.r1 + 3.6 * v * r.r2)
        still = (v <= MOVING) & (self.speed[:-1] <= MOVING)
        return np.where(still, 0.0, self.acceleration + self.climb() + resistance)


@dataclass(frozen=True)
class Aboard:
    """What the fitted sensors read: names (n,); y (K, n, S), there (K, n, S), variance (K, n, S) that each tells;
    inputs (K, 7, S): those of `railway.odometer.INPUTS`; share (K, S): part of the step after which its balise is
    read; passed (K, S): which balise, -1 for none; passages: the balises; slides (K, 2, S): whether an axle slides."""

    names: tuple[str, ...]
    y: Array
    there: Mask
    variance: Array
    inputs: Array
    share: Array
    passed: Array
    passages: Passages | None
    slides: Mask

    def carried(self, position: Array) -> Aboard:
        """The same with each balise told at its step's end: the way (m) since it was read is added, as a train knows it
        to. position (K + 1, S) m."""
        if "balise" not in self.names:
            return self
        y = self.y.copy()
        y[:, self.names.index("balise")] += (1.0 - self.share) * np.diff(position, axis=0)
        return replace(self, y=y, share=np.ones_like(self.share))

    def beside(self, y: Array, state: Array) -> tuple[Array, Mask, Array]:
        """(readings, which there are, readings without noise as far as these are known) of a setting's own y (K, m, S),
        which are always there and whose clean ones are `state`, and those aboard behind them; (K, m + n, S) each."""
        return (np.concatenate([y, self.y], axis=1), np.concatenate([np.ones(y.shape, dtype=bool), self.there], axis=1),
                np.concatenate([state, self.y], axis=1))

    def heard(self, trajectory: Trajectory) -> Trajectory:
        """A trajectory whose last measurements are these, as observed: what they tell, balises inside steps, places
        known on the way."""
        own = trajectory.y.shape[1] - len(self.names)
        told = np.concatenate([np.full((len(self.y), own, self.y.shape[2]), np.nan), self.variance], axis=1)
        if "balise" not in self.names:
            return replace(trajectory, variance=told)
        row = own + self.names.index("balise")
        reference = self.references(trajectory.received[:, row])
        more = {"since-reference": trajectory.truth[:, 0] - reference[:, 1],
                "reference-error": reference[:, 0] - reference[:, 1]}
        return replace(trajectory, variance=told, inside=(row, self.share), reference=reference,
                       extra=Later(lambda: {**trajectory.extra, **more}))

    def references(self, heard: Mask) -> Array:
        """Where the last balise heard (K, S) lies as told and in truth (K, 2, S), NaN before the first."""
        assert self.passages is not None
        at = np.where(heard, np.arange(len(heard))[:, None], -1)
        last = np.maximum.accumulate(at, axis=0)
        which = np.take_along_axis(self.passed, np.maximum(last, 0), axis=0)
        places = np.stack([np.take_along_axis(part, np.maximum(which, 0), axis=0)
                           for part in (self.passages.told, self.passages.place)], axis=1)
        return np.where((last >= 0)[:, None], places, np.nan)


def sense(trip: Trip, fitted: Sequence[str], instruments: Instruments, route: Route,
          balises: tuple[list[float], list[float]], streams: Streams) -> Aboard:
    """The readings of the fitted sensors. balises: where they lie, and which of them at platforms."""
    position, speed, lengths = trip.position[1:], trip.speed[1:], trip.lengths
    names = tuple(name for name in FITTED if name in fitted)
    everywhere, period = np.ones(position.shape, dtype=bool), float(np.median(lengths))
    rolled, slides = _rolled(trip, route, streams)
    counts, _ = instruments.wheel.count(rolled, streams("wheel"))
    distance = instruments.wheel.travelled(counts)
    error = None if trip.line is None else instruments.gradient * streams("gradient").normal(len(trip.line.gradients))
    reading, _ = instruments.accelerometer.read(trip.acceleration, trip.climb(error), lengths[:, None],
                                                streams("accelerometer"))
    smooth = instruments.wheel.speed(counts, period)
    inputs = np.stack([reading, trip.pull(), np.ones_like(reading), distance[:, 0], distance[:, 1], smooth[:, 0],
                       smooth[:, 1]], axis=1)
    found: dict[str, tuple[Array, Mask, Array]] = {}
    if "wheel-a" in names or "wheel-b" in names:
        worth = instruments.wheel.variance(distance, speed <= MOVING, period)
        found |= {f"wheel-{axle}": (distance[:, j], everywhere, worth[:, j]) for j, axle in enumerate("ab")}
    share, passed, passages = np.ones(position.shape), np.full(position.shape, -1), None
    if "balise" in names:
        passages, share, passed = _passed(trip, instruments, balises, streams)
        told = np.take_along_axis(passages.told, np.maximum(passed, 0), axis=0)
        found["balise"] = (told, passed >= 0, instruments.balise.variance(passages.sd)[np.maximum(passed, 0)])
    if "gnss" in names:
        fixed, seen = instruments.gnss.read(position, route.tunnels, period, streams("gnss"), np.cumsum(lengths))
        found["gnss"] = (fixed, seen, np.full_like(position, instruments.gnss.told**2))
    if "radar" in names:
        doppler, heard, _ = instruments.radar.read(speed, streams("radar"))
        found["radar"] = (doppler, heard, np.full_like(position, instruments.radar.noise**2))
    y, there, variance = (np.stack([found[name][i] for name in names], axis=1) if names else
                          np.zeros((len(position), 0, position.shape[1])) for i in range(3))
    return Aboard(names, y.astype(float), there.astype(bool), variance.astype(float), inputs, share, passed, passages,
                  slides)


def _rolled(trip: Trip, route: Route, streams: Streams) -> tuple[Array, Mask]:
    """Distances that wheels rolled (K, 2, S) m, and whether they slide."""
    if route.adhesion is None:
        moved = np.repeat((trip.position[1:] - trip.position[0])[:, None], 2, axis=1)
        return moved, np.zeros(moved.shape, dtype=bool)
    stops = trip.line.stops if trip.line else [float(trip.position.min()), float(trip.position.max())]
    rail = route.adhesion.rail(stops, route.tunnels, streams("adhesion"))
    return roll(route.adhesion, rail, trip.position, trip.speed, trip.pull(), trip.lengths, trip.rotating)


def _passed(trip: Trip, instruments: Instruments, balises: tuple[list[float], list[float]], streams: Streams
            ) -> tuple[Passages, Array, Array]:
    """The balises, the part of each step (K, S) after which one is read, and which (-1: none); of several in one step
    the last."""
    places, balise = np.array(balises[0]), instruments.balise
    passages = balise.draw(*balises, streams("balise"))
    unit = streams("reader").uniform(-1.0, 1.0, len(places))
    ahead = np.maximum.accumulate(trip.position, axis=0)
    share, passed = np.ones(trip.speed[1:].shape), np.full(trip.speed[1:].shape, -1)
    for r in range(trip.speed.shape[1]):
        near = np.minimum(np.searchsorted(ahead[:, r], places), len(ahead) - 1)
        reach = np.interp(3.6 * trip.speed[near, r], [40.0, 500.0], balise.reader)
        at = places + unit[:, r] * reach
        end = np.searchsorted(ahead[:, r], at)
        for j in np.flatnonzero((end > 0) & (end < len(ahead)) & passages.read[:, r]):
            begun = ahead[end[j] - 1, r]
            share[end[j] - 1, r] = (at[j] - begun) / (ahead[end[j], r] - begun)
            passed[end[j] - 1, r] = j
    return passages, share, passed
