"""The measurement update of covariances alone, compiled: a Kalman filter's without its mean.

For bounds that need no estimate: the same arithmetic, run by run, as `kalman.kalman_update`."""

from __future__ import annotations

import numpy as np

from .core import gather2, gather3, inner, kernel, scatter3, tile_width
from .factors import compose, decompose, sequential
from .kalman import _of_kind, _whiten, receivers


@kernel
def covariance_update(covariance, received, h, r, failed):
    """covariance (nx, nx, S) := that after the elements received (ny, S) bool, in place; h (ny, nx, S or 1), r (ny, ny,
    S or 1), diagonal or not. failed (S,) is set, and the run's numbers NaN, where an innovation variance is not
    positive."""
    index = receivers(received)
    for diagonal in (True, False):
        part = _of_kind(index, r, diagonal)
        if len(part):
            _update_kind(covariance, received, h, r, failed, part, diagonal)


@inner
def _update_kind(covariance, received, h, r, failed, index, diagonal):
    """`covariance_update` of the runs of index, whose noise is of one kind."""
    n, ny, own = covariance.shape[0], h.shape[0], r.shape[2] > 1
    wide = max(1, tile_width(n, len(index)))
    noise, tile = np.ones((ny, wide if own and diagonal else 1)), np.empty((ny, ny, wide if own else 1))
    if diagonal and not own:
        for j in range(ny):
            noise[j, 0] = r[j, j, 0]
    p, got = np.empty((n, n, wide)), np.empty((ny, wide), np.bool_)
    jacobian, gain = np.empty((ny, n, 1 if h.shape[2] == 1 else wide)), np.empty((ny, n, wide))
    spread, work = np.empty((ny, wide)), np.empty((n + 3, wide))
    for first in range(0, len(index), wide):
        width = min(wide, len(index) - first)
        part = index[first:first + width]
        gather3(covariance, part, width, p)
        gather2(received, part, width, got)
        gather3(h, part, width, jacobian)
        lost = np.zeros(width, np.bool_)
        decompose(p, lost, work, width)
        if diagonal:
            if own:
                for j in range(ny):
                    for s in range(width):
                        noise[j, s] = r[j, j, part[s]]
            sequential(p, jacobian, noise, got, gain, spread, lost, work, width)
        else:
            gather3(r, part, width, tile)
            white, _ = _whiten(tile, got, jacobian, np.zeros((ny, width)), lost, width)
            sequential(p, white, noise, got, gain, spread, lost, work, width)
        compose(p, work, width)
        for s in range(width):
            failed[part[s]] |= lost[s]
            for i in range(n if lost[s] else 0):
                p[i, :, s] = np.nan
        scatter3(p, part, width, covariance)
