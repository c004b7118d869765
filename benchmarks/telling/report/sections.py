"""A scenario's part of the page: findings, ranked plots, tables of the variants, curves, lost runs, faults x filters.

Cells of tables are chips and texts with the numbers behind them, by which they sort and which are saved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup

from ..figures.canvas import Canvas
from ..figures.catalogue import FIGURES, Figure, of_scenario
from ..figures.data import CellResults, Results
from ..marks import MARKS, Line, Mark, drawn, shade
from ..rankings import Cell
from ..sentences import caption, claims_of, finding, floor_name, least, over_variants, requirements_of
from ..wording import (
    bracket,
    counted,
    deciding,
    metric_name,
    notes_of,
    number,
    percent,
    plus_minus,
    ratio_interval,
    ratio_of,
)
from .matrix import anchor
from .plots import curves, ranked

PLOTS = 2
"""Quantities of a variant that have a ranked plot; the table has all."""
FOR_EACH = ("error-over-time", "errors-per-run")
"""Figures that the page draws in its own way."""
CARRIED = "one run carries"
BREAKDOWN = 2.0
"""Times the best of a variant with outliers at which a filter counts as broken down."""


class Entry(NamedTuple):
    """A table cell: its HTML, the numbers that it sorts by (the first) and that are saved, whether it is set right."""

    html: Markup | str
    data: str = ""
    right: bool = False


@dataclass
class Table:
    """heads: (words, names of the saved numbers, whether set right). lines: by entry. notes: under it."""

    heads: list[tuple[Markup | str, str, bool]]
    lines: list[tuple[str, list[Entry]]]
    caption: str
    notes: list[str] = field(default_factory=list)


@dataclass
class Variant:
    """What the page shows of one variant."""

    id: str
    key: str
    title: str
    words: list[str]
    plots: list[tuple[Markup, str]]
    table: Table
    failures: list[tuple[str, str, str]]
    notes: list[str]
    curves: Markup
    panels: int
    curve_words: str
    figures: list[tuple[Figure, Markup]]


@dataclass
class Section:
    """What the page shows of one scenario."""

    id: str
    name: str
    title: str
    source: str
    words: list[str]
    faults: Table | None
    figures: list[tuple[Figure, Markup]]
    variants: list[Variant]


def chip(word: str, text: str, css: str = "") -> Markup:
    """A verdict with its sign."""
    found = MARKS.get(word, Mark("", "", word, "outline"))
    return Markup('<span class="c {}">{} {}</span>').format(css or found.css, found.sign, text)


def section(results: Results, name: str, cells: Sequence[CellResults]) -> Section:
    """A scenario's part. Figures of the settings are drawn for the default variant alone, all in files by `plot`."""
    drawings: dict[str, list[tuple[Figure, Markup]]] = {}
    for figure in FIGURES:
        if figure.name not in FOR_EACH and not (figure.name == "nis" and cells[0].of("consistency", "nees")):
            for variant, canvas in of_scenario(figure, cells if figure.draw_all else cells[:1]):
                drawings.setdefault(variant, []).append((figure, _drawn(canvas)))
    about = cells[0].about
    return Section(anchor(name), name, about["title"], about["source"], over_variants(cells),
                   fault_table(cells), drawings.get("", []),
                   [variant_of(cell, str(results.folder), drawings.get(cell.variant, [])) for cell in cells])


def _drawn(canvas: Canvas) -> Markup:
    return Markup(canvas.svg(inline=True))


def variant_of(cell: CellResults, folder: str, figures: list[tuple[Figure, Markup]]) -> Variant:
    """A variant's part."""
    about = cell.about["variants"][cell.variant]
    words = [finding(cell, ranking) for ranking in cell.rankings]
    words += filter(None, [claims_of(cell), *requirements_of(cell)])
    drawing, panels = curves(cell, cell.rankings[0]) if cell.rankings else ("", 0)
    first = cell.rankings[0] if cell.rankings else None
    return Variant(
        anchor(cell.scenario, cell.variant), cell.key, cell.title, words,
        [(Markup(ranked(r)), f"{least(r)} Dot and 95 % interval of each entry alone; right, the ratio over the same "
          "runs, on which the verdict rests; shaded: ±1 %.") for r in cell.rankings[:PLOTS]],
        table(cell), failures(cell, folder), notes_of(about), Markup(drawing), panels,
        f"Root mean square error of {first.quantity} [{first.unit}] over the runs that finished; grey: the best's."
        if first else "", figures)


