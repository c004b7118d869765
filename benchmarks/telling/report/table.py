"""The report's table of one scenario variant: a line per estimator, what it achieved, what it promised, what it costs.

Cells carry a sorting value beside their text; a cell without a claim says why it is empty."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..figures.data import CellResults
from ..sayings import Line, deciding, drawn
from ..tables import required_word, value_words
from ..wording import change_interval, counted, metric_name, number, percent, plus_minus, ratio, rough


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
    columns: list[tuple[tuple[str, str], Callable[[str], Entry]]] = []
    for _, metric, quantity, raw in cell.judged:
        columns.append(((f"{quantity} {metric_name(metric)}", cell.unit(metric, quantity, raw)[0]),
                        lambda label, key=(metric, quantity): _error(cell.line("error", *key, label))))
    for metric, quantity, unit in _outcomes(cell):
        columns.append(((f"{quantity} {metric}" if metric not in quantity else quantity, unit),
                        lambda label, key=(metric, quantity): _outcome(
                            cell.line("value", *key, label) or cell.line("share", *key, label))))
    for metric, quantity in dict.fromkeys((line["metric"], line["quantity"]) for line in cell.lines("consistency")):
        columns.append((("ANEES" if metric == "nees" else metric.upper() if metric == "nis" else metric,
                         {"whiteness": "0 is right", "log-likelihood": "per element"}.get(metric, "1 is right")),
                        lambda label, key=(metric, quantity): _consistency(cell.line("consistency", *key, label))))
    for name in dict.fromkeys(line["quantity"] for line in cell.lines("requirement")):
        metric = next(line["metric"] for line in cell.lines("requirement") if line["quantity"] == name)
        columns.append(((f"requirement {name}", "of runs" if metric == "kept" else "of time"),
                        lambda label, key=(metric, name): _required(cell.line("requirement", *key, label))))
    if cell.lines("claim", "coverage"):
        columns.append((("set holds the truth", "of steps"), lambda label: _coverage(cell, label)))
    if cell.lines("claim", "bound"):
        columns.append((("measured / certified", "mean square"),
                        lambda label: _bound(cell.line("claim", "bound", "performance", label))))
    columns.append((("not finished", "runs"), lambda label: _failures(cell.line("reliability", "lost", "runs", label))))
    if cell.timing:
        columns.append((("latency, 99 %", "µs"), lambda label: _latency(cell, label)))
        columns.append((("throughput", "ns per run and step"), lambda label: _time(cell, label, "throughput_ns", 1.0)))
        columns.append((("design", "s"), lambda label: _time(cell, label, "design_s", 0.001)))
    lines = [TableLine(label, "oracle" if label in cell.oracles else "", [make(label) for _, make in columns])
             for label in cell.labels]
    return Table([head for head, _ in columns], lines)


def contest_table(challengers: Mapping[tuple[str, str, str], Sequence[Line]]) -> Table:
    """Challengers against rivals (by challenger, rival, quantity), a line each, a column per variant."""
    variants = list(dict.fromkeys(line["variant"] for lines in challengers.values() for line in lines))
    out: list[TableLine] = []
    for (challenger, rival, quantity), lines in challengers.items():
        better = sum(line["verdict"] == "better" for line in lines)
        found = {line["variant"]: line for line in lines}
        out.append(TableLine(challenger, f"{quantity}, against {rival}", [
            Entry(f"{better} of {len(lines)}", "", better), *(_contest(found.get(variant)) for variant in variants)]))
    return Table([("better in", "variants"), *((variant, "") for variant in variants)], out)


def _contest(line: Line | None) -> Entry:
    if line is None:
        return Entry("no runs of both", kind="none")
    return Entry(change_interval(line), f"{line['verdict']}, wins {percent(line['won'])}", line["ratio"],
                 {"better": "good", "worse": "bad"}.get(line["verdict"], ""))


def _outcomes(cell: CellResults) -> list[tuple[str, str, str]]:
    """(metric, quantity, shown unit) of the scenario's table that are neither judged errors nor claims."""
    wanted = [tuple(pair) for pair in cell.about["table"]]
    found = {(line["metric"], line["quantity"]): line["shown_unit"]
             for line in [*cell.lines("value"), *cell.lines("share")]}
    return [(*pair, found[pair]) for pair in wanted if pair in found and pair[0] not in
            ("nees", "coverage", "half-width", "bound", "mean-square")]


