"""Quadratic forms e' M^-1 e of errors under claimed matrices: NEES and its spread, sets that hold the truth or not."""

from __future__ import annotations

import math

import numpy as np

from ...estimators.kernels.core import factorise, forward, inner, kernel, tile_width
from .kernels import lane_sum

NO_ERROR = 1e-12
"""A squared error under this share of a variance is none: a hundred times what counts as no variance beside it."""
FINENESS, BINS = 16, 640
"""Bins of an octave, and all bins, of the histogram of a run's NEES over the steps; the middle one begins at 1."""
LOWEST, HIGHEST = 2.0 ** (-BINS / 2 / FINENESS), 2.0 ** (BINS / 2 / FINENESS)


@kernel
def score_forms(form, failed, live, lost, total, count, places, curves, middle, limit, inside, histogram):
    """The NEES of steps b, form (B, S), taken up by total, count (S,) and curves (K, 6, ..) of each step: the sum over
    runs in [4, 0], their number in [5, 0]. lost (S,): set where a live run failed. The rest as in `add_spread`."""
    for b in range(form.shape[0]):
        for s in range(lost.shape[0]):
            lost[s] |= failed[b, s] and live[b, s] > 0.0
        curve = curves[places[b]]
        add_forms(form[b], live[b], total, count, curve[4], curve[5])
        add_spread(form[b], live[b], middle, limit, inside, histogram)


@kernel
def score_sets(form, failed, diagonal, live, lost, index, weight, owner, share, inside, steps, half_width):
    """Of steps b, form, live (B, S): inside (S,) counts those with the truth in the ellipsoid, form <= 1, steps (S,)
    all, half_width (nq, S) sums the ellipsoid's: roots of its diagonal (B, n, S), NaN where it has no such element."""
    for b in range(form.shape[0]):
        for s in range(lost.shape[0]):
            lost[s] |= failed[b, s] and live[b, s] > 0.0
            if live[b, s] > 0.0 and form[b, s] == form[b, s]:
                inside[s] += 1.0 if form[b, s] <= 1.0 + 1e-9 else 0.0
                steps[s] += 1.0
                for r in range(index.shape[0]):
                    wide = diagonal[b, index[r], s] if index[r] < diagonal.shape[1] else np.nan
                    half_width[owner[r], s] += share[r] * np.sqrt(weight[r] * weight[r] * (0.0 if wide < 0.0 else wide))


@kernel
def quadratic_forms(vector, truth, matrix, states, diagonal, form, failed):
    """Of steps b: diagonal (B, m, S) of the matrix M (B, m, m, S or 1), and form (B, S), e' M^-1 e by Cholesky, of its
    leading `states`, e = vector - truth (B, >= states, S), 0 where the truth is unknown (NaN). Where M is singular:
    infinite if e leaves the directions that M allows for, else NaN (nothing to be judged). failed (B, S): whether M is
    indefinite or not finite."""
    runs, n, shared = form.shape[1], states, matrix.shape[3] == 1
    width = runs if n * n * runs <= 8192 else tile_width(n, runs)
    tile, factor = np.empty((n, n, 1 if width == runs else width)), np.empty((n, n, width))
    inverse, error, bad = np.empty((n, width)), np.empty((n, 1, width)), np.empty(width, np.bool_)
    for b in range(form.shape[0]):
        whole = matrix[b]
        for i in range(diagonal.shape[1]):
            row, to = whole[i, i], diagonal[b, i]
            for s in range(runs):
                to[s] = row[0 if shared else s]
        for first in range(0, runs, width):
            count = min(width, runs - first)
            if not shared or first == 0:
                source, some = whole, 1 if shared else count
                for s in range(count):
                    bad[s] = False
                if not shared and width < runs:
                    source = tile
                    for i in range(n):
                        for j in range(i + 1):
                            row, to = whole[i, j, first:first + some], tile[i, j]
                            for s in range(some):
                                to[s] = row[s]
                factorise(source, factor, inverse, bad, False, some)
                for i in range(n if shared else 0):
                    for j in range(i):
                        for s in range(1, width):
                            factor[i, j, s] = factor[i, j, 0]
                    for s in range(1, width):
                        inverse[i, s] = inverse[i, 0]
                for s in range(1, width if shared else 0):
                    bad[s] = bad[0]
            for i in range(n):
                mine, theirs, row = vector[b, i, first:first + count], truth[b, i, first:first + count], error[i, 0]
                for s in range(count):
                    there = theirs[s]
                    row[s] = mine[s] - (there if there == there else mine[s])
            forward(factor, inverse, error, count)
            total = form[b, first:first + count]
            for s in range(count):
                total[s] = 0.0
                failed[b, first + s] = bad[s]
            for i in range(n):
                row, scale = error[i, 0], inverse[i]
                for s in range(count):
                    value = total[s] + row[s] * row[s]
                    total[s] = value if scale[s] > 0.0 else np.nan
            for s in range(count):
                if total[s] != total[s] and not bad[s]:
                    total[s] = _singular_form(vector[b], truth[b], whole, factor, inverse, error, first, s)


