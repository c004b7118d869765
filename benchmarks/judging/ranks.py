"""Ranks over settings: Friedman's test and the cliques of a critical-difference diagram (Demsar 2006).

A block is a setting, never a run: runs of one setting repeat each other and say nothing of other settings."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
import pandas as pd

from ...scenarios.arrays import Array
from .statistics import ALPHA


class Ranks(NamedTuple):
    """Mean ranks over n settings (1 = least error), Friedman's p, the cliques (index groups, in order of rank, whose
    ranks differ by less than the critical difference), n, and that difference."""

    mean: Array
    p: float
    cliques: list[tuple[int, ...]]
    n: int
    difference: float


def over_settings(table: pd.DataFrame, quantity: str) -> tuple[list[str], Ranks] | None:
    """Ranks of the estimators that all settings of a verdict table share, by their errors in one quantity; who is not
    eligible in a setting comes last there. None with fewer than two estimators or settings."""
    errors = table[(table["kind"] == "error") & (table["quantity"] == quantity)
                   & ~table["verdict"].isin(["oracle", "none"])]
    shown = errors["value"].where(errors["eligible"], np.inf).fillna(np.inf)
    grid = errors.assign(shown=shown).pivot_table("shown", ["scenario", "variant"], "estimator", sort=False,
                                                  aggfunc="first").dropna(axis=1)
    if min(grid.shape) < 2:
        return None
    return [str(label) for label in grid.columns], friedman(grid.to_numpy())


def friedman(errors: Array) -> Ranks:
    """Ranks over blocks. errors (blocks, estimators), infinite: last.

    Two estimators are told apart where their mean ranks differ by the critical difference of Nemenyi's test,
    q sqrt(k (k + 1) / (6 n)), q the Studentised range's quantile over sqrt 2. Cliques are the maximal stretches of
    neighbouring ranks within it."""
    from scipy.stats import friedmanchisquare, rankdata

    n, k = errors.shape
    mean = rankdata(errors, axis=1).mean(axis=0)
    alike = bool((errors == errors[:, :1]).all())
    p = 1.0 if alike else float(friedmanchisquare(*errors.T).pvalue) if k > 2 else float("nan")
    difference = _range_quantile(k) * float(np.sqrt(k * (k + 1) / (12 * n)))
    order = [int(i) for i in np.argsort(mean, kind="stable")]
    cliques: list[tuple[int, ...]] = []
    reached = 0
    for begin in range(k):
        end = begin + 1
        while end < k and mean[order[end]] - mean[order[begin]] < difference:
            end += 1
        if end > reached and end - begin > 1:
            cliques.append(tuple(order[begin:end]))
        reached = max(reached, end)
    return Ranks(mean, p, cliques, n, difference)


@cache
def _range_quantile(k: int) -> float:
    from scipy.stats import studentized_range

    return float(studentized_range.ppf(1 - ALPHA, k, np.inf))
