"""Errors over the named windows of a trip (a section, the end of an outage), next to those over the whole run.

A window is a set of steps of each run; a step belongs to one window at most."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...estimators.interface import Estimate
from ...scenarios.arrays import Array
from ...scenarios.setting import Outcome, Quantity
from ...scenarios.world import Step


class WindowErrors:
    """Accumulates the squared errors of S runs per window; no windows, no work."""

    def __init__(self, names: Sequence[str], quantities: Sequence[Quantity], runs: int) -> None:
        self.names, self.quantities = tuple(names), tuple(quantities)
        self.squared = np.zeros((len(self.quantities), len(self.names), runs))
        self.steps = np.zeros((len(self.quantities), len(self.names), runs))

    def add(self, estimate: Estimate, step: Step) -> None:
        """Score the estimate of a step in the window each run is in (step.window (S,), -1: none), where the truth is
        known (not NaN)."""
        if not self.names or step.window is None:
            return
        inside = np.flatnonzero(step.active & (step.window >= 0))
        window = step.window[inside]
        parts = [estimate.mean] if estimate.parameter is None else [estimate.mean, estimate.parameter]
        vector = np.concatenate(parts)
        for q, item in enumerate(self.quantities):
            known = np.isfinite(step.truth[[i for i, _ in item.components]][:, inside]).all(axis=0)
            self.steps[q, window, inside] += known
            for i, weight in item.components:
                error = weight * (vector[i, inside] - step.truth[i, inside])
                self.squared[q, window, inside] += np.where(
                    known, error * error / (len(item.components) if item.mean else 1), 0.0)

    def finish(self) -> dict[Outcome, Array]:
        """{("rmse", "QUANTITY-WINDOW", unit): (S,)}, NaN where a run never was in the window."""
        steps = np.where(self.steps > 0, self.steps, np.nan)
        return {("rmse", f"{item.name}-{name}", item.unit): np.sqrt(self.squared[q, w] / steps[q, w])
                for q, item in enumerate(self.quantities) for w, name in enumerate(self.names)}
