"""The names of a row's columns: written by running, read by everyone after it."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # workers import this
    import pandas as pd

IDENTITY = ("scenario", "variant", "estimator", "run")
TIMING = ("scenario", "variant", "estimator", "design_s", "latency_us_median", "latency_us_p99", "samples",
          "throughput_ns", "sampling_period_s")
"""Columns of timing.csv."""
PHASES = ("standing", "accelerating", "coasting", "braking")
"""Phases of driving, by the mean acceleration over a step: coasting is what neither accelerates nor brakes."""


def metric_columns(rows: pd.DataFrame) -> list[tuple[str, str, str, str]]:
    """(column, metric, quantity, unit) of the metric columns `metric:quantity:unit`."""
    return [(name, *parts) for name in rows.columns if len(parts := name.split(":")) == 3]  # pyright: ignore


def window_columns(columns: Iterable[str], quantities: Collection[str]) -> dict[str, list[tuple[str, str]]]:
    """quantity -> (window, column) of a rows table's windowed errors, in the order of the columns."""
    out: dict[str, list[tuple[str, str]]] = {}
    for column in columns:
        metric, _, rest = str(column).partition(":")
        name = rest.partition(":")[0]
        quantity = next((q for q in quantities if metric == "rmse" and name.startswith(f"{q}-")), None)
        if quantity and name not in quantities:
            out.setdefault(quantity, []).append((name.removeprefix(f"{quantity}-"), str(column)))
    return out


def shown_unit(about: Mapping[str, Any], metric: str, quantity: str, unit: str) -> tuple[str, float]:
    """(unit, factor) a value is shown in: the scenario's choice for plain errors of the quantity, else as it is."""
    chosen = about.get("shown", {}).get(quantity)
    if chosen and metric in ("rmse", "mae", "max", "min", "final", "mean", "half-width", "floor"):
        return str(chosen[0]), float(chosen[1])
    return ("" if unit in ("1", "1^2") else unit.replace("^2", "²")), 1.0
