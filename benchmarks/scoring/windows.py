"""Errors over parts of a trip (a section, the end of an outage, the phases of driving), next to those of the whole run.

A part is a set of steps of each run; a step belongs to one window and to one phase at most."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...scenarios.arrays import Array
from ...scenarios.setting import Outcome, Quantity
from .columns import PHASES
from .kernels import add_windows, driving_phases
from .stretch import Stretch


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

    def add(self, stretch: Stretch, skip: int) -> None:
        """Score steps from the world's step `skip` on in the window each run is in, where the truth is known."""
        if stretch.window is not None:
            self._add(stretch, skip, stretch.window)

    def _add(self, stretch: Stretch, skip: int, window: NDArray[np.int16]) -> None:
        if self.names:
            take = stretch.from_place(skip)
            add_windows(stretch.vector[take], stretch.truth[take], stretch.active[take], window[take], self.index,
                        self.weight, self.owner, self.share, self.squared, self.steps)

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
        self.before = np.full(runs, np.nan)

    def add(self, stretch: Stretch, skip: int) -> None:
        """Score steps from the world's step `skip` on; of those before only the speed counts."""
        if self.names:
            phase = np.empty(stretch.active.shape, dtype=np.int16)
            (speed, _), *_ = self.quantities[-1].components
            driving_phases(stretch.truth[:stretch.count], speed, stretch.length, self.before, phase[:stretch.count])
            self._add(stretch, skip, phase)
