"""Compiled steps back in time over a batch of runs: cross-covariances of neighbouring events, the smoother's gain.

A run at a time, sums in a fixed order: no run's bits depend on its company."""

from __future__ import annotations

import numpy as np

from ..kernels.core import kernel

NEGLIGIBLE = 1e-14
"""A pivot of a predicted covariance below this share of its diagonal: known exactly, and revised by nothing."""


@kernel
def linear_cross(covariance, jacobian, cross):
    """cross (n, n, S) := P F', P (n, n, S or 1) before and F (n, n, S or 1) over the interval."""
    n, runs = cross.shape[0], cross.shape[2]
    for s in range(runs):
        p = s if covariance.shape[2] > 1 else 0
        f = s if jacobian.shape[2] > 1 else 0
        for i in range(n):
            for k in range(n):
                total = 0.0
                for j in range(n):
                    total += covariance[i, j, p] * jacobian[k, j, f]
                cross[i, k, s] = total


@kernel
def point_cross(deviations, moved, mean, weights, cross):
    """cross (n, n, S) := sum_i w_i d_i (m_i - mean)', from sigma points' deviations d (n, m, S) before and the points
    moved (n, m, S)."""
    n, runs = cross.shape[0], cross.shape[2]
    for s in range(runs):
        for i in range(n):
            for k in range(n):
                total = 0.0
                for j in range(len(weights)):
                    total += weights[j] * deviations[i, j, s] * (moved[k, j, s] - mean[k, s])
                cross[i, k, s] = total


@kernel
def step_back(later_mean, later_covariance, predicted_mean, predicted, cross, still, mean, covariance):
    """mean (n, S), covariance (n, n, S) of an event, revised in place by the smoothed later one:
    G = cross P-^-1, x + G (xs - x-), P + G (Ps - P-) G'. still (S,): runs for which no time passes in between, whose
    later estimate it is. predicted (n, n, S or 1) = P-, factorised as L D L' without its zero pivots."""
    n, runs = mean.shape[0], mean.shape[1]
    lower, pivots, gain = np.zeros((n, n)), np.zeros(n), np.zeros((n, n))
    gap, spread = np.zeros(n), np.zeros((n, n))
    for s in range(runs):
        if still[s]:
            for i in range(n):
                mean[i, s] = later_mean[i, s]
                for j in range(n):
                    covariance[i, j, s] = later_covariance[i, j, s]
            continue
        p = s if predicted.shape[2] > 1 else 0
        for j in range(n):
            for i in range(j, n):
                total = predicted[i, j, p]
                for k in range(j):
                    total -= lower[i, k] * lower[j, k] * pivots[k]
                if i == j:
                    pivots[j] = total if total > NEGLIGIBLE * predicted[j, j, p] else 0.0
                    lower[j, j] = 1.0
                else:
                    lower[i, j] = total / pivots[j] if pivots[j] > 0.0 else 0.0
        for i in range(n):  # gain[i] L D L' = cross[i]
            for j in range(n):
                total = cross[i, j, s]
                for k in range(j):
                    total -= lower[j, k] * gain[i, k]
                gain[i, j] = total
            for j in range(n):
                gain[i, j] = gain[i, j] / pivots[j] if pivots[j] > 0.0 else 0.0
            for j in range(n - 1, -1, -1):
                total = gain[i, j]
                for k in range(j + 1, n):
                    total -= lower[k, j] * gain[i, k]
                gain[i, j] = total
        for j in range(n):
            gap[j] = later_mean[j, s] - predicted_mean[j, s]
        for i in range(n):
            total = 0.0
            for j in range(n):
                total += gain[i, j] * gap[j]
            mean[i, s] += total
            for j in range(n):
                total = 0.0
                for k in range(n):
                    total += gain[i, k] * (later_covariance[k, j, s] - predicted[k, j, p])
                spread[i, j] = total
        for i in range(n):
            for j in range(i + 1):
                total = 0.0
                for k in range(n):
                    total += spread[i, k] * gain[j, k]
                covariance[i, j, s] += total
                covariance[j, i, s] = covariance[i, j, s]
