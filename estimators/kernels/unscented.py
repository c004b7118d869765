"""Compiled unscented transforms over a batch of runs: sigma points, their moments, the measurement update.

Unscented and cubature filters differ in the weights alone. Tiles and masks as in the Kalman kernels."""

from __future__ import annotations

import numpy as np

from .core import backward, factorise, forward, gather2, gather3, kernel, scatter2, scatter3, tile_width
from .kalman import innovate, receivers


@kernel
def _moments(values, weights, mean, width):
    """mean (n, width) := weighted mean of values (n, m, width), which become deviations from it."""
    for a in range(values.shape[0]):
        for s in range(width):
            mean[a, s] = 0.0
        for i in range(values.shape[1]):
            w = weights[i]
            for s in range(width):
                mean[a, s] += w * values[a, i, s]
        for i in range(values.shape[1]):
            for s in range(width):
                values[a, i, s] -= mean[a, s]


@kernel
def _spread(deviations, weights, out, width):
    """Add the weighted sum of the outer products of deviations (n, m, width) to out's lower triangle (n, n, width),
    and mirror it."""
    for a in range(deviations.shape[0]):
        for b in range(a + 1):
            for i in range(deviations.shape[1]):
                w = weights[i]
                for s in range(width):
                    out[a, b, s] += (w * deviations[a, i, s]) * deviations[b, i, s]
            if b < a:
                for s in range(width):
                    out[b, a, s] = out[a, b, s]


@kernel
def _draw(mean, covariance, scale, points, deviations, failed, width):
    """Sigma points mean +- scale L_i (n, m, width), L the Cholesky factor of covariance; m = 2 n, or 2 n + 1 with the
    mean first. deviations: the same without the mean, exactly symmetric."""
    n, m = points.shape[0], points.shape[1]
    factor, inverse = np.empty((n, n, width)), np.empty((n, width))
    factorise(covariance, factor, inverse, failed, False, width)
    for s in range(width):
        if failed[s]:
            factor[:, :, s] = np.nan
    centre = m - 2 * n
    for a in range(n):
        if centre:
            for s in range(width):
                points[a, 0, s] = mean[a, s]
                deviations[a, 0, s] = 0.0
        for i in range(n):
            plus, minus = centre + i, centre + n + i
            for s in range(width):
                deviations[a, plus, s] = scale * factor[a, i, s]
            for s in range(width):
                deviations[a, minus, s] = -deviations[a, plus, s]
            for s in range(width):
                points[a, plus, s] = mean[a, s] + deviations[a, plus, s]
            for s in range(width):
                points[a, minus, s] = mean[a, s] - deviations[a, plus, s]


@kernel
def sigma_points(mean, covariance, scale, points, deviations, failed):
    """Draw points and deviations (nx, m, S), see `_draw`, for all runs. failed (S,) is set, and the run's points NaN,
    where the covariance (nx, nx, S) is indefinite. Returns how many runs failed here."""
    lost = np.zeros(len(failed), np.bool_)
    _draw(mean, covariance, scale, points, deviations, lost, len(failed))
    for s in range(len(failed)):
        failed[s] |= lost[s]
    return lost.sum()


@kernel
def unscented_predict(moved, index, weights_mean, weights_covariance, q, scale, redraw, mean, covariance, points,
                      deviations, failed):
    """Moments of the propagated sigma points, and fresh points for them. Returns how many runs failed here.

    index: the runs to predict; the others are not touched. moved (nx, m, S): transition of the points. mean (nx, S) and
    covariance (nx, nx, S) := their weighted moments plus q (nx, nx, S or 1). redraw: points and deviations (nx, m, S)
    are drawn anew from them; otherwise points are left alone and deviations are those of `moved`."""
    n, m, runs = moved.shape[0], moved.shape[1], len(index)
    wide = max(1, tile_width(n, runs))
    x, p = np.empty((n, wide)), np.empty((n, n, wide))
    noise = np.empty((n, n, 1 if q.shape[2] == 1 else wide))
    cloud, fresh = np.empty((n, m, wide)), np.empty((n, m, wide))
    bad = 0
    for first in range(0, runs, wide):
        width = min(wide, runs - first)
        part = index[first:first + width]
        gather3(moved, part, width, cloud)
        gather3(q, part, width, noise)
        _moments(cloud, weights_mean, x, width)
        for a in range(n):
            for b in range(n):
                for s in range(width):
                    p[a, b, s] = noise[a, b, 0] if noise.shape[2] == 1 else noise[a, b, s]
        _spread(cloud, weights_covariance, p, width)
        if redraw:
            lost = np.zeros(width, np.bool_)
            _draw(x, p, scale, fresh, cloud, lost, width)
            scatter3(fresh, part, width, points)
            for s in range(width):
                failed[part[s]] |= lost[s]
                bad += lost[s]
        scatter2(x, part, width, mean)
        scatter3(p, part, width, covariance)
        scatter3(cloud, part, width, deviations)
    return bad


