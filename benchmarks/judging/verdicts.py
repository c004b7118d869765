"""Plain-word verdicts from rows alone: who is best, who ties, who is worse and by how much, who breaks a promise.

Used by the terminal tables, by `compare` and by the report, so that all three say the same."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from . import statistics as st
from .summary import metric_columns
from .wording import (
    change,
    change_interval,
    change_range,
    counted,
    number,
    percent,
)

Array = NDArray[np.float64]

ERRORS = ("rmse", "mae", "sum-squared", "max", "final")
"""Metrics that are judged; the first a scenario's table shows of a quantity speaks for the quantity."""
COMPLETE = 0.95
"""An estimator can be best only if it finished at least this share of the runs that the most reliable one did."""

NEGLIGIBLE = 1e-9
"""Errors under this (SI) are rounding: equal to each other, and no quantity to win by."""

Column = tuple[str, str, str, str]
"""(column of the rows, metric, quantity, unit)."""


@dataclass(frozen=True)
class Judged:
    """An estimator's error in one quantity: its value with interval, the paired difference to the best, the verdict.

    verdict: `best`, `tie` (with the best), `worse`, `oracle` (knows what the others must estimate), `incomplete` (too
    few finished runs to be best, or to be told from it), `none` (no value)."""

    estimator: str
    value: st.Interval
    against: st.Paired | None
    verdict: Literal["best", "tie", "worse", "oracle", "incomplete", "none"]


def oracle_labels(manifest: Mapping[str, Any], scenario: str, variant: str) -> set[str]:
    """Labels of a cell whose plug-in is marked as an oracle."""
    entries = manifest["configuration"]["cells"][f"{scenario}/{variant}"]["estimators"]
    return {label for label, entry in entries.items() if manifest["estimators"][entry["plugin"]]["oracle"]}


def judged_columns(rows: pd.DataFrame, about: Mapping[str, Any]) -> list[Column]:
    """The error column that speaks for each quantity of a scenario, in the table's order, where there are values."""
    known = {(metric, quantity): (column, metric, quantity, unit)
             for column, metric, quantity, unit in metric_columns(rows) if rows[column].notna().any()}
    chosen: dict[str, Column] = {}
    for metric, quantity in (tuple(pair) for pair in about["table"]):
        if metric in ERRORS and (metric, quantity) in known:
            chosen.setdefault(quantity, known[metric, quantity])
    return list(chosen.values())


def by_run(rows: pd.DataFrame, column: str) -> dict[str, Array]:
    """One cell's column as an array per estimator, aligned by run (NaN where there is no value)."""
    runs, place = np.unique(rows["run"].to_numpy(), return_inverse=True)
    codes, labels = pd.factorize(rows["estimator"])
    table = np.full((len(labels), len(runs)), np.nan)
    table[codes, place] = rows[column].to_numpy(dtype=float)
    return {str(label): values for label, values in zip(labels, table, strict=True)}


_AGAINST_BEST: Mapping[st.Verdict, Literal["tie", "worse", "incomplete"]] = {
    "worse": "worse", "tie": "tie", "better": "tie", "too few runs": "incomplete"}


def judge(errors: Mapping[str, Array], metric: str, oracles: Collection[str] = ()) -> dict[str, Judged]:
    """Judge estimators (arrays over the same runs) against the best of them that is no oracle.

    Best is the least shown value; errors under `NEGLIGIBLE` count as none. Rivals are compared with it over the runs
    both finished; Holm corrects over the rivals. A rival that does better over the paired runs although its shown value
    is larger ties."""
    errors = {label: np.where(np.abs(array) < NEGLIGIBLE, 0.0, array) for label, array in errors.items()}
    interval = st.pooled_interval if metric == "rmse" else st.mean_interval
    values = {label: interval(array) for label, array in errors.items()}
    most = max((found.n for found in values.values()), default=0)
    ranked = {label: found.value for label, found in values.items()
              if found.n and found.n >= COMPLETE * most and label not in oracles}
    best = min(ranked, key=lambda label: ranked[label]) if ranked else None
    against = {label: st.paired(array, errors[best]) for label, array in errors.items()
               if best is not None and label != best and values[label].n}
    rivals = [label for label in against if label not in oracles]
    adjusted = dict(zip(rivals, st.holm([against[label].p for label in rivals]), strict=True))
    out: dict[str, Judged] = {}
    for label, found in values.items():
        pair = against.get(label)
        word: Literal["best", "tie", "worse", "oracle", "incomplete", "none"]
        if not found.n:
            word = "none"
        elif label in oracles:
            word = "oracle"
        elif pair is None:
            word = "best"
        elif found.n < COMPLETE * most:
            word = "incomplete"
        else:
            word = _AGAINST_BEST[st.verdict(pair, adjusted[label], len(rivals))]
        out[label] = Judged(label, found, pair, word)
    return out


def cells(rows: pd.DataFrame) -> Iterator[tuple[str, str, pd.DataFrame]]:
    """(scenario, variant, rows) in the order of the rows."""
    for (scenario, variant), part in rows.groupby(["scenario", "variant"], sort=False):
        yield str(scenario), str(variant), part


