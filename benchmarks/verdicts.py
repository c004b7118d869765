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
from .wording import change, change_interval, counted, listing, number, percent

Array = NDArray[np.float64]

ERRORS = ("rmse", "mae", "sum-squared", "max", "final")
"""Metrics that are judged; the first a scenario's table shows of a quantity speaks for the quantity."""
COMPLETE = 0.95
"""An estimator can be best only if it finished at least this share of the runs that the most reliable one did."""

Column = tuple[str, str, str, str]
"""(column of the rows, metric, quantity, unit)."""


@dataclass(frozen=True)
class Judged:
    """An estimator's error in one quantity: its value with interval, the paired difference to the best, the verdict.

    verdict: `best`, `tie` (with the best), `worse`, `oracle` (knows what the others must estimate), `incomplete` (too
    few finished runs to be best, or to be compared), `none` (no value)."""

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
    runs = np.unique(rows["run"].to_numpy())
    out: dict[str, Array] = {}
    for label, part in rows.groupby("estimator", sort=False):
        values = np.full(len(runs), np.nan)
        values[np.searchsorted(runs, part["run"].to_numpy())] = part[column].to_numpy(dtype=float)
        out[str(label)] = values
    return out


def judge(errors: Mapping[str, Array], metric: str, oracles: Collection[str] = ()) -> dict[str, Judged]:
    """Judge estimators (arrays over the same runs) against the best of them that is no oracle.

    Best is the least shown value. Rivals are compared with it over the runs both finished; Holm corrects over the
    rivals. A rival that does better over the paired runs although its shown value is larger ties."""
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
            word = "worse" if st.verdict(pair, adjusted[label]) == "worse" else "tie"
        out[label] = Judged(label, found, pair, word)
    return out


def cells(rows: pd.DataFrame) -> Iterator[tuple[str, str, pd.DataFrame]]:
    """(scenario, variant, rows) in the order of the rows."""
    for (scenario, variant), part in rows.groupby(["scenario", "variant"], sort=False):
        yield str(scenario), str(variant), part


def broken_promises(part: pd.DataFrame) -> list[str]:
    """What one estimator claimed in one cell and did not keep, and how its runs failed, in few words."""
    out: list[str] = []
    runs = len(part)
    for status, count in part.loc[part["status"] != "ok", "status"].value_counts().items():
        out.append(str(status) if count == runs else f"{status} in {count} of {runs} runs")
    states = nees_states(part)
    if states:
        nees = part["nees:state:1"].to_numpy(dtype=float)
        if st.consistency(nees, states) == "too sure":
            out.append(f"too sure (ANEES {number(st.anees(nees, states).value)})")
    inside = column_values(part, "coverage:ellipsoid:1")
    if inside.size and (inside < 1).any():
        out.append(f"leaves its set in {int((inside < 1).sum())} of {inside.size} runs")
    bound = bound_check(part)
    if bound and bound.broken:
        out.append(f"exceeds its bound ({number(bound.measured.value)} > {number(bound.certified)})")
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
            words = {quantity: _short(found[str(label)]) for quantity, found in judged.items()}
            same = set(words.values())
            pieces = ([same.pop()] if len(same) == 1 else [f"{quantity} {word}" for quantity, word in words.items()])
            out[scenario, variant, str(label)] = "; ".join(filter(None, [", ".join(filter(None, pieces)),
                                                                         *broken_promises(mine)]))
    return out


def _short(found: Judged) -> str:
    if found.verdict == "worse" and found.against:
        return change(found.against)
    return {"none": "", "incomplete": "too few runs"}.get(found.verdict, found.verdict)


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
        out.setdefault((rival, quantity), []).append(Contest(variant, st.verdict(pair, p), pair))
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


def headlines(rows: pd.DataFrame, manifest: Mapping[str, Any]) -> list[str]:
    """Where the robust estimators beat the Kalman filters and where not, in plain lines (a part of honesty)."""
    lines: list[str] = []
    for scenario in rows["scenario"].unique():
        for challenger, table in robust_contests(rows, manifest, str(scenario)).items():
            for (rival, quantity), results in table.items():
                lines.append(f"{scenario}: {challenger} against {rival}, {quantity}: {contest_words(results)}")
    return lines


