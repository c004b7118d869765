"""Compiled scalar measurement updates of a covariance by its factors, P = L D L', over a batch of runs.

No rounding makes a variance negative: D is multiplied by ratios of sums of squares, never subtracted from."""

from __future__ import annotations

import numpy as np

from .core import INDEFINITE, SMALLEST_PIVOT_RATIO, inner

SMALLEST = float(np.finfo(float).tiny)
"""The smallest number that has a reciprocal."""


@inner
def decompose(p, failed, work, width):
    """p (n, n, >= width) := L below the diagonal and D on it, p = L D L' with L unit lower triangular, in place.

    A pivot of zero (to rounding: SMALLEST_PIVOT_RATIO, INDEFINITE) is a direction without uncertainty, and its column
    of L zero. failed (>= width,) is set, and entries NaN, where p is indefinite. Only the lower triangle is read. work
    (>= n + 2, >= width) is for scratch."""
    n = p.shape[0]
    inverse, column = work[n], work[n + 1]
    for j in range(n):
        diagonal, scale = p[j, j], work[j]
        for s in range(width):
            scale[s] = abs(diagonal[s])
    for j in range(n):
        diagonal, scale = p[j, j], work[j]
        for s in range(width):
            pivot = diagonal[s]
            good = pivot >= -INDEFINITE * scale[s]
            positive = pivot > SMALLEST_PIVOT_RATIO * scale[s] and pivot > SMALLEST
            diagonal[s] = (pivot if positive else 0.0) if good else np.nan
            failed[s] |= not good
            inverse[s] = pivot if positive else np.inf
        if j + 1 < n:
            for s in range(width):
                inverse[s] = 1.0 / inverse[s]
        for i in range(n - 1, j, -1):
            entry, other = p[i, j], work[i]
            for s in range(width):  # nothing may be correlated with a direction without uncertainty
                bad = inverse[s] == 0.0 and entry[s] * entry[s] > INDEFINITE * (other[s] * scale[s])
                failed[s] |= bad
                column[s] = np.nan if bad else entry[s] * inverse[s]
            for k in range(j + 1, i + 1):
                left, right = p[i, k], p[k, j]
                for s in range(width):
                    left[s] -= column[s] * right[s]
            for s in range(width):
                entry[s] = column[s]


@inner
def compose(p, work, width):
    """p (n, n, >= width) := L D L', both triangles, in place of L and D as `decompose` leaves them. work (>= n, >=
    width) is for scratch."""
    n = p.shape[0]
    for a in range(n - 1, -1, -1):
        diagonal = p[a, a]
        for k in range(a):
            scaled, entry, pivot = work[k], p[a, k], p[k, k]
            for s in range(width):
                scaled[s] = entry[s] * pivot[s]
                diagonal[s] += scaled[s] * entry[s]
        for b in range(a):
            entry, scaled = p[a, b], work[b]
            for s in range(width):
                entry[s] = scaled[s]
            for k in range(b):
                scaled, other = work[k], p[b, k]
                for s in range(width):
                    entry[s] += scaled[s] * other[s]
    for a in range(n):
        for b in range(a):
            here, there = p[a, b], p[b, a]
            for s in range(width):
                there[s] = here[s]


@inner
def sequential(p, h, variance, received, gain, spread, failed, work, width):
    """Measurements h (ny, n, >= width or 1) of uncorrelated noise, one after the other, on p (n, n, >= width) as
    `decompose` leaves it: L and D after them (Bierman's update, with L lower in place of U upper).

    variance (ny, >= width or 1) of the noise; spread (ny, >= width): h P h' + r of each in turn, summed from terms that
    are not negative, as D is multiplied by ratios that are not: no cancellation can make a variance negative. gain (ny,
    n, >= width): each scalar step's gain K = P h'/(h P h' + r), zero where not received, where nothing changes. failed
    is set where h P h' + r <= 0. work (>= n + 3, >= width) is for scratch."""
    n = p.shape[0]
    shared, own = h.shape[2] == 1, variance.shape[1] > 1
    inverse, moved, step = work[n], work[n + 1], work[n + 2]
    for j in range(h.shape[0]):
        got, gained, total = received[j], gain[j], spread[j]
        last = n - 1
        while shared and last >= 0 and h[j, last, 0] == 0.0:
            last -= 1
        for i in range(last + 1):  # L' h
            seen = work[i]
            if shared:
                weight = h[j, i, 0]
                for s in range(width):
                    seen[s] = weight
            else:
                row = h[j, i]
                for s in range(width):
                    seen[s] = row[s]
            for k in range(i + 1, last + 1):
                factor = p[k, i]
                if not shared:
                    row = h[j, k]
                    for s in range(width):
                        seen[s] += row[s] * factor[s]
                elif h[j, k, 0] != 0.0:
                    weight = h[j, k, 0]
                    for s in range(width):
                        seen[s] += weight * factor[s]
        if own:
            noises = variance[j]
            for s in range(width):
                total[s] = noises[s] if got[s] else 1.0
        else:
            noise = variance[j, 0]
            for s in range(width):
                total[s] = noise if got[s] else 1.0
        for s in range(width):
            inverse[s] = 0.0  # of no use in the first turn, whose rows below are zero
        for i in range(last + 1, n):
            row = gained[i]
            for s in range(width):
                row[s] = 0.0
        for i in range(last, -1, -1):
            seen, pivot, own_gain = work[i], p[i, i], gained[i]
            for s in range(width):
                f = seen[s] if got[s] else 0.0
                moved[s] = pivot[s] * f
                step[s] = -f * inverse[s]
                before = total[s]
                total[s] = before + f * moved[s]
                positive = total[s] > 0.0
                inverse[s] = 1.0 / (total[s] if positive else np.inf)
                pivot[s] *= before * inverse[s] if positive else 1.0
                own_gain[s] = moved[s]
            for k in range(i + 1, n):
                entry, row = p[k, i], gained[k]
                for s in range(width):
                    before = entry[s]
                    entry[s] = before + row[s] * step[s]
                    row[s] += before * moved[s]
        for s in range(width):
            failed[s] |= not total[s] > 0.0
        for i in range(n):
            row = gained[i]
            for s in range(width):
                row[s] *= inverse[s]


@inner
def shift(mean, innovation, h, gain, work, width):
    """mean (n, >= width) moved by the scalar steps of `sequential`: dx += K_j (innovation_j - h_j dx), j = 0, 1, ..

    h (ny, n, >= width or 1), gain (ny, n, >= width or 1). innovation (ny, >= width) becomes what is left of each in
    turn. work (>= n, >= width) is for scratch."""
    n, ny = mean.shape[0], h.shape[0]
    for j in range(ny):
        left = innovation[j]
        for k in range(n if j > 0 else 0):
            change = work[k]
            if h.shape[2] > 1:
                row = h[j, k]
                for s in range(width):
                    left[s] -= row[s] * change[s]
            elif h[j, k, 0] != 0.0:
                weight = h[j, k, 0]
                for s in range(width):
                    left[s] -= weight * change[s]
        for i in range(n):
            change = work[i]
            if j == 0:
                for s in range(width):
                    change[s] = 0.0
            if gain.shape[2] > 1:
                row = gain[j, i]
                for s in range(width):
                    change[s] += row[s] * left[s]
            else:
                weight = gain[j, i, 0]
                for s in range(width):
                    change[s] += weight * left[s]
    for i in range(n if ny > 0 else 0):
        row, change = mean[i], work[i]
        for s in range(width):
            row[s] += change[s]