@kernel
def unscented_update(mean, covariance, points, deviations, images, weights_mean, weights_covariance, scale, y, received,
                     r, extra, residual, variance, failed):
    """Unscented update in place of the runs that received something, and fresh points. Returns how many runs failed.

    images (ny, m, S): measurement of the points; deviations (nx, m, S): of the points from the mean; r (ny, ny, S or
    1), diagonal or not; extra (nx, nx, S or 1): the part of the covariance that the points do not spread (zero where
    they were redrawn). residual, variance (ny, S): the innovation of each element received, in turn. K = Pxy S^-1 over
    the elements received; the covariance is the Joseph form of the transform,
    sum w (dx - K dy)(dx - K dy)' + extra + K r K', positive semidefinite for weights that are not negative."""
    n, m, ny = points.shape[0], points.shape[1], images.shape[0]
    index = receivers(received)
    wide = max(1, tile_width(n, len(index)))
    x, p, innovation = np.empty((n, wide)), np.empty((n, n, wide)), np.empty((ny, wide))
    measured, guess, got = np.empty((ny, wide)), np.empty((ny, wide)), np.empty((ny, wide), np.bool_)
    cloud, image, fresh = np.empty((n, m, wide)), np.empty((ny, m, wide)), np.empty((n, m, wide))
    spread, factor, inverse = np.empty((ny, ny, wide)), np.empty((ny, ny, wide)), np.empty((ny, wide))
    gain, noise = np.empty((ny, n, wide)), np.empty((n, n, 1 if extra.shape[2] == 1 else wide))
    sensed, turn = np.empty((ny, ny, 1 if r.shape[2] == 1 else wide)), np.empty((ny, 1, wide))
    bad = 0
    for first in range(0, len(index), wide):
        width = min(wide, len(index) - first)
        part = index[first:first + width]
        gather2(mean, part, width, x)
        gather2(y, part, width, measured)
        gather2(received, part, width, got)
        gather3(deviations, part, width, cloud)
        gather3(images, part, width, image)
        gather3(extra, part, width, noise)
        gather3(r, part, width, sensed)
        lost = np.zeros(width, np.bool_)
        _moments(image, weights_mean, guess, width)
        innovate(measured, guess, got, innovation, width)
        _mask_images(image, got, sensed, spread, width)
        _spread(image, weights_covariance, spread, width)
        factorise(spread, factor, inverse, lost, True, width)
        _cross(image, cloud, weights_covariance, gain, width)
        forward(factor, inverse, gain, width)
        backward(factor, inverse, gain, width)
        for j in range(ny):
            for s in range(width):
                turn[j, 0, s] = innovation[j, s]
        forward(factor, inverse, turn, width)
        for j in range(ny):
            for s in range(width):
                turn[j, 0, s] /= inverse[j, s]
                guess[j, s] = 1.0 / (inverse[j, s] * inverse[j, s])
        scatter2(turn[:, 0], part, width, residual)
        scatter2(guess, part, width, variance)
        _correct(x, cloud, p, gain, innovation, image, sensed, noise, width)
        _spread(cloud, weights_covariance, p, width)
        for a in range(n):
            for s in range(width):
                if lost[s]:
                    x[a, s] = np.nan
        _draw(x, p, scale, fresh, cloud, lost, width)
        scatter2(x, part, width, mean)
        scatter3(p, part, width, covariance)
        scatter3(cloud, part, width, deviations)
        scatter3(fresh, part, width, points)
        for s in range(width):
            failed[part[s]] |= lost[s]
            bad += lost[s]
    return bad


@kernel
def _mask_images(image, received, r, spread, width):
    """Zero the deviations image (ny, m, width) of elements not received; spread (ny, ny, width) := r (ny, ny, width or
    1) over the received elements, 1 on the diagonal of the others, which so get no gain."""
    for j in range(image.shape[0]):
        for i in range(image.shape[1]):
            for s in range(width):
                image[j, i, s] = image[j, i, s] if received[j, s] else 0.0
        for k in range(image.shape[0]):
            for s in range(width):
                value = r[j, k, 0] if r.shape[2] == 1 else r[j, k, s]
                spread[j, k, s] = value if received[j, s] and received[k, s] else (1.0 if j == k else 0.0)


@kernel
def _cross(image, cloud, weights, out, width):
    """out (ny, n, width) := weighted sum of the outer products of image (ny, m, width) and cloud (n, m, width)."""
    for j in range(image.shape[0]):
        for a in range(cloud.shape[0]):
            for s in range(width):
                out[j, a, s] = 0.0
            for i in range(image.shape[1]):
                w = weights[i]
                for s in range(width):
                    out[j, a, s] += (w * image[j, i, s]) * cloud[a, i, s]


@kernel
def _correct(mean, cloud, covariance, gain, innovation, image, r, extra, width):
    """mean += K innovation; cloud := dx - K dy; covariance's lower triangle := extra + K r K'. gain (ny, n, width)."""
    n, ny = mean.shape[0], image.shape[0]
    for a in range(n):
        for j in range(ny):
            for s in range(width):
                mean[a, s] += gain[j, a, s] * innovation[j, s]
            for i in range(image.shape[1]):
                for s in range(width):
                    cloud[a, i, s] -= gain[j, a, s] * image[j, i, s]
        for b in range(a + 1):
            for s in range(width):
                covariance[a, b, s] = extra[a, b, 0] if extra.shape[2] == 1 else extra[a, b, s]
            for j in range(ny):
                for k in range(ny):
                    weight = r[j, k, 0]
                    if r.shape[2] > 1:
                        for s in range(width):
                            covariance[a, b, s] += (r[j, k, s] * gain[j, a, s]) * gain[k, b, s]
                    elif weight != 0.0:
                        for s in range(width):
                            covariance[a, b, s] += (weight * gain[j, a, s]) * gain[k, b, s]