def table(cell: Cell) -> Table:
    """A line an entry: errors with verdict, value, ratio; requirements, claims, outcomes, lost runs, time of a step."""
    columns: list[tuple[tuple[Markup | str, str, bool], dict[str, Entry]]] = []

    def add(head: Markup | str, data: str, right: bool, entries: dict[str, Entry]) -> None:
        if any(entry.html for entry in entries.values()):
            columns.append(((head, data, right), entries))

    for ranking in cell.rankings:
        lines = {str(line["estimator"]): line for line in ranking.lines}
        name, unit = ranking.quantity, ranking.unit
        add(name, f"{name} verdict", False, {k: Entry(_verdict(v)) for k, v in lines.items()})
        add(bracket(metric_name(ranking.metric), unit), f"{name} value|{name} low|{name} high", True,
            {k: _value(v) for k, v in lines.items()})
        add("ratio", f"{name} ratio|{name} ratio low|{name} ratio high", True, {k: _ratio(v) for k, v in lines.items()})
        add("eff.", f"{name} efficiency", True, {k: Entry(percent(v["efficiency"]), _data(v["efficiency"]), True)
                                                if floor_name(v) else Entry("") for k, v in lines.items()})
    for name, lines in cell.requirements.items():
        what = "runs" if lines[0]["metric"] == "kept" else "time"
        add(Markup("{}<br>in {:g} % of the {}").format(name, 100 * float(lines[0]["against"]), what),
            f"{name} kept|{name} low|{name} high", False, {str(line["estimator"]): _required(line) for line in lines})
    add("claim", "claim", False, {label: Entry(_claims(cell, label)) for label in cell.labels})
    for lines in cell.outcomes:
        metric, quantity = lines[0]["metric"], lines[0]["quantity"]
        name = quantity if metric in quantity else f"{quantity} {metric}"
        add(bracket(name, lines[0]["shown_unit"]), f"{name}|low|high", True,
            {str(line["estimator"]): _outcome(line) for line in lines})
    add("lost", "lost", True, {label: Entry(str(cell.lost(label)), "", True) for label in cell.labels})
    steps = {label: times.get("latency_us_median", np.nan) for label, times in cell.timing.items()}
    add("step [µs]", "step us", True, {label: Entry(number(v), _data(v), True) for label, v in steps.items()
                                      if np.isfinite(v) and cell.lost(label) < cell.runs})
    nees = {str(line["estimator"]): line for line in cell.of("consistency", "nees") if np.isfinite(line["median"])}
    add("median, inside 95 %", "nees median|nees inside", True, {
        label: Entry(f"{number(line['median'])}, {percent(line['inside'])}", _data(line["median"], line["inside"]),
                     True) for label, line in nees.items()})
    add("NIS", "nis", False, {str(line["estimator"]): Entry(chip(line["verdict"], number(line["value"])), _data(
        line["value"])) for line in cell.of("consistency", "nis")})
    add("differs by", "differs by", False, {label: Entry(Markup("<small>{}</small>").format(cell.told(label)))
                                            for label in cell.labels if cell.told(label)})
    notes = _notes(cell)
    return Table([head for head, _ in columns], [(label, [entries.get(label, Entry("")) for _, entries in columns])
                                                 for label in cell.labels], caption(cell), notes)


def _notes(cell: Cell) -> list[str]:
    notes = []
    for name, lines in cell.requirements.items():
        runs = sorted({deciding(line) for line in lines if line["verdict"] == "undecided" and deciding(line)})
        sizes = [f"{line['estimator']} {line['note'].removeprefix('P95 over runs: ')}" for line in lines
                 if line["note"].startswith("P95")]
        if sizes:
            notes.append(f"{name}, 95th percentiles over the runs: {'; '.join(sizes)}.")
        if runs:
            notes.append(f"{name}: what is undecided, about {' or '.join(runs)} would decide.")
    if any(CARRIED in line["note"] for line in cell.of("error")):
        notes.append("† one run carries more than 20 % of the mean square.")
    return notes


def _data(*values: Any) -> str:
    return "|".join("" if value != value else f"{float(value):.6g}" for value in values)


def _verdict(line: Line) -> Markup | str:
    return chip(drawn(line), MARKS[drawn(line)].word, shade(line)) if drawn(line) else ""


def _value(line: Line) -> Entry:
    if not line["runs"]:
        return Entry("")
    text = plus_minus(line) + (f" of {line['runs']}" if line["lost"] else "")
    mark_ = " †" if CARRIED in line["note"] else ""
    return Entry(text + mark_, _data(*(line[name] * line["factor"] for name in ("value", "low", "high"))), True)


def _ratio(line: Line) -> Entry:
    if drawn(line) == "lost":
        return Entry(f"{line['lost']} lost", "", True)
    if drawn(line) in ("oracle", "") or not np.isfinite(line["ratio"]):
        return Entry("")
    return Entry(f"{ratio_of(line)} {ratio_interval(line)}".strip(),
                 _data(*(line[name] for name in ("ratio", "ratio_low", "ratio_high"))), True)


