"""The rows a reproduction draws on, by scenario, variant, estimator, metric and quantity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from ...scenarios.arrays import Array
from ...scenarios.errors import InputError
from ..judging.statistics import mean_se, pooled_rmse


@dataclass(frozen=True)
class Found:
    """Our number: value, its standard error, and the standard deviation of single runs (0 where there are none)."""

    value: float
    error: float = 0.0
    spread: float = 0.0


class Book:
    """The rows of a results folder."""

    def __init__(self, rows: pd.DataFrame) -> None:
        self.rows = rows

    def values(self, scenario: str, variant: str, estimator: str, metric: str, quantity: str) -> Array:
        """One value per run in the order of the runs, NaN where a run has none. Raises InputError if none has."""
        part = self.rows[(self.rows["scenario"] == scenario) & (self.rows["variant"] == variant)
                         & (self.rows["estimator"] == estimator)]
        column = next((name for name in part.columns if name.startswith(f"{metric}:{quantity}:")), None)
        if column is None or part[column].isna().all():
            raise InputError(f"published: {scenario}/{variant}/{estimator} has no {metric}:{quantity}")
        return part.sort_values("run")[column].to_numpy(dtype=float)

    def found(self, scenario: str, variant: str, estimator: str, metric: str, quantity: str) -> Found:
        """Mean (RMSE pooled) with its standard error over the runs that have a value."""
        values = self.values(scenario, variant, estimator, metric, quantity)
        values = values[~np.isnan(values)]
        mean, error = pooled_rmse(values) if metric == "rmse" else mean_se(values)
        return Found(mean, error, float(np.std(values, ddof=1)) if len(values) > 1 else 0.0)


def ratio(a: Array, b: Array) -> Found:
    """Ratio of the means of a and b over the runs that have both (errors and spread by the delta method)."""
    both = np.isfinite(a) & np.isfinite(b)
    a, b = a[both], b[both]
    value = float(a.mean() / b.mean())
    spread = float((a - value * b).std(ddof=1) / abs(b.mean()))
    return Found(value, spread / len(a) ** 0.5, spread)
