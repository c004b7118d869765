"""Quadratic forms of claimed matrices taken up step by step, beside loops of the test's own: ties with limits, runs
that have ended or failed, forms and diagonals that are no numbers or negative, elements that a set lacks."""

from __future__ import annotations

import numpy as np
import pytest
from railstate.benchmarks.scoring.forms import BINS, score_forms, score_sets

B, S, K = 3, 21, 5


def given(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """form, failed, live (B, S): a form that ties with 1 and nearly, one beyond, none, infinite; a run that is not."""
    rng = np.random.default_rng(seed)
    form = rng.choice([0.25, 1.0, 1.0 + 9e-10, 1.0 + 2e-9, 4.0, np.nan, np.inf], (B, S))
    return form, rng.random((B, S)) < 0.1, (rng.random((B, S)) < 0.7).astype(float)


@pytest.mark.parametrize("seed", [1, 2])
def test_sets_and_their_half_widths(seed: int) -> None:
    rng = np.random.default_rng(seed)
    form, failed, live = given(seed)
    diagonal = rng.choice([-0.5, -1e-9, 0.0, 0.25, 0.75, 4.0], (B, 2, S))
    index, weight, owner, share = np.array([0, 1, 2]), np.array([2.0, -3.0, 1.0]), np.array([0, 1, 1]), np.array(
        [1.0, 0.5, 0.25])
    lost, inside, steps, wide = rng.random(S) < 0.1, np.full(S, 3.0), np.full(S, 5.0), np.full((2, S), 7.0)
    wanted = [part.copy() for part in (lost, inside, steps, wide)]
    for b in range(B):
        for s in range(S):
            wanted[0][s] |= failed[b, s] and live[b, s] == 1
            if live[b, s] and not np.isnan(form[b, s]):
                wanted[1][s] += form[b, s] <= 1 + 1e-9
                wanted[2][s] += 1
                for i, w, q, part in zip(index, weight, owner, share, strict=True):
                    wanted[3][q, s] += part * abs(w) * np.sqrt(max(diagonal[b, i, s], 0.0)) if i < 2 else np.nan
    score_sets(form, failed, diagonal, live, lost, index, weight, owner, share, inside, steps, wide)
    for found, one in zip((lost, inside, steps, wide), wanted, strict=True):
        np.testing.assert_allclose(found, one, rtol=1e-14)
    assert wanted[0].any() and not wanted[0].all() and np.isfinite(wanted[3][0]).all()
    assert np.isnan(wanted[3][1]).any() and (wanted[1] > 3).any() and (wanted[1] - 3 < wanted[2] - 5).any()


@pytest.mark.parametrize("seed", [1, 2])
def test_forms_and_their_spread(seed: int) -> None:
    form, failed, live = given(seed)
    places, middle, limit = np.array([1, 2, 4]), 0.5, 1.0
    lost, total, count, inside = np.zeros(S, bool), np.full(S, 2.0), np.full(S, 1.0), np.full(S, 4.0)
    curves, histogram = np.full((K, 6, 2), 9.0), np.zeros((S, BINS), np.int32)
    wanted = [part.copy() for part in (lost, total, count, inside, curves)]
    for b, place in enumerate(places):
        for s in range(S):
            wanted[0][s] |= failed[b, s] and live[b, s] == 1
            if live[b, s] and not np.isnan(form[b, s]):
                wanted[1][s] += form[b, s]
                wanted[2][s] += 1
                wanted[3][s] += form[b, s] <= limit
                wanted[4][place, 4, 0] += form[b, s]
                wanted[4][place, 5, 0] += 1
    score_forms(form, failed, live, lost, total, count, places, curves, middle, limit, inside, histogram)
    for found, one in zip((lost, total, count, inside, curves), wanted, strict=True):
        np.testing.assert_allclose(found, one, rtol=1e-14)
    assert histogram.sum(axis=1).tolist() == (wanted[2] - 1).tolist()
    assert np.flatnonzero(histogram.sum(axis=0)).tolist() == [
        BINS // 2 - 16, BINS // 2 + 16, BINS // 2 + 48, BINS - 1]  # 0.25, 1 and a little more, 4, all beyond; over 0.5
