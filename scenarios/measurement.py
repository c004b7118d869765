"""What the runner hands an estimator besides the input: the interval to predict over, and a measurement of one stamp.

Both know their step, so that nobody counts: step 0 is the start, the interval to step k takes A, B, Q of k - 1 and the
measurement of step k the C and R of k."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .arrays import Array, Mask

PerRun = float | Array
"""A number, or one per run (S,)."""


class Interval(NamedTuple):
    """A stretch of time inside one step. The interval to the first measurement leads to step 1; a world that measures
    at the start gives step 0 and no interval.

    start, length: seconds. share: the part of the step's input u that falls into it (u may be a distance of the whole
    step); 1.0 is a whole step. A run of length 0 stays to the bit as it is, its random stream too. Numbers, or one per
    run (S,)."""

    step: int
    start: PerRun
    length: PerRun
    share: PerRun = 1.0

    @property
    def depart(self) -> int:
        """The step it leaves from: the index of A, B, h, Q."""
        return self.step - 1

    @property
    def whole(self) -> bool:
        """Whether all runs go the whole step."""
        return self.share == 1.0 if isinstance(self.share, float) else bool((np.asarray(self.share) == 1.0).all())

    def moving(self, runs: int) -> Mask:
        """Which of the runs (S,) go any way at all."""
        return np.broadcast_to(np.asarray(self.length) != 0.0, (runs,))

    def of_run(self, run: int) -> Interval:
        """The same for one run, in numbers."""
        def own(part: PerRun) -> float:
            return float(part[run]) if isinstance(part, np.ndarray) and part.ndim else float(part)

        return Interval(self.step, own(self.start), own(self.length), own(self.share))


class Measurement(NamedTuple):
    """What was measured at one stamp and has now arrived. Late packets of several stamps are several of these.

    y, received (ny, S): elements that were not received are never to be read. step: the step of the stamp (C(step)
    belongs to it); event: which event of that step; time: of the stamp, s, a number or (S,). covariance (ny, ny, S or
    1) where sensors tell their own, NaN in the rows and columns of those that do not; None: nobody tells any."""

    y: Array
    received: Mask
    step: int
    event: int = 0
    time: PerRun = 0.0
    covariance: Array | None = None


class Course(NamedTuple):
    """Whole sampling periods in a row, with one measurement at the end of each: B intervals and measurements at once,
    for estimators that go them in compiled code.

    step: the first one leads to; period s; times (B,) of the measurements, s. u (B, nu, S), y, received (B, ny, S);
    variance (B, ny, S) that sensors tell of their elements, uncorrelated, NaN where they do not; None: nobody tells
    any."""

    step: int
    period: float
    times: Array
    u: Array
    y: Array
    received: Mask
    variance: Array | None = None

    @property
    def told(self) -> Array:
        """`variance`, or as many NaN."""
        return np.full(self.y.shape, np.nan) if self.variance is None else self.variance


def untold(step: int, ny: int) -> Measurement:
    """A measurement of one run at a step with nothing told: what to ask a model's own R with."""
    return Measurement(np.zeros((ny, 1)), np.ones((ny, 1), dtype=bool), step)


def told(noise: Callable[[int], Array], inflate: float = 1.0) -> Callable[[Measurement], Array]:
    """`DesignModel.measurement_covariance` from the model's own R of a step, `noise`(step) (ny, ny, 1 or S): R as the
    sensors tell it, the model's own where they do not; a mode may inflate either.

    The shared form (ny, ny, 1) is kept where nothing is told."""

    def covariance(measurement: Measurement) -> Array:
        own, said = noise(measurement.step), measurement.covariance
        if said is not None:
            own = np.where(np.isnan(said), own, said)
        return own if inflate == 1.0 else inflate * own

    return covariance
