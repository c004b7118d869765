"""Estimators of one cell against each other, every pair at once: whose ratio of errors may be called a difference.

The family-wise error holds also for the best picked from the same data: max |T| over all pairs, simulated from the
cell's own runs by a bootstrap and by exchange within the runs, the larger of both."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...scenarios.arrays import Array, Mask
from ...scenarios.randomness import RunRandom
from .statistics import ALPHA

SEED = 1992
DRAWS, MANY_DRAWS = 1999, 4999
MARGIN = 0.01
"""Ratios within 1 +- MARGIN are a tie, where their whole interval is."""
FLOOR = 0.25
"""Least standard error of a log ratio of mean squares, in margins: pairs of near-copies, whose tiny differences are far
from normal, would else set the critical value of the whole cell."""
BLOCKS = 1000
"""More runs than this are averaged into so many blocks for the critical value."""
LEAST = 20
"""Fewer runs than this give no verdict."""
TOLERATED = 0.005
"""Share of runs by which an estimator may lose more than the most reliable one, whatever a test says."""


def _random(what: str, key: str, n: int) -> np.random.Generator:
    return RunRandom(SEED, (what, key, str(n)), (0,)).generators[0]


class Draws:
    """The random resampling of one cell of n runs: seeded by a constant, the cell's key and n, so that neither the
    order of estimators nor batches nor other cells matter. All quantities of the cell share it. level: of the tests;
    a small one takes more draws."""

    def __init__(self, key: str, n: int, level: float = ALPHA) -> None:
        self.key, self.n, self.size, self.level = key, n, min(n, BLOCKS), level
        self.count = DRAWS if level >= ALPHA else MANY_DRAWS

    @cached_property
    def weights(self) -> Array:
        """Bootstrap weights (count, size), each row adding up to 1."""
        chosen = _random("bootstrap", self.key, self.n).integers(0, self.size, (self.count, self.size), np.int32)
        chosen += self.size * np.arange(self.count, dtype=np.int32)[:, None]
        counts = np.bincount(chosen.ravel(), minlength=self.count * self.size)
        return counts.reshape(self.count, self.size) / self.size

    @cached_property
    def signs(self) -> Array:
        """Random signs (count, size), one a run for all pairs, divided by size."""
        drawn = _random("exchange", self.key, self.n).integers(0, 2, (self.count, self.size), np.int8)
        return (2.0 * drawn - 1.0) / self.size

    def blocks(self, x: Array) -> Array:
        """x (k, n) averaged into `size` blocks of neighbouring runs."""
        if self.n == self.size:
            return x
        starts = np.searchsorted(np.arange(self.n) * self.size // self.n, np.arange(self.size))
        return np.add.reduceat(x, starts, axis=1) / np.diff(np.append(starts, self.n))


def _place(sample: Array, level: float = ALPHA) -> float:
    """The 1 - level quantile of simulated values, as a test's critical value."""
    place = int(np.ceil((1 - level) * (len(sample) + 1))) - 1
    return float(np.partition(sample, place)[place])


def critical_value(x: Array, draws: Draws, floor: float) -> float:
    """The critical value of max |T| over all pairs. x (k, size): runs' (or blocks') values over their mean, so that all
    estimators are equal; floor: least standard error of a log ratio."""
    k, n = x.shape
    first, second = np.triu_indices(k, 1)
    product = x[first] * x[second]
    start = np.concatenate([[0], np.cumsum(np.arange(k - 1, 0, -1))])
    top = np.zeros((2, draws.count))

    def take(which: int, gap: Array, variance: Array) -> None:
        np.maximum(top[which], (gap**2 / np.maximum(variance / (n - 1), floor**2)).max(axis=0), out=top[which])

    mean = np.maximum(x @ draws.weights.T, np.finfo(float).tiny)
    log, inverse, square, cross = np.log(mean), 1 / mean, x**2 @ draws.weights.T / mean**2, product @ draws.weights.T
    shifts, spreads = x @ draws.signs.T / 2, x**2 @ draws.signs.T / 2
    middle, fixed = (x**2).mean(axis=1) / 2, product.mean(axis=1)
    for i in range(k - 1):
        pairs, rest = slice(start[i], start[i + 1]), slice(i + 1, k)
        take(0, log[i] - log[rest], square[i] + square[rest] - 2 * cross[pairs] * inverse[i] * inverse[rest])
        shift = np.clip(shifts[i] - shifts[rest], -1 + 1e-12, 1 - 1e-12)
        up, down, spread = 1 + shift, 1 - shift, spreads[i] - spreads[rest]
        both = (middle[i] + middle[rest])[:, None]
        take(1, 2 * np.arctanh(shift), (both + spread) / up**2 + (both - spread) / down**2
             - 2 * fixed[pairs, None] / (up * down))
    return float(np.sqrt(max(_place(each, draws.level) for each in top)))


