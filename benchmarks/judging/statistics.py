"""Intervals of what a sample of independent runs says: means, root mean squares, shares, claimed covariances.

Pure functions over arrays with the runs as the last axis. NaN means that a run gave no value: it is left out."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import gammaincinv, ndtr, ndtri, stdtrit

from ...scenarios.arrays import Array

ALPHA = 0.05
"""Level of every test; intervals cover 1 - ALPHA."""
ENOUGH_INSIDE = 5
"""Runs' worth of the rarer outcome from which a share's own variance is trusted (else Wilson's interval over runs)."""


class Intervals(NamedTuple):
    """Of each row of a sample: value, limits, its standard error, and the number of runs behind it; NaN where there
    are too few (limits and error need two)."""

    value: Array
    low: Array
    high: Array
    error: Array
    n: NDArray[np.int64]


class Share(NamedTuple):
    """A share of runs, or of the time in them, with its limits and the number of runs."""

    value: float
    low: float
    high: float
    n: int


def finite(values: ArrayLike) -> Array:
    """The values that are numbers, as a flat array."""
    flat = np.asarray(values, dtype=np.float64).ravel()
    return flat[np.isfinite(flat)]


def mean_se(values: ArrayLike) -> tuple[float, float]:
    """Mean and its standard error. NaN without values; the standard error is NaN for a single one."""
    v = finite(values)
    if not v.size:
        return float("nan"), float("nan")
    return float(v.mean()), float(v.std(ddof=1) / np.sqrt(v.size)) if v.size > 1 else float("nan")


def pooled_rmse(rmse_per_run: ArrayLike) -> tuple[float, float]:
    """Root of the mean over runs of each run's mean square, and its standard error by the delta method.

    With m = mean square of a run: R = sqrt(mean m), s.e.(R) = s.e.(mean m) / (2 R)."""
    mean, error = mean_se(finite(rmse_per_run) ** 2)
    root = float(np.sqrt(mean))
    return root, (error / (2 * root) if root > 0 else 0.0 * error)


def hall(sample: Array, *, positive: bool = False) -> Intervals:
    """Mean of each row of `sample` (.., runs) with the interval of Hall (1992), which takes account of the skewness:
    mean - h(+-t) s / sqrt n, h(z) = (cbrt(1 + 3 a (z - g / (6 sqrt n))) - 1) / a, a = g / (3 sqrt n), g the skewness,
    t Student's quantile. positive: the lower limit is 0 at least. NaN is left out; an infinite value makes all
    infinite."""
    v = np.asarray(sample, dtype=np.float64)
    use = ~np.isnan(v)
    n = use.sum(axis=-1)
    with np.errstate(all="ignore"):
        mean = np.where(use, v, 0.0).sum(axis=-1) / np.where(n > 0, n, np.nan)
        centred = np.where(use, v - mean[..., None], 0.0)
        second, third = (centred**2).sum(axis=-1) / n, (centred**3).sum(axis=-1) / n
        sd = np.sqrt(second * n / np.where(n > 1, n - 1, np.nan))
        skewness = np.where(second > 0, third / second**1.5, 0.0)
        root = np.sqrt(n)
        error, a = sd / root, skewness / (3 * root)
        t = stdtrit(np.maximum(n - 1, 1), 1 - ALPHA / 2)
        limits = []
        for z in (t, -t):
            bent = (np.cbrt(1 + 3 * a * (z - skewness / (6 * root))) - 1) / a
            limit = mean - np.where(np.abs(a) < 1e-9, z, bent) * error
            limits.append(np.where(np.isinf(mean), mean, limit))
    low = np.maximum(limits[0], 0.0) if positive else limits[0]
    return Intervals(mean, low, limits[1], error, n)


def rooted(found: Intervals) -> Intervals:
    """Mean squares as root mean squares, the error by the delta method."""
    root = np.sqrt(found.value)
    with np.errstate(all="ignore"):
        error = np.where(root > 0, found.error / (2 * root), 0.0 * found.error)
    return Intervals(root, np.sqrt(found.low), np.sqrt(found.high), error, found.n)


@cache
def chi_square_interval(runs: int, nx: int, level: float = 1 - ALPHA) -> tuple[float, float]:
    """Where the mean NEES of `runs` independent runs at *one* step, divided by nx, lies for a consistent estimator.

    runs x mean NEES is chi-square with runs x nx degrees of freedom (Bar-Shalom, Li, Kirubarajan 2001, 5.4.2-10).
    Not the interval of a mean over time as well: NEES of one run is correlated in time."""
    degrees = runs * nx
    low, high = (2 * float(gammaincinv(degrees / 2, share)) for share in ((1 - level) / 2, (1 + level) / 2))
    return low / degrees, high / degrees


def share(per_run: ArrayLike) -> Share:
    """The mean of runs' shares (0 or 1 where a run is one event) and its 95 % interval.

    With s_r the share of run r, p their mean and v = var / n: Clopper and Pearson's limits at p n_eff of
    n_eff = p (1 - p) / v (z / t)^2 (Korn and Graubard 1998), where n min(p, 1 - p) is at least ENOUGH_INSIDE; else, or
    where all runs agree, Wilson's (1927) over runs, never over steps, which are no independent sample."""
    v = finite(per_run)
    n = v.size
    if not n:
        return Share(float("nan"), 0.0, 1.0, 0)
    p = float(v.mean())
    z = float(ndtri(1 - ALPHA / 2))
    variance = float(v.var(ddof=1)) / n if n > 1 else 0.0
    if n * min(p, 1 - p) >= ENOUGH_INSIDE and variance > 0:
        from scipy.special import betaincinv

        size = p * (1 - p) / variance * (z / float(stdtrit(n - 1, 1 - ALPHA / 2))) ** 2
        inside = p * size
        low = float(betaincinv(inside, size - inside + 1, ALPHA / 2))
        return Share(p, low, float(betaincinv(inside + 1, size - inside, 1 - ALPHA / 2)), n)
    centre = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * float(np.sqrt(p * (1 - p) / n + z * z / (4 * n * n)))
    return Share(p, 0.0 if p == 0 else centre - half, 1.0 if p == 1 else centre + half, n)


def signed_rank(gaps: ArrayLike) -> float:
    """The p value of Wilcoxon's signed-rank test that `gaps` (n,) lie about 0; 1 where all are zero.

    By its normal approximation (from some 20 on), zeros left out, ties at their mean rank, as scipy.stats.wilcoxon's
    "asymptotic", without the import of scipy.stats."""
    v = finite(gaps)
    v = v[v != 0]
    if not v.size:
        return 1.0
    _, place, tied = np.unique(np.abs(v), return_inverse=True, return_counts=True)
    rank = (np.cumsum(tied) - (tied - 1) / 2)[place]
    n = float(v.size)
    variance = n * (n + 1) * (2 * n + 1) / 24 - (tied**3 - tied).sum() / 48
    return float(2 * ndtr(-abs(rank[v > 0].sum() - n * (n + 1) / 4) / np.sqrt(variance)))
