"""Verdicts in plain words, a phrase or a line each."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from ..judging.comparison import FINISHED, Comparison
from ..judging.contests import Contest, robust_contests
from ..judging.verdicts import Breach, Judged, broken_promises, by_run, cells, judge, judged_columns, oracle_labels
from .wording import change, change_interval, change_range, counted, number, percent


def comparison_words(contest: Comparison, a: str, b: str) -> str:
    """One line in plain comparison_words."""
    found = contest.found
    where = f"{contest.cell}{'/' + contest.label if contest.label else ''}"
    certainty = f"p {'< 0.001' if contest.p < 1e-3 else '= ' + number(contest.p, 2)}, {counted(found.n, 'run')}"
    if contest.metric == FINISHED:
        chance = ", which may be chance" if contest.verdict == "tie" else ""
        return (f"{where}: {b} ends well in {percent(1 - contest.b)} of the runs, {a} in {percent(1 - contest.a)}"
                f"{chance} ({certainty})")
    subject = f"{contest.quantity} {contest.metric}"
    if contest.verdict in ("tie", "too few runs"):
        verdict = "a tie" if contest.verdict == "tie" else "too few runs to tell"
        return f"{where}: {subject}: {verdict}, {b} {change_interval(found)} against {a} ({certainty})"
    return (f"{where}: {subject}: {b} is {contest.verdict} than {a}, {change_interval(found)}, with the lower error in "
            f"{percent(found.won)} of the runs ({certainty})")


def short_verdicts(rows: pd.DataFrame, manifest: Mapping[str, Any]) -> dict[tuple[str, str, str], str]:
    """(scenario, variant, estimator) -> the verdict for a line of the terminal's tables."""
    out: dict[tuple[str, str, str], str] = {}
    for scenario, variant, part in cells(rows):
        oracles = oracle_labels(manifest, scenario, variant)
        judged = {quantity: judge(by_run(part, column), metric, oracles)
                  for column, metric, quantity, _ in judged_columns(part, manifest["scenarios"][scenario])}
        for label, mine in part.groupby("estimator", sort=False):
            verdict = _short({quantity: found[str(label)] for quantity, found in judged.items()})
            out[scenario, variant, str(label)] = "; ".join(
                filter(None, [verdict, *(breach_words(breach) for breach in broken_promises(mine))]))
    return out


def _short(found: Mapping[str, Judged]) -> str:
    """One estimator's verdicts over the quantities: said once where they agree, as a range where all are worse."""
    found = {quantity: each for quantity, each in found.items()
             if not (each.against and np.isinf(each.against.relative)) and each.value.value != 0} or found
    pairs = [each.against for each in found.values() if each.verdict == "worse" and each.against]
    if len(pairs) == len(found) and pairs:
        return change_range(pairs)
    words = {quantity: change(each.against) if each.verdict == "worse" and each.against
             else {"none": "", "incomplete": "too few runs"}.get(each.verdict, each.verdict)
             for quantity, each in found.items()}
    if len(set(words.values())) == 1:
        return next(iter(words.values()))
    return ", ".join(f"{quantity} {word}" for quantity, word in words.items() if word)


def headlines(rows: pd.DataFrame, manifest: Mapping[str, Any], scenario: str) -> list[str]:
    """Where a scenario's robust estimators beat the Kalman filters and where not, in plain lines."""
    return [f"{challenger} against {rival}, {quantity}: {contest_words(results)}"
            for challenger, table in robust_contests(rows, manifest, scenario).items()
            for (rival, quantity), results in table.items()]


def contest_words(results: list[Contest]) -> str:
    """`better in 2 of 8 variants (sinusoid -30 % [..], 100 % of runs; ..), tie in 1 (..), worse in 5 (..)`."""
    total = counted(len(results), "variant")
    parts: list[str] = []
    for word in ("better", "tie", "worse", "too few runs"):
        which = [contest for contest in results if contest.verdict == word]
        if word == "better":
            shown = "; ".join(f"{c.variant} {change_interval(c.found)}, {percent(c.found.won)} of runs" for c in which)
            parts.append(f"better in {len(which) or 'none'} of {total}" + (f" ({shown})" if which else ""))
        elif which:
            parts.append(f"{word} in {len(which)} (" + ", ".join(f"{c.variant} {change(c.found)}" for c in which) + ")")
    return ", ".join(parts)


def breach_words(breach: Breach) -> str:
    """What a line of a table says of a promise that was not kept."""
    if breach.kind == "status":
        return breach.what if breach.count == breach.runs else f"{breach.what} in {breach.count} of {breach.runs} runs"
    if breach.kind == "nees":
        return f"too sure (ANEES {number(breach.size)})"
    if breach.kind == "set":
        return f"leaves its set in {breach.count} of {breach.runs} runs"
    return f"exceeds its bound ({number(breach.measured)} > {number(breach.certified)})"
