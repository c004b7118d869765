"""Weights and selection of a weighted cloud of particles, one run at a time, compiled.

Weights are logarithms throughout: a floor on weights would decide which particles live."""

from __future__ import annotations

import numpy as np

from ...scenarios.machine_code import njit
from ..kernels.modes import exponentials


@njit(cache=True, inner=True)
def collapse(logw, n, g, draws, picked, part):
    """Optimal proposal, eqs. (9), (12), (13): one of the g children of each of n parents, drawn by its weight.

    logw (n g,) is overwritten in its first n places by the parents' log sums (place i lies before every child still
    to be read); picked[i] = index of i's child. draws[1 + i]: parent i's uniform. part (n g,) is scratch."""
    tops = np.empty(n)
    for i in range(n):
        tops[i] = -np.inf
        for c in range(i * g, (i + 1) * g):
            if logw[c] > tops[i]:
                tops[i] = logw[c]
        if tops[i] == -np.inf:  # no child has weight; nor will the parent
            tops[i] = 0.0
        for c in range(i * g, (i + 1) * g):
            logw[c] -= tops[i]
    exponentials(logw, n * g, 0.0, part)
    for i in range(n):
        total = 0.0
        for c in range(i * g, (i + 1) * g):
            total += part[c]
        target = draws[1 + i] * total
        reached = 0.0
        picked[i] = i * g
        for c in range(i * g, (i + 1) * g):
            if part[c] > 0.0:
                picked[i] = c
            reached += part[c]
            if reached > target:
                break
        logw[i] = tops[i] + np.log(total) if total > 0.0 else -np.inf


@njit(cache=True)
def systematic(w, n, keep, uniform, index):
    """Systematic resampling: index[j] of the particle under (uniform + j) / keep. Never one of weight zero.

    Particle i + 1 begins at place c, the number of targets below the sum of the weights to i; a place belongs to the
    last that has begun. There is no branch that weights decide, which a processor could only guess."""
    last = n - 1
    while last > 0 and w[last] == 0.0:
        last -= 1
    for j in range(keep):
        index[j] = 0
    reached = 0.0
    for i in range(last):
        reached += w[i]
        near = reached * keep - uniform
        c = min(max(int(np.ceil(near)), 0), keep)
        if abs(near - np.round(near)) < 1e-6:  # here rounding decides
            while c > 0 and (uniform + (c - 1)) / keep >= reached:
                c -= 1
            while c < keep and (uniform + c) / keep < reached:
                c += 1
        if c < keep:
            index[c] = i + 1
    for j in range(1, keep):
        index[j] = max(index[j], index[j - 1])


@njit(cache=True)
def heaviest(logw, n, keep, index):
    """The keep particles of largest weight, in their order; of equals the first."""
    threshold = -np.partition(-logw[:n], keep - 1)[keep - 1]
    above = 0
    for i in range(n):
        if logw[i] > threshold:
            above += 1
    ties = keep - above
    j = 0
    for i in range(n):
        if logw[i] > threshold:
            index[j] = i
            j += 1
        elif logw[i] == threshold and ties > 0:
            index[j] = i
            ties -= 1
            j += 1


@njit(cache=True, inner=True)
def select(logw, w, n, total, keep, by_weight, uniform, index, kept):
    """Fill index (and the kept ones' log weights) with the particles that go on; returns how many.

    keep = 0: all of them, weights normalised by their log sum `total`. by_weight: the heaviest, weights kept (they are
    biased: page of the scenario); else systematic resampling, equal weights."""
    if keep == 0:
        for i in range(n):
            index[i], kept[i] = i, logw[i] - total
        return n
    if by_weight:
        heaviest(logw, n, keep, index)
        for j in range(keep):
            kept[j] = logw[index[j]] - total
        return keep
    systematic(w, n, keep, uniform, index)
    for j in range(keep):
        kept[j] = 0.0
    return keep


@njit(cache=True, inner=True)
def distinct(theta, logw, n, seen):
    """How many different parameter values the first n particles of non-zero weight have; seen (m,) is scratch."""
    seen[:] = False
    count = 0
    for i in range(n):
        if logw[i] > -np.inf and not seen[theta[i]]:
            seen[theta[i]] = True
            count += 1
    return count
