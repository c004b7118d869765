"""What of the rows is judged: cells, the error column that speaks for a quantity, who stands apart, runs aligned.

A cell's columns come as arrays (estimators, runs), so that every statistic pairs the same runs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from ...scenarios.arrays import Array, Index, Mask
from ..scoring.columns import metric_columns

ERRORS = ("rmse", "mae", "sum-squared", "max", "final")
"""Metrics that are judged; the first a scenario's table shows of a quantity speaks for the quantity."""
FLOORS = ("floor", "efficiency")
"""Metrics of the least error possible, which stand beside an error."""
NEGLIGIBLE = 1e-9
"""Errors under this (SI) are rounding: equal to each other, and no quantity to win by."""
KALMAN_PLUGINS = ("kalman", "ekf", "ukf", "ckf")
"""Plug-ins whose first one in a scenario, in every tuning, is the yardstick that others are set beside."""
Column = tuple[str, str, str, str]
"""(column of the rows, metric, quantity, unit)."""


def cells(rows: pd.DataFrame) -> Iterator[tuple[str, str, pd.DataFrame]]:
    """(scenario, variant, rows) in the order of the rows."""
    for (scenario, variant), part in rows.groupby(["scenario", "variant"], sort=False):
        yield str(scenario), str(variant), part


def judged_columns(rows: pd.DataFrame, about: Mapping[str, Any]) -> list[Column]:
    """The error column that speaks for each quantity of a scenario, in the table's order, where there are values."""
    known = {(metric, quantity): (column, metric, quantity, unit)
             for column, metric, quantity, unit in metric_columns(rows)}
    chosen: dict[str, Column] = {}
    for metric, quantity in (tuple(pair) for pair in about["table"]):
        if metric in ERRORS and (metric, quantity) in known and rows[known[metric, quantity][0]].notna().any():
            chosen.setdefault(quantity, known[metric, quantity])
    return list(chosen.values())


def apart(manifest: Mapping[str, Any], scenario: str, variant: str) -> dict[str, str]:
    """Label -> why an entry is not ranked with the filters: `oracle` (told what others must estimate), `smoother`
    (answers another question; ranked among its own)."""
    entries = manifest["configuration"]["cells"][f"{scenario}/{variant}"]["estimators"]
    about = {label: manifest["estimators"][entry["plugin"]] for label, entry in entries.items()}
    return {label: kind for label, facts in about.items() for kind in ("oracle", "smoother") if facts.get(kind)}


def grounds(manifest: Mapping[str, Any], scenario: str, variant: str) -> dict[str, str]:
    """Label -> what an entry's claims rest on, by the names of `Setting.uncertified`."""
    entries = manifest["configuration"]["cells"][f"{scenario}/{variant}"]["estimators"]
    return {label: "as-new" if entry.get("late") == "as-new" else "guarantee"
            if "reception" in manifest["estimators"][entry["plugin"]].get("needs", ()) else "covariance"
            for label, entry in entries.items()}


def yardsticks(manifest: Mapping[str, Any], scenario: str) -> list[str]:
    """Labels of a scenario's first Kalman-type filter, in every tuning (matched, naive, inflated)."""
    plugins: dict[str, str] = {}
    for key, cell in manifest["configuration"]["cells"].items():
        if key.rpartition("/")[0] == scenario:
            plugins.update({label: entry["plugin"] for label, entry in cell["estimators"].items()})
    first = next((plugin for plugin in plugins.values() if plugin in KALMAN_PLUGINS), None)
    return [label for label, plugin in plugins.items() if plugin == first]


@dataclass(frozen=True)
class Aligned:
    """One cell's rows over the runs that all its estimators have."""

    part: pd.DataFrame

    @cached_property
    def _places(self) -> tuple[Index, Index, list[str], Mask]:
        codes, labels = pd.factorize(self.part["estimator"])
        runs, place = np.unique(self.part["run"].to_numpy(), return_inverse=True)
        present = np.zeros((len(labels), len(runs)), dtype=bool)
        present[codes, place] = True
        whole = np.asarray(present.all(axis=0))
        return np.asarray(codes, dtype=np.int64), place, [str(label) for label in labels], whole

    @property
    def labels(self) -> list[str]:
        """The estimators, in the order of the rows."""
        return self._places[2]

    @property
    def runs(self) -> int:
        """Number of runs that all estimators have."""
        return int(self._places[3].sum())

    @property
    def left_out(self) -> int:
        """Number of runs that only some estimators have."""
        return len(self._places[3]) - self.runs

    def __contains__(self, column: str) -> bool:
        return column in self.part

    def values(self, column: str) -> Array:
        """A column as (estimators, runs); NaN where a run gave no value."""
        return self._laid(self.part[column].to_numpy(dtype=float), np.nan)

    @cached_property
    def lost(self) -> Mask:
        """Which runs did not end well (estimators, runs)."""
        return self._laid((self.part["status"] != "ok").to_numpy(), False)

    def ended(self, statuses: Sequence[str]) -> Mask:
        """Which runs ended in each status (statuses, estimators, runs)."""
        if not self.lost.any():
            return np.zeros((len(statuses), *self.lost.shape), dtype=bool)
        found = self.part["status"].to_numpy()
        return np.stack([self._laid(found == status, False) for status in statuses])

    def _laid(self, values: Array | Mask, empty: float) -> Any:
        codes, place, labels, whole = self._places
        table = np.full((len(labels), len(whole)), empty)
        table[codes, place] = values
        return table[:, whole]
