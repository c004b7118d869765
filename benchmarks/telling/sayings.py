"""Verdicts in plain words, a phrase or a line each: lines of the verdict table, worded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from ..judging.comparison import Comparison
from .wording import change, change_interval, change_range, counted, number, percent

Line = Mapping[str, Any]
"""A line of the verdict table."""
SHORT = {"none": "", "undecided": "undecided", "too sure": "too sure", "lost": "lost too many runs"}


def records(table: pd.DataFrame, *kinds: str) -> list[dict[str, Any]]:
    """Lines of a verdict table, of some kinds, as mappings."""
    return table[table["kind"].isin(kinds)].to_dict("records") if kinds else table.to_dict("records")  # pyright: ignore


def comparison_words(found: Comparison, a: str, b: str) -> str:
    """One line in plain words."""
    where = f"{found.cell}{'/' + found.label if found.label else ''}"
    line = found.b
    if found.lost:
        chance = ", which may be chance" if found.verdict == "tie" else ""
        return (f"{where}: {b} ends well in {percent(1 - line['value'])} of the runs, {a} in "
                f"{percent(1 - found.a['value'])}{chance} ({counted(line['runs'], 'run')})")
    subject = f"{where}: {line['quantity']} {line['metric']}"
    note = f"; {line['note']}" if line["note"] else ""
    if found.verdict in ("better", "worse"):
        return (f"{subject}: {b} is {found.verdict} than {a}, {change_interval(line)}, with the lower error in "
                f"{percent(line['won'])} of the runs{note}")
    if found.verdict == "tie":
        return f"{subject}: a tie within 1 %, {b} {change_interval(line)} against {a}{note}"
    return f"{subject}: undecided, {b} {change_interval(line)} against {a}{deciding(line)}{note}"


def deciding(line: Line) -> str:
    """`; about 40 runs would decide`, nothing where it is not known."""
    runs = line.get("deciding", float("nan"))
    if not 0 < runs < float("inf"):
        return ""
    if runs > 1e5:
        return "; more than 100000 runs would decide"
    rounded = -(-int(runs) // 10) * 10 if runs < 1000 else int(float(f"{runs:.2g}"))
    return f"; about {rounded} runs would decide"


def caption(errors: Sequence[Line], total: int) -> str:
    """What the signs of a table mean and which runs it is over. errors: lines of kind error of one cell; total: its
    runs."""
    family = max((line["family"] for line in errors), default=0)
    lost = any(line["lost"] for line in errors)
    parts = [f"{counted(total, 'run')}; ± is half of the 95 % interval."]
    if family > 1:
        parts.append(f"Verdicts: ratio to the best over the same runs, 95 % intervals that hold for all pairs of the "
                     f"{family} entries at once.")
    if lost:
        parts.append("Values are over finished runs; in verdicts a lost run has the largest error of its cell.")
    common = [note for note in ("under 20 runs there is no verdict",
                                "events rarer than 3/n of the runs may not have been seen")
              if any(note in line["note"] for line in errors)]
    return " ".join([*parts, *(f"{note[0].upper()}{note[1:]}." for note in common)])


def short_verdicts(table: pd.DataFrame) -> dict[tuple[str, str, str], str]:
    """(scenario, variant, estimator) -> the verdict for a line of the terminal's tables."""
    out: dict[tuple[str, str, str], str] = {}
    for key, mine in table.groupby(["scenario", "variant", "estimator"], sort=False):
        lines = records(mine, "error", "consistency", "claim", "reliability")
        errors = {line["quantity"]: line for line in lines if line["kind"] == "error"}
        out[key] = "; ".join(filter(None, [  # pyright: ignore[reportArgumentType]
            _short(errors), *(breach_words(line) for line in lines if line["kind"] != "error")]))
    return out


def drawn(line: Line) -> str:
    """The verdict as it is drawn: who lost more runs than equals would is lost, whatever the errors say."""
    return "lost" if not line["eligible"] and line["verdict"] != "none" else line["verdict"]


def _short(found: Mapping[str, Line]) -> str:
    """One estimator's verdicts over the quantities: said once where they agree, as a range where all are worse."""
    found = {quantity: line for quantity, line in found.items() if line["runs"]}
    found = {quantity: line for quantity, line in found.items() if line["value"] != 0
             and line["ratio"] != float("inf")} or found
    worse = [line for line in found.values() if drawn(line) == "worse"]
    if worse and len(worse) == len(found):
        return change_range([line["ratio"] for line in worse])
    words = {quantity: change(line) if drawn(line) == "worse" else SHORT.get(drawn(line), drawn(line))
             for quantity, line in found.items()}
    if len(set(words.values())) == 1:
        return next(iter(words.values()))
    return ", ".join(f"{quantity} {word}" for quantity, word in words.items() if word)


def headlines(table: pd.DataFrame, scenario: str) -> list[str]:
    """Where a scenario's robust estimators beat the Kalman filters and where not, in plain lines."""
    return [f"{challenger} against {rival}, {quantity}: {contest_words(lines)}"
            for (challenger, rival, quantity), lines in robust_contests(table, scenario).items()]


def robust_contests(table: pd.DataFrame, scenario: str) -> dict[tuple[str, str, str], list[dict[str, Any]]]:
    """(robust estimator, Kalman filter, quantity) -> its line in each variant."""
    mine = table[(table["scenario"] == scenario) & (table["kind"] == "yardstick")
                 & table["estimator"].str.startswith("robust-")]
    out: dict[tuple[str, str, str], list[dict[str, Any]]] = {}
    for line in sorted(records(mine), key=lambda line: line["estimator"]):
        out.setdefault((line["estimator"], line["against"], line["quantity"]), []).append(line)
    return out


def contest_words(lines: Sequence[Line]) -> str:
    """`better in 2 of 8 variants (sinusoid -30 % [..], 100 % of runs; ..), tie in 1 (..), worse in 5 (..)`."""
    parts: list[str] = []
    for word in ("better", "tie", "worse", "undecided"):
        which = [line for line in lines if line["verdict"] == word]
        if word == "better":
            shown = "; ".join(f"{line['variant']} {change_interval(line)}, {percent(line['won'])} of runs"
                              for line in which)
            parts.append(f"better in {len(which) or 'none'} of {counted(len(lines), 'variant')}"
                         + (f" ({shown})" if which else ""))
        elif which:
            parts.append(f"{word} in {len(which)} (" + ", ".join(f"{line['variant']} {change(line)}"
                                                                 for line in which) + ")")
    return ", ".join(parts)


def breach_words(line: Line) -> str:
    """What a line of a table says of a claim that does not hold, or of runs that were lost."""
    if line["kind"] == "reliability":
        if line["metric"] != "lost" or not line["lost"]:
            return ""
        alone = line["note"].partition(" ")[2] if "," not in line["note"] else ""
        return alone if alone and line["lost"] == line["runs"] else f"{line['note']} of {line['runs']} runs"
    if line["verdict"] == "too sure" and line["metric"] == "nees":
        return f"too sure (ANEES {number(line['value'])})"
    if line["kind"] == "consistency" and line["verdict"] == "too sure":
        return f"too sure ({line['metric']} {number(line['value'])})"
    if line["kind"] == "claim" and line["verdict"] == "broken":
        if line["metric"] == "coverage":
            return line["note"].replace("left in", "leaves its set in")
        return f"exceeds its bound ({number(line['value'])} > {number(line['value'] / line['ratio'])})"
    return ""
