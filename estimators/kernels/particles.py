"""Compiled steps of a particle filter, one run at a time: a run's particles stay in the first cache for all of a step.

Particles (S, nx, N), logarithms of weights and weights (S, N). Sums are in eight lanes, the same for any batch."""

from __future__ import annotations

import numpy as np

from ...scenarios.compiled import call
from ...scenarios.normals import normals, uniform
from .core import HALF_LOG_TURN, inner, kernel
from .modes import exponentials, greatest


@inner
def dot(a, b):
    """Sum of a_i b_i."""
    t0, t1, t2, t3, t4, t5, t6, t7 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    whole = len(a) // 8 * 8
    for i in range(0, whole, 8):
        t0 += a[i] * b[i]
        t1 += a[i + 1] * b[i + 1]
        t2 += a[i + 2] * b[i + 2]
        t3 += a[i + 3] * b[i + 3]
        t4 += a[i + 4] * b[i + 4]
        t5 += a[i + 5] * b[i + 5]
        t6 += a[i + 6] * b[i + 6]
        t7 += a[i + 7] * b[i + 7]
    total = ((t0 + t4) + (t1 + t5)) + ((t2 + t6) + (t3 + t7))
    for i in range(whole, len(a)):
        total += a[i] * b[i]
    return total


@inner
def _moments(x, w, work, mean, covariance, s):
    """Weighted mean and covariance of run s from its particles x (nx, N), weights w (N,). work (nx + 1, N)."""
    nx, count = x.shape
    scaled = work[nx]
    for a in range(nx):
        mean[a, s] = dot(x[a], w)
        row, off, middle = x[a], work[a], mean[a, s]
        for i in range(count):
            off[i] = row[i] - middle
    for a in range(nx):
        off = work[a]
        for i in range(count):
            scaled[i] = w[i] * off[i]
        for b in range(a + 1):
            covariance[a, b, s] = covariance[b, a, s] = dot(scaled, work[b])


