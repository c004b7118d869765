"""What became of a run whose sensors failed: locked or recovered, and what its filter noticed.

Only where the scenario has faults: positions in metres decide whether a run is lost, filters that judge readings
whether a fault was seen."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...estimators.interface import Estimate
from ...scenarios.arrays import Array, Mask
from ...scenarios.faults import Base as Fault
from ...scenarios.measurement import Measurement
from ...scenarios.setting import Outcome, Quantity
from ...scenarios.world import Step

LIMIT, LASTING = 3.0, 10.0
"""A run is locked whose error is above so many metres in each of its last so many seconds."""


def fault_table(faults: Sequence[object], quantities: Sequence[Quantity]) -> tuple[tuple[str, str], ...]:
    """(metric, quantity) pairs that the printed tables of a scenario with faults show besides its own."""
    place = next((item.name for item in quantities if item.unit == "m" and len(item.components) == 1), None)
    positions = () if place is None else (("locked", place), ("recovery", place))
    readings = tuple((name, "readings") for name in ("first-alarm", "hits", "false-alarms"))
    return (*positions, *readings) if faults else ()


class FaultScores:
    """Accumulates over S runs; without faults it does nothing."""

    def __init__(self, faults: Sequence[object], quantities: Sequence[Quantity], runs: int) -> None:
        self.faults = [fault for fault in faults if isinstance(fault, Fault)]
        self.place = next((item for item in quantities if item.unit == "m" and len(item.components) == 1), None)
        self.onset = min((fault.from_ for fault in self.faults), default=np.inf)
        ends = [fault.ends() for fault in self.faults]
        self.end = max((end for end in ends if np.isfinite(end)), default=np.nan)
        self.last, self.fine = np.full(runs, np.nan), np.full(runs, -np.inf)
        self.back = np.full(runs, -np.inf)
        self.lost = np.zeros(runs, dtype=bool)
        self.judges, self.alarm = False, np.full(runs, np.nan)
        self.hits, self.wrong, self.false, self.right = (np.zeros(runs) for _ in range(4))

    def add(self, estimate: Estimate, step: Step) -> None:
        """The estimate of a step, against the truth."""
        if not self.faults or self.place is None:
            return
        (i, weight), = self.place.components
        time = np.broadcast_to(step.start + step.length, self.last.shape)
        error = np.abs(weight * (estimate.mean[i] - step.truth[i]))
        lost = ~(error <= LIMIT)
        found = step.active & self.lost & ~lost
        self.back = np.where(found, time, self.back)
        self.fine = np.where(step.active & ~lost, time, self.fine)
        self.last = np.where(step.active, time, self.last)
        self.lost = np.where(step.active, lost, self.lost)

    def judged(self, step: Step, measurement: Measurement, rejected: Mask | None) -> None:
        """What a filter made of the readings of an event, where it judges them."""
        if not self.faults or rejected is None or measurement.step != step.number:
            return
        self.judges = True
        faulty = step.events[measurement.event].faulty
        faulty = np.zeros_like(rejected) if faulty is None else faulty
        got = measurement.received
        self.hits += (rejected & faulty & got).sum(axis=0)
        self.wrong += (faulty & got).sum(axis=0)
        self.false += (rejected & ~faulty & got).sum(axis=0)
        self.right += (~faulty & got).sum(axis=0)
        time = np.broadcast_to(measurement.time, self.alarm.shape)
        first = (rejected & got).any(axis=0) & (time >= self.onset - 1e-9) & np.isnan(self.alarm)
        self.alarm = np.where(first, time - self.onset, self.alarm)

    def finish(self) -> dict[Outcome, Array]:
        """locked: 1 where the run ends lost (its mean is the share of runs); recovery s: from the end of the faults (a
        jump of the vehicle: from it) until the error stays within the limit, NaN where it never does; first-alarm s
        after the first fault can be; hits, false-alarms: rejected shares of the faulty and of the good readings."""
        out: dict[Outcome, Array] = {}
        if not self.faults:
            return out
        if self.place is not None:
            locked = self.lost & (self.last - self.fine >= LASTING - 1e-9)
            out["locked", self.place.name, "1"] = locked.astype(float)
            if np.isfinite(self.end):
                after = np.maximum(self.back - self.end, 0.0)
                out["recovery", self.place.name, "s"] = np.where(self.lost, np.nan, after)
        if self.judges:
            out["first-alarm", "readings", "s"] = self.alarm
            with np.errstate(invalid="ignore", divide="ignore"):
                out["hits", "readings", "1"] = self.hits / np.where(self.wrong > 0, self.wrong, np.nan)
                out["false-alarms", "readings", "1"] = self.false / np.where(self.right > 0, self.right, np.nan)
        return out
