"""Ranks over blocks: Friedman's test and the cliques of a critical-difference diagram."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...scenarios.arrays import Array
from .statistics import ALPHA, RESOLUTION, holm, wilcoxon


class Ranks(NamedTuple):
    """Mean Friedman ranks (1 = least error), Friedman's p, and the cliques: index groups that are not told apart."""

    mean: Array
    p: float
    cliques: list[tuple[int, ...]]
    n: int


def friedman(errors: Array) -> Ranks:
    """Ranks of estimators over blocks, for a critical-difference diagram. errors (blocks, estimators), positive.

    Blocks are what is independent and shared by all (one run of one variant); blocks with a NaN are left out. Two
    estimators are told apart where Wilcoxon's test of log(error ratio), Holm-corrected over all pairs, says so and the
    median ratio differs from 1 by RESOLUTION or more. Cliques are the maximal stretches of neighbouring ranks without
    a pair told apart, members in order of rank."""
    from scipy.stats import friedmanchisquare, rankdata

    use = errors[np.isfinite(errors).all(axis=1)]
    count = errors.shape[1]
    if use.shape[0] < 2 or count < 2:
        return Ranks(np.full(count, np.nan), float("nan"), [], use.shape[0])
    mean = rankdata(use, axis=1).mean(axis=0)
    p = float(friedmanchisquare(*use.T).pvalue) if count > 2 else float("nan")
    logs = np.log(np.maximum(use, np.finfo(float).tiny))
    pairs = [(i, j) for i in range(count) for j in range(i + 1, count)]
    gaps = [logs[:, i] - logs[:, j] for i, j in pairs]
    adjusted = holm([wilcoxon(gap) for gap in gaps])
    apart = {pair for pair, gap, value in zip(pairs, gaps, adjusted, strict=True)
             if value < ALPHA and abs(float(np.median(gap))) >= np.log1p(RESOLUTION)}
    order = [int(i) for i in np.argsort(mean, kind="stable")]
    cliques: list[tuple[int, ...]] = []
    reached = 0
    for begin in range(count):
        end = begin + 1
        while end < count and all((min(m, order[end]), max(m, order[end])) not in apart for m in order[begin:end]):
            end += 1
        if end > reached and end - begin > 1:
            cliques.append(tuple(order[begin:end]))
        reached = max(reached, end)
    return Ranks(mean, p, cliques, use.shape[0])