def contest_words(results: list[Contest]) -> str:
    """`better in 2 of 8 variants (sinusoid -30 % [..], 100 % of runs; ..), tie in 1 (..), worse in 5 (..)`."""
    total = counted(len(results), "variant")
    parts: list[str] = []
    for word in ("better", "tie", "worse"):
        which = [contest for contest in results if contest.verdict == word]
        if word == "better":
            shown = "; ".join(f"{c.variant} {change_interval(c.found)}, {percent(c.found.won)} of runs" for c in which)
            parts.append(f"better in {len(which) or 'none'} of {total}" + (f" ({shown})" if which else ""))
        elif which:
            parts.append(f"{word} in {len(which)} (" + ", ".join(f"{c.variant} {change(c.found)}" for c in which) + ")")
    return ", ".join(parts)


def paragraph(rows: pd.DataFrame, manifest: Mapping[str, Any], scenario: str) -> list[str]:
    """A scenario in plain sentences: the default variant's best per quantity, the other variants, broken promises."""
    mine = rows[rows["scenario"] == scenario]
    about = manifest["scenarios"][scenario]
    sentences: list[str] = []
    tops: dict[str, list[list[str]]] = {}
    broken: dict[str, list[tuple[str, list[str]]]] = {}
    variants: list[str] = []
    for _, variant, part in cells(mine):
        oracles = oracle_labels(manifest, scenario, variant)
        alike: dict[str, list[str]] = {}
        for column, metric, quantity, unit in judged_columns(part, about):
            found = judge(by_run(part, column), metric, oracles)
            tops.setdefault(quantity, []).append([j.estimator for j in found.values() if j.verdict in ("best", "tie")])
            if not variants:
                alike.setdefault(_ranking(found), []).append(quantity)
        for ranking, quantities in alike.items():
            sentences.append(f"Variant {variant}, {listing(quantities)}: {ranking}.")
        for label, estimator_rows in part.groupby("estimator", sort=False):
            words = broken_promises(estimator_rows)
            if words:
                broken.setdefault(str(label), []).append((variant, words))
        variants.append(variant)
    if len(variants) > 1:
        sentences += _over_variants(tops, len(variants))
    for label, where in broken.items():
        first_variant, words = where[0]
        rest = f", and something of the kind in {counted(len(where) - 1, 'other variant')}" if len(where) > 1 else ""
        sentences.append(f"{label} breaks a promise in {first_variant}: {listing(words)}{rest}.")
    if not broken:
        sentences.append("Nobody broke a promise, and no run failed.")
    return sentences


def _ranking(found: Mapping[str, Judged]) -> str:
    best = next((j for j in found.values() if j.verdict == "best"), None)
    if best is None:
        return "no estimator gave a value"
    ties = [j.estimator for j in found.values() if j.verdict == "tie"]
    worse = sorted((j for j in found.values() if j.verdict == "worse" and j.against),
                   key=lambda j: j.against.relative if j.against else 0.0)
    text = f"{best.estimator} is best" + (f", {listing(ties)} {'tie' if len(ties) > 1 else 'ties'} with it" if ties
                                          else "")
    if worse and worse[0].against and worse[-1].against:
        text += f"; the next, {worse[0].estimator}, is {_worse_by(worse[0].against)}"
        if len(worse) > 1:
            text += f", the last, {worse[-1].estimator}, {_worse_by(worse[-1].against)}"
    return text


def _worse_by(found: st.Paired) -> str:
    words = change(found)
    return f"off by {words} as much" if words.endswith("times") else f"{words.lstrip('+')} worse"


def _over_variants(tops: Mapping[str, list[list[str]]], total: int) -> list[str]:
    out: list[str] = []
    for quantity, lists in tops.items():
        count: dict[str, int] = {}
        for names in lists:
            for name in names:
                count[name] = count.get(name, 0) + 1
        if count:
            most = max(count.values())
            names = [name for name, times in count.items() if times == most]
            verb = "are" if len(names) > 1 else "is"
            out.append(f"Over all {total} variants, {listing(names)} {verb} best or tied most often for {quantity}: in "
                       f"{most} of {len(lists)}.")
    return out
