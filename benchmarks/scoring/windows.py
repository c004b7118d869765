"""Errors over parts of a trip (a section, the end of an outage, the phases of driving), next to those of the whole run.

A part is a set of steps of each run; a step belongs to one window and to one phase at most."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...estimators.interface import Estimate
from ...scenarios.arrays import Array
from ...scenarios.setting import Outcome, Quantity
from ...scenarios.world import Step
from .columns import PHASES
from .kernels import add_phases, add_windows


class WindowErrors:
    """Accumulates the squared errors of S runs per window; no windows, no work."""

    def __init__(self, names: Sequence[str], quantities: Sequence[Quantity], runs: int) -> None:
        self.names, self.quantities = tuple(names), tuple(quantities)
        self.squared = np.zeros((len(self.quantities), len(self.names), runs))
        self.steps = np.zeros((len(self.quantities), len(self.names), runs))
        parts = [(i, weight, q, len(item.components) if item.mean else 1)
                 for q, item in enumerate(self.quantities) for i, weight in item.components]
        self.index, self.owner = (np.array([part[column] for part in parts], dtype=np.int64) for column in (0, 2))
        self.weight, self.share = (np.array([part[column] for part in parts], dtype=float) for column in (1, 3))

    def add(self, estimate: Estimate, step: Step) -> None:
        """Score the estimate of a step in the window each run is in (step.window (S,), -1: none), where the truth is
        known (not NaN)."""
        if not self.names or step.window is None:
            return
        vector = estimate.mean if estimate.parameter is None else np.concatenate([estimate.mean, estimate.parameter])
        add_windows(np.ascontiguousarray(vector), np.ascontiguousarray(step.truth), step.active, step.window,
                    self.index, self.weight, self.owner, self.share, self.squared, self.steps)

    def finish(self) -> dict[Outcome, Array]:
        """{("rmse", "QUANTITY-WINDOW", unit): (S,)}, NaN where a run never was in the window."""
        steps = np.where(self.steps > 0, self.steps, np.nan)
        return {("rmse", f"{item.name}-{name}", item.unit): np.sqrt(self.squared[q, w] / steps[q, w])
                for q, item in enumerate(self.quantities) for w, name in enumerate(self.names)}


class PhaseErrors(WindowErrors):
    """The same by phase of driving, as the true speed and its change over a step tell it: of the first position (m) and
    the first speed (m/s) among the quantities; without a speed it does nothing."""

    def __init__(self, quantities: Sequence[Quantity], runs: int) -> None:
        speeds = [item for item in quantities if item.unit == "m/s" and item.mean]
        places = [item for item in quantities if item.unit == "m" and item.mean]
        super().__init__(PHASES if speeds else (), [*places[:1], *speeds[:1]] if speeds else (), runs)
        self.speed = speeds[0].components[0][0] if speeds else -1
        self.before, self.phase, self.length = np.full(runs, np.nan), np.full(runs, -1, dtype=np.int16), np.zeros(runs)

    def add(self, estimate: Estimate, step: Step, scored: bool = True) -> None:
        """Score the estimate of a step; of one that is not scored only the speed counts, from which the next one's
        acceleration follows."""
        if not self.names:
            return
        if isinstance(step.length, np.ndarray) or step.length != self.length[0]:
            self.length[:] = step.length
        vector = estimate.mean if estimate.parameter is None else np.concatenate([estimate.mean, estimate.parameter])
        add_phases(np.ascontiguousarray(vector), np.ascontiguousarray(step.truth), step.active, self.speed, self.length,
                   self.before, self.phase, scored, self.index, self.weight, self.owner, self.share, self.squared,
                   self.steps)
