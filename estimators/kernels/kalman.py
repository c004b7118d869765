"""Compiled Kalman measurement updates over a batch of runs, each element of each run received or not.

Only runs that received something are touched: gathered into tiles that fit the cache, updated, and written back."""

from __future__ import annotations

import numpy as np

from .core import (
    INDEFINITE,
    SMALLEST_PIVOT_RATIO,
    factorise,
    forward,
    gather2,
    gather3,
    kernel,
    scatter2,
    scatter3,
    tile_width,
)

SMALLEST = float(np.finfo(float).tiny)
"""The smallest number that has a reciprocal."""


@kernel
def receivers(received):
    """Numbers of the runs that received at least one element, increasing."""
    runs = received.shape[1]
    index = np.empty(runs, np.int64)
    count = 0
    for s in range(runs):
        for j in range(received.shape[0]):
            if received[j, s]:
                index[count] = s
                count += 1
                break
    return index[:count]


@kernel
def innovate(y, predicted, received, out, width):
    """out := y - predicted where received, 0 elsewhere (there y is not used: it may be NaN). All (ny, >= width)."""
    for j in range(y.shape[0]):
        for s in range(width):
            out[j, s] = y[j, s] - predicted[j, s] if received[j, s] else 0.0


@kernel
def decompose(p, failed, width):
    """p (n, n, width) := L below the diagonal and D on it, p = L D L' with L unit lower triangular, in place.

    A pivot of zero (to rounding: SMALLEST_PIVOT_RATIO, INDEFINITE) is a direction without uncertainty, and its column
    of L zero. failed (width,) is set, and entries NaN, where p is indefinite. Only the lower triangle is read."""
    n = p.shape[0]
    work = np.empty((n + 2, width))
    scale, inverse, row = work[:n], work[n], work[n + 1]
    for j in range(n):
        for s in range(width):
            scale[j, s] = abs(p[j, j, s])
    for j in range(n):
        for s in range(width):
            pivot = p[j, j, s]
            good = pivot >= -INDEFINITE * scale[j, s]
            positive = pivot > SMALLEST_PIVOT_RATIO * scale[j, s] and pivot > SMALLEST
            inverse[s] = 1.0 / pivot if positive else 0.0
            p[j, j, s] = (pivot if positive else 0.0) if good else np.nan
            failed[s] |= not good
        for i in range(n - 1, j, -1):
            for s in range(width):  # nothing may be correlated with a direction without uncertainty
                entry = p[i, j, s]
                bad = inverse[s] == 0.0 and entry * entry > INDEFINITE * (scale[i, s] * scale[j, s])
                failed[s] |= bad
                row[s] = np.nan if bad else entry * inverse[s]
            for k in range(j + 1, i + 1):
                for s in range(width):
                    p[i, k, s] -= row[s] * p[k, j, s]
            for s in range(width):
                p[i, j, s] = row[s]


@kernel
def compose(p, width):
    """p (n, n, width) := L D L', both triangles, in place of L and D as `decompose` leaves them."""
    n = p.shape[0]
    scaled = np.empty((n, width))
    for a in range(n - 1, -1, -1):
        for k in range(a):
            for s in range(width):
                scaled[k, s] = p[a, k, s] * p[k, k, s]
        for k in range(a):
            for s in range(width):
                p[a, a, s] += scaled[k, s] * p[a, k, s]
        for b in range(a):
            for s in range(width):
                p[a, b, s] = scaled[b, s]
            for k in range(b):
                for s in range(width):
                    p[a, b, s] += scaled[k, s] * p[b, k, s]
    for a in range(n):
        for b in range(a):
            for s in range(width):
                p[b, a, s] = p[a, b, s]


