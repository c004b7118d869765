"""Compiled Kalman measurement updates over a batch of runs, each element of each run received or not.

Only runs that received something are touched: gathered into tiles that fit the cache, updated, and written back."""

from __future__ import annotations

import numpy as np

from .core import factorise, forward, gather2, gather3, inner, kernel, scatter2, scatter3, tile_width
from .factors import compose, decompose, sequential, shift


@inner
def receivers(received):
    """Numbers of the runs that received at least one element, increasing."""
    runs, count = received.shape[1], 0
    index = np.zeros(runs, np.int64)
    for j in range(received.shape[0]):
        got = received[j]
        for s in range(runs):
            index[s] |= got[s]
    for s in range(runs):
        some = index[s]
        index[count] = s
        count += some
    return index[:count]


@inner
def innovate(y, predicted, received, out, width):
    """out := y - predicted where received, 0 elsewhere (there y is not used: it may be NaN). All (ny, >= width)."""
    for j in range(y.shape[0]):
        seen, guess, got, left = y[j], predicted[j], received[j], out[j]
        for s in range(width):
            left[s] = seen[s] - guess[s] if got[s] else 0.0


@inner
def _spoil(mean, covariance, s):
    """NaN for run s: nothing that comes of a lost run can pass for a number."""
    for a in range(mean.shape[0]):
        mean[a, s] = np.nan
        for b in range(mean.shape[0]):
            covariance[a, b, s] = np.nan


@inner
def _diagonal(r, s):
    """Whether the noise covariance r (ny, ny, S) of run s is diagonal."""
    for i in range(r.shape[0]):
        for j in range(r.shape[1]):
            if i != j and r[i, j, s] != 0.0:
                return False
    return True


@inner
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


@inner
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


CORRELATED = -1
"""What `uncorrelated_update` returns where it does not do."""


@inner
def _update(kind, diagonal, tile, mean, covariance, y, predicted, received, h, r, residual, variance, failed):
    """`kalman_update` of the runs of `kind`, whose noise is diagonal or not. tile: r, or room for a tile of it where
    runs have their own; None: the noise of all is diagonal, and what else there is is not even compiled."""
    n, ny, own, bad = mean.shape[0], y.shape[0], r.shape[2] > 1, 0
    wide = tile_width(n, len(kind))
    whole = wide == mean.shape[1]
    noise = np.ones((ny, wide if own and diagonal else 1))
    if diagonal and not own:
        for j in range(ny):
            noise[j, 0] = r[j, j, 0]
    cubes = np.empty((ny if whole else n + ny, n, wide))
    rows = np.empty((n + 3 + 2 * ny + (0 if whole else n + 2 * ny), wide))
    gain, work, seen, guess = cubes[:ny], rows[:n + 3], rows[n + 3:n + 3 + ny], rows[n + 3 + ny:n + 3 + 2 * ny]
    rest = rows[n + 3 + 2 * ny:]
    p, x = covariance if whole else cubes[ny:], mean if whole else rest[:n]
    innovation, spread = residual if whole else rest[n:n + ny], variance if whole else rest[n + ny:]
    flags = np.empty((ny + 1, wide), np.bool_)
    got, lost = flags[:ny], flags[ny]
    jacobian = h if h.shape[2] == 1 else np.empty((ny, n, wide))
    for first in range(0, len(kind), wide):
        width = min(wide, len(kind) - first)
        part = kind[first:first + width]
        if not whole:
            gather2(mean, part, width, x)
            gather3(covariance, part, width, p)
        gather2(y, part, width, seen)
        gather2(predicted, part, width, guess)
        gather2(received, part, width, got)
        if h.shape[2] > 1:
            gather3(h, part, width, jacobian)
        for s in range(width):
            lost[s] = False
        innovate(seen, guess, got, innovation, width)
        decompose(p, lost, work, width)
        design, inverse = jacobian, noise
        if tile is not None and not diagonal:
            if own:
                gather3(r, part, width, tile)
            design, inverse = _whiten(tile, got, jacobian, innovation, lost, width)
        if own and diagonal:
            for j in range(ny):
                for s in range(width):
                    noise[j, s] = r[j, j, part[s]]
        sequential(p, design, noise, got, gain, spread, lost, work, width)
        shift(x, innovation, design, gain, work, width)
        if tile is not None and not diagonal:
            for j in range(ny):
                for s in range(width):
                    innovation[j, s] /= inverse[j, s]
                    spread[j, s] /= inverse[j, s] * inverse[j, s]
        compose(p, work, width)
        for s in range(width):
            if lost[s]:
                failed[part[s]] = True
                bad += 1
                _spoil(x, p, s)
        if not whole:
            scatter2(innovation, part, width, residual)
            scatter2(spread, part, width, variance)
            scatter2(x, part, width, mean)
            scatter3(p, part, width, covariance)
    return bad