def _error(line: Line | None) -> Entry:
    if line is None or not line["runs"]:
        return Entry("no finished run", kind="none")
    text, value, word = value_words(line), line["value"] * line["factor"], drawn(line)
    if word in ("best", "oracle"):
        return Entry(text, "best" if word == "best" else "not ranked", value, "good" if word == "best" else "")
    if word == "lost":
        return Entry(text, f"lost more runs than equals would; ratio {ratio(line['ratio'])} with the lost runs", value,
                     "bad")
    versus = (f"{change_interval(line)}, wins {percent(line['won'])}" if np.isfinite(line["ratio"])
              else "the best has no error")
    return Entry(text, f"{word}: {versus}{deciding(line)}", value, {"tie": "good", "worse": "bad"}.get(word, ""))


def _outcome(line: Line | None) -> Entry:
    """Mean with its interval; what is 0 or 1 per run is counted instead, with the interval of the share."""
    if line is None:
        return Entry("no value", kind="none")
    if line["kind"] == "share":
        return Entry(f"{round(line['value'] * line['runs'])} of {line['runs']}",
                     f"{percent(line['low'])} to {percent(line['high'])}", line["value"])
    return Entry(plus_minus(line), "", line["value"] * line["factor"])


def _consistency(line: Line | None) -> Entry:
    if line is None:
        return Entry("claims no covariance", kind="none")
    beside = [f"median {number(line['median'])}" if np.isfinite(line["median"]) else "",
              f"{percent(line['inside'], 3)} of steps inside 95 %" if np.isfinite(line["inside"]) else "", line["note"]]
    return Entry(f"{number(line['value'])} [{number(line['low'])}, {number(line['high'])}]",
                 "; ".join(filter(None, [line["verdict"], *beside])), line["value"],
                 {"too sure": "bad", "consistent": "good"}.get(line["verdict"], ""))


def _required(line: Line | None) -> Entry:
    if line is None:
        return Entry("claims nothing of it", kind="none")
    interval = f"{percent(line['value'])} [{number(100 * line['low'])}, {number(100 * line['high'])}]"
    return Entry(required_word(line), f"{interval}; {line['note']}", line["value"],
                 {"met": "good", "not met": "bad"}.get(line["verdict"], ""))


def _coverage(cell: CellResults, label: str) -> Entry:
    line = cell.line("claim", "coverage", "ellipsoid", label)
    if line is None:
        return Entry("claims no set", kind="none")
    widths = [f"{each['quantity']} ±{number(each['value'] * each['factor'])} {each['shown_unit']}".rstrip()
              for each in cell.lines("value", "half-width") if each["estimator"] == label]
    broken = line["note"] or f"never left in {counted(line['runs'], 'run')}"
    return Entry(percent(line["value"]), "; ".join([broken, *widths]), line["value"],
                 "good" if line["verdict"] == "kept" else "bad")


def _bound(line: Line | None) -> Entry:
    if line is None:
        return Entry("certifies no bound", kind="none")
    return Entry(f"{number(line['value'])} / {number(line['value'] / line['ratio'])}",
                 f"{line['verdict']}: {percent(line['ratio'])} of the bound", line["ratio"],
                 {"broken": "bad", "kept": "good"}.get(line["verdict"], ""))


def _failures(line: Line | None) -> Entry:
    if line is None:
        return Entry("no runs", kind="none")
    interval = f"{percent(line['low'])} to {percent(line['high'])}"
    return Entry(f"{line['lost']} of {line['runs']}", f"{line['note']}; {interval}" if line["note"] else interval,
                 line["value"], "bad" if line["lost"] else "")


def _latency(cell: CellResults, label: str) -> Entry:
    values = cell.timing.get(label, {})
    value = values.get("latency_us_p99", np.nan)
    if not np.isfinite(value):
        return Entry("not measured", kind="none")
    factor = 1e6 * cell.period / value
    fits = (f"fits {cell.period:g} s with a factor {rough(factor)}" if factor >= 1
            else f"misses {cell.period:g} s by a factor {rough(1 / factor)}")
    samples = values.get("samples", np.nan)
    few = f"; from {samples:.0f} steps" if samples < 1000 else ""
    return Entry(number(value), fits + few, value, "" if factor >= 1 else "bad")


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

