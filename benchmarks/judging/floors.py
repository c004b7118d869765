"""The least error possible beside the errors: pooled over the runs that an estimator finished, and how near it comes.

Efficiency is floor over RMSE of the same runs; its limits are the floor over those of the RMSE."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ...scenarios.arrays import Array
from ..scoring.columns import metric_columns
from . import statistics as st
from .judged import Line
from .selection import NEGLIGIBLE, Aligned, Column

UNDER = 4.0
"""So many standard errors under a floor are not chance."""
UNDER_NOTE = f"under the floor by more than {UNDER:g} standard errors"


def floored(line: Line, aligned: Aligned, i: int, kind: str) -> Line:
    """Estimator i's line of an error with its entries `floor`, `efficiency` and `floor_kind`, and a note where it is
    under the floor; as it is where the error has no floor. kind: what the variant's floor is called."""
    of = f"floor:{line['quantity']}:{line['unit']}"
    if line["metric"] != "rmse" or of not in aligned or not kind:
        return line
    errors, floors = aligned.values(f"rmse:{line['quantity']}:{line['unit']}")[i], aligned.values(of)[i]
    least, value = _root(floors, errors), float(line["value"])
    found = {**line, "floor": least, "floor_kind": kind}
    if value > NEGLIGIBLE:
        found["efficiency"] = least / value
        if kind.startswith("floor") and beneath(errors, floors) > UNDER:
            found["note"] = "; ".join(filter(None, [line.get("note", ""), UNDER_NOTE]))
    return found


def beneath(errors: Array, floors: Array) -> float:
    """By how many standard errors the mean square of `errors` is under that of `floors` (each per run, NaN: lost)."""
    gap = st.finite(floors**2 - errors**2)
    spread = float(gap.std(ddof=1)) if gap.size > 1 else 0.0
    return float(gap.mean()) / (spread / gap.size**0.5) if spread > 0 else 0.0


def floor_lines(aligned: Aligned) -> Iterator[tuple[Column, str, dict[str, Any]]]:
    """(column, estimator, facts) of pooled floors and efficiencies, for lines that pass no verdict."""
    for name, metric, quantity, unit in metric_columns(aligned.part):
        of = f"rmse:{quantity}:{unit}"
        if metric != "floor" or of not in aligned:
            continue
        floors, errors = aligned.values(name), aligned.values(of)
        rooted = st.rooted(st.hall(floors**2, positive=True))
        error = st.rooted(st.hall(errors**2, positive=True))
        for i, label in enumerate(aligned.labels):
            if not rooted.n[i]:
                continue
            runs, least = int(rooted.n[i]), _root(floors[i], errors[i])
            yield (name, metric, quantity, unit), label, {
                "value": least, "low": rooted.low[i], "high": rooted.high[i], "standard_error": rooted.error[i],
                "runs": runs}
            if error.value[i] > NEGLIGIBLE:
                share = least / float(error.value[i])
                yield (f"efficiency:{quantity}:1", "efficiency", quantity, "1"), label, {
                    "value": share, "low": least / error.high[i], "runs": runs,
                    "high": least / error.low[i] if error.low[i] > 0 else np.inf,
                    "standard_error": share * error.error[i] / error.value[i]}


def _root(floors: Array, errors: Array) -> float:
    """The pooled floor over the runs that have an error."""
    known = floors[~np.isnan(errors) & ~np.isnan(floors)]
    return float(np.sqrt((known**2).mean())) if known.size else np.nan
