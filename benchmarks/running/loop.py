"""The only loop in the suite that feeds an estimator: rows, latency, speed comparisons and the conformance test use it.

Causality holds by construction, closed loops work, and the estimator's time is measured apart from everything else."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from time import perf_counter

import numpy as np

from ...estimators.interface import Estimate, Estimator, Innovation, Walk, cut
from ...estimators.late import Mailbox
from ...scenarios.arrays import Mask, read_only
from ...scenarios.errors import InputError
from ...scenarios.measurement import Interval, Measurement, PerRun
from ...scenarios.world import FIRST_EDITION, Event, Step, Straight, World

STRETCH = 16
"""How many steps an estimator walks at once at the most: their covariances stay in the cache."""
new = tuple.__new__
"""Makes a named tuple in half the time, which counts where one run goes a step in microseconds."""


class Observer:
    """What is looked at on the way, outside the estimator's time. Arrays handed in may be reused by the next call.

    walks: whole stretches may come at once, in `walked`, where only estimates after the measurements are asked for, or
    only those before.
    every: `predicted` and `updated` come for each event, not for the last of a step alone; innovations: `measured` is
    called. Nothing that is not asked for is computed."""

    predicted_wanted = False
    updated_wanted = True
    every = False
    walks = False

    def walked(self, k: int, straight: Straight, walk: Walk) -> None:
        """Estimates and innovations of steps from k on."""

    def predicted(self, step: Step, event: int, estimate: Estimate) -> None:
        """The estimate before the measurement of an event."""

    def measured(self, step: Step, measurement: Measurement, innovation: Innovation) -> None:
        """The innovation of a measurement, where the estimator tells one."""

    def updated(self, step: Step, event: int, estimate: Estimate) -> None:
        """The estimate after the measurements of an event."""

    def smoothed(self, number: int, estimate: Estimate) -> None:
        """A smoother's estimate at the end of the step of this number, which lies back."""


class Loop:
    """A started estimator in a world. `step` goes one step ahead; seconds: spent inside the estimator so far.

    idle: the estimator is called even where no run of the batch has anything to do. own: how many leading states of the
    estimator are the setting's; all are where it is None. What observers and the world see is cut to them."""

    def __init__(self, world: World, estimator: Estimator, observer: Observer, *, idle: bool = True,
                 own: int | None = None) -> None:
        self.world, self.estimator, self.observer, self.idle, self.own = world, estimator, observer, idle, own
        self.mailbox = Mailbox(estimator.late)
        begun = perf_counter()
        self.mean = self._estimate().mean
        self.seconds = perf_counter() - begun

    def steps(self) -> Iterator[Step]:
        """All steps of the world, until no run is under way any more; of those walked at once the last alone."""
        k, straight = 0, getattr(self.world, "straight", None)
        early, late = self.observer.predicted_wanted, self.observer.updated_wanted
        walks = (self.observer.walks and early != late and straight is not None and self.estimator.lag == 0
                 and not self.estimator.oracle and self.own in (None, *np.shape(self.mean)[:1]))
        while k < self.world.steps:
            ahead = straight(k, STRETCH) if walks and straight else None
            if ahead is not None:
                begun = perf_counter()
                walk = self.estimator.walk(ahead.course, early)
                self.seconds += perf_counter() - begun
                walks = walk is not None
                if walk is not None:
                    self.observer.walked(k, ahead, walk)
                    k += len(ahead.truth)
                    yield ahead.last
                    continue
            step = self.step(k)
            if step is None:
                return
            k += 1
            yield step

    def step(self, k: int) -> Step | None:
        """What happens on the way to the world's instant k; None, and nothing happens, once all runs have ended."""
        estimator, observer = self.estimator, self.observer
        early, late, every = observer.predicted_wanted, observer.updated_wanted, observer.every
        step = self.world.step(k, self.mean)
        under_way = int(np.count_nonzero(step.active))
        if not under_way:
            return None
        if step.number == FIRST_EDITION:
            raise InputError(
                f"{type(self.world).__name__}.step: a Step needs number=.. (0 is the start), start=.. and length=.. in "
                "seconds, its events Event(share, y, received) with the share of the step; one without is of "
                "railstate's first edition")
        listens = None if under_way == len(step.active) else step.active
        if estimator.oracle:
            estimator.reveal(step.truth)
        u = read_only(step.u)
        last, gone, spent = len(step.events) - 1, 0.0, 0.0
        for number, event in enumerate(step.events):
            share, interval = event.share, None
            if isinstance(share, float) and share == 1.0:
                interval, gone = new(Interval, (step.number, step.start, step.length, 1.0)), 1.0
            else:
                if not (isinstance(share, float) and share == 0.0) and (self.idle or np.any(share)):
                    interval = Interval(step.number, step.start + gone * step.length, share * step.length, share)
                gone = gone + share
            arriving = self._arriving(step, event, number, gone, listens)
            begun = perf_counter()
            if interval is not None:
                estimator.predict(u, interval)
            if early and (number == last or every):
                estimate = self._estimate()
                spent += perf_counter() - begun
                observer.predicted(step, number, estimate)
                begun = perf_counter()
            for measurement in arriving:
                innovation = estimator.update(measurement)
                if innovation is not None:
                    spent += perf_counter() - begun
                    observer.measured(step, measurement, innovation)
                    begun = perf_counter()
            after = self._estimate() if late and (number == last or every) else None
            spent += perf_counter() - begun
            if after is not None:
                self.mean = after.mean
                observer.updated(step, number, after)
        begun = perf_counter()
        if self.world.closed_loop and not late:
            self.mean = self._estimate().mean
        past = estimator.past() if estimator.lag else None
        self.seconds += spent + (perf_counter() - begun)
        if past is not None and estimator.lag:
            observer.smoothed(step.number - estimator.lag, self._cut(past))
        return step

    def finish(self) -> None:
        """Have a smoother say what it makes of the whole, once all steps are done."""
        begun = perf_counter()
        for number, estimate in self.estimator.finish():
            self.seconds += perf_counter() - begun
            self.observer.smoothed(number, self._cut(estimate))
            begun = perf_counter()
        self.seconds += perf_counter() - begun

    def _estimate(self) -> Estimate:
        return self._cut(self.estimator.estimate())

    def _cut(self, estimate: Estimate) -> Estimate:
        return estimate if self.own is None or len(estimate.mean) <= self.own else cut(estimate, self.own)

    def _arriving(self, step: Step, event: Event, number: int, gone: PerRun,
                  listens: Mask | None) -> Sequence[Measurement]:
        """The measurements that are there at an event of a step: its own, and with the last one what comes late. Runs
        that have ended hear nothing."""
        time = step.start + gone * step.length
        received = event.received if listens is None else event.received & listens
        if self.estimator.told_faults and event.faulty is not None:
            received = received & ~event.faulty
        if event.late is not None:
            self.mailbox.post(event, step.number, number, time)
        found: tuple[Measurement, ...] = ()
        if self.idle or received.any():
            covariance = event.covariance
            found = new(Measurement, (read_only(event.y), read_only(received), step.number, number, time,
                                      None if covariance is None else read_only(covariance))),
        if self.mailbox.waiting and number == len(step.events) - 1:
            found += tuple(map(_handed, self.mailbox.due(step.number, number, time, listens)))
        return found


def _handed(measurement: Measurement) -> Measurement:
    """A late measurement, to be read."""
    y, received, step, event, time, covariance = measurement
    return Measurement(read_only(y), read_only(received), step, event, time,
                       None if covariance is None else read_only(covariance))