@kernel
def sequential(p, h, variance, received, gain, spread, failed, width):
    """Measurements h (ny, n, width or 1) of uncorrelated noise, one after the other, on p (n, n, width) as `decompose`
    leaves it: L and D after them (Bierman's update, with L lower in place of U upper).

    variance (ny, width or 1) of the noise; spread (ny, width): h P h' + r of each in turn, summed from terms that are
    not negative, as D is multiplied by ratios that are not: no cancellation can make a variance negative. gain (n, ny,
    width): each scalar step's gain K = P h'/(h P h' + r), zero where not received, where nothing changes. failed is
    set where h P h' + r <= 0."""
    n = p.shape[0]
    shared, own = h.shape[2] == 1, variance.shape[1] > 1
    work = np.empty((2 * n + 4, width))
    seen, gained = work[:n], work[n:2 * n]
    total, inverse, moved, step = work[2 * n], work[2 * n + 1], work[2 * n + 2], work[2 * n + 3]
    for j in range(h.shape[0]):
        got = received[j]
        last = n - 1
        while shared and last >= 0 and h[j, last, 0] == 0.0:
            last -= 1
        for i in range(last + 1):  # L' h
            if shared:
                weight = h[j, i, 0]
                for s in range(width):
                    seen[i, s] = weight
            else:
                for s in range(width):
                    seen[i, s] = h[j, i, s]
            for k in range(i + 1, last + 1):
                if not shared:
                    for s in range(width):
                        seen[i, s] += h[j, k, s] * p[k, i, s]
                elif h[j, k, 0] != 0.0:
                    weight = h[j, k, 0]
                    for s in range(width):
                        seen[i, s] += weight * p[k, i, s]
        noise = variance[j, 0]
        for s in range(width):
            total[s] = (variance[j, s] if own else noise) if got[s] else 1.0
            inverse[s] = 1.0 / total[s] if total[s] > 0.0 else 0.0
        for i in range(n):
            for s in range(width):
                gained[i, s] = 0.0
        for i in range(last, -1, -1):
            for s in range(width):
                f = seen[i, s] if got[s] else 0.0
                moved[s] = p[i, i, s] * f
                step[s] = -f * inverse[s]
                before = total[s]
                total[s] = before + f * moved[s]
                inverse[s] = 1.0 / total[s] if total[s] > 0.0 else 0.0
                p[i, i, s] *= before * inverse[s] if total[s] > 0.0 else 1.0
            for k in range(i + 1, n):
                for s in range(width):
                    before = p[k, i, s]
                    p[k, i, s] = before + gained[k, s] * step[s]
                    gained[k, s] += before * moved[s]
            for s in range(width):
                gained[i, s] = moved[s]
        for s in range(width):
            spread[j, s] = total[s]
            failed[s] |= not total[s] > 0.0
            inverse[s] = inverse[s] if got[s] else 0.0
        for i in range(n):
            for s in range(width):
                gain[i, j, s] = gained[i, s] * inverse[s]


@kernel
def shift(mean, innovation, h, gain, width):
    """mean (n, width) moved by the scalar steps of `sequential`: dx += K_j (innovation_j - h_j dx), j = 0, 1, ..

    h (ny, n, width or 1), gain (n, ny, width or 1). innovation (ny, width) becomes what is left of each in turn."""
    n = mean.shape[0]
    change = np.zeros((n, width))
    for j in range(h.shape[0]):
        left = innovation[j]
        if j > 0:
            for k in range(n):
                if h.shape[2] > 1:
                    for s in range(width):
                        left[s] -= h[j, k, s] * change[k, s]
                elif h[j, k, 0] != 0.0:
                    weight = h[j, k, 0]
                    for s in range(width):
                        left[s] -= weight * change[k, s]
        for i in range(n):
            if gain.shape[2] > 1:
                for s in range(width):
                    change[i, s] += gain[i, j, s] * left[s]
            else:
                weight = gain[i, j, 0]
                for s in range(width):
                    change[i, s] += weight * left[s]
    for i in range(n):
        for s in range(width):
            mean[i, s] += change[i, s]


