"""Plain-word verdicts from rows alone: who is best, who ties, who is worse and by how much, who breaks a promise.

Used by the terminal tables, by `compare` and by the report, so that all three say the same."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pandas as pd

from ...scenarios.arrays import Array
from ..scoring.columns import metric_columns
from . import statistics as st

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
_AGAINST_BEST: Mapping[st.Difference, Literal["tie", "worse", "incomplete"]] = {
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
    """A promise not kept in one cell. kind: `status` (runs that did not end well), `nees`, `set` or `bound`; size: how
    bad it is (share of runs, ANEES, measured over certified); what: the status; count of runs; measured against
    certified."""

    kind: Literal["status", "nees", "set", "bound"]
    size: float
    what: str = ""
    count: int = 0
    runs: int = 0
    measured: float = float("nan")
    certified: float = float("nan")


def broken_promises(part: pd.DataFrame) -> list[Breach]:
    """What one estimator claimed in one cell and did not keep, and how its runs failed."""
    out: list[Breach] = []
    runs = len(part)
    for status, count in part.loc[part["status"] != "ok", "status"].value_counts().items():
        out.append(Breach("status", int(count) / runs, str(status), int(count), runs))
    states = nees_states(part)
    if states:
        nees = part["nees:state:1"].to_numpy(dtype=float)
        if st.consistency(nees, states) == "too sure":
            out.append(Breach("nees", st.anees(nees, states).value))
    inside = column_values(part, "coverage:ellipsoid:1")
    left = int((inside < 1).sum())
    if left:
        out.append(Breach("set", left / inside.size, count=left, runs=inside.size))
    bound = bound_check(part)
    if bound and bound.broken:
        out.append(Breach("bound", bound.measured.value / bound.certified, measured=bound.measured.value,
                          certified=bound.certified))
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
