"""Kalman recursions over many whole periods in one call, with the design model in machine code (`WholeSteps`).

Step for step the kernels that `predict` and `update` call, so that both give the same bits."""

from __future__ import annotations

import numpy as np

from ...scenarios.compiled import call
from .core import extended_predict, kernel
from .kalman import kalman_update
from .unscented import linearised, sigma_points, unscented_predict


@kernel
def observe(measurement, jacobian, data, x, nothing, predicted, h):
    """predicted (ny, S) = h(x), h (ny, nx, S) = dh/dx; nothing: what stands for inputs and lengths."""
    runs = x.shape[1]
    call(measurement, x, nothing, nothing[0], data, 1, runs, runs, predicted)
    call(jacobian, x, nothing, nothing[0], data, 1, runs, runs, h)


@kernel
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
        bad += kalman_update(mean, covariance, y[b], predicted, received[b], h, r, residuals[b], variances[b], failed)
        means[b], covariances[b] = mean, covariance
    return bad


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
        bad += kalman_update(mean, covariance, y[b], predicted, received[b], h, told, residuals[b], variances[b],
                             failed)
        means[b], covariances[b] = mean, covariance
    return bad
