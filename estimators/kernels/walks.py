"""Kalman recursions over many whole periods in one call, with the design model in machine code (`WholeSteps`).

Step for step the kernels that `predict` and `update` call, so that both give the same bits."""

from __future__ import annotations

import numpy as np

from ...scenarios.compiled import accumulate, call
from .core import apply, extended_predict, inner, kernel, predict
from .kalman import any_update, uncorrelated_update
from .unscented import linearised, sigma_points, unscented_predict


@inner
def copy2(source, out):
    """out (n, S) := source."""
    for i in range(source.shape[0]):
        row, to = source[i], out[i]
        for s in range(row.shape[0]):
            to[s] = row[s]


@inner
def copy3(source, out):
    """out (n, m, S) := source."""
    for i in range(source.shape[0]):
        copy2(source[i], out[i])


@inner
def times(matrix, x, out):
    """out (m, S) := matrix (m, n) times x (n, S), as `model.product`."""
    for i in range(out.shape[0]):
        for s in range(out.shape[1]):
            out[i, s] = 0.0
    accumulate(matrix, x, out)


@inner
def observe(measurement, jacobian, data, x, nothing, predicted, h):
    """predicted (ny, S) = h(x), h (ny, nx, S) = dh/dx; nothing: what stands for inputs and lengths."""
    runs = x.shape[1]
    call(measurement, x, nothing, nothing[0], data, 1, runs, runs, predicted)
    call(jacobian, x, nothing, nothing[0], data, 1, runs, runs, h)


@inner
def noises(variance, noise, first, r):
    """Diagonal of r (ny, ny, S or more), from run `first` on := R by what sensors tell, variance (ny, S); noise (3, ny)
    as in `WholeSteps`."""
    for j in range(variance.shape[0]):
        own, factor, fixed, said, out = noise[0, j], noise[1, j], noise[2, j], variance[j], r[j, j]
        for s in range(said.shape[0]):
            told = factor * (said[s] if said[s] == said[s] else own)
            out[first + s] = fixed if fixed == fixed else told


@kernel
def walk_kalman(f, F, measurement, jacobian, data, q, noise, seconds, u, y, received, variance, mean, covariance,
                failed, means, covariances, residuals, variances):
    """The extended Kalman filter: mean (nx, S), covariance (nx, nx, S) in place; u, y, received, variance (B, .., S) as
    in `Course`; means, covariances, residuals, variances (B, .., S) come out. Returns how many runs failed."""
    nx, runs, ny, bad = mean.shape[0], mean.shape[1], y.shape[1], 0
    predicted, nothing = np.empty((ny, runs)), np.zeros((1, 1))
    h, r = np.empty((ny, nx, runs)), np.zeros((ny, ny, runs))
    for b in range(y.shape[0]):
        extended_predict(f, F, u[b], seconds, data, q, mean, covariance)
        observe(measurement, jacobian, data, mean, nothing, predicted, h)
        noises(variance[b], noise, 0, r)
        bad += uncorrelated_update(mean, covariance, y[b], predicted, received[b], h, r, residuals[b], variances[b],
                                   failed)
        copy2(mean, means[b])
        copy3(covariance, covariances[b])
    return bad


@kernel
def walk_linear(f, data, F, q, H, r, seconds, u, y, received, early, mean, covariance, failed, means, covariances,
                residuals, variances):
    """The Kalman filter of a linear model, `LinearSteps`: see `walk_kalman`. early: means, covariances are those before
    the measurements."""
    predicted, C, bad = np.empty((y.shape[1], y.shape[2])), H.reshape(H.shape[0], H.shape[1]), 0
    for b in range(y.shape[0]):
        predict(f, u[b], seconds, data, F, q, mean, covariance)
        if early:
            copy2(mean, means[b])
            copy3(covariance, covariances[b])
        times(C, mean, predicted)
        bad += uncorrelated_update(mean, covariance, y[b], predicted, received[b], H, r, residuals[b], variances[b],
                                   failed)
        if not early:
            copy2(mean, means[b])
            copy3(covariance, covariances[b])
    return bad


@kernel
def walk_gain(A, B, h, C, gain, u, y, received, early, mean, means):
    """A constant gain (nx, ny, 1): mean (nx, S) in place, means (B, nx, S) come out. A, B, C (.., 1), h (nx, 1)."""
    (nx, runs), ny = mean.shape, y.shape[1]
    moved, driven, left = np.empty((nx, runs)), np.empty((nx, runs)), np.empty((ny, runs))
    for b in range(y.shape[0]):
        apply(A, mean, moved)
        apply(B, u[b], driven)
        for i in range(nx):
            for s in range(runs):
                mean[i, s] = (moved[i, s] + driven[i, s]) + h[i, 0]
        if early:
            copy2(mean, means[b])
        apply(C, mean, left)
        for j in range(ny):
            for s in range(runs):
                left[j, s] = y[b, j, s] - left[j, s] if received[b, j, s] else 0.0
        apply(gain, left, moved)
        for i in range(nx):
            for s in range(runs):
                mean[i, s] += moved[i, s]
        if not early:
            copy2(mean, means[b])


@kernel
def walk_held(inverse, y, received, held, mean, means):
    """The last measurements received, held (ny, S), as states, mean (nx, S): both in place, means (B, nx, S) out."""
    found = np.empty(mean.shape)
    for b in range(y.shape[0]):
        for j in range(y.shape[1]):
            for s in range(y.shape[2]):
                held[j, s] = y[b, j, s] if received[b, j, s] else held[j, s]
        times(inverse, held, found)
        for s in range(y.shape[2]):
            some = False
            for j in range(y.shape[1]):
                some |= received[b, j, s]
            if some:
                for i in range(mean.shape[0]):
                    mean[i, s] = found[i, s]
        copy2(mean, means[b])


@kernel
def walk_points(f, measurement, data, q, noise, seconds, weights, scale, u, y, received, variance, mean, covariance,
                failed, means, covariances, residuals, variances):
    """A sigma-point filter that draws its points anew for each measurement: see `walk_kalman`. Returns how many runs
    failed in prediction or update."""
    nx, runs, ny, m, bad = mean.shape[0], mean.shape[1], y.shape[1], weights.shape[1], 0
    predicted, h, told = np.empty((ny, runs)), np.empty((ny, nx, runs)), np.empty((ny, ny, runs))
    r, images = np.zeros((ny, ny, runs)), np.empty((ny, m, runs))
    points, off = np.empty((nx, m, runs)), np.empty((nx, m, runs))
    everyone, none, nothing = np.arange(runs), np.empty((nx, 0, 0)), np.zeros((1, 1))
    for b in range(y.shape[0]):
        bad += unscented_predict(f, u[b], seconds, data, everyone, weights, scale, q, mean, covariance, none, failed)
        noises(variance[b], noise, 0, r)
        bad += sigma_points(mean, covariance, scale, points, off, failed)
        call(measurement, points, nothing, nothing[0], data, m, runs, runs, images)
        bad += linearised(off, images, weights, covariance, r, predicted, h, told, failed)
        bad += any_update(mean, covariance, y[b], predicted, received[b], h, told, residuals[b], variances[b], failed)
        copy2(mean, means[b])
        copy3(covariance, covariances[b])
    return bad