@inner
def _singular_form(vector, truth, matrix, factor, inverse, error, first, s):
    """Infinite where run first + s errs in a direction in which its M claims no uncertainty, else NaN; factor,
    inverse, error (n, 1, ..): as they stand after `forward`."""
    for i in range(error.shape[0]):
        if inverse[i, s] == 0.0:
            there = truth[i, first + s]
            rest = vector[i, first + s] - (there if there == there else vector[i, first + s])
            for k in range(i):
                rest -= factor[i, k, s] * error[k, 0, s]
            if rest * rest > NO_ERROR * matrix[i, i, 0 if matrix.shape[2] == 1 else first + s]:
                return np.inf
    return np.nan


@inner
def add_forms(form, live, total, count, curve, curve_count):
    """total, count (S,) take up form (S,) where live and not NaN; curve[0] its sum over runs, curve_count[0] their
    number."""
    value, ones = np.empty(live.shape[0]), np.empty(live.shape[0])
    for s in range(live.shape[0]):
        on = live[s] > 0.0 and form[s] == form[s]
        value[s] = form[s] if on else 0.0
        ones[s] = 1.0 if on else 0.0
        total[s] += value[s]
        count[s] += ones[s]
    curve[0] += lane_sum(value)
    curve_count[0] += lane_sum(ones)


@inner
def add_spread(form, live, middle, limit, inside, histogram):
    """Of live runs whose form (S,) is not NaN: inside (S,) counts the steps with form <= limit, histogram (S, BINS)
    form / middle, each octave in FINENESS equal parts; what is beyond either end, 0 and infinity too, is in the bin
    there. No logarithm: which bin it is may not hang on its rounding."""
    for s in range(live.shape[0]):
        if live[s] > 0.0 and form[s] == form[s]:
            inside[s] += 1.0 if form[s] <= limit else 0.0
            size, place = form[s] / middle, 0
            if size > HIGHEST:
                place = BINS - 1
            elif size > LOWEST:
                part, octave = math.frexp(size)
                place = min(BINS // 2 + (octave - 1) * FINENESS + int((2.0 * part - 1.0) * FINENESS), BINS - 1)
            histogram[s, place] += 1


@kernel
def histogram_medians(histogram):
    """The medians (S,) of the sizes in histogram (S, BINS), by linear interpolation within a bin, which is at most
    1 / FINENESS wide. 0 and infinity in the first and last bin, NaN where nothing was counted."""
    out = np.full(histogram.shape[0], np.nan)
    for s in range(histogram.shape[0]):
        half, below = histogram[s].sum() / 2.0, 0
        for place in range(histogram.shape[1]):
            count = histogram[s, place]
            if count and below + count >= half:
                octave, part = divmod(place - BINS // 2, FINENESS)
                size = 2.0**octave * (1.0 + (part + (half - below) / count) / FINENESS)
                out[s] = 0.0 if place == 0 else np.inf if place == BINS - 1 else size
                break
            below += count
    return out
