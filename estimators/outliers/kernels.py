"""Compiled scalar updates over a batch of runs: one measurement element at a time, weights and noise per run.

Every loop over runs stands innermost and alone, so that no run's bits depend on its neighbours."""

from __future__ import annotations

import math

import numpy as np

from ..kernels.core import extended_predict, kernel
from ..kernels.walks import copy2, copy3, noises, observe


@kernel
def look(mean, start, covariance, h, y, predicted, received, residual, spread, product):
    """Of one element with row h (nx, S or 1): residual (S,) = y - predicted - h (mean - start), spread (S,) = h P h',
    product (nx, S) = P h'; residual is 0 where it is not received (there y is not used)."""
    n, runs = mean.shape
    shared = h.shape[1] == 1
    for s in range(runs):
        residual[s] = y[s] - predicted[s] if received[s] else 0.0
        spread[s] = 0.0
    for a in range(n):
        for s in range(runs):
            product[a, s] = 0.0
        for b in range(n):
            for s in range(runs):
                product[a, s] += covariance[a, b, s] * (h[b, 0] if shared else h[b, s])
        for s in range(runs):
            weight = h[a, 0] if shared else h[a, s]
            spread[s] += weight * product[a, s]
            residual[s] -= weight * (mean[a, s] - start[a, s]) if received[s] else 0.0


@kernel
def correct(mean, covariance, h, product, residual, variance, noise, weight, received, failed):
    """Take in one element in place: gain K = P h' / variance, mean += weight K residual,
    P := weight J + (1 - weight) P + weight (1 - weight) residual^2 K K', J = (I - K h) P (I - K h)' + K noise K'.

    weight 1 is the Kalman filter in Joseph form, 0 leaves all as it is, between them the moments of the mixture of both
    (Bar-Shalom, probabilistic data association). h (nx, S or 1), product (nx, S) = P h', others (S,). Returns how many
    runs failed (variance not positive)."""
    n, runs = mean.shape
    shared = h.shape[1] == 1
    bad = 0
    use, gain, left, after = np.zeros(runs, np.bool_), np.empty((n, runs)), np.empty((n, runs)), np.empty((n, n, runs))
    joseph, square = np.empty(runs), np.empty(runs)
    for s in range(runs):
        use[s] = received[s] and weight[s] > 0.0
        if use[s] and not variance[s] > 0.0:
            failed[s] = True
            bad += 1
            use[s] = False
    for a in range(n):
        own, lean = gain[a], left[a]
        for s in range(runs):
            own[s] = product[a, s] / variance[s] if use[s] else 0.0
            lean[s] = 0.0
        for b in range(n):
            moved, old, row = after[a, b], covariance[a, b], product[b]
            for s in range(runs):
                moved[s] = old[s] - own[s] * row[s]
            if shared:
                for s in range(runs):
                    lean[s] += moved[s] * h[b, 0]
            else:
                for s in range(runs):
                    lean[s] += moved[s] * h[b, s]
    for a in range(n):
        for s in range(runs):
            mean[a, s] += weight[s] * gain[a, s] * residual[s] if use[s] else 0.0
        for b in range(a + 1):
            old, moved, lean, other, own = covariance[a, b], after[a, b], left[a], gain[b], gain[a]
            for s in range(runs):
                square[s] = own[s] * other[s]
                joseph[s] = moved[s] - lean[s] * other[s] + noise[s] * square[s]
            for s in range(runs):
                w = weight[s]
                mixed = w * joseph[s] + (1.0 - w) * old[s] + w * (1.0 - w) * residual[s] * residual[s] * square[s]
                old[s] = mixed if use[s] else old[s]
            if b < a:
                for s in range(runs):
                    covariance[b, a, s] = covariance[a, b, s]
    return bad


@kernel
def close(outside, received, time, since, element, together, after):
    """Of a gate that opens after a time of rejections: which readings (S,) outside are rejected, all but where those
    of `together` (elements) have been outside for `after` s. since (ny, S) is the time of the first of an element's
    unbroken row of readings outside, and is brought up to time (S or 1,)."""
    rejected, own = np.empty(outside.shape[0], np.bool_), since[element]
    for s in range(outside.shape[0]):
        now, longest = time[0 if time.shape[0] == 1 else s], -np.inf
        for k in range(together.shape[0]):
            longest = max(longest, since[together[k], s])
        rejected[s] = outside[s] and not now - longest >= after
        if received[s]:
            own[s] = min(own[s], now) if outside[s] else np.inf
    return rejected


