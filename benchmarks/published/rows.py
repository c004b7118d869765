"""The rows a reproduction draws on, by scenario, variant, estimator, metric and quantity.

What is found in them keeps its single runs, by which a number of one run is judged."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from ...scenarios.arrays import Array
from ...scenarios.errors import InputError
from ..judging.statistics import mean_se, pooled_rmse


@dataclass(frozen=True)
class Found:
    """Our number: value, its standard error, the standard deviation of single runs (0 where there are none), and the
    runs themselves (S,), NaN where one has no value."""

    value: float
    error: float = 0.0
    spread: float = 0.0
    runs: Array | None = field(default=None, compare=False)

    def times(self, factor: float) -> Found:
        """In another unit."""
        return Found(self.value * factor, self.error * abs(factor), self.spread * abs(factor),
                     None if self.runs is None else self.runs * factor)


class Book:
    """The rows of a results folder."""

    def __init__(self, rows: pd.DataFrame) -> None:
        keys = ["scenario", "variant", "estimator"]
        self.parts = {key: part.sort_values("run") for key, part in rows.groupby(keys, sort=False)} if len(rows) else {}

    def values(self, scenario: str, variant: str, estimator: str, metric: str, quantity: str) -> Array:
        """One value per run in the order of the runs, NaN where a run has none. Raises InputError if none has."""
        part = self.parts.get((scenario, variant, estimator), pd.DataFrame())
        column = next((name for name in part.columns if name.startswith(f"{metric}:{quantity}:")), None)
        if column is None or part[column].isna().all():
            raise InputError(f"published: {scenario}/{variant}/{estimator} has no {metric}:{quantity}")
        return part[column].to_numpy(dtype=float)

    def found(self, scenario: str, variant: str, estimator: str, metric: str, quantity: str) -> Found:
        """Mean (RMSE pooled) with its standard error over the runs that have a value."""
        return summary(self.values(scenario, variant, estimator, metric, quantity), metric == "rmse")


def summary(runs: Array, pooled: bool = False) -> Found:
    """Of one number per run (S,): their mean, pooled as mean squares are where it is an RMSE."""
    values = runs[~np.isnan(runs)]
    mean, error = pooled_rmse(values) if pooled else mean_se(values)
    return Found(mean, error, float(np.std(values, ddof=1)) if len(values) > 1 else 0.0, runs)


def ratio(a: Array, b: Array) -> Found:
    """Ratio of the means of a and b over the runs that have both (errors and spread by the delta method; single runs
    by their own ratios)."""
    both = np.isfinite(a) & np.isfinite(b)
    with np.errstate(divide="ignore", invalid="ignore"):
        runs = np.where(both, a / b, np.nan)
    a, b = a[both], b[both]
    value = float(a.mean() / b.mean())
    spread = float((a - value * b).std(ddof=1) / abs(b.mean()))
    return Found(value, spread / len(a) ** 0.5, spread, runs)


def root(of: Found) -> Found:
    """The root of a ratio of mean squares."""
    value = of.value**0.5
    return Found(value, 0.5 * of.error / value, 0.5 * of.spread / value, None if of.runs is None else of.runs**0.5)


def reduction(a: Array, b: Array) -> Found:
    """1 - a / b, paired over the runs."""
    found = ratio(a, b)
    return Found(1 - found.value, found.error, found.spread, None if found.runs is None else 1 - found.runs)
