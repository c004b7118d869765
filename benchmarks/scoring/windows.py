"""Errors over the named windows of a trip (a section, the end of an outage), next to those over the whole run.

A window is a set of steps of each run; a step belongs to one window at most."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...estimators.interface import Estimate
from ...scenarios.arrays import Array
from ...scenarios.setting import Outcome, Quantity
from ...scenarios.world import Step
from .kernels import add_windows


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
