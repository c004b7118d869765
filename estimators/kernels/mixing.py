"""Compiled interaction of a bank of filters, runs innermost: mixed priors, weights, and the moments over the modes.

Mode j of run s is column j S + s of means (n, m S) and covariances (n, n, m S)."""

from __future__ import annotations

import numpy as np

from .core import kernel

LOG_2PI = float(np.log(2 * np.pi))


@kernel
def mix(transition, weight, moving, mean, covariance):
    """Interaction in place: mean, covariance become the mixed priors of each mode, weight (m, S) its prior.

    transition (m, m, S or 1); moving (S,): the other runs stay to the bit."""
    m, runs = weight.shape
    n = mean.shape[0]
    shared = transition.shape[2] == 1
    offset, spread = np.empty((m, n, runs)), np.empty((m, n, n, runs))
    share, shift, total, value = np.empty((m, runs)), np.empty((n, runs)), np.empty((m, runs)), np.empty(runs)
    for j in range(m):
        for a in range(n):
            for s in range(runs):
                offset[j, a, s] = mean[a, j * runs + s] - mean[a, s]
        for a in range(n):
            for b in range(a + 1):
                for s in range(runs):
                    spread[j, a, b, s] = covariance[a, b, j * runs + s] + offset[j, a, s] * offset[j, b, s]
    base = mean[:, :runs].copy()
    for j in range(m):
        for s in range(runs):
            total[j, s] = 0.0
        for i in range(m):
            for s in range(runs):
                share[i, s] = (transition[i, j, 0] if shared else transition[i, j, s]) * weight[i, s]
                total[j, s] += share[i, s]
        for i in range(m):
            for s in range(runs):
                # no way into this mode: it keeps its own state and has no weight
                share[i, s] = share[i, s] / total[j, s] if total[j, s] > 0.0 else (1.0 if i == j else 0.0)
        for a in range(n):
            for s in range(runs):
                shift[a, s] = 0.0
            for i in range(m):
                for s in range(runs):
                    shift[a, s] += share[i, s] * offset[i, a, s]
            for s in range(runs):
                if moving[s]:
                    mean[a, j * runs + s] = base[a, s] + shift[a, s]
        for a in range(n):
            for b in range(a + 1):
                for s in range(runs):
                    value[s] = 0.0
                for i in range(m):
                    part, of = share[i], spread[i, a, b]
                    for s in range(runs):
                        value[s] += part[s] * of[s]
                lower, upper = covariance[a, b, j * runs:(j + 1) * runs], covariance[b, a, j * runs:(j + 1) * runs]
                for s in range(runs):
                    mixed = value[s] - shift[a, s] * shift[b, s]
                    lower[s] = mixed if moving[s] else lower[s]
                for s in range(runs):
                    upper[s] = lower[s]
    for j in range(m):
        for s in range(runs):
            if moving[s]:
                weight[j, s] = total[j, s]


@kernel
def log_density(residual, variance, received):
    """Sum over the received elements of log N(residual; 0, variance), all (ny, m S), received (ny, S). Returns (m S,).

    Scalar logarithms: those of whole arrays may differ in the last digit with the place in the array."""
    runs = received.shape[1]
    out = np.zeros(residual.shape[1])
    for i in range(residual.shape[0]):
        for c in range(residual.shape[1]):
            if received[i, c % runs]:
                e, v = residual[i, c], variance[i, c]
                out[c] -= 0.5 * (e * e / v + np.log(v) + LOG_2PI)
    return out


@kernel
def powers(values, exponents):
    """values (m,) to the powers exponents (S,), (m, S), each by itself."""
    out = np.empty((len(values), len(exponents)))
    for i in range(len(values)):
        for s in range(len(exponents)):
            out[i, s] = values[i] ** exponents[s]
    return out


@kernel
def weigh(weight, loglik, heard, lost):
    """weight (m, S) times exp(loglik (m S,)), normalised, in place. Returns the log-likelihood of the mixture (S,).

    Runs that heard (S,) nothing stay to the bit. lost (S,) is set where no mode is possible any more; a mode whose
    log-likelihood is NaN is not."""
    m, runs = weight.shape
    out = np.zeros(runs)
    for s in range(runs):
        if not heard[s]:
            continue
        top = -np.inf
        for j in range(m):
            value = loglik[j * runs + s]
            if weight[j, s] > 0.0 and value > top:
                top = value
        total = 0.0
        if top > -np.inf:
            for j in range(m):
                value = loglik[j * runs + s]
                weight[j, s] *= np.exp(value - top) if value == value else 0.0
                total += weight[j, s]
        if not total > 0.0:
            lost[s] = True
            out[s] = np.nan
            for j in range(m):
                weight[j, s] = np.nan
            continue
        for j in range(m):
            weight[j, s] /= total
        out[s] = np.log(total) + top
    return out


@kernel
def moments(weight, mean, covariance, mean_out, covariance_out):
    """Mean (n, S) and covariance (n, n, S) of the mixture. A mode of no weight counts nothing, whatever its numbers."""
    m, runs = weight.shape
    n = mean.shape[0]
    off, value = np.empty((m, n, runs)), np.empty(runs)
    for a in range(n):
        first = mean[a, :runs]
        for s in range(runs):
            value[s] = 0.0
        for j in range(m):
            part, own = weight[j], mean[a, j * runs:(j + 1) * runs]
            for s in range(runs):
                value[s] += part[s] * (own[s] - first[s]) if part[s] != 0.0 else 0.0
        for s in range(runs):
            mean_out[a, s] = first[s] + value[s]
        for j in range(m):
            own = mean[a, j * runs:(j + 1) * runs]
            for s in range(runs):
                off[j, a, s] = own[s] - mean_out[a, s]
    for a in range(n):
        for b in range(a + 1):
            for s in range(runs):
                value[s] = 0.0
            for j in range(m):
                part, own, left, right = weight[j], covariance[a, b, j * runs:(j + 1) * runs], off[j, a], off[j, b]
                for s in range(runs):
                    value[s] += part[s] * (own[s] + left[s] * right[s]) if part[s] != 0.0 else 0.0
            for s in range(runs):
                covariance_out[a, b, s] = covariance_out[b, a, s] = value[s]
