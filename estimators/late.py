"""Packets that come late: the mailbox between a world and an estimator, and the wrapper that rewinds.

One mailbox serves all policies: `drop` takes what is in time, `as-new` takes late readings for fresh ones, `rewind`
goes back to their stamp."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..scenarios.arrays import Array, Mask, read_only
from ..scenarios.errors import Unsupported
from ..scenarios.measurement import Interval, Measurement, PerRun
from ..scenarios.model import DesignModel
from ..scenarios.randomness import RunRandom
from ..scenarios.world import Event
from .interface import Estimate, Estimator, Innovation


class Mailbox:
    """Late packets of a batch, kept until they arrive. policy: of the estimator that they are for."""

    def __init__(self, policy: str) -> None:
        self.policy = policy
        self.waiting: dict[int, list[Measurement]] = {}

    def post(self, event: Event, step: int, number: int, time: PerRun) -> None:
        """Keep what an event of a step sends late, by the step in which it arrives."""
        if event.late is None or self.policy == "drop":
            return
        for age in np.unique(event.late[event.late > 0]).tolist():
            self.waiting.setdefault(step + age, []).append(
                Measurement(event.y, event.late == age, step, number, time, event.covariance))

    def due(self, step: int, number: int, time: PerRun, listens: Mask | None) -> Iterator[Measurement]:
        """What arrives with the last event of a step, oldest stamp first; runs that do not listen hear nothing."""
        arriving = self.waiting.pop(step, [])
        for packet in sorted(arriving, key=lambda found: (found.step, found.event)):
            received = packet.received if listens is None else packet.received & listens
            if not received.any():
                continue
            if self.policy == "as-new":
                yield packet._replace(received=received, step=step, event=number, time=time)
            else:
                yield packet._replace(received=received)


@dataclass
class _Entry:
    """One event of the past: how it was before, the truth revealed until then (to oracles), the prediction that led to
    it (if any) and its measurement so far."""

    before: Any
    truth: Array | None
    prediction: tuple[Array, Interval] | None = None
    measurement: Measurement | None = None


class Rewinding(Estimator):
    """Any estimator, made to take late measurements at their stamp: back to the snapshot before it, and all events
    since once more, the late reading among those of its event.

    From the last late packet on it is equal to the estimator that got everything in order, to the bit. depth: by how
    many steps packets can be late; older ones are not taken. Costs about the filter times depth where packets are late
    all the time."""

    handles_late = True

    def __init__(self, estimator: Estimator, depth: int) -> None:
        self.estimator, self.depth = estimator, depth
        self.parameters = estimator.parameters
        for name in ("oracle", "predicts", "claims", "honours", "needs", "lag", "summary", "source"):
            setattr(self, name, getattr(estimator, name))
        self._past: dict[tuple[int, int], _Entry] = {}
        self._stale: tuple[int, int] | None = None
        self._now = (0, 0)
        self._truth: Array | None = None

    def design(self, model: DesignModel) -> dict[str, Any]:
        return self.estimator.design(model)

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        self.estimator.start(model, runs, random)
        self._judged()
        self._past, self._stale, self._now, self._truth = {}, None, (0, 0), None
        self._next()

    def reveal(self, truth: Array) -> None:
        self._catch_up()
        self._truth = read_only(truth.copy())
        self.estimator.reveal(truth)

    def predict(self, u: Array, interval: Interval) -> None:
        self._catch_up()
        entry = self._past[self._now]
        if entry.measurement is not None or entry.prediction is not None:
            step, event = self._now
            self._now = (interval.step, event + 1 if interval.step == step else 0)
            entry = self._next()
        elif interval.step != self._now[0]:
            del self._past[self._now]
            self._now = (interval.step, 0)
            entry = self._next()
        entry.truth, entry.prediction = self._truth, (read_only(u.copy()), interval)
        self.estimator.predict(u, interval)
        self.status, self.reasons = self.estimator.status, self.estimator.reasons

    def update(self, measurement: Measurement) -> Innovation | None:
        at = measurement.step, measurement.event
        newest = max(self._past)
        if at >= newest:
            self._catch_up()
            if at > newest:
                self._now = at
                entry = self._next()
            else:
                entry = self._past[newest]
            entry.truth, entry.measurement = self._truth, _merged(entry.measurement, measurement)
            innovation = self.estimator.update(measurement)
            self._judged()
            return innovation
        entry = self._past.get(at)
        if entry is not None:
            entry.measurement = _merged(entry.measurement, measurement)
            self._stale = at if self._stale is None else min(at, self._stale)
        return None

    def estimate(self) -> Estimate:
        self._catch_up()
        return self.estimator.estimate()

    def counters(self) -> dict[str, Array]:
        self._catch_up()
        return self.estimator.counters()

    def extremes(self) -> dict[str, Array]:
        self._catch_up()
        return self.estimator.extremes()

    def _judged(self) -> None:
        """Have the estimator's own verdicts at hand: runs that failed, readings it discounted."""
        self.status, self.reasons = self.estimator.status, self.estimator.reasons
        self.rejected = self.estimator.rejected

    def _next(self) -> _Entry:
        """A new event; what is older than `depth` steps is forgotten."""
        entry = self._past[self._now] = _Entry(self.estimator.snapshot(), self._truth)
        for key in [key for key in self._past if key[0] < self._now[0] - self.depth]:
            del self._past[key]
        return entry

    def _catch_up(self) -> None:
        """Everything since the oldest stamp that something new came for, once more."""
        if self._stale is None:
            return
        stale, self._stale = self._stale, None
        for key in sorted(key for key in self._past if key >= stale):
            entry = self._past[key]
            if key == stale:
                self.estimator.restore(entry.before)
            else:
                entry.before = self.estimator.snapshot()
            if entry.truth is not None:
                self.estimator.reveal(entry.truth)
            if entry.prediction is not None:
                self.estimator.predict(*entry.prediction)
            if entry.measurement is not None:
                self.estimator.update(entry.measurement)
        self.status, self.reasons = self.estimator.status, self.estimator.reasons


def _merged(old: Measurement | None, new: Measurement) -> Measurement:
    """Both parts of the measurement of one stamp as one."""
    if old is None:
        return new._replace(y=read_only(new.y.copy()), received=read_only(new.received.copy()))
    return old._replace(y=read_only(np.where(new.received, new.y, old.y)),
                        received=read_only(old.received | new.received))


def for_late(estimator: Estimator, policy: str, depth: int) -> Estimator:
    """The estimator as its entry wants late packets taken; depth: how late they can be, steps. Raises Unsupported for a
    smoother that is to rewind."""
    if policy == "rewind" and estimator.lag != 0:
        raise Unsupported("a smoother cannot rewind: late = \"drop\" or \"as-new\"")
    if policy == "rewind" and depth and not estimator.handles_late:
        estimator = Rewinding(estimator, depth)
    estimator.late = policy
    return estimator
