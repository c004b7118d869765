"""What requirements ask of a run's kept errors, compiled: arrays (S, K), masks say which steps count.

A run at a time, so that no batch changes a bit."""

from __future__ import annotations

import numpy as np

from ...scenarios.machine_code import njit


@njit(cache=True)
def keep_errors(vector, truth, active, scored, matrix, index, weight, error, true, counts, claim):  # pyright: ignore
    """error, true, counts, claim (n, S) := of one step, of the elements `index` of the truth, times their weight: error
    of the vector (n, S), the truth, whether it counts (scored (0, 0): all do), and one standard deviation claimed by a
    matrix (m, m, S or 1), where it has that element. Nothing is written of elements that are not estimated."""
    for q in range(index.shape[0]):
        i, w = index[q], weight[q]
        if i >= vector.shape[0]:
            continue
        for s in range(active.shape[0]):
            error[q, s], true[q, s] = w * (vector[i, s] - truth[i, s]), w * truth[i, s]
            counts[q, s] = active[s] and not np.isnan(truth[i, s]) and (scored.shape[0] == 0 or scored[i, s])
        if i < matrix.shape[0]:
            for s in range(active.shape[0]):
                variance = matrix[i, i, s if matrix.shape[2] > 1 else 0]
                claim[q, s] = abs(w) * np.sqrt(0.0 if variance < 0.0 else variance)


@njit(cache=True)
def shares(error, limit, counts):  # pyright: ignore
    """(share of steps with |error| <= limit, largest |error| / limit, largest error, largest -error), (S,) each."""
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
                most = max(most, abs(e) / limit[r, k])
                high, low = max(high, e), max(low, -e)
        if steps and not lost:
            inside[r], use[r], over[r], under[r] = good / steps, most, high, low
    return inside, use, over, under


@njit(cache=True)
def _percentile(values, percent):  # pyright: ignore
    """Of sorted values, by linear interpolation between order statistics (numpy's default)."""
    place = percent / 100.0 * (values.shape[0] - 1)
    low = int(np.floor(place))
    high = min(low + 1, values.shape[0] - 1)
    return values[low] + (place - low) * (values[high] - values[low])


@njit(cache=True)
def percentiles(error, counts, percents):  # pyright: ignore
    """Percentiles of |error| over the steps that count, (len(percents), S)."""
    runs = error.shape[0]
    out = np.full((percents.shape[0], runs), np.nan)
    for r in range(runs):
        values = np.sort(np.abs(error[r][counts[r]]))
        if values.shape[0] and np.isfinite(values[-1]):
            for i in range(percents.shape[0]):
                out[i, r] = _percentile(values, percents[i])
    return out


@njit(cache=True)
def claims(error, claim, counts, k):  # pyright: ignore
    """(share of steps with |error| <= k claim, median of k claim, 99th percentile of |error| / claim), (S,) each."""
    runs = error.shape[0]
    inside, median, needed = np.full(runs, np.nan), np.full(runs, np.nan), np.full(runs, np.nan)
    for r in range(runs):
        e, c = np.abs(error[r][counts[r]]), claim[r][counts[r]]
        if e.shape[0] == 0 or not np.isfinite(e.sum() + c.sum()):
            continue
        good = 0
        ratio = np.empty_like(e)
        for i in range(e.shape[0]):
            good += 1 if e[i] <= k * c[i] else 0
            ratio[i] = e[i] / c[i] if c[i] > 0.0 else (0.0 if e[i] == 0.0 else np.inf)
        inside[r] = good / e.shape[0]
        median[r] = k * _percentile(np.sort(c), 50.0)
        needed[r] = _percentile(np.sort(ratio), 99.0)
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