@dataclass(frozen=True)
class Breach:
    """A promise not kept in one cell. kind: `status` (runs that did not end well), `nees`, `set` or `bound`; words:
    what a line of a table says; size: how bad it is (share of runs, ANEES, measured over certified)."""

    kind: Literal["status", "nees", "set", "bound"]
    words: str
    size: float


def broken_promises(part: pd.DataFrame) -> list[Breach]:
    """What one estimator claimed in one cell and did not keep, and how its runs failed."""
    out: list[Breach] = []
    runs = len(part)
    for status, count in part.loc[part["status"] != "ok", "status"].value_counts().items():
        words = str(status) if count == runs else f"{status} in {count} of {runs} runs"
        out.append(Breach("status", words, int(count) / runs))
    states = nees_states(part)
    if states:
        nees = part["nees:state:1"].to_numpy(dtype=float)
        if st.consistency(nees, states) == "too sure":
            value = st.anees(nees, states).value
            out.append(Breach("nees", f"too sure (ANEES {number(value)})", value))
    inside = column_values(part, "coverage:ellipsoid:1")
    left = int((inside < 1).sum())
    if left:
        out.append(Breach("set", f"leaves its set in {left} of {inside.size} runs", left / inside.size))
    bound = bound_check(part)
    if bound and bound.broken:
        out.append(Breach("bound", f"exceeds its bound ({number(bound.measured.value)} > {number(bound.certified)})",
                          bound.measured.value / bound.certified))
    return out


@dataclass(frozen=True)
class Bound:
    """A certified mean-square bound beside the measured mean square. Broken: the whole interval lies above."""

    certified: float
    measured: st.Interval

    @property
    def broken(self) -> bool:
        return bool(self.measured.low > self.certified)


def bound_check(part: pd.DataFrame) -> Bound | None:
    """The certified bound of one estimator in one cell against what was measured; None without a claim."""
    certified = column_values(part, "bound:performance:1")
    measured = column_values(part, "mean-square:performance:1")
    if not certified.size or not measured.size:
        return None
    return Bound(float(certified.mean()), st.mean_interval(measured))


def nees_states(part: pd.DataFrame) -> int:
    """Degrees of freedom of an estimator's NEES; 0 where it claims no covariance."""
    if "nees_states" not in part or not column_values(part, "nees:state:1").size:
        return 0
    return int(part["nees_states"].max())


def column_values(part: pd.DataFrame, column: str) -> Array:
    """The numbers of a column; none where the column does not exist."""
    return st.finite(part[column].to_numpy(dtype=float)) if column in part else np.zeros(0)


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
                filter(None, [verdict, *(breach.words for breach in broken_promises(mine))]))
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


@dataclass(frozen=True)
class Contest:
    """A challenger against a rival in one quantity of one variant."""

    variant: str
    verdict: st.Verdict
    found: st.Paired


def contests(rows: pd.DataFrame, challenger: str, rivals: Collection[str],
             columns: Collection[Column]) -> dict[tuple[str, str], list[Contest]]:
    """(rival, quantity) -> one contest per variant of one scenario's rows, Holm-corrected over all of them."""
    found: list[tuple[str, str, str, st.Paired]] = []
    for _, variant, part in cells(rows):
        for column, _, quantity, _ in columns:
            errors = by_run(part, column)
            for rival in rivals:
                if challenger in errors and rival in errors:
                    pair = st.paired(errors[challenger], errors[rival])
                    if pair.n > 1:
                        found.append((rival, quantity, variant, pair))
    out: dict[tuple[str, str], list[Contest]] = {}
    for (rival, quantity, variant, pair), p in zip(found, st.holm([item[3].p for item in found]), strict=True):
        out.setdefault((rival, quantity), []).append(Contest(variant, st.verdict(pair, p, len(found)), pair))
    return out


KALMAN = ("kalman", "ekf", "ukf", "ckf")


def robust_contests(rows: pd.DataFrame, manifest: Mapping[str, Any],
                    scenario: str) -> dict[str, dict[tuple[str, str], list[Contest]]]:
    """Each robust estimator of a scenario against every tuning of its first Kalman-type filter (matched, naive,
    inflated): challenger -> contests. Empty where a scenario does not have both."""
    mine = rows[rows["scenario"] == scenario]
    plugins: dict[str, str] = {}
    for key, cell in manifest["configuration"]["cells"].items():
        if key.rpartition("/")[0] == scenario:
            plugins.update({label: entry["plugin"] for label, entry in cell["estimators"].items()})
    challengers = [label for label, plugin in plugins.items() if plugin.startswith("robust-")]
    filters = [plugin for plugin in plugins.values() if plugin in KALMAN]
    rivals = [label for label, plugin in plugins.items() if filters and plugin == filters[0]]
    columns = judged_columns(mine, manifest["scenarios"][scenario])
    return {label: contests(mine, label, rivals, columns) for label in challengers} if rivals else {}


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
