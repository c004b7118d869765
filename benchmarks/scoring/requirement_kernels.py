"""What requirements ask of a run's kept errors: arrays (S, K), masks say which steps count. Compiled but for sorting.

A run at a time, so that no batch changes a bit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...scenarios.arrays import Array, Mask
from ...scenarios.machine_code import njit


@njit(cache=True)
def keep_errors(vector, truth, active, scored, diagonal, places, estimated, index, weight, error, true, counts,
                claim):  # pyright: ignore
    """error, true, counts, claim (n, S, K) := of steps b, which are places[b], of the elements `index` of the truth,
    times their weight: error of the vector (B, n, S), the truth, whether it counts (scored (B, 0, 0): all do), and one
    standard deviation by a matrix's diagonal (B, m, S), where it has that element. Nothing is written of elements
    beyond those `estimated`."""
    for q in range(index.shape[0]):
        i, w = index[q], weight[q]
        if i < estimated:
            for s in range(active.shape[1]):
                for b in range(vector.shape[0]):
                    k, there = places[b], truth[b, i, s]
                    error[q, s, k], true[q, s, k] = w * (vector[b, i, s] - there), w * there
                    counts[q, s, k] = active[b, s] and there == there and (scored.shape[1] == 0 or scored[b, i, s])
                    if i < diagonal.shape[1]:
                        variance = diagonal[b, i, s]
                        claim[q, s, k] = abs(w) * np.sqrt(0.0 if variance < 0.0 else variance)


@njit(cache=True)
def shares(error, limit, counts):  # pyright: ignore
    """(share of steps with |error| <= limit, largest |error| / limit, largest error, largest -error), (S,) each; no
    error uses nothing of a limit of 0, any other more than all of it."""
    runs = error.shape[0]
    inside, use = np.full(runs, np.nan), np.full(runs, np.nan)
    over, under = np.full(runs, np.nan), np.full(runs, np.nan)
    for r in range(runs):
        steps, good, most, high, low = 0, 0, 0.0, 0.0, 0.0
        lost = False
        for k in range(error.shape[1]):
            if counts[r, k]:
                e = error[r, k]
                lost = lost or not np.isfinite(e)
                steps += 1
                good += 1 if abs(e) <= limit[r, k] else 0
                most = max(most, 0.0 if e == 0.0 else np.inf if limit[r, k] == 0.0 else abs(e) / limit[r, k])
                high, low = max(high, e), max(low, -e)
        if steps and not lost:
            inside[r], use[r], over[r], under[r] = good / steps, most, high, low
    return inside, use, over, under


def _percentiles(values: Array, percents: Sequence[float]) -> list[float]:
    """Of values, infinite ones too, by linear interpolation between order statistics."""
    places = [percent / 100.0 * (len(values) - 1) for percent in percents]
    pairs = [(int(np.floor(place)), min(int(np.floor(place)) + 1, len(values) - 1)) for place in places]
    ordered = np.partition(values, sorted({place for pair in pairs for place in pair}))
    return [float(ordered[low] + (place - low) * (ordered[high] - ordered[low])
                  if place > low and ordered[high] > ordered[low] else ordered[low])
            for place, (low, high) in zip(places, pairs, strict=True)]


def percentiles(error: Array, counts: Mask, percents: Sequence[float]) -> Array:
    """Percentiles of |error| over the steps that count, (len(percents), S)."""
    out = np.full((len(percents), len(error)), np.nan)
    for r, row in enumerate(error):
        values = np.abs(row[counts[r]])
        if len(values) and np.isfinite(values).all():
            out[:, r] = _percentiles(values, percents)
    return out


def claims(error: Array, claim: Array, counts: Mask, k: float) -> tuple[Array, Array, Array]:
    """(share of steps with |error| <= k claim, median of k claim, 99th percentile of |error| / claim), (S,) each."""
    inside, median, needed = np.full((3, len(error)), np.nan)
    for r, row in enumerate(error):
        e, c = np.abs(row[counts[r]]), claim[r][counts[r]]
        if len(e) and np.isfinite(e).all() and np.isfinite(c).all():
            ratio = np.where(e == 0.0, 0.0, np.inf)
            np.divide(e, c, out=ratio, where=c > 0.0)
            inside[r] = np.count_nonzero(e <= k * c) / len(e)
            median[r] = k * _percentiles(c, (50.0,))[0]
            needed[r] = _percentiles(ratio, (99.0,))[0]
    return inside, median, needed


@njit(cache=True)
def drifts(error, place, counts, distances):  # pyright: ignore
    """Root mean square change of the error over each of the distances travelled, one behind the other, while the steps
    count; (len(distances), S). Jumps where a filter relocates are in it."""
    runs = error.shape[0]
    out = np.full((distances.shape[0], runs), np.nan)
    for r in range(runs):
        for i in range(distances.shape[0]):
            total, windows, begun, before, at = 0.0, 0, False, 0.0, 0.0
            for k in range(error.shape[1]):
                if not counts[r, k]:
                    continue
                if not begun:
                    begun, before, at = True, error[r, k], place[r, k]
                elif place[r, k] - at >= distances[i]:
                    change = error[r, k] - before
                    total, windows = total + change * change, windows + 1
                    before, at = error[r, k], place[r, k]
            if windows and np.isfinite(total):
                out[i, r] = np.sqrt(total / windows)
    return out
