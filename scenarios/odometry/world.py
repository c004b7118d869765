"""The world of an odometry scenario: measurements at the end of each step, balises at their instants inside steps.

A step's first events are its balises, each a prediction up to it and a reading of its own; its last has the rest."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Index, Mask, read_only
from ..measurement import Course
from ..sensors.balise import Passages
from ..world import Event, Step, Straight
from .plant import Ride


@dataclass(frozen=True)
class OdometryWorld:
    """An open-loop world. truth (K, nt, S), u (K, 11, S), y, received, variance (K, ny, S): variance is what each
    sensor tells; heard (K, ny, S): what the channel lets through; balise: its place among the measurements (-1: none),
    start: the first stop, m. extra: what figures want."""

    truth: Array
    u: Array
    y: Array
    received: Mask
    variance: Array
    active: Mask
    period: float
    balise: int
    heard: Mask
    passages: Passages
    ride: Ride
    balise_variance: Array
    start: float
    moving: float
    closed_loop: bool = False
    extra: dict[str, Array] = field(default_factory=dict)

    says: Array = field(init=False)
    """What the sensors tell of their readings at the end of a step (ny, ny, S), the same array every time."""

    def __post_init__(self) -> None:
        ny, runs = self.y.shape[1:]
        object.__setattr__(self, "says", np.zeros((ny, ny, runs)))
        for name in ("u", "y", "received"):  # what estimators are handed, step by step
            object.__setattr__(self, name, read_only(getattr(self, name)))
        # the readings in time order: (step, event) -> runs, shares of the step, balises
        object.__setattr__(self, "readings", dict(self._readings()))
        reference = np.full((self.steps, 2, self.truth.shape[2]), np.nan)
        for step in sorted(self.readings):
            for runs, _, balises in self.readings[step]:
                reference[step:, 0, runs] = self.passages.told[balises, runs]
                reference[step:, 1, runs] = self.passages.place[balises, runs]
        object.__setattr__(self, "reference", reference)
        counts = (self.truth[:, 1] > self.moving) & np.isfinite(reference[:, 1])
        object.__setattr__(self, "scored", np.broadcast_to(counts[:, None], self.truth.shape))
        slides = self.ride.slipping.astype(float)
        self.extra.update({"since-reference": self.truth[:, 0] - reference[:, 1],
                           "reference-error": reference[:, 0] - reference[:, 1], "slide-a": slides[:, 0],
                           "slide-b": slides[:, 1]})

    _events: dict[int, tuple[tuple[Event, ...], Array]] = field(init=False, default_factory=dict)
    readings: dict[int, list[tuple[NDArray[np.int64], Array, NDArray[np.int64]]]] = field(init=False)
    reference: Array = field(init=False)
    scored: Mask = field(init=False)

    def _readings(self) -> Iterator[tuple[int, list[tuple[NDArray[np.int64], Array, NDArray[np.int64]]]]]:
        """For each step with readings a list of events: (runs, share of the step before it, balise of each run)."""
        if self.balise < 0:
            return
        read = self.passages.read & np.isfinite(self.ride.passed)
        balise, run = np.nonzero(read)
        step = np.minimum((self.ride.passed[balise, run] / self.period).astype(np.int64), self.steps - 1)
        share = np.clip(self.ride.passed[balise, run] / self.period - step, 0.0, 1.0)
        got = self.heard[step, self.balise, run]
        balise, run, step, share = balise[got], run[got], step[got], share[got]
        order = np.lexsort((share, run, step))
        balise, run, step, share = balise[order], run[order], step[order], share[order]
        for k in np.unique(step).tolist():
            inside = np.flatnonzero(step == k)
            turn = np.concatenate([np.arange(n) for n in np.unique(run[inside], return_counts=True)[1]])
            yield k, [(run[inside[turn == n]], share[inside[turn == n]], balise[inside[turn == n]])
                      for n in range(int(turn.max()) + 1)]

    @property
    def steps(self) -> int:
        return self.truth.shape[0]

    @property
    def lengths(self) -> Array:
        return np.full(self.steps, self.period)

    @property
    def initial_mean(self) -> Array:
        mean = np.zeros(self.truth.shape[1:])
        mean[0] = self.start
        return mean

    @cached_property
    def _ends(self) -> Index:
        """Steps before which something changes: runs end, or a balise is read inside (K,), the world's end last."""
        turns = np.flatnonzero((self.active[1:] != self.active[:-1]).any(axis=1)) + 1
        return np.unique(np.concatenate([turns, np.fromiter(self.readings, dtype=np.int64), [self.steps]]))

    @cached_property
    def _heard(self) -> Mask:
        """What arrives of runs under way (K, ny, S)."""
        return self.received & self.active[:, None]

    def straight(self, k: int, most: int) -> Straight | None:
        """Steps between two balises."""
        if k in self.readings or not self.active[k].any():
            return None
        end = min(k + most, int(self._ends[np.searchsorted(self._ends, k, side="right")]))
        part = slice(k, end)
        times = np.arange(k, end, dtype=np.float64) * self.period + self.period
        course = Course(k + 1, self.period, times, self.u[part], self.y[part], self._heard[part], self.variance[part])
        return Straight(course, self.truth[part], self.active[part], self.scored[part], None, self.reference[part],
                        self.step(end - 1, self.truth[end - 1]))

    def step(self, k: int, mean: Array) -> Step:
        ny, runs = self.y.shape[1:]
        inner, gone = self._inside(k)
        self.says.reshape(ny * ny, runs)[::ny + 1] = self.variance[k]
        last = Event(1.0 - gone, self.y[k], self.received[k], self.says)
        return Step(self.u[k], (*inner, last), self.truth[k], self.active[k], self.scored[k], None, k + 1,
                    k * self.period, self.period, reference=self.reference[k])

    def _inside(self, k: int) -> tuple[tuple[Event, ...], Array | float]:
        """The balises inside a step, and how much of it is gone then: made once, for all estimators."""
        if k not in self.readings:
            return (), 0.0
        if k not in self._events:
            ny, runs = self.y.shape[1:]
            events, gone = list[Event](), np.zeros(runs)
            for who, share, balise in self.readings[k]:
                at = gone.copy()
                at[who] = share
                y, received = np.zeros((ny, runs)), np.zeros((ny, runs), dtype=bool)
                covariance = np.zeros((ny, ny, runs))
                covariance.reshape(ny * ny, runs)[::ny + 1] = self.variance[k]
                y[self.balise, who] = self.passages.told[balise, who]
                received[self.balise, who] = True
                covariance[self.balise, self.balise, who] = self.balise_variance[balise]
                events.append(Event(at - gone, read_only(y), read_only(received), read_only(covariance)))
                gone = at
            self._events[k] = tuple(events), gone
        return self._events[k]
