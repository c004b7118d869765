"""Compiled unscented transforms over a batch of runs: sigma points through the model, and what they say of h.

Unscented and cubature filters differ in the weights alone. The measurement update is the Kalman kernel's."""

from __future__ import annotations

import numpy as np

from ...scenarios.compiled import call
from .core import backward, factorise, forward, gather2, gather3, inner, kernel, scatter2, scatter3, tile_width


@inner
def _moments(values, weights, mean, width):
    """mean (n, width) := weighted mean of values (n, m, width), which become deviations from it."""
    for a in range(values.shape[0]):
        centre = mean[a]
        for s in range(width):
            centre[s] = 0.0
        for i in range(values.shape[1]):
            w, row = weights[i], values[a, i]
            for s in range(width):
                centre[s] += w * row[s]
        for i in range(values.shape[1]):
            row = values[a, i]
            for s in range(width):
                row[s] -= centre[s]


@inner
def _spread(deviations, weights, out, width):
    """Add the weighted sum of the outer products of deviations (n, m, width) to out's lower triangle (n, n, width),
    and mirror it. The deviations are overwritten."""
    m = deviations.shape[1]
    for a in range(deviations.shape[0] - 1, -1, -1):  # row a is no other's `right` below: it may take its weights
        total, left = out[a, a], deviations[a]
        for i in range(m):
            w, row = weights[i], left[i]
            for s in range(width):
                weighted = w * row[s]
                total[s] += weighted * row[s]
                row[s] = weighted
        for b in range(a):
            total, other, right, i = out[a, b], out[b, a], deviations[b], 0
            while i + 6 <= m:  # six terms at a time: fewer loads and stores, the same order of additions
                for s in range(width):
                    total[s] = (((((total[s] + left[i, s] * right[i, s]) + left[i + 1, s] * right[i + 1, s])
                                  + left[i + 2, s] * right[i + 2, s]) + left[i + 3, s] * right[i + 3, s])
                                + left[i + 4, s] * right[i + 4, s]) + left[i + 5, s] * right[i + 5, s]
                i += 6
            while i < m:
                for s in range(width):
                    total[s] += left[i, s] * right[i, s]
                i += 1
            for s in range(width):
                other[s] = total[s]


@inner
def _gathered(cloud, weights, noise, mean, covariance, width):
    """mean (n, width), covariance (n, n, width) := the moments of a cloud of points (n, m, width), which are
    overwritten, plus noise (n, n, width or 1). weights (2, m): of the mean and of covariances."""
    _moments(cloud, weights[0], mean, width)
    for a in range(mean.shape[0]):
        for b in range(a + 1):
            start = covariance[a, b]
            if noise.shape[2] == 1:
                value = noise[a, b, 0]
                for s in range(width):
                    start[s] = value
            else:
                row = noise[a, b]
                for s in range(width):
                    start[s] = row[s]
    _spread(cloud, weights[1], covariance, width)


@inner
def _draw(mean, covariance, scale, factor, inverse, points, failed, width):
    """Sigma points mean +- scale L_i (n, m, >= width), L the Cholesky factor of covariance (into factor); m = 2 n, or
    2 n + 1 with the mean first."""
    n, m = points.shape[0], points.shape[1]
    factorise(covariance, factor, inverse, failed, False, width)
    for s in range(width):
        if failed[s]:
            for a in range(n):
                factor[a, 0, s] = np.nan
    centre = m - 2 * n
    for a in range(n):
        middle = mean[a]
        if centre:
            point = points[a, 0]
            for s in range(width):
                point[s] = middle[s]
        for i in range(n):
            column, over, under = factor[a, i], points[a, centre + i], points[a, centre + n + i]
            for s in range(width):
                away = scale * column[s]
                over[s] = middle[s] + away
                under[s] = middle[s] - away


@kernel
def sigma_points(mean, covariance, scale, points, deviations, failed):
    """Draw points (nx, m, S), see `_draw`, for all runs, and their deviations from the mean, exactly symmetric. failed
    (S,) is set, and the run's points NaN, where the covariance (nx, nx, S) is indefinite. Returns how many runs failed
    here."""
    n, runs = mean.shape
    lost, factor, inverse = np.zeros(runs, np.bool_), np.empty((n, n, runs)), np.empty((n, runs))
    _draw(mean, covariance, scale, factor, inverse, points, lost, runs)
    centre = points.shape[1] - 2 * n
    for a in range(n):
        for s in range(runs if centre else 0):
            deviations[a, 0, s] = 0.0
        for i in range(n):
            for s in range(runs):
                deviations[a, centre + i, s] = scale * factor[a, i, s]
                deviations[a, centre + n + i, s] = -deviations[a, centre + i, s]
    for s in range(runs):
        failed[s] |= lost[s]
    return lost.sum()


