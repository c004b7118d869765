"""Whether what an estimator, a scenario or a certificate claims holds: covariances, sets, bounds, required shares.

Each gives a word, or `undecided` where the runs do not tell; equality is shown within a tolerance, never assumed."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri, stdtrit

from ...scenarios.arrays import Array
from .family import LEAST
from .statistics import ALPHA, Intervals, Share, finite, hall, share

TOLERANCE = 0.1
"""A mean of squares over their claimed size is consistent where its whole interval lies within 1 +- TOLERANCE."""
INSIDE = 0.95
"""Share of the steps that a consistent estimator's 95 % ellipsoid holds the truth."""
Consistency = Literal["consistent", "too sure", "too cautious", "undecided"]
Requirement = Literal["met", "not met", "undecided"]


class Claim(NamedTuple):
    """Squares over their claimed size: mean over the runs with limits (1 is right), whether it is consistent, and what
    else a reader has to know."""

    value: float
    low: float
    high: float
    runs: int
    verdict: Consistency
    note: str = ""


def consistency(ratio_per_run: ArrayLike, inside_per_run: ArrayLike = ()) -> Claim:
    """ANEES or a mean NIS with its interval over the runs, and the verdict by TOLERANCE.

    ratio_per_run: each run's mean over its steps of the squared error over its claimed size (steps of one run are
    correlated, so runs are the sample); infinite where a run claimed no error in a direction in which it had one.
    inside_per_run: share of each run's steps inside the 95 % ellipsoid; where its interval holds INSIDE, a few steps
    carry the mean, and alone they decide nothing."""
    values = np.asarray(ratio_per_run, dtype=np.float64)
    values = values[~np.isnan(values)]
    endless = int(np.isinf(values).sum())
    found = hall(values, positive=True)
    mean, low, high = float(found.value), float(found.low), float(found.high)
    note = f"singular claim with an error in {endless} of {values.size} runs" if endless else ""
    verdict: Consistency = "undecided"
    if endless or (values.size >= LEAST and low > 1 + TOLERANCE):
        held = share(inside_per_run)
        few = held.n > 0 and held.low <= INSIDE <= held.high
        note = "; ".join(filter(None, [note, "few steps carry the mean" if few else ""]))
        verdict = "undecided" if few else "too sure"
    elif values.size >= LEAST:
        if high < 1 - TOLERANCE:
            verdict = "too cautious"
        elif low >= 1 - TOLERANCE and high <= 1 + TOLERANCE:
            verdict = "consistent"
    return Claim(mean, low, high, values.size, verdict, note)


def white(found: Intervals) -> Literal["white", "coloured", "undecided"]:
    """Whether innovations are white, from the interval of their mean lag-1 autocorrelation over the runs: within
    +-TOLERANCE, beyond it, or neither."""
    if found.n < LEAST:
        return "undecided"
    if found.low >= -TOLERANCE and found.high <= TOLERANCE:
        return "white"
    return "coloured" if found.low > TOLERANCE or found.high < -TOLERANCE else "undecided"


class Bounded(NamedTuple):
    """A measured mean over its certified bound, with limits, and whether the certificate is kept."""

    value: float
    certified: float
    low: float
    high: float
    runs: int
    verdict: Literal["kept", "broken", "undecided"]


def bounded(measured: Array, certified: Array) -> Bounded | None:
    """A certified mean-square bound against what was measured, both per run; None without a claim."""
    limit, values = finite(certified), finite(measured)
    if not limit.size or not values.size:
        return None
    bound, found = float(limit.mean()), hall(values, positive=True)
    verdict = "broken" if found.low > bound else "kept" if found.high <= bound else "undecided"
    return Bounded(float(found.value), bound, float(found.low), float(found.high), values.size, verdict)


class Required(NamedTuple):
    """A required share: what was found, whether it is met, and about how many runs would decide (NaN: decided)."""

    found: Share
    verdict: Requirement
    deciding: float


def requirement(per_run: ArrayLike, least: float) -> Required:
    """Whether the share of runs (values 0 or 1), or of the time in them, is `least` or more: met where the whole 95 %
    interval is, not met where none of it is."""
    found = share(per_run)
    if found.low >= least:
        return Required(found, "met", float("nan"))
    if found.high < least:
        return Required(found, "not met", float("nan"))
    return Required(found, "undecided", runs_for_share(per_run, least))


def runs_for_share(per_run: ArrayLike, least: float) -> float:
    """About how many runs would decide whether a share like this one is `least` or more; infinite where it is `least`
    itself. Without spread by Wilson's interval (73 runs of which none fails are the least that decide 95 %)."""
    v = finite(per_run)
    gap = abs(float(v.mean()) - least) if v.size else 0.0
    if gap == 0:
        return float("inf")
    score = float(ndtri(1 - ALPHA / 2)) ** 2 * least * (1 - least)
    spread = float(v.var(ddof=1)) * float(stdtrit(v.size - 1, 1 - ALPHA / 2)) ** 2 if v.size > 1 else 0.0
    return float(np.ceil((spread or score) / gap**2))