@kernel
def _spoil(mean, covariance, s):
    """NaN for run s: nothing that comes of a lost run can pass for a number."""
    for a in range(mean.shape[0]):
        mean[a, s] = np.nan
        for b in range(mean.shape[0]):
            covariance[a, b, s] = np.nan


@kernel
def _diagonal(r, s):
    """Whether the noise covariance r (ny, ny, S) of run s is diagonal."""
    for i in range(r.shape[0]):
        for j in range(r.shape[1]):
            if i != j and r[i, j, s] != 0.0:
                return False
    return True


@kernel
def _of_kind(index, r, diagonal):
    """The runs of index whose noise covariance r (ny, ny, S or 1) is diagonal, or is not."""
    if r.shape[2] == 1:
        return index if _diagonal(r, 0) == diagonal else index[:0]
    out, count = np.empty_like(index), 0
    for s in index:
        if _diagonal(r, s) == diagonal:
            out[count] = s
            count += 1
    return out[:count]


@kernel
def _whiten(r, received, h, innovation, failed, width):
    """Decorrelate the noise of the received elements: h and innovation become L^-1 h, L^-1 innovation, with L L' = r
    (ny, ny, width or 1) over the received elements, so that the noise left has unit covariance. Returns the new h (ny,
    n, width) and one over L's diagonal (ny, width)."""
    ny, n = h.shape[0], h.shape[1]
    masked, factor, inverse = np.empty((ny, ny, width)), np.empty((ny, ny, width)), np.empty((ny, width))
    white, column = np.empty((ny, n, width)), np.empty((ny, 1, width))
    for i in range(ny):
        for s in range(width):
            column[i, 0, s] = innovation[i, s]
        for j in range(ny):
            for s in range(width):
                value = r[i, j, 0] if r.shape[2] == 1 else r[i, j, s]
                masked[i, j, s] = value if received[i, s] and received[j, s] else (1.0 if i == j else 0.0)
        for k in range(n):
            for s in range(width):
                value = h[i, k, 0] if h.shape[2] == 1 else h[i, k, s]
                white[i, k, s] = value if received[i, s] else 0.0
    factorise(masked, factor, inverse, failed, True, width)
    forward(factor, inverse, white, width)
    forward(factor, inverse, column, width)
    for i in range(ny):
        for s in range(width):
            innovation[i, s] = column[i, 0, s]
    return white, inverse


@kernel
def kalman_update(mean, covariance, y, predicted, received, h, r, residual, variance, failed):
    """Kalman update in place of the runs that received something. Returns how many runs failed here.

    mean (nx, S), covariance (nx, nx, S), y and predicted = h(mean) (ny, S), received (ny, S) bool, h (ny, nx, S or 1),
    r (ny, ny, S or 1), diagonal or not. Elements are used one after the other; correlated noise is decorrelated over
    the elements received. residual, variance (ny, S): the innovation of each element received, in turn. failed (S,) is
    set, and the run's numbers NaN, where an innovation variance is not positive."""
    index = receivers(received)
    bad = 0
    for diagonal in (True, False):
        part = _of_kind(index, r, diagonal)
        if len(part):
            bad += _update_kind(mean, covariance, y, predicted, received, h, r, residual, variance, failed, part,
                                diagonal)
    return bad