@kernel
def correntropy(ratio, bandwidth, out):
    """out (S,) := exp(-ratio / (2 bandwidth^2)), ratio (S,) a squared normalised residual."""
    for s in range(out.shape[0]):
        out[s] = math.exp(-0.5 * ratio[s] / (bandwidth * bandwidth))


@kernel
def student(residual, spread, noise, dof, iterations, out):
    """out (S,) := the precision of Student noise by a fixed point of so many iterations from 1 on; residual, spread =
    h P h', noise = R, each (S,)."""
    for s in range(out.shape[0]):
        out[s] = 1.0
        for _ in range(iterations):
            scaled = noise[s] / out[s]
            share = scaled / (spread[s] + scaled)
            square = residual[s] * share
            left = square * square + spread[s] * share
            out[s] = (dof + 1) / (dof + left / noise[s])


@kernel
def association(residual, variance, wide, share, out):
    """out (S,): probability that a reading is a good one: N(residual; 0, variance) against N(residual; 0, wide), of
    which a `share` of all readings is."""
    for s in range(out.shape[0]):
        square = residual[s] * residual[s]
        odds = math.log(share / (1.0 - share)) + 0.5 * (math.log(variance[s] / wide[s]) + square / variance[s]
                                                        - square / wide[s])
        out[s] = 1.0 / (1.0 + math.exp(odds)) if odds < 700.0 else 0.0


@kernel
def walk_elements(f, F, measurement, jacobian, data, q, noise, seconds, u, y, received, variance, times, limit, judged,
                  together, since, after, dof, iterations, mean, covariance, failed, means, covariances, residuals,
                  variances):
    """As `walks.walk_kalman`, element by element: readings of `judged` (ny,) elements whose ratio is above the limit
    are rejected, by a gate that opens after a time (`close`) of rejections of the elements together (ny, ny); times
    (B,), s. With iterations, noise is Student's of so many degrees of freedom."""
    nx, runs, ny, bad = mean.shape[0], mean.shape[1], y.shape[1], 0
    predicted, nothing = np.empty((ny, runs)), np.zeros((1, 1))
    h, r = np.empty((ny, nx, runs)), np.zeros((ny, ny, runs))
    start, product, weight, told = np.empty((nx, runs)), np.empty((nx, runs)), np.empty(runs), np.empty(runs)
    outside, elements, used, total = np.empty(runs, np.bool_), np.arange(ny), np.empty(runs), np.empty(runs)
    for b in range(y.shape[0]):
        extended_predict(f, F, u[b], seconds, data, q, mean, covariance)
        observe(measurement, jacobian, data, mean, nothing, predicted, h)
        noises(variance[b], noise, 0, r)
        for a in range(nx):
            for s in range(runs):
                start[a, s] = mean[a, s]
        for j in range(ny):
            residual, spread, got, own = residuals[b, j], variances[b, j], received[b, j], r[j, j]
            some = False
            for s in range(runs):
                some |= got[s]
            if not some:
                continue
            look(mean, start, covariance, h[j], y[b, j], predicted[j], got, residual, spread, product)
            if iterations:
                student(residual, spread, own, dof, iterations, weight)
                for s in range(runs):
                    used[s] = own[s] / weight[s]
            else:
                for s in range(runs):
                    used[s] = own[s]
            for s in range(runs):
                weight[s], told[s], total[s] = 1.0, spread[s] + own[s], spread[s] + used[s]
            if judged[j]:
                for s in range(runs):
                    outside[s] = residual[s] * residual[s] / told[s] > limit
                rejected = close(outside, got, times[b:b + 1], since, j, elements[together[j]], after)
                for s in range(runs):
                    weight[s] = 0.0 if rejected[s] else 1.0
            bad += correct(mean, covariance, h[j], product, residual, total, used, weight, got, failed)
            for s in range(runs):
                spread[s] = told[s]
        copy2(mean, means[b])
        copy3(covariance, covariances[b])
    return bad
