"""The statistics that the runner, `compare` and the report share: means, intervals, paired tests, ranks.

Pure functions over arrays of one value per run. NaN means the run gave no value: it is left out, and `n` says so."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammaincinv, ndtr, ndtri, stdtrit

from ...scenarios.arrays import Array

ALPHA = 0.05
"""Level of every test; intervals cover 1 - ALPHA."""
RESOLUTION = 0.01
"""Differences under this share of the reference are called a tie even where they are statistically resolved."""


class Interval(NamedTuple):
    """A value, its lower and upper limit, and the number of runs behind it."""

    value: float
    low: float
    high: float
    n: int


class Paired(NamedTuple):
    """a - b over the same runs: mean with its t interval, Wilcoxon's p, share of runs where a is smaller (equal runs
    count half), the mean difference relative to b's mean, and the number of pairs."""

    difference: float
    low: float
    high: float
    p: float
    won: float
    relative: float
    n: int
Difference = Literal["better", "worse", "tie", "too few runs"]


def finite(values: ArrayLike) -> Array:
    """The values that are numbers, as a flat array."""
    flat = np.asarray(values, dtype=np.float64).ravel()
    return flat[np.isfinite(flat)]


@cache
def t_quantile(degrees: int, level: float = 1 - ALPHA) -> float:
    """Two-sided Student quantile; infinite without a degree of freedom."""
    return float(stdtrit(degrees, 0.5 + level / 2)) if degrees > 0 else float("inf")


def mean_se(values: ArrayLike) -> tuple[float, float]:
    """Mean and its standard error. NaN without values; the standard error is NaN for a single one."""
    v = finite(values)
    if not v.size:
        return float("nan"), float("nan")
    return float(v.mean()), float(v.std(ddof=1) / np.sqrt(v.size)) if v.size > 1 else float("nan")


def mean_interval(values: ArrayLike, level: float = 1 - ALPHA) -> Interval:
    """Mean with its t interval; the limits are NaN for fewer than two values."""
    v = finite(values)
    mean, error = mean_se(v)
    half = t_quantile(v.size - 1, level) * error if v.size > 1 else float("nan")
    return Interval(mean, mean - half, mean + half, v.size)


def pooled_rmse(rmse_per_run: ArrayLike) -> tuple[float, float]:
    """Root of the mean over runs of each run's mean square, and its standard error by the delta method.

    With m = mean square of a run: R = sqrt(mean m), s.e.(R) = s.e.(mean m) / (2 R)."""
    mean, error = mean_se(finite(rmse_per_run) ** 2)
    root = float(np.sqrt(mean))
    return root, (error / (2 * root) if root > 0 else 0.0 * error)


def pooled_interval(rmse_per_run: ArrayLike, level: float = 1 - ALPHA) -> Interval:
    """`pooled_rmse` with its t interval."""
    v = finite(rmse_per_run)
    root, error = pooled_rmse(v)
    half = t_quantile(v.size - 1, level) * error if v.size > 1 else float("nan")
    return Interval(root, root - half, root + half, v.size)


@cache
def chi_square_interval(runs: int, nx: int, level: float = 1 - ALPHA) -> tuple[float, float]:
    """Where the mean NEES of `runs` independent runs at *one* step, divided by nx, lies for a consistent estimator.

    runs x mean NEES is chi-square with runs x nx degrees of freedom (Bar-Shalom, Li, Kirubarajan 2001, 5.4.2-10).
    Not the interval of a mean over time as well: NEES of one run is correlated in time (see `anees`)."""
    degrees = runs * nx
    low, high = (2 * float(gammaincinv(degrees / 2, share)) for share in ((1 - level) / 2, (1 + level) / 2))
    return low / degrees, high / degrees


def anees(nees_per_run: ArrayLike, nx: int, level: float = 1 - ALPHA) -> Interval:
    """NEES averaged over time and runs, divided by nx (1 is consistent), with a t interval over the runs.

    nees_per_run: each run's mean over its steps of e' P^-1 e. Steps of one run are correlated, so the runs are the
    independent sample, and their spread gives the interval without any assumption on that correlation."""
    return mean_interval(finite(nees_per_run) / nx, level)


def consistency(nees_per_run: ArrayLike, nx: int) -> Literal["consistent", "too sure", "too cautious", "unknown"]:
    """`consistent` where 1 lies in the t interval of `anees`, or the value in the chi-square interval of one step.

    The second is the resolution of the usual test: what it would let pass at every step is not held against anyone."""
    found = anees(nees_per_run, nx)
    if found.n < 2:
        return "unknown"
    low, high = chi_square_interval(found.n, nx)
    if found.low <= 1 <= found.high or low <= found.value <= high:
        return "consistent"
    return "too sure" if found.value > 1 else "too cautious"