def eligible(lost: Mask, key: str) -> Mask:
    """Which estimators lose no more runs than equals would. lost (k, n) -> (k,).

    Lost flags are exchanged among the estimators within each run; who lost more than the least by more than the 95 %
    quantile of the range of counts, and by more than TOLERATED of the runs, is out; repeated among the rest."""
    inside = np.ones(len(lost), dtype=bool)
    while inside.sum() > 1:
        flags = lost[inside]
        excess = flags.sum(axis=1) - flags.sum(axis=1).min()
        limit = max(_range_quantile(flags, key), TOLERATED * lost.shape[1])
        out = excess > limit
        if not out.any():
            break
        inside[np.flatnonzero(inside)[out]] = False
    return inside


def _range_quantile(flags: Mask, key: str) -> float:
    """95 % quantile of (most - least) runs lost, if those who lose a run are drawn by lot in each run."""
    k, count = len(flags), flags.sum(axis=0)
    count = count[(count > 0) & (count < k)]
    if not count.size:
        return 0.0
    random = _random("reliability", key, flags.shape[1])
    if count.size > 200:  # sums of so many draws are normal: independent but for the common part, which the range drops
        spread = np.sqrt((count * (k - count)).sum() / (k * (k - 1)))
        return _place(spread * np.ptp(random.standard_normal((DRAWS, k)), axis=1))
    totals = np.zeros((DRAWS, k))
    for lost in count:
        order = np.argsort(random.random((DRAWS, k)), axis=1)
        np.put_along_axis(totals, order[:, :lost], np.take_along_axis(totals, order[:, :lost], 1) + 1, 1)
    return _place(np.ptp(totals, axis=1))


@dataclass(frozen=True)
class Family:
    """All pairs of k estimators over the same n runs, on the scale that is shown (power 1/2 of mean squares for RMSE).

    log_ratio (k, k): log of i's error over j's; half (k, k): half width of its simultaneous interval; value (k,): the
    errors, a lost run counted as the largest of the cell; tails (k, k): j's tails are so much heavier than i's that
    "i worse than j" cannot be said, unless it were so with an interval of twice the width. critical: the critical
    value. runs: n."""

    log_ratio: Array
    half: Array
    value: Array
    tails: Mask
    critical: float
    runs: int

    def verdict(self, i: int, j: int) -> str:
        """i against j: better, worse, tie or undecided."""
        if self.runs < LEAST:
            return "undecided"
        if self.value[i] == 0 or self.value[j] == 0:
            return "tie" if self.value[i] == self.value[j] else "better" if self.value[i] == 0 else "worse"
        low, high = self.log_ratio[i, j] - self.half[i, j], self.log_ratio[i, j] + self.half[i, j]
        margin = np.log1p(MARGIN)
        if low > 0 and high >= margin:
            return "undecided" if self.tails[i, j] else "worse"
        if high < 0 and low <= -margin:
            return "undecided" if self.tails[j, i] else "better"
        return "tie" if -margin <= low and high <= margin else "undecided"

    def deciding(self, i: int, j: int) -> float:
        """About how many runs would decide between i and j."""
        margin, size = np.log1p(MARGIN), abs(self.log_ratio[i, j])
        return max(float(LEAST), float(np.ceil(self.runs * (self.half[i, j] / max(size, margin - size)) ** 2)))


def compare_all(values: Array, draws: Draws, power: float) -> Family:
    """Compare all pairs. values (k, n): what is averaged over the runs (the mean square of a run for power 1/2, else
    the value itself), not negative; NaN: lost, which counts as the largest of the cell. All need a value."""
    k, n = values.shape
    m = np.where(np.isnan(values), np.nanmax(values), values)
    mean = m.mean(axis=1)
    value = mean**power
    zero = np.zeros((k, k))
    none = zero.astype(bool)
    some = mean > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = power * np.log(mean)
        ratio = logs[:, None] - logs[None, :]
    if n < 2 or some.sum() < 2:
        return Family(ratio, np.full((k, k), np.inf), value, none, np.inf, n)
    x = draws.blocks(m[some] / mean[some, None])
    x = x / x.mean(axis=1, keepdims=True)
    size = x.shape[1]
    floor = FLOOR * 0.5 * np.log1p(MARGIN) / power
    critical = critical_value(x, draws, floor)
    half, tails = np.full((k, k), np.inf), none.copy()
    sd = x.std(axis=1)
    for a, i in enumerate(np.flatnonzero(some)):
        d = x[a] - x
        spread = d.std(axis=1)
        half[i, some] = critical * power * np.maximum(spread / np.sqrt(size - 1), floor)
        with np.errstate(divide="ignore", invalid="ignore"):
            skewness = np.where(spread > 0, ((d - d.mean(axis=1, keepdims=True)) ** 3).mean(axis=1) / spread**3, 0.0)
        near = ratio[i, some] < 2 * half[i, some]
        tails[i, some] = (sd > 2 * sd[a]) & (25 * skewness**2 > size) & near
    return Family(ratio, half, value, tails, critical, n)
