"""summary.csv and tables/ from the rows alone: means with standard errors per scenario, variant, estimator, metric.

RMSE is pooled (root of the mean over runs of each run's mean square) with its error by the delta method."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from .statistics import mean_se, pooled_rmse
from .windows import window_columns
from .wording import number, numeric, shown_unit, with_error

COLUMNS = ("scenario", "variant", "estimator", "metric", "quantity", "unit", "mean", "standard_error", "runs")


def metric_columns(rows: pd.DataFrame) -> list[tuple[str, str, str, str]]:
    """(column, metric, quantity, unit) of the metric columns `metric:quantity:unit`."""
    return [(name, *parts) for name in rows.columns if len(parts := name.split(":")) == 3]  # pyright: ignore


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
    return pd.DataFrame(lines, columns=list(COLUMNS))


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


def to_markdown(title: str, frame: pd.DataFrame, notes: Sequence[str]) -> str:
    """A Markdown table with a heading and its notes."""
    head = "| " + " | ".join(frame.columns) + " |"
    rule = "|" + "|".join(" ---: " if numeric(frame[c].tolist()) else " --- " for c in frame.columns) + "|"
    body = ["| " + " | ".join(str(value) for value in row) + " |" for row in frame.to_numpy()]
    return "\n".join([f"## {title}", "", head, rule, *body, "", *(f"- {note}" for note in notes)]) + "\n"


_LATEX = str.maketrans({
    **{letter: f"\\{letter}" for letter in "&%_#${}"}, "\\": r"\textbackslash{}", "^": r"\^{}", "~": r"\~{}",
    "<": "$<$", ">": "$>$", "±": r"$\pm$", "−": "$-$", "–": "--", "·": r"$\cdot$", "×": r"$\times$",
    "∞": r"$\infty$", "µ": r"$\mu$", "σ": r"$\sigma$", "χ": r"$\chi$", "‰": r"\textperthousand{}",
    **{raised: f"$^{{{plain}}}$" for raised, plain in zip("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789", strict=True)}})


def _latex(text: object) -> str:
    """Text for LaTeX; letters it has no word for become question marks."""
    return str(text).translate(_LATEX).replace("}$$^{", "").encode("ascii", "replace").decode()


def to_latex(title: str, frame: pd.DataFrame, notes: Sequence[str]) -> str:
    """A LaTeX table with booktabs rules, in plain ASCII."""
    spec = "".join("r" if numeric(frame[c].tolist()) else "l" for c in frame.columns)
    lines = [r"\begin{table}", r"\centering", rf"\caption{{{_latex(title)}}}", rf"\begin{{tabular}}{{{spec}}}",
             r"\toprule", " & ".join(_latex(c) for c in frame.columns) + r" \\", r"\midrule"]
    lines += [" & ".join(_latex(value) for value in row) + r" \\" for row in frame.to_numpy()]
    lines += [r"\bottomrule", r"\end{tabular}", *(rf"\par\footnotesize {_latex(note)}" for note in notes)]
    lines += [r"\end{table}"]
    return "\n".join(lines) + "\n"
