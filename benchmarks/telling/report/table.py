"""The report's table of one scenario variant: a line per estimator, what it achieved, what it promised, what it costs.

Cells carry a sorting value beside their text; a cell without a claim says why it is empty."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ...judging import statistics as st
from ...judging.contests import Contest
from ...judging.verdicts import Judged, bound_check, column_values, nees_states
from ...scoring.columns import metric_columns
from ..figures.data import CellResults
from ..wording import change_interval, counted, metric_name, number, percent, plus_minus, rough


@dataclass(frozen=True)
class Entry:
    """A table cell: text, a second smaller line, the value it sorts by (None: last), its kind for colouring.

    kind: `good`, `bad`, `none` (empty, the text says why) or ``."""

    text: str
    detail: str = ""
    sort: float | None = None
    kind: str = ""


@dataclass(frozen=True)
class TableLine:
    """A table line: the estimator, its note, its entries."""

    label: str
    note: str
    entries: list[Entry]


@dataclass(frozen=True)
class Table:
    """Column heads (name, unit) and lines."""

    heads: list[tuple[str, str]]
    lines: list[TableLine]


def table(cell: CellResults) -> Table:
    """The table of a variant."""
    parts = {str(label): part for label, part in cell.rows.groupby("estimator", sort=False)}
    columns: list[tuple[tuple[str, str], Callable[[str, pd.DataFrame], Entry]]] = []
    for _, metric, quantity, raw in cell.judged:
        unit, factor = cell.unit(metric, quantity, raw)
        name = f"{quantity} {metric_name(metric)}"
        found = cell.judgements[quantity]
        columns.append(((name, unit), lambda label, _, found=found, factor=factor: _error(found[label], factor)))
    for column, metric, quantity, raw in _outcomes(cell):
        unit, factor = cell.unit(metric, quantity, raw)
        columns.append(((f"{quantity} {metric}" if metric not in quantity else quantity, unit),
                        lambda _, part, column=column, factor=factor: _outcome(part, column, factor)))
    if any(nees_states(part) for part in parts.values()):
        columns.append((("ANEES", "1 is right"), lambda _, part: _anees(part)))
    if any(column_values(part, "coverage:ellipsoid:1").size for part in parts.values()):
        columns.append((("set holds the truth", "of steps"), lambda _, part: _coverage(part, cell)))
    if any(bound_check(part) for part in parts.values()):
        columns.append((("measured / certified", "mean square"), lambda _, part: _bound(part)))
    columns.append((("not finished", "runs"), lambda _, part: _failures(part)))
    if cell.timing:
        columns.append((("latency, 99 %", "µs"), lambda label, _: _latency(cell, label)))
        columns.append((("throughput", "ns per run and step"),
                        lambda label, _: _time(cell, label, "throughput_ns", 1.0)))
        columns.append((("design", "s"), lambda label, _: _time(cell, label, "design_s", 0.001)))
    lines = [TableLine(label, "oracle" if label in cell.oracles else "", [make(label, part) for _, make in columns])
             for label, part in parts.items()]
    return Table([head for head, _ in columns], lines)


def contest_table(challengers: Mapping[str, Mapping[tuple[str, str], Sequence[Contest]]]) -> Table:
    """Challengers against rivals, a line per challenger, quantity and rival, a column per variant."""
    contests = [(challenger, f"{quantity}, against {rival}", {contest.variant: contest for contest in found})
                for challenger, table in challengers.items() for (rival, quantity), found in table.items()]
    variants = list(dict.fromkeys(variant for _, _, found in contests for variant in found))
    lines: list[TableLine] = []
    for challenger, note, found in contests:
        better = sum(contest.verdict == "better" for contest in found.values())
        lines.append(TableLine(challenger, note, [Entry(f"{better} of {len(found)}", "", better),
                                             *(_contest(found.get(variant)) for variant in variants)]))
    return Table([("better in", "variants"), *((variant, "") for variant in variants)], lines)


def _contest(contest: Contest | None) -> Entry:
    if contest is None:
        return Entry("no runs of both", kind="none")
    return Entry(change_interval(contest.found), f"{contest.verdict}, wins {percent(contest.found.won)}",
                 contest.found.relative, {"better": "good", "worse": "bad"}.get(contest.verdict, ""))


def _outcomes(cell: CellResults) -> list[tuple[str, str, str, str]]:
    """Columns of the scenario's table that are neither judged errors nor claims."""
    judged = {column[1:3] for column in cell.judged}
    wanted = [tuple(pair) for pair in cell.about["table"]]
    found = {(metric, quantity): (column, metric, quantity, unit)
             for column, metric, quantity, unit in metric_columns(cell.rows)}
    return [found[pair] for pair in wanted if pair in found and pair not in judged and pair[0] not in
            ("nees", "coverage", "half-width", "bound", "mean-square")]


