"""The printed tables: a line an estimator, values with half of their 95 % interval, of verdicts alone."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import pandas as pd

from ..scoring.columns import window_columns
from .sayings import caption, records, short_verdicts
from .wording import bracket, number, percent, plus_minus

SHOWN = ("consistency", "claim", "error", "value", "share")
"""Kinds of lines that a printed table shows, the first that has a metric."""
LAST = ("lost", "latency [us]", "ns/run-step", "verdict")


def cell_tables(table: pd.DataFrame, manifest: Mapping[str, Any],
                timing: pd.DataFrame | None) -> Iterator[tuple[str, pd.DataFrame, str]]:
    """For each scenario/variant its printed table and its caption: a line per estimator, values in the scenario's shown
    units, the short verdict, latency and throughput."""
    short = short_verdicts(table)
    for (scenario, variant), part in table.groupby(["scenario", "variant"], sort=False):
        wanted = [tuple(pair) for pair in manifest["scenarios"][str(scenario)]["table"]]
        heads: dict[str, int] = {}
        lines: list[dict[str, str]] = []
        for estimator, mine in part.groupby("estimator", sort=False):
            cells: dict[str, str] = {"estimator": str(estimator)}
            known = records(mine)
            for place, pair in enumerate(wanted):
                line = next((each for kind in SHOWN for each in known
                             if each["kind"] == kind and (each["metric"], each["quantity"]) == pair), None)
                if line and (line["runs"] or line["kind"] == "error"):
                    head = ("ANEES" if line["kind"] == "consistency" and pair[0] == "nees" else
                            bracket(f"{line['metric']} {line['quantity']}", line["shown_unit"]))
                    heads[head] = place
                    cells[head] = value_words(line)
            lost = next((line for line in known if line["metric"] == "lost"), None)
            if lost and lost["lost"]:
                cells["lost"] = f"{lost['lost']} of {lost['runs']}"
            cells["verdict"] = short.get((str(scenario), str(variant), str(estimator)), "")
            if timing is not None:
                here = timing[(timing["scenario"] == scenario) & (timing["variant"] == variant)
                              & (timing["estimator"] == estimator)]
                if len(here):
                    cells["latency [us]"] = number(float(here["latency_us_median"].iloc[0]))
                    cells["ns/run-step"] = number(float(here["throughput_ns"].iloc[0]))
            lines.append(cells)
        frame = pd.DataFrame(lines).fillna("")
        order = ["estimator", *sorted(heads, key=heads.__getitem__),
                 *(c for c in LAST if c in frame.columns and frame[c].astype(bool).any())]
        runs = int(part.loc[part["metric"] == "lost", "runs"].max())
        yield f"{scenario}/{variant}", frame[order], caption(records(part, "error"), runs)


def requirement_tables(table: pd.DataFrame) -> Iterator[tuple[str, pd.DataFrame]]:
    """(scenario/variant: requirements, table) of cells with requirements: a line an estimator and requirement, whether
    it is met, the share that kept it with its interval, and the sizes beside it."""
    for (scenario, variant), part in table[table["kind"] == "requirement"].groupby(["scenario", "variant"], sort=False):
        yield f"{scenario}/{variant}: requirements", pd.DataFrame([
            {"requirement": line["quantity"], "estimator": line["estimator"], "verdict": required_word(line),
             "kept": f"{percent(line['value'])} [{number(100 * line['low'])}, {number(100 * line['high'])}]",
             "asked": f"{percent(float(line['against']))} of {'runs' if line['metric'] == 'kept' else 'time'}",
             "sizes": line["note"].removeprefix("P95 over runs: ")}
            for line in sorted(records(part), key=lambda line: line["quantity"])])


def required_word(line: Mapping[str, Any]) -> str:
    """`met`, `not met`, or `undecided (about 120 runs)`."""
    runs = f" (about {number(line['deciding'], 2)} runs)" if line["deciding"] < float("inf") else ""
    return line["verdict"] + (runs if line["verdict"] == "undecided" else "")


def value_words(line: Mapping[str, Any]) -> str:
    """`0.112 ± 0.003`, shares as `95 % [84, 99]`; with the runs behind it where some are lost; nothing where there is
    no value."""
    if not line["runs"]:
        return ""
    if line["kind"] == "share" or line["metric"] == "coverage":
        return f"{percent(line['value'])} [{number(100 * line['low'])}, {number(100 * line['high'])}]"
    text = plus_minus(line)
    return f"{text} of {line['runs']}" if line["lost"] and line["kind"] == "error" else text


def window_tables(table: pd.DataFrame, manifest: Mapping[str, Any]) -> Iterator[tuple[str, pd.DataFrame]]:
    """(scenario/variant: quantity by window, table) of cells with several named windows: a line a window, a column an
    estimator, pooled RMSE with half of its 95 % interval in the scenario's shown unit."""
    for (scenario, variant), part in table[table["kind"] == "value"].groupby(["scenario", "variant"], sort=False):
        names = (part["metric"] + ":" + part["quantity"] + ":" + part["unit"]).unique()
        for quantity, columns in windows(names, manifest["scenarios"][str(scenario)]["quantities"]).items():
            lines: list[dict[str, str]] = []
            unit = ""
            for window, name in columns:
                mine = records(part[(part["metric"] == "rmse") & (part["quantity"] == name)])
                unit = mine[0]["shown_unit"]
                lines.append({"window": window} | {line["estimator"]: plus_minus(line) for line in mine})
            yield f"{scenario}/{variant}: {bracket(f'rmse of {quantity}', unit)} by window", pd.DataFrame(
                lines).fillna("")


def windows(names: Sequence[str], quantities: Sequence[str]) -> dict[str, list[tuple[str, str]]]:
    """quantity -> (window, its quantity's name) of metrics that are errors in one of several windows."""
    found = window_columns(names, quantities)
    return {quantity: [(window, column.split(":")[1]) for window, column in columns]
            for quantity, columns in found.items() if len(columns) > 1}


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