def wilson(successes: int, n: int, level: float = 1 - ALPHA) -> Interval:
    """A share with Wilson's score interval (1927): valid for few runs and for shares near 0 and 1."""
    if not n:
        return Interval(float("nan"), 0.0, 1.0, 0)
    z = float(ndtri(0.5 + level / 2))
    share = successes / n
    centre = (share + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * float(np.sqrt(share * (1 - share) / n + z * z / (4 * n * n)))
    low = 0.0 if successes == 0 else centre - half
    return Interval(share, low, 1.0 if successes == n else centre + half, n)


@cache
def _signed_rank_tail(n: int) -> Array:
    """P(W <= w) of the signed-rank sum of n differences without ties, w = 0 .. n (n + 1) / 2."""
    ways = np.ones(1)
    for rank in range(1, n + 1):
        grown = np.zeros(ways.size + rank)
        grown[:ways.size] += ways
        grown[rank:] += ways
        ways = grown / 2
    return np.cumsum(ways)


def wilcoxon(differences: ArrayLike) -> float:
    """Two-sided p of Wilcoxon's signed-rank test, zeros ranked and dropped (Pratt), ties given mean ranks.

    Exact for up to 50 differences without zeros or ties, otherwise normal with tie correction. 1 where all are 0."""
    from scipy.stats import rankdata  # scipy.stats takes half a second to import, which most commands can do without

    d = finite(differences)
    if d.size < 2 or not d.any():
        return 1.0
    n = d.size
    ranks = rankdata(np.abs(d))
    zeros = int((d == 0).sum())
    counts = np.unique(ranks[d != 0], return_counts=True)[1]
    above = float(ranks[d > 0].sum())
    if n <= 50 and not zeros and counts.max() == 1:
        return min(1.0, 2 * float(_signed_rank_tail(n)[round(min(above, n * (n + 1) / 2 - above))]))
    expected = (n * (n + 1) - zeros * (zeros + 1)) / 4
    variance = (n * (n + 1) * (2 * n + 1) - zeros * (zeros + 1) * (2 * zeros + 1) - (counts**3 - counts).sum() / 2) / 24
    return float(2 * ndtr(-abs(above - expected) / np.sqrt(variance)))


def paired(a: ArrayLike, b: ArrayLike, level: float = 1 - ALPHA) -> Paired:
    """Compare two estimators over the same runs (arrays of one length, same order); pairs with a NaN are left out."""
    first, second = np.asarray(a, dtype=np.float64).ravel(), np.asarray(b, dtype=np.float64).ravel()
    both = np.isfinite(first) & np.isfinite(second)
    first, second = first[both], second[both]
    d = first - second
    inner = mean_interval(d, level)
    if not d.size:
        return Paired(inner.value, inner.low, inner.high, 1.0, float("nan"), float("nan"), 0)
    reference = float(second.mean())
    relative = inner.value / abs(reference) if reference else (0.0 if inner.value == 0 else float("inf"))
    won = float(((d < 0) + 0.5 * (d == 0)).mean())
    return Paired(inner.value, inner.low, inner.high, wilcoxon(d), won, relative, d.size)


def holm(pvalues: Sequence[float]) -> list[float]:
    """Holm's step-down adjusted p values (1979), in the order given; NaN stays NaN and does not count."""
    p = np.asarray(pvalues, dtype=np.float64)
    out = np.full(p.size, np.nan)
    known = np.flatnonzero(~np.isnan(p))
    running = 0.0
    for place, index in enumerate(known[np.argsort(p[known], kind="stable")]):
        running = max(running, (known.size - place) * p[index])
        out[index] = min(running, 1.0)
    return out.tolist()


def verdict(found: Paired, adjusted_p: float, comparisons: int = 1) -> Difference:
    """What may be said of a against b. Better and worse need all three: Holm's p under ALPHA, an interval of the mean
    difference without 0, and a mean difference of at least RESOLUTION of b's mean.

    `too few runs`: a difference that would matter, in so few runs that with so many `comparisons` no outcome could have
    Holm's p under ALPHA (2^(1-n) is the least p of n runs). Anything else is a tie."""
    if abs(found.relative) < RESOLUTION:
        return "tie"
    if adjusted_p < ALPHA and (found.low > 0 or found.high < 0):
        return "better" if found.difference < 0 else "worse"
    return "too few runs" if comparisons * 2.0 ** (1 - found.n) >= ALPHA else "tie"