def _required(line: Line) -> Entry:
    kept = (f"{round(line['value'] * line['runs'])}/{line['runs']}" if line["metric"] == "kept"
            else percent(line["value"]))
    html = Markup("{} [{}, {}] %").format(chip(line["verdict"], kept), number(100 * line["low"]),
                                          number(100 * line["high"]))
    return Entry(html, _data(line["value"], line["low"], line["high"]))


def _claims(cell: Cell, label: str) -> Markup:
    """All that an entry claims, a chip each."""
    out = []
    for kind, metric, of in (("consistency", "nees", ""), ("claim", "coverage", "set "), ("claim", "bound", "bound ")):
        for line in cell.of(kind, metric):
            if line["estimator"] == label and line["runs"]:
                value = f" {number(line['value'])}" if kind == "consistency" else ""
                word = MARKS.get(line["verdict"], MARKS["undecided"]).word
                said = of + ("" if line["verdict"] == "undecided" else word) + value
                out.append(chip(line["verdict"] or "undecided", said.strip()))
    return Markup(" ").join(out)


def _outcome(line: Line) -> Entry:
    if line["kind"] == "share":
        return Entry(f"{round(line['value'] * line['runs'])} of {line['runs']}",
                     _data(line["value"], line["low"], line["high"]), True)
    return Entry(plus_minus(line), _data(*(line[name] * line["factor"] for name in ("value", "low", "high"))), True)


def fault_table(cells: Sequence[CellResults]) -> Table | None:
    """Faults by filters: a line a variant, a column an entry, the ratio to the best with its verdict, under it the
    share of runs locked and the time of recovery; a line for the share of outliers at which each breaks down. None
    where no variant has faults."""
    kinds = {cell.variant: ", ".join(dict.fromkeys(map(_fault, cell.table.get("faults") or ()))) for cell in cells}
    if not any(kinds.values()):
        return None
    labels = list(dict.fromkeys(label for cell in cells for label in cell.labels))
    lines: list[tuple[str, list[Entry]]] = []
    broken: dict[float, set[str]] = {}
    for cell in cells:
        ranking = cell.rankings[0] if cell.rankings else None
        faults = list(cell.table.get("faults") or ())
        alone = len(faults) == 1 and faults[0]["kind"] == "outliers" and faults[0].get("sign", "both") == "both"
        fell = broken.setdefault(faults[0]["share"], set()) if alone and faults[0].get("share") else set()
        locked = {line["estimator"]: line["value"] for line in cell.of("share", "locked") if line["value"] > 0}
        back = {line["estimator"]: line for line in cell.of("value", "recovery") if line["runs"]}
        entries = [Entry(kinds[cell.variant] or "none")]
        for label in labels:
            line = ranking.line(label) if ranking else None
            if line is None or not drawn(line):
                entries.append(Entry(Markup('<span class="dot" aria-hidden="true">·</span>')))
                continue
            said = {"lost": f"{line['lost']} lost", "oracle": ""}.get(drawn(line), ratio_of(line))
            if drawn(line) == "lost" or line["ratio"] > BREAKDOWN or label in locked:
                fell.add(label)
            words = [f"{percent(locked[label])} locked"] if label in locked else []
            words += [f"{number(back[label]['value'])} s back"] if label in back else []
            under = Markup("<small>{}</small>").format(", ".join(words)) if words else ""
            entries.append(Entry(Markup("{}{}").format(chip(drawn(line), said, shade(line)), under),
                                 _data(line["ratio"])))
        lines.append((cell.variant, entries))
    if len(broken) > 1:
        entries = [Entry("breaks down at outliers of")]
        for label in labels:
            at = min((share for share, fell in broken.items() if label in fell), default=None)
            said = f"none up to {100 * max(broken):g} %" if at is None else f"{100 * at:g} %"
            entries.append(Entry(said, _data(at or 1.0)))
        lines.append(("all shares", entries))
    return Table([("faults", "faults", False), *((label, label, False) for label in labels)], lines,
                 "Ratio to the best of each variant, first quantity; under it the share of runs locked (over 3 m in "
                 "each of the last 10 s) and the mean time until the error is back to its usual size. A filter breaks "
                 f"down where its error is over {BREAKDOWN:g} times the best or a run is locked or lost.")


def _fault(fault: Any) -> str:
    """`outliers 10 %`."""
    return f"{fault['kind']} {100 * fault['share']:g} %" if fault.get("share") else str(fault["kind"])


def failures(cell: CellResults, folder: str) -> list[tuple[str, str, str]]:
    """Every kind of lost run: what, why, and the line that replays the first."""
    out = []
    bad = cell.rows[cell.rows["status"] != "ok"]
    for (label, status, reason), part in bad.groupby(["estimator", "status", "reason"], sort=False, dropna=False):
        out.append((f"{label}: {status} in {counted(len(part), 'run')}",
                    str(reason) if isinstance(reason, str) and reason else "no reason given",
                    f"railstate replay {cell.key}/{label}/{int(part['run'].iloc[0])} --out {folder}"))
    return out
