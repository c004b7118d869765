"""Kalman recursions over many whole periods in one call, with the design model in machine code (`WholeSteps`).

Step for step the kernels that `predict` and `update` call, so that both give the same bits."""

from __future__ import annotations

import numpy as np

from ...scenarios.compiled import call
from .core import extended_predict, kernel
from .kalman import kalman_update
from .mixing import log_density, mix, moments, weigh


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
def repeat(values, m, out):
    """out (n, m S) := values (n, S), m times."""
    runs = values.shape[1]
    for i in range(values.shape[0]):
        for j in range(m):
            for s in range(runs):
                out[i, j * runs + s] = values[i, s]


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
def walk_modes(f, F, measurement, jacobian, data, q, noise, seconds, transition, u, y, received, variance, mean,
               covariance, weight, failed, lost, means, covariances, likelihoods):
    """The interacting multiple model filter, an extended Kalman filter for each of m modes, which differ in `noise` (m,
    3, ny) alone: mean (nx, m S), covariance (nx, nx, m S), weight (m, S) in place; likelihoods (B, S). The rest as in
    `walk_kalman`."""
    m, runs, nx, ny, bad = weight.shape[0], weight.shape[1], mean.shape[0], y.shape[1], 0
    wide, nothing, moving = m * runs, np.zeros((1, 1)), np.ones(runs, np.bool_)
    inputs, seen, got = np.empty((u.shape[1], wide)), np.empty((ny, wide)), np.empty((ny, wide), np.bool_)
    predicted, h, r = np.empty((ny, wide)), np.empty((ny, nx, wide)), np.zeros((ny, ny, wide))
    residual, spread, heard = np.zeros((ny, wide)), np.zeros((ny, wide)), np.empty(runs, np.bool_)
    for b in range(y.shape[0]):
        mix(transition, weight, moving, mean, covariance)
        repeat(u[b], m, inputs)
        extended_predict(f, F, inputs, seconds, data, q, mean, covariance)
        some = False
        for s in range(runs):
            heard[s] = False
            for j in range(ny):
                heard[s] |= received[b, j, s]
            some |= heard[s]
            likelihoods[b, s] = 0.0
        if some:
            observe(measurement, jacobian, data, mean, nothing, predicted, h)
            for j in range(m):
                noises(variance[b], noise[j], j * runs, r)
            repeat(y[b], m, seen)
            repeat(received[b], m, got)
            bad += kalman_update(mean, covariance, seen, predicted, got, h, r, residual, spread, failed)
            likelihoods[b] = weigh(weight, log_density(residual, spread, received[b]), heard, lost)
        moments(weight, mean, covariance, means[b], covariances[b])
    return bad