def kalman_update(*arguments):
    """Kalman update in place of the runs that received something. Returns how many runs failed here.

    mean (nx, S), covariance (nx, nx, S), y and predicted = h(mean) (ny, S), received (ny, S) bool, h (ny, nx, S or 1),
    r (ny, ny, S or 1), diagonal or not. Elements are used one after the other; correlated noise is decorrelated over
    the elements received. residual, variance (ny, S): the innovation of each element received, in turn. failed (S,) is
    set, and the run's numbers NaN, where the covariance is indefinite or an innovation variance is not positive."""
    bad = uncorrelated_update(*arguments)
    return any_update(*arguments) if bad == CORRELATED else bad


@kernel
def uncorrelated_update(mean, covariance, y, predicted, received, h, r, residual, variance, failed):
    """`kalman_update`; or CORRELATED, and nothing happens, where the noise of a run that received something is."""
    index = receivers(received)
    if not len(index):
        return 0
    for k in range(len(index) if r.shape[2] > 1 else 1):
        if not _diagonal(r, index[k] if r.shape[2] > 1 else 0):
            return CORRELATED
    return _update(index, True, None, mean, covariance, y, predicted, received, h, r, residual, variance, failed)


@kernel
def any_update(mean, covariance, y, predicted, received, h, r, residual, variance, failed):
    """`kalman_update`, whatever the noise, in one piece."""
    index, bad, ny = receivers(received), 0, y.shape[0]
    tile = r if r.shape[2] == 1 else np.empty((ny, ny, tile_width(mean.shape[0], len(index))))
    for diagonal in (True, False):
        kind = _of_kind(index, r, diagonal)
        if len(kind):
            bad += _update(kind, diagonal, tile, mean, covariance, y, predicted, received, h, r, residual, variance,
                           failed)
    return bad


@kernel
def shared_kalman_update(mean, covariance, y, predicted, received, h, r, residual, variance, failed):
    """`kalman_update` where every run received the same elements: covariance (nx, nx, 1) and h (ny, nx, 1) are shared,
    r (ny, ny, 1) is diagonal, and the gains and variance (ny, 1) are computed once for all runs. Bit-identical to
    `kalman_update` on each run, so nothing is touched where nothing was received."""
    some = False
    for j in range(received.shape[0]):
        some |= received[j, 0]
    if not some:
        return 0
    n, ny, runs, one = mean.shape[0], y.shape[0], mean.shape[1], covariance.shape[2]
    noise, gain, lost = np.empty((ny, 1)), np.empty((ny, n, 1)), np.zeros(1, np.bool_)
    work = np.empty((n + 3, runs))
    for j in range(ny):
        noise[j, 0] = r[j, j, 0]
    decompose(covariance, lost, work, one)
    sequential(covariance, h, noise, received, gain, variance, lost, work, one)
    compose(covariance, work, one)
    innovate(y, predicted, received, residual, runs)
    shift(mean, residual, h, gain, work, runs)
    if lost[0]:
        _spoil(mean, covariance, 0)
        for s in range(runs):
            failed[s] = True
            for a in range(n):
                mean[a, s] = np.nan
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
