"""What requirements ask of a run's errors, against loops of the test's own: whole numbers that tie with limits, steps
that do not count, runs of none, one and two steps, runs with an error that is no number."""

from __future__ import annotations

import numpy as np
import pytest
from railstate.benchmarks.scoring.requirement_kernels import claims, drifts, keep_errors, percentiles, shares

S, K = 12, 9


def runs(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """error, limits, counts (S, K): none, the first, the last and two of the steps of the first runs count."""
    rng = np.random.default_rng(seed)
    error, limit = rng.integers(-3, 4, (S, K)) + 0.0, rng.integers(1, 4, (S, K)) + 0.0
    counts = rng.random((S, K)) < 0.7
    counts[:4], counts[1, 0], counts[2, -1], counts[3, 2:4] = False, True, True, True
    error[4], error[5] = -abs(error[4]) - 1, abs(error[5]) + 1
    for run, value in ((6, np.nan), (7, np.inf), (8, -np.inf)):
        error[run, 3], counts[run, 3] = value, run != 8
    return error, limit, counts


@pytest.mark.parametrize("seed", [1, 2])
def test_shares(seed: int) -> None:
    """A limit of 0 is kept by no error alone."""
    error, limit, counts = runs(seed)
    limit[9], error[10, 3:], limit[10, 3:] = 0.0, 0.0, 0.0
    for run, found in enumerate(zip(*shares(error, limit, counts), strict=True)):
        e, top = error[run, counts[run]], limit[run, counts[run]]
        known = len(e) and np.isfinite(e).all()
        used = [0.0 if not a else np.inf if not b else abs(a) / b for a, b in zip(e, top, strict=True)]
        wanted = (np.mean(abs(e) <= top), max(used), max(0, *e, 0), max(0, *-e, 0)) if known else [np.nan] * 4
        np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("seed", [1, 2])
def test_percentiles_and_claims(seed: int) -> None:
    error, claim, counts = runs(seed)
    claim[9, counts[9].argmax()], claim[10, counts[10].argmax()], claim[11] = np.nan, np.inf, 0.0
    found, said = percentiles(error, counts, [0, 33.0, 95.0, 100]), claims(error, claim, counts, 0.5)
    for run in range(S):
        e, c = abs(error[run, counts[run]]), claim[run, counts[run]]
        wanted = np.percentile(e, [0, 33, 95, 100]) if len(e) and np.isfinite(e).all() else [np.nan] * 4
        np.testing.assert_allclose(found[:, run], wanted, rtol=1e-14)
        if len(e) and np.isfinite([*e, *c]).all():
            ratio = sorted(0.0 if a == 0 else np.inf if b == 0 else a / b for a, b in zip(e, c, strict=True))
            at = 0.99 * (len(e) - 1)
            low, high = ratio[int(at)], ratio[min(int(at) + 1, len(e) - 1)]
            most = low if low == high else low + (at - int(at)) * (high - low)
            wanted = np.mean(e <= 0.5 * c), 0.5 * np.median(c), most
        else:
            wanted = [np.nan] * 3
        np.testing.assert_allclose([part[run] for part in said], wanted, rtol=1e-14)


@pytest.mark.parametrize("seed", [1, 2])
def test_drifts(seed: int) -> None:
    """Windows that end at a distance to the bit, and those that it is not reached in; places that start anywhere."""
    error, steps, counts = runs(seed)
    place = 5.0 + np.cumsum(steps, axis=1)
    distances = np.array([0.5, 3.0, 4.0, 100.0])
    found = drifts(error, place, counts, distances)
    for run in range(S):
        e, at = error[run, counts[run]], place[run, counts[run]]
        for i, distance in enumerate(distances):
            marks = [0] if len(e) else []
            for k in range(1, len(e)):
                marks += [k] if at[k] - at[marks[-1]] >= distance else []
            change = np.diff(e[marks])
            known = len(change) and np.isfinite(change).all()
            np.testing.assert_allclose(found[i, run], np.sqrt(np.mean(change**2)) if known else np.nan, rtol=1e-14)


@pytest.mark.parametrize("every", [True, False])
def test_what_is_kept_of_steps(every: bool) -> None:
    """Weighed elements, one beyond those estimated, one that the matrix lacks, a negative variance, unknown truth."""
    rng = np.random.default_rng(3)
    B, runs_, places = 3, 2, np.array([1, 2, 4])
    vector, truth, diagonal = rng.normal(size=(B, 3, runs_)), rng.normal(size=(B, 4, runs_)), rng.random((B, 1, runs_))
    truth[1, 0, 1], diagonal[2, 0, 0] = np.nan, -0.5
    active = rng.random((B, runs_)) < 0.6
    mask = np.zeros((B, 0, 0), dtype=bool) if every else rng.random((B, 4, runs_)) < 0.6
    index, weight = np.array([0, 2, 3, 0]), np.array([-2.0, 3.0, 1.0, 0.5])
    error, true, claim = np.full((3, 4, runs_, 5), 7.0)
    counts = np.zeros((4, runs_, 5), dtype=bool)
    keep_errors(vector, truth, active, mask, diagonal, places, 3, index, weight, error, true, counts, claim)
    for q, (i, w) in enumerate(zip(index, weight, strict=True)):
        for s in range(runs_):
            wanted = np.full((4, 5), 7.0)
            wanted[2] = False
            for b, k in enumerate(places if i < 3 else []):
                known = active[b, s] and not np.isnan(truth[b, i, s]) and (every or mask[b, i, s])
                wanted[:3, k] = w * (vector[b, i, s] - truth[b, i, s]), w * truth[b, i, s], known
                wanted[3, k] = abs(w) * np.sqrt(max(diagonal[b, 0, s], 0.0)) if i == 0 else 7.0
            np.testing.assert_array_equal([error[q, s], true[q, s], counts[q, s], claim[q, s]], wanted)