@kernel
def advance(model, u, seconds, data, particles, weights, factor, key, runs, draws, which, mean, covariance):
    """Particles of the runs `which` (S,) through the model (`compiled.SIGNATURE`; 0: they have been moved), plus normal
    noise with the Cholesky factor (nx, nx, S), and their moments.

    key, runs, draws: of `RunRandom.counted`."""
    _, nx, count = particles.shape
    moved, work, noise = np.empty((nx, count)), np.empty((nx + 1, count)), np.empty((nx * count + 1) // 2 * 2)
    inputs, times = np.empty((u.shape[0], count)), np.empty(count)
    for s in range(len(runs)):
        if not which[s]:
            continue
        x = particles[s]
        normals(key, draws[s], runs[s], noise)
        source = x
        if model != 0:
            for l in range(u.shape[0]):
                for i in range(count):
                    inputs[l, i] = u[l, s]
            for i in range(count):
                times[i] = seconds[s]
            call(model, x, inputs, times, data, 1, count, count, moved)
            source = moved
        for a in range(nx):
            row, start = x[a], source[a]
            for i in range(count):
                row[i] = start[i]
            for b in range(a + 1):
                f, z = factor[a, b, s], noise[b * count:(b + 1) * count]
                for i in range(count):
                    row[i] += f * z[i]
        _moments(x, weights[s], work, mean, covariance, s)


@inner
def _whitened(r, received, inverse, factor, s):
    """Cholesky factor (ny, ny) of run s's R over its received elements, and one over its diagonal (ny,); whether there
    is one."""
    ny, at = r.shape[0], s if r.shape[2] > 1 else 0
    good = True
    for a in range(ny):
        for b in range(a + 1):
            both = received[a, s] and received[b, s]
            total = r[a, b, at] if both else (1.0 if a == b else 0.0)
            for l in range(b):
                total -= factor[a, l] * factor[b, l]
            if a > b:
                factor[a, b] = total * inverse[b]
            else:
                good &= total > 0.0
                factor[a, a] = np.sqrt(total)
                inverse[a] = 1.0 / factor[a, a]
    return good


@kernel
def take(images, predicted, h, y, received, r, key, runs, draws, share, particles, logs, weights, mean, covariance,
         log_likelihood, degenerate, failed):
    """Weigh each run that received something, take its moments, and resample it (systematically, particle i of the new
    set where the summed weights pass (i + offset) / N) where 1 / sum w^2 is under `share` of N.

    images (S, ny, N): measurements of the particles, overwritten; empty: they are predicted + h (x - mean), predicted
    (ny, S), h (ny, nx, S or 1). logs are kept so that a run's greatest is 0. log_likelihood (S,) := log sum_i w_i
    N(y; h(x_i), R) with the weights from before, 0 where nothing was received; degenerate (S,) += 1 where 1 / sum w^2
    is under nx + 1. failed (S,) is set, and the run NaN, where no particle's likelihood is finite. Returns how many."""
    _, nx, count = particles.shape
    ny, linear = y.shape[0], images.shape[0] == 0
    own, work, chosen = np.empty((ny, count)), np.empty((nx + 1, count)), np.empty(count, np.int64)
    inverse, factor, bad = np.empty(ny), np.empty((ny, ny)), 0
    for s in range(len(runs)):
        log_likelihood[s] = 0.0
        some = False
        for j in range(ny):
            some |= received[j, s]
        if not some:
            continue
        x, log, w, rows = particles[s], logs[s], weights[s], own if linear else images[s]
        good = _whitened(r, received, inverse, factor, s)
        constant = np.log(max(greatest(w, len(w)), 0.0))
        for j in range(ny):
            if not received[j, s]:
                continue
            constant += np.log(inverse[j]) - HALF_LOG_TURN
            row = rows[j]
            if linear:
                for i in range(count):
                    row[i] = y[j, s] - predicted[j, s]
                for a in range(nx):
                    weight, state, middle = h[j, a, s if h.shape[2] > 1 else 0], x[a], mean[a, s]
                    if weight != 0.0:
                        for i in range(count):
                            row[i] -= weight * (state[i] - middle)
            else:
                for i in range(count):
                    row[i] = y[j, s] - row[i]
            for l in range(j):
                if factor[j, l] != 0.0:
                    other, weight = rows[l], factor[j, l]
                    for i in range(count):
                        row[i] -= weight * other[i]
            for i in range(count):
                row[i] *= inverse[j]
                log[i] -= 0.5 * row[i] * row[i]
        top = greatest(log, len(log)) if good else -np.inf
        if top == -np.inf:
            failed[s] = True
            bad += 1
            for i in range(count):
                log[i], w[i] = -np.inf, np.nan
            log_likelihood[s] = np.nan
            _moments(x, w, work, mean, covariance, s)
            continue
        exponentials(log, count, top, w)
        ones = work[nx]
        for i in range(count):
            ones[i] = 1.0
            log[i] -= top
        total = dot(w, ones)
        for i in range(count):
            w[i] /= total
        log_likelihood[s] = top + np.log(total) + constant
        squares = dot(w, w)
        degenerate[s] += squares * (nx + 1) > 1.0
        _moments(x, w, work, mean, covariance, s)
        if share * count * squares > 1.0:
            _resample(x, log, w, uniform(key, draws[s], runs[s]), chosen, work)
    return bad


@inner
def _resample(x, log, w, offset, chosen, work):
    """Systematic resampling of one run's particles x (nx, N) in place. chosen (N,), work (>= 1, N): for scratch."""
    nx, count = x.shape
    source, passed = 0, w[0]
    for i in range(count):
        while passed < (i + offset) / count and source < count - 1:
            source += 1
            passed += w[source]
        chosen[i] = source
    old = work[0]
    for a in range(nx):
        row = x[a]
        for i in range(count):
            old[i] = row[i]
        for i in range(count):
            row[i] = old[chosen[i]]
    for i in range(count):
        log[i] = 0.0
        w[i] = 1.0 / count
