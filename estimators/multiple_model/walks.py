"""The interacting multiple model filter over many whole periods in one call, with the design model in machine code.

Step for step the kernels that `predict` and `update` call, so that both give the same bits."""

from __future__ import annotations

import numpy as np

from ..kernels.core import extended_predict, inner, kernel
from ..kernels.kalman import uncorrelated_update
from ..kernels.mixing import log_density, mix, moments, weigh
from ..kernels.walks import noises, observe
from ..outliers.kernels import close, look


@inner
def repeat(values, m, out):
    """out (n, m S) := values (n, S), m times."""
    runs = values.shape[1]
    for i in range(values.shape[0]):
        for j in range(m):
            for s in range(runs):
                out[i, j * runs + s] = values[i, s]


@kernel
def walk_modes(f, F, measurement, jacobian, data, q, noise, seconds, transition, u, y, received, variance, mean,
               covariance, weight, failed, lost, times, own, limit, judged, since, after, means, covariances,
               likelihoods):
    """The interacting multiple model filter, an extended Kalman filter for each of m modes, which differ in `noise` (m,
    3, ny) alone: mean (nx, m S), covariance (nx, nx, m S), weight (m, S) in place; likelihoods (B, S), NaN where
    nobody heard anything. The rest as in `walk_kalman`.

    Readings of `judged` (ny,) elements whose ratio by the moments of all modes and the noise `own` (3, ny) is above the
    limit are rejected by a gate that opens `after` so many s, see `close`; since (ny, S), times (B,) s."""
    m, runs, nx, ny = weight.shape[0], weight.shape[1], mean.shape[0], y.shape[1]
    wide, nothing, moving = m * runs, np.zeros((1, 1)), np.ones(runs, np.bool_)
    inputs, seen, got = np.empty((u.shape[1], wide)), np.empty((ny, wide)), np.empty((ny, wide), np.bool_)
    predicted, h, r = np.empty((ny, wide)), np.empty((ny, nx, wide)), np.zeros((ny, ny, wide))
    residual, spread, heard = np.zeros((ny, wide)), np.zeros((ny, wide)), np.empty(runs, np.bool_)
    accepted, elements, outside = np.empty((ny, runs), np.bool_), np.arange(ny), np.empty(runs, np.bool_)
    guess, rows, worth = np.empty((ny, runs)), np.empty((ny, nx, runs)), np.zeros((ny, ny, runs))
    off, wideness, product = np.empty(runs), np.empty(runs), np.empty((nx, runs))
    for b in range(y.shape[0]):
        mix(transition, weight, moving, mean, covariance)
        repeat(u[b], m, inputs)
        extended_predict(f, F, inputs, seconds, data, q, mean, covariance)
        some = False
        for j in range(ny):
            for s in range(runs):
                accepted[j, s] = received[b, j, s]
                some |= judged[j] and received[b, j, s]
        if some:
            there, claim = means[b], covariances[b]
            moments(weight, mean, covariance, there, claim)
            observe(measurement, jacobian, data, there, nothing, guess, rows)
            noises(variance[b], own, 0, worth)
            for j in range(ny):
                if judged[j]:
                    look(there, there, claim, rows[j], y[b, j], guess[j], received[b, j], off, wideness, product)
                    for s in range(runs):
                        outside[s] = off[s] * off[s] / (wideness[s] + worth[j, j, s]) > limit
                    rejected = close(outside, received[b, j], times[b:b + 1], since, j, elements[j:j + 1], after)
                    for s in range(runs):
                        accepted[j, s] &= not rejected[s]
        some = False
        for s in range(runs):
            heard[s] = False
            for j in range(ny):
                heard[s] |= accepted[j, s]
            some |= heard[s]
            likelihoods[b, s] = np.nan
        if some:
            observe(measurement, jacobian, data, mean, nothing, predicted, h)
            for j in range(m):
                noises(variance[b], noise[j], j * runs, r)
            repeat(y[b], m, seen)
            repeat(accepted, m, got)
            uncorrelated_update(mean, covariance, seen, predicted, got, h, r, residual, spread, failed)
            likelihoods[b] = weigh(weight, log_density(residual, spread, accepted), heard, lost)
        moments(weight, mean, covariance, means[b], covariances[b])
