"""The one place that judges a printed number by ours: within what it was accepted, what that makes of it, and whether
the runs were enough.

A number of one run is judged by our single runs, one of a mean by our mean, cells of one run together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import binomtest

from ...scenarios.arrays import Array
from ..judging.statistics import finite
from .files import Published, Trial, Word
from .rows import Found

TAIL = 0.025
"""Share of our single runs beyond a number of one run, on either side, under which it is not one of theirs."""
LEVEL = 0.05
"""The same of all numbers of one run together."""


class Judged(NamedTuple):
    """A printed number under a reading: ours (NaN: none), its standard error (NaN: exact), the range in which the print
    agrees with it, and the verdict."""

    value: float
    error: float
    low: float
    high: float
    verdict: Word


NOTHING = Judged(np.nan, np.nan, np.nan, np.nan, "unreachable")


def judge(cell: Published, found: Found | None) -> Judged:
    """A cell by our number for it. `undecided` where more runs could turn the verdict."""
    if found is None:
        return NOTHING
    error = found.error or np.nan
    if np.isnan(found.value):
        return Judged(found.value, np.nan, np.nan, np.nan, cell.differs)
    if cell.claim:
        low = -np.inf if cell.at_least is None else cell.at_least
        high = np.inf if cell.at_most is None else cell.at_most
        least, most = found.value - 2 * found.error, found.value + 2 * found.error
        agrees, differs = low <= least and most <= high, most < low or least > high
    elif cell.trials == 1 and found.runs is not None and len(finite(found.runs)) > 1:
        printed, room, runs = float(cell.published), _room(cell), finite(found.runs)
        low, high = (float(v) for v in np.quantile(runs, [TAIL, 1 - TAIL]))
        low, high = low - room, high + room
        beyond = [np.sum(runs - room <= printed), np.sum(runs + room >= printed)]
        least, most = binomtest(int(min(beyond)), len(runs)).proportion_ci(0.95, "wilson")
        agrees, differs = least > TAIL, most < TAIL
    else:
        printed = float(cell.published)
        room = _room(cell) + (2 * found.spread / cell.trials**0.5 if cell.trials else 0.0)
        low, high = found.value - room, found.value + room
        distance = abs(printed - found.value)
        agrees, differs = distance <= room - 3 * found.error, distance > room + 3 * found.error
    verdict: Word = cell.agrees if agrees else cell.differs if differs else "undecided"
    return Judged(found.value, error, low, high, verdict)


def _room(cell: Published) -> float:
    return cell.relative * abs(float(cell.published)) + cell.absolute


def together(trial: Trial, cells: Sequence[Published], found: Sequence[Found | None]) -> Judged | None:
    """Whether one run can have given all these numbers: the share of our runs, rounded as printed, that lie as far out
    as the print (Mahalanobis distance, the print pooled with the runs: an exact test for equals). None where the
    numbers are not of the same runs. Undecided where no print could be rejected: the farthest of n runs and the print
    is the print in one of n + 1 studies of equals."""
    values = [one.runs for one in found if one is not None and one.runs is not None]
    if len(values) < 2 or len(values) < len(found) or len({len(v) for v in values}) > 1:
        return None
    runs = np.array(values) / trial.rounding
    printed = np.array([float(cell.published) for cell in cells]) / trial.rounding
    runs = runs[:, np.isfinite(runs).all(axis=0)]
    n = runs.shape[1]
    beyond = int(np.sum(_farther(np.rint(runs), np.rint(printed))))
    least, most = binomtest(beyond, n).proportion_ci(0.95, "wilson")
    blind = 1 / (n + 1) > LEVEL or least <= LEVEL <= most
    word: Word = "undecided" if blind else cells[0].agrees if least > LEVEL else "not reproduced"
    return Judged(beyond / n, float(np.sqrt(beyond * (n - beyond) / n**3)), LEVEL, 1.0, word)


def _farther(runs: Array, printed: Array) -> Array:
    """Which columns of runs (k, n) are at least as far from the mean of all columns, the printed one (k,) among them,
    as that. In the covariance rounding alone counts (1/12 of its unit squared), so that it is never singular."""
    pool = np.concatenate([runs, printed[:, None]], axis=1)
    away = pool - pool.mean(axis=1, keepdims=True)
    covariance = away @ away.T / (pool.shape[1] - 1) + np.eye(len(pool)) / 12
    squared = np.einsum("in,in->n", away, np.linalg.solve(covariance, away))
    return squared[:-1] >= squared[-1] * (1 - 1e-9)
