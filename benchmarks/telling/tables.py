"""The printed tables: a line an estimator, values with their errors in shown units."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import pandas as pd

from ..judging.statistics import pooled_rmse
from ..scoring.columns import shown_unit, window_columns
from .wording import number, with_error


def cell_tables(summary: pd.DataFrame, manifest: Mapping[str, Any], timing: pd.DataFrame | None,
                notes: Mapping[tuple[str, str, str], str]) -> Iterator[tuple[str, pd.DataFrame]]:
    """For each scenario/variant its printed table: a line per estimator, values with their standard errors in the
    scenario's shown units, the short verdict from `notes`, latency and throughput."""
    for (scenario, variant), part in summary.groupby(["scenario", "variant"], sort=False):
        described = manifest["scenarios"][scenario]
        wanted = [*map(tuple, described["table"]), *((status, "runs") for status in _STATUS)]
        heads: dict[str, int] = {}
        lines: list[dict[str, str]] = []
        for estimator, mine in part.groupby("estimator", sort=False):
            line: dict[str, str] = {"estimator": str(estimator)}
            for metric, quantity, unit, mean, error in zip(
                    *(mine[name] for name in ("metric", "quantity", "unit", "mean", "standard_error")), strict=True):
                if (metric, quantity) in wanted:
                    name, factor = shown_unit(described, metric, quantity, unit)
                    head = f"{metric} {quantity}" + (f" [{name}]" if name else "")
                    heads[head] = wanted.index((metric, quantity))
                    line[head] = with_error(mean * factor, error * factor)
            line["verdict"] = notes.get((str(scenario), str(variant), str(estimator)), "")
            if timing is not None:
                here = timing[(timing["scenario"] == scenario) & (timing["variant"] == variant)
                              & (timing["estimator"] == estimator)]
                if len(here):
                    line["latency [us]"] = number(float(here["latency_us_median"].iloc[0]))
                    line["ns/run-step"] = number(float(here["throughput_ns"].iloc[0]))
            lines.append(line)
        frame = pd.DataFrame(lines).fillna("")
        order = ["estimator", *sorted(heads, key=heads.__getitem__),
                 *(c for c in _LAST if c in frame.columns and frame[c].astype(bool).any())]
        yield f"{scenario}/{variant}", frame[order]


def window_tables(rows: pd.DataFrame, manifest: Mapping[str, Any]) -> Iterator[tuple[str, pd.DataFrame]]:
    """(scenario/variant: quantity by window, table) of cells with several named windows: a line a window, a column an
    estimator, pooled RMSE with its standard error in the scenario's shown unit."""
    for (scenario, variant), part in rows.groupby(["scenario", "variant"], sort=False):
        about = manifest["scenarios"][scenario]
        for quantity, columns in window_columns(rows.columns, about["quantities"]).items():
            given = [(window, column) for window, column in columns if part[column].notna().any()]
            if len(given) < 2:
                continue
            name, factor = shown_unit(about, "rmse", quantity, given[0][1].rpartition(":")[2])
            lines = [{"window": window} | {str(label): with_error(*(factor * x for x in pooled_rmse(mine[column])))
                                           for label, mine in part.groupby("estimator", sort=False)}
                     for window, column in given]
            unit = f" [{name}]" if name else ""
            yield f"{scenario}/{variant}: rmse of {quantity}{unit} by window", pd.DataFrame(lines)


def outage_tables(rows: pd.DataFrame) -> Iterator[tuple[str, pd.DataFrame]]:
    """(scenario/variant, table) of cells whose runs have an outage each: a line a place, in the order of the places,
    a column an estimator, position error at the outage's end, m."""
    begin, error = "begin:outage:s", "rmse:position-outage-end:m"
    if {begin, error} <= set(rows.columns):
        for (scenario, variant), part in rows.groupby(["scenario", "variant"], sort=False):
            table = part.pivot_table(error, begin, "estimator", sort=False)
            if len(table) > 1:
                table = table.sort_index()[[label for label in part["estimator"].unique() if label in table]]
                yield f"{scenario}/{variant}", table.rename_axis("outage begins [s]").reset_index()
_STATUS = ("diverged", "failed", "crashed", "timeout", "infeasible")
_LAST = ("latency [us]", "ns/run-step", "verdict")