@kernel
def unscented_predict(model, u, seconds, data, index, weights, scale, q, mean, covariance, moved, failed):
    """Mean (nx, S) and covariance (nx, nx, S) := the moments of the propagated sigma points plus q (nx, nx, S or 1), of
    the runs of index; the others are not touched. Returns how many runs failed here.

    model, u, seconds, data: the transition and what it takes, see `compiled.SIGNATURE`: points are drawn and propagated
    block by block. model 0: `moved` (nx, m, S) are the propagated points, from a model that is called from Python."""
    n, m, runs = mean.shape[0], weights.shape[1], len(index)
    wide, lengths = tile_width(n, runs), seconds.reshape(1, len(seconds))
    whole = wide == mean.shape[1]  # one tile of all runs: means and covariances are not copied
    cubes, clouds = np.empty((n if whole else 2 * n, n, wide)), np.empty((2 * n, m, wide))
    rows = np.empty((n + 1 + u.shape[0] + (0 if whole else n), wide))
    factor, p, points, cloud = cubes[:n], covariance if whole else cubes[n:], clouds[:n], clouds[n:]
    inverse, times, inputs = rows[:n], rows[n:n + 1], rows[n + 1:n + 1 + u.shape[0]]
    x, lost, bad = mean if whole else rows[n + 1 + u.shape[0]:], np.empty(wide, np.bool_), 0
    noise = q if q.shape[2] == 1 else np.empty((n, n, wide))
    for first in range(0, runs, wide):
        width = min(wide, runs - first)
        part = index[first:first + width]
        if model == 0:
            gather3(moved, part, width, cloud)
        else:
            for s in range(width):
                lost[s] = False
            gather2(u, part, width, inputs)
            gather2(lengths, part, width, times)
            if not whole:
                gather2(mean, part, width, x)
                gather3(covariance, part, width, p)
            _draw(x, p, scale, factor, inverse, points, lost, width)
            call(model, points, inputs, times, data, m, width, wide, cloud)
            for s in range(width):
                failed[part[s]] |= lost[s]
                bad += lost[s]
        if q.shape[2] > 1:
            gather3(q, part, width, noise)
        _gathered(cloud, weights, noise, x, p, width)
        if not whole:
            scatter2(x, part, width, mean)
            scatter3(p, part, width, covariance)
    return bad


@kernel
def linearised(deviations, images, weights, covariance, r, predicted, h, noise, failed):
    """The measurement by statistical linear regression over sigma points, y = predicted + h (x - mean) + noise.

    deviations (nx, m, S) of the points from the mean, images (ny, m, S) of the points, which are overwritten;
    covariance (nx, nx, S), r (ny, ny, S or 1). predicted (ny, S) := weighted mean; h (ny, nx, S) := Pyx P^-1; noise
    (ny, ny, S) := R + Pyy - h P h', so that h P h' + noise is the transform's S and P h' its Pxy. Returns how many runs
    failed here (indefinite covariance)."""
    n, m, runs = deviations.shape
    ny = images.shape[0]
    lost, factor, inverse = np.zeros(runs, np.bool_), np.empty((n, n, runs)), np.empty((n, runs))
    cross = np.zeros((n, ny, runs))
    _moments(images, weights[0], predicted, runs)
    for j in range(ny):
        for k in range(j + 1):
            for s in range(runs):
                noise[j, k, s] = r[j, k, 0] if r.shape[2] == 1 else r[j, k, s]
    for a in range(n):
        for j in range(ny):
            for i in range(m):
                w = weights[1, i]
                for s in range(runs):
                    cross[a, j, s] += (w * images[j, i, s]) * deviations[a, i, s]
    _spread(images, weights[1], noise, runs)
    factorise(covariance, factor, inverse, lost, False, runs)
    forward(factor, inverse, cross, runs)
    for j in range(ny):
        for k in range(j + 1):
            for a in range(n):
                for s in range(runs):
                    noise[j, k, s] -= cross[a, j, s] * cross[a, k, s]
            for s in range(runs):
                noise[k, j, s] = noise[j, k, s]
    backward(factor, inverse, cross, runs)
    for j in range(ny):
        for a in range(n):
            for s in range(runs):
                h[j, a, s] = cross[a, j, s]
    for s in range(runs):
        failed[s] |= lost[s]
    return lost.sum()
