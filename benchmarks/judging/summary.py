"""summary.csv and tables/ from the rows alone: means with standard errors per scenario, variant, estimator, metric.

RMSE is pooled (root of the mean over runs of each run's mean square) with its error by the delta method."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from ..scoring.columns import metric_columns
from .statistics import mean_se, pooled_rmse

SUMMARY_COLUMNS = ("scenario", "variant", "estimator", "metric", "quantity", "unit", "mean", "standard_error", "runs")


def summarise(rows: pd.DataFrame) -> pd.DataFrame:
    """summary.csv: only runs whose status is ok count, `runs` says how many; shares of other statuses have rows too."""
    lines: list[tuple[Any, ...]] = []
    for (scenario, variant, estimator), part in rows.groupby(["scenario", "variant", "estimator"], sort=False):
        key = (scenario, variant, estimator)
        for column, metric, quantity, unit in metric_columns(rows):
            values = part[column].to_numpy(dtype=float)
            values = values[~np.isnan(values)]
            if len(values):
                mean, error = pooled_rmse(values) if metric == "rmse" else mean_se(values)
                lines.append((*key, metric, quantity, unit, mean, error, len(values)))
        for status in ("diverged", "failed", "crashed", "timeout", "infeasible"):
            share = (part["status"] == status).to_numpy(dtype=float)
            if share.any():
                lines.append((*key, status, "runs", "1", *mean_se(share), len(share)))
    return pd.DataFrame(lines, columns=list(SUMMARY_COLUMNS))