def _error(found: Judged, factor: float) -> Entry:
    if found.verdict == "none":
        return Entry("no finished run", kind="none")
    text, value = plus_minus(found.value, factor), found.value.value * factor
    if found.against is None:
        return Entry(text, "best", value, "good")
    versus = (f"{change_interval(found.against)}, wins {percent(found.against.won)}"
              if np.isfinite(found.against.relative) else "the best has no error")
    words = {"tie": "tie", "worse": "worse", "oracle": "not ranked", "incomplete": "too few runs"}[found.verdict]
    return Entry(text, f"{words}: {versus}", value, {"tie": "good", "worse": "bad"}.get(found.verdict, ""))


def _outcome(part: pd.DataFrame, column: str, factor: float) -> Entry:
    """Mean with its interval; what is 0 or 1 per run is counted instead, with Wilson's interval of the share."""
    values = column_values(part, column)
    if not values.size:
        return Entry("no value", kind="none")
    if column.endswith(":1") and np.isin(values, (0.0, 1.0)).all():
        share = st.wilson(int(values.sum()), values.size)
        return Entry(f"{int(values.sum())} of {values.size}", f"{percent(share.low)} to {percent(share.high)}",
                     share.value)
    found = st.mean_interval(values)
    return Entry(plus_minus(found, factor), "", found.value * factor)


def _anees(part: pd.DataFrame) -> Entry:
    states = nees_states(part)
    if not states:
        return Entry("claims no covariance", kind="none")
    values = part["nees:state:1"].to_numpy(dtype=float)
    found, word = st.anees(values, states), st.consistency(values, states)
    low, high = st.chi_square_interval(found.n, states)
    return Entry(f"{number(found.value)} [{number(found.low)}, {number(found.high)}]",
                 f"{word}; χ² of a step [{number(low)}, {number(high)}]",
                 found.value, {"too sure": "bad", "consistent": "good"}.get(word, ""))


def _coverage(part: pd.DataFrame, cell: CellResults) -> Entry:
    inside = column_values(part, "coverage:ellipsoid:1")
    if not inside.size:
        return Entry("claims no set", kind="none")
    widths = []
    for column, metric, quantity, raw in metric_columns(part):
        if metric == "half-width":
            unit, factor = cell.unit(metric, quantity, raw)
            widths.append(f"{quantity} ±{number(st.mean_se(part[column])[0] * factor)} {unit}".rstrip())
    left = int((inside < 1).sum())
    broken = f"left in {left} of {inside.size} runs" if left else f"never left in {counted(inside.size, 'run')}"
    return Entry(percent(float(inside.mean())), "; ".join([broken, *widths]), float(inside.mean()),
                 "bad" if left else "good")


def _bound(part: pd.DataFrame) -> Entry:
    found = bound_check(part)
    if not found:
        return Entry("certifies no bound", kind="none")
    share = found.measured.value / found.certified
    return Entry(f"{number(found.measured.value)} / {number(found.certified)}",
                 f"{'broken' if found.broken else 'kept'}: {percent(share)} of the bound", share,
                 "bad" if found.broken else "good")


def _failures(part: pd.DataFrame) -> Entry:
    bad = part.loc[part["status"] != "ok", "status"].value_counts()
    count = int(bad.sum())
    share = st.wilson(count, len(part))
    words = ", ".join(f"{n} {status}" for status, n in bad.items())
    interval = f"{percent(share.low)} to {percent(share.high)}"
    return Entry(f"{count} of {len(part)}", f"{words}; {interval}" if words else interval, share.value,
                 "bad" if count else "")


def _latency(cell: CellResults, label: str) -> Entry:
    values = cell.timing.get(label, {})
    value = values.get("latency_us_p99", np.nan)
    if not np.isfinite(value):
        return Entry("not measured", kind="none")
    factor = 1e6 * cell.period / value
    fits = (f"fits {cell.period:g} s with a factor {rough(factor)}" if factor >= 1
            else f"misses {cell.period:g} s by a factor {rough(1 / factor)}")
    return Entry(number(value), fits, value, "" if factor >= 1 else "bad")


def _time(cell: CellResults, label: str, name: str, least: float) -> Entry:
    """A time of timing.csv; under `least` it says only that."""
    value = cell.timing.get(label, {}).get(name, np.nan)
    if not np.isfinite(value):
        return Entry("not measured", kind="none")
    return Entry(number(value) if value >= least else f"< {least:g}", "", value)


@dataclass(frozen=True)
class Failure:
    """Runs of one estimator that ended alike, and the line that replays the first of them."""

    text: str
    reason: str
    replay: str


def failures(cell: CellResults, folder: str) -> list[Failure]:
    """Every kind of failed run in a variant with its replay line."""
    out: list[Failure] = []
    bad = cell.rows[cell.rows["status"] != "ok"]
    for (label, status, reason), part in bad.groupby(["estimator", "status", "reason"], sort=False, dropna=False):
        first = int(part["run"].iloc[0])
        out.append(Failure(f"{label}: {status} in {counted(len(part), 'run')}",
                           str(reason) if isinstance(reason, str) and reason else "no reason given",
                           f"railstate replay {cell.key}/{label}/{first} --out {folder}"))
    return out