@kernel
def _update_kind(mean, covariance, y, predicted, received, h, r, residual, variance, failed, index, diagonal):
    """`kalman_update` of the runs of index, whose noise is of one kind."""
    n, ny, own = mean.shape[0], y.shape[0], r.shape[2] > 1
    wide = max(1, tile_width(n, len(index)))
    noise, tile = np.ones((ny, wide if own and diagonal else 1)), np.empty((ny, ny, wide if own else 1))
    if diagonal and not own:
        for j in range(ny):
            noise[j, 0] = r[j, j, 0]
    bad = 0
    x, p = np.empty((n, wide)), np.empty((n, n, wide))
    measured, guess, got = np.empty((ny, wide)), np.empty((ny, wide)), np.empty((ny, wide), np.bool_)
    jacobian, gain = np.empty((ny, n, 1 if h.shape[2] == 1 else wide)), np.empty((n, ny, wide))
    innovation, spread = np.zeros((ny, wide)), np.empty((ny, wide))
    for first in range(0, len(index), wide):
        width = min(wide, len(index) - first)
        part = index[first:first + width]
        gather2(mean, part, width, x)
        gather3(covariance, part, width, p)
        gather2(y, part, width, measured)
        gather2(predicted, part, width, guess)
        gather2(received, part, width, got)
        gather3(h, part, width, jacobian)
        innovate(measured, guess, got, innovation, width)
        lost = np.zeros(width, np.bool_)
        decompose(p, lost, width)
        if diagonal:
            if own:
                for j in range(ny):
                    for s in range(width):
                        noise[j, s] = r[j, j, part[s]]
            sequential(p, jacobian, noise, got, gain, spread, lost, width)
            shift(x, innovation, jacobian, gain, width)
        else:
            gather3(r, part, width, tile)
            white, inverse = _whiten(tile, got, jacobian, innovation, lost, width)
            sequential(p, white, noise, got, gain, spread, lost, width)
            shift(x, innovation, white, gain, width)
            for j in range(ny):
                for s in range(width):
                    innovation[j, s] /= inverse[j, s]
                    spread[j, s] /= inverse[j, s] * inverse[j, s]
        compose(p, width)
        for s in range(width):
            failed[part[s]] |= lost[s]
            bad += lost[s]
            if lost[s]:
                _spoil(x, p, s)
        scatter2(innovation, part, width, residual)
        scatter2(spread, part, width, variance)
        scatter2(x, part, width, mean)
        scatter3(p, part, width, covariance)
    return bad


@kernel
def shared_kalman_update(mean, covariance, y, predicted, received, h, r, residual, variance, failed):
    """`kalman_update` where every run received the same elements: covariance (nx, nx, 1) and h (ny, nx, 1) are shared,
    r (ny, ny, 1) is diagonal, and the gains and variance (ny, 1) are computed once for all runs. Bit-identical to
    `kalman_update` on each run."""
    n, ny, runs = mean.shape[0], y.shape[0], mean.shape[1]
    noise, gain, lost = np.empty((ny, 1)), np.empty((n, ny, 1)), np.zeros(1, np.bool_)
    for j in range(ny):
        noise[j, 0] = r[j, j, 0]
    decompose(covariance, lost, 1)
    sequential(covariance, h, noise, received, gain, variance, lost, 1)
    compose(covariance, 1)
    innovate(y, predicted, received, residual, runs)
    shift(mean, residual, h, gain, runs)
    if lost[0]:
        for s in range(runs):
            failed[s] = True
            for i in range(n):
                mean[i, s] = np.nan
        _spoil(mean, covariance, 0)
    return runs if lost[0] else 0


@kernel
def in_turn(spread, received, innovation, variance):
    """innovation (ny, S), 0 where not received, and variance (ny, S) := each received element's after those before it.

    spread (ny, ny, 1): the covariance of all elements' innovations."""
    ny, runs = innovation.shape
    masked, factor, inverse = np.empty((ny, ny, runs)), np.empty((ny, ny, runs)), np.empty((ny, runs))
    column, failed = np.empty((ny, 1, runs)), np.zeros(runs, np.bool_)
    for i in range(ny):
        for s in range(runs):
            column[i, 0, s] = innovation[i, s]
        for j in range(ny):
            for s in range(runs):
                masked[i, j, s] = spread[i, j, 0] if received[i, s] and received[j, s] else (1.0 if i == j else 0.0)
    factorise(masked, factor, inverse, failed, True, runs)
    forward(factor, inverse, column, runs)
    for i in range(ny):
        for s in range(runs):
            innovation[i, s] = column[i, 0, s] / inverse[i, s]
            variance[i, s] = 1.0 / (inverse[i, s] * inverse[i, s])
