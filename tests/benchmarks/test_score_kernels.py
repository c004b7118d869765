"""The compiled loops of scoring beside loops of the test's own, in whole numbers: limits that tie, runs that end or are
lost on the way, elements that are not known or do not count, phases at their very limits."""

from __future__ import annotations

import numpy as np
import pytest
from railstate.benchmarks.scoring.kernels import add_windows, driving_phases, has_gaps, score_bound, score_errors

B, S, K = 4, 21, 6
INDEX, WEIGHT, OWNER, SHARE = np.array([0, 1, 2]), np.array([2.0, -1.0, 3.0]), np.array([0, 0, 1]), np.array(
    [0.5, 0.5, 1.0])


def errors(seed: int) -> tuple[np.ndarray, np.ndarray, np.random.Generator]:
    """Vector (B, 4, S) and truth (B, 3, S) of whole numbers."""
    rng = np.random.default_rng(seed)
    return rng.integers(-3, 4, (B, 4, S)) + 0.0, rng.integers(-1, 2, (B, 3, S)) + 0.0, rng


@pytest.mark.parametrize(("seed", "whole"), [(1, True), (2, False), (3, False)])
def test_errors_of_steps(seed: int, whole: bool) -> None:
    """What leaves a limit, or is no number, is lost from that step on; an element that does not count is left out of
    the totals, not of the curves and the last error."""
    vector, truth, rng = errors(seed)
    vector[1, 0, 3], vector[2, 2, 4] = np.nan, np.inf
    limit, active, good = np.array([7.0, 9.0]), rng.random((B, S)) < 0.8, rng.random(S) < 0.9
    scored = np.zeros((B, 0, 0), bool) if whole else rng.random((B, 3, S)) < 0.7
    live, step, places = np.full((B, S), 5.0), np.empty((4, 2, S)), np.array([0, 1, 3, 5])
    totals, last, left_out, steps, curves = (np.full(shape, 2.0) for shape in ((3, 2, S), (2, S), (2, S), S, (K, 6, 3)))
    wanted = [part.copy() for part in (totals, last, left_out, steps, curves)]
    still, lives = good.copy(), np.zeros((B, S))
    for b in range(B):
        for s in range(S):
            e = WEIGHT * (vector[b, :3, s] - truth[b, :, s])
            on = active[b, s] and still[s] and bool((abs(e) <= limit[OWNER]).all())
            still[s] &= on or not active[b, s]
            lives[b, s] = on
            for q in range(2 if on else 0):
                mine, counts = q == OWNER, np.ones(3, bool) if whole else scored[b, :, s]
                wanted[1][q, s] = square = (SHARE * e**2)[mine].sum()
                wanted[4][places[b], :3, q] += square, square**2, (SHARE * e)[mine].sum()
                wanted[0][0, q, s] += (SHARE * e**2)[mine & counts].sum()
                wanted[0][1, q, s] += (SHARE * abs(e))[mine & counts].sum()
                wanted[0][2, q, s] = max(wanted[0][2, q, s], *abs(e[mine & counts]), 0.0)
                wanted[2][q, s] += SHARE[mine & ~counts].sum()
            wanted[3][s] += on
            wanted[4][places[b], 3, 0] += on
    score_errors(vector, truth, active, scored, INDEX, WEIGHT, OWNER, SHARE, limit, good, live, step, totals, last,
                 left_out, steps, places, curves)
    for found, one in zip((totals, last, left_out, steps, curves, good, live), (*wanted, still, lives), strict=True):
        np.testing.assert_array_equal(found, one)
    assert 0 < still.sum() < S and (wanted[2] > 2).any() != whole


@pytest.mark.parametrize("shared", [True, False])
def test_bounds_of_steps(shared: bool) -> None:
    vector, truth, rng = errors(4)
    performance = np.array([[1.0, 0.0, -2.0], [0.0, 3.0, 0.5]])
    bound, live = rng.integers(1, 9, (B, 1 if shared else S)) + 0.0, (rng.random((B, S)) < 0.7).astype(float)
    certified, performed, steps = np.full((3, S), 2.0)
    wanted = np.full((3, S), 2.0)
    for b in range(B):
        for s in np.flatnonzero(live[b]):
            square = ((performance @ (vector[b, :3, s] - truth[b, :, s])) ** 2).sum()
            wanted[:, s] += bound[b, 0 if shared else s], square, 1
    score_bound(vector, truth, performance, bound, live, certified, performed, steps)
    np.testing.assert_array_equal([certified, performed, steps], wanted)


def test_errors_by_window() -> None:
    """A step counts for a quantity where all of its elements are known."""
    vector, truth, rng = errors(5)
    truth[rng.random(truth.shape) < 0.1] = np.nan
    truth[0, 1, 2] = np.inf
    active, window = rng.random((B, S)) < 0.8, rng.integers(-1, 2, (B, S))
    share, squared, steps = np.array([2.0, 2.0, 1.0]), np.full((2, 2, S), 3.0), np.full((2, 2, S), 4.0)
    wanted = squared.copy(), steps.copy()
    for b in range(B):
        for s in range(S):
            for q in range(2 if active[b, s] and window[b, s] >= 0 else 0):
                mine = q == OWNER
                if np.isfinite(truth[b, mine, s]).all():
                    e = WEIGHT[mine] * (vector[b, :3, s] - truth[b, :, s])[mine]
                    wanted[0][q, window[b, s], s] += (e**2 / share[mine]).sum()
                    wanted[1][q, window[b, s], s] += 1
    add_windows(vector, truth, active, window, INDEX, WEIGHT, OWNER, share, squared, steps)
    np.testing.assert_array_equal(squared, wanted[0])
    np.testing.assert_array_equal(steps, wanted[1])
    assert not has_gaps(np.array([[1.0, np.inf], [0.0, -np.inf]])) and has_gaps(np.array([[1.0, 2.0], [np.nan, 0.0]]))


def test_phases_at_their_limits() -> None:
    """By place: standing at 0.05 m/s and under, accelerating over 0.1 m/s^2, coasting at it, braking under -0.1."""
    cases = [  # speed before and after, length of the step, phase
        (9.0, 0.05, 1.0, 0), (9.0, np.nextafter(0.05, 1), 1.0, 3), (1.0, 0.0, 0.0, 0), (0.0, -1.0, 1.0, 0),
        (0.1, 0.2, 1.0, 2), (0.2, 0.1, 1.0, 2), (0.1, np.nextafter(0.2, 1), 1.0, 1), (1.0, 1.5, 1.0, 1),
        (1.0, 0.5, 1.0, 3), (1.0, 1.5, 0.0, -1), (np.nan, 1.5, 1.0, -1), (1.0, np.nan, 1.0, -1), (np.inf, 1.5, 1.0, 3)]
    before, after, length, phase = (np.array(part) for part in zip(*cases, strict=True))
    truth, found = np.zeros((2, 3, len(cases))), np.full((2, len(cases)), 7, dtype=np.int16)
    truth[0, 1], truth[1, 1] = after, after + 1.0
    passed = before.copy()
    driving_phases(truth, 1, np.array([length, np.full(len(cases), 2.0)]), passed, found)
    assert found[0].tolist() == phase.tolist()
    assert found[1].tolist() == [-1 if np.isnan(v) else 0 if v + 1 <= 0.05 else 1 for v in after]
    np.testing.assert_array_equal(passed, after + 1.0)
