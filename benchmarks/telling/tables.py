"""Tables as frames of texts: a cell's verdicts, errors by window, by phase of driving, by outage. Of verdicts alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import pandas as pd

from ..scoring.columns import PHASES, window_columns
from .marks import drawn
from .rankings import Cell, records
from .sentences import title_of
from .wording import bracket, metric_name, number, percent, plus_minus, ratio_interval, ratio_of, value_words

Parts = Callable[[Sequence[str], Sequence[str]], dict[str, list[tuple[str, str]]]]


def cell_table(cell: Cell) -> pd.DataFrame:
    """A line an entry: per error its verdict, value and ratio to the best; claim, requirements, outcomes, lost runs,
    time of a step. Columns without an entry are left out."""
    lines: list[dict[str, str]] = []
    for label in cell.labels:
        out = {"entry": label}
        for ranking in cell.rankings:
            line = ranking.line(label)
            if line is not None and drawn(line):
                out[ranking.quantity] = drawn(line)
                out[title_of(ranking)] = value_words(line)
                out[f"{ranking.quantity}: ratio"] = (
                    "" if drawn(line) in ("oracle", "lost") else f"{ratio_of(line)} {ratio_interval(line)}".strip())
                if line["efficiency"] > 0:
                    out[f"{ranking.quantity}: eff."] = percent(line["efficiency"])
        claim = cell.claim(label)
        if claim is not None:
            value = f" {number(claim['value'])}" if claim["kind"] == "consistency" else ""
            out[f"claim ({metric_name(claim['metric'])})"] = f"{claim['verdict']}{value}"
        for name, found in cell.requirements.items():
            out[f"requirement {name}"] = next((f"{line['verdict']} {value_words(line)}" for line in found
                                               if line["estimator"] == label), "")
        for found in cell.outcomes:
            head = bracket(f"{metric_name(found[0]['metric'])} {found[0]['quantity']}", found[0]["shown_unit"])
            out[head] = next((value_words(line) for line in found if line["estimator"] == label), "")
        out["lost"] = f"{cell.lost(label)} of {cell.runs}" if cell.lost(label) else ""
        step = cell.timing.get(label, {}).get("latency_us_median", float("nan"))
        out["step [µs]"] = number(step) if step == step and cell.lost(label) < cell.runs else ""
        lines.append(out)
    frame = pd.DataFrame(lines).fillna("")
    return frame[[name for name in frame.columns if frame[name].astype(bool).any()]]


def window_tables(table: pd.DataFrame, manifest: Mapping[str, Any]) -> Iterator[tuple[str, pd.DataFrame]]:
    """(scenario/variant: quantity by window, table) of cells with several named windows: a line a window, a column an
    estimator, pooled RMSE with half of its 95 % interval in the scenario's shown unit."""
    for head, columns, words in _by_part(table, manifest, windows):
        lines = [{"window": window} | words[name] for window, name in columns]
        yield f"{head} by window", pd.DataFrame(lines).fillna("")


def windows(names: Sequence[str], quantities: Sequence[str]) -> dict[str, list[tuple[str, str]]]:
    """quantity -> (window, its quantity's name) of metrics that are errors in one of several windows."""
    return {quantity: found for quantity, columns in _parts(names, quantities).items()
            if len(found := [part for part in columns if part[0] not in PHASES]) > 1}


def phase_tables(table: pd.DataFrame, manifest: Mapping[str, Any]) -> Iterator[tuple[str, pd.DataFrame]]:
    """(scenario/variant: quantity by phase, table) of cells with a true speed: a line an entry, a column a phase of
    driving."""
    for head, columns, words in _by_part(table, manifest, phases):
        yield f"{head} by phase", pd.DataFrame([
            {"entry": label} | {phase: words[name][label] for phase, name in columns if label in words[name]}
            for label in dict.fromkeys(label for _, name in columns for label in words[name])]).fillna("")


def phases(names: Sequence[str], quantities: Sequence[str]) -> dict[str, list[tuple[str, str]]]:
    """quantity -> (phase, its quantity's name) of metrics that are errors in a phase of driving."""
    return {quantity: found for quantity, columns in _parts(names, quantities).items()
            if (found := [part for part in columns if part[0] in PHASES])}


def _by_part(table: pd.DataFrame, manifest: Mapping[str, Any], parts: Parts) -> Iterator[
        tuple[str, list[tuple[str, str]], dict[str, dict[str, str]]]]:
    """What each table is of, its parts with their quantities' names, and by name the words of each estimator."""
    values = table[table["kind"] == "value"]
    for (scenario, variant), part in values.groupby(["scenario", "variant"], sort=False):
        names = (part["metric"] + ":" + part["quantity"] + ":" + part["unit"]).unique()
        by_quantity = parts(names, manifest["scenarios"][str(scenario)]["quantities"])
        wanted = {name for columns in by_quantity.values() for _, name in columns}
        lines = records(part[(part["metric"] == "rmse") & part["quantity"].isin(wanted)])
        for quantity, columns in by_quantity.items():
            found = {name: [line for line in lines if line["quantity"] == name] for _, name in columns}
            head = bracket(f"rmse of {quantity}", found[columns[0][1]][0]["shown_unit"])
            yield f"{scenario}/{variant}: {head}", columns, {
                name: {line["estimator"]: plus_minus(line) for line in some} for name, some in found.items()}


def _parts(names: Sequence[str], quantities: Sequence[str]) -> dict[str, list[tuple[str, str]]]:
    return {quantity: [(window, column.split(":")[1]) for window, column in columns]
            for quantity, columns in window_columns(names, quantities).items()}


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
