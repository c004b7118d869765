"""The compiled loops of scoring: errors into running sums, by window and phase too. Runs are innermost throughout.

Scoring must cost little beside the filters it scores: many steps are one call, and every loop over runs is one that the
compiler vectorises."""

from __future__ import annotations

import numpy as np

from ...estimators.kernels.core import inner, kernel

LANES = 8


@inner
def lane_sum(values):
    """Sum of values (S,) in eight interleaved partial sums: as fast as memory, and of the same bits every time."""
    lanes, total, whole = np.empty(LANES), 0.0, values.shape[0] // LANES * LANES
    for lane in range(LANES):
        lanes[lane] = 0.0
    for s in range(0, whole, LANES):
        for lane in range(LANES):
            lanes[lane] += values[s + lane]
    for lane in range(LANES):
        total += lanes[lane]
    for s in range(whole, values.shape[0]):
        total += values[s]
    return total


@kernel
def has_gaps(truth):
    """Whether anything of the truth (nt, S) is not known (NaN)."""
    for i in range(truth.shape[0]):
        row = truth[i]
        for s in range(row.shape[0]):
            if row[s] != row[s]:
                return True
    return False


@kernel
def score_errors(vector, truth, active, scored, index, weight, owner, share, limit, good, live, step, totals, last,
                 left_out, steps, places, curves):
    """Take up the errors of steps b of the runs that are active (B, S) and good (S,), which live (B, S) 1.0 or 0.0
    tells afterwards; a run whose error is not finite or above its limit is good no longer.

    vector, truth (B, >= nt, S); scored (B, nt, S), or (B, 0, 0): all elements count. step (4, nq, S) is work space.
    totals (3, nq, S), last (nq, S), left_out (nq, S), steps (S,) as in the functions below; curves (K, 6, nq or more)
    of each step, b being places[b]: sums over runs of squares, their squares, errors, number of runs in [3, 0]."""
    for b in range(vector.shape[0]):
        on = live[b]
        for s in range(on.shape[0]):
            on[s] = 1.0 if active[b, s] and good[s] else 0.0
        add_errors(vector[b], truth[b], on, index, weight, owner, share, limit, step)
        for s in range(on.shape[0]):
            good[s] = good[s] and (on[s] > 0.0 or not active[b, s])
        accumulate_curves(step, on, last, steps, curves[places[b]])
        if scored.shape[1]:
            add_partial(vector[b], truth[b], on, scored[b], index, weight, owner, share, step, left_out)
        accumulate(step, on, totals)


@kernel
def score_bound(vector, truth, performance, bound, live, certified, performed, steps):
    """Of live runs (B, S), certified (S,) takes up the bound (B, S or 1), performed (S,) the square |M e|^2 of the
    performance M (nz, nx), steps (S,) one."""
    runs = live.shape[1]
    z = np.empty(runs)
    for b in range(live.shape[0]):
        for s in range(runs):
            certified[s] += live[b, s] * bound[b, 0 if bound.shape[1] == 1 else s]
            steps[s] += live[b, s]
        for i in range(performance.shape[0]):
            for s in range(runs):
                z[s] = 0.0
            for j in range(performance.shape[1]):
                weight = performance[i, j]
                if weight != 0.0:
                    for s in range(runs):
                        z[s] += weight * (vector[b, j, s] - truth[b, j, s])
            for s in range(runs):
                performed[s] += z[s] * z[s] if live[b, s] > 0.0 else 0.0


@inner
def add_errors(vector, truth, live, index, weight, owner, share, limit, step):
    """step[0..2, q] (3, nq, S) := this step's squared, absolute and signed error of each quantity; step[3, q] its
    largest component. live (S,) 1.0 or 0.0 becomes 0.0 where an error is not finite or above its limit.

    Components r: index, weight, owner (quantity), share of the quantity's mean, each (nr,); limit (nq,)."""
    step[:] = 0.0
    runs = truth.shape[1]
    error = np.empty(runs)
    for r in range(index.shape[0]):
        w, f, bound = weight[r], share[r], limit[owner[r]]
        a, b = vector[index[r]], truth[index[r]]
        squared, absolute, signed, largest = step[0, owner[r]], step[1, owner[r]], step[2, owner[r]], step[3, owner[r]]
        # a loop each: few arrays in a loop are what the compiler can prove apart, and so vectorise
        for s in range(runs):
            error[s] = w * (a[s] - b[s])
        for s in range(runs):
            live[s] = live[s] if abs(error[s]) <= bound else 0.0
        for s in range(runs):
            squared[s] += f * error[s] * error[s]
        for s in range(runs):
            absolute[s] += f * abs(error[s])
        for s in range(runs):
            signed[s] += f * error[s]
        for s in range(runs):
            size = abs(error[s])
            largest[s] = size if size > largest[s] else largest[s]


@inner
def add_partial(vector, truth, live, scored, index, weight, owner, share, step, left_out):
    """As `add_errors` for step[0], [1] and [3], but of the elements with scored (nt, S) alone; left_out (nq, S) adds
    up the share of a quantity's step that was missed so. step[2] (the signed error) is left alone."""
    for part in (0, 1, 3):
        step[part] = 0.0
    for r in range(index.shape[0]):
        i, w, q, f = index[r], weight[r], owner[r], share[r]
        for s in range(truth.shape[1]):
            e = w * (vector[i, s] - truth[i, s])
            e = e if scored[i, s] else 0.0
            step[0, q, s] += f * e * e
            step[1, q, s] += f * abs(e)
            step[3, q, s] = max(step[3, q, s], abs(e))
            left_out[q, s] += 0.0 if scored[i, s] else f * live[s]


@inner
def accumulate(step, live, totals):
    """totals (3, nq, S) of squared, absolute and largest error take up the step's, where live."""
    for q in range(step.shape[1]):
        for part in range(2):
            total, value = totals[part, q], step[part, q]
            for s in range(live.shape[0]):
                total[s] += value[s] if live[s] > 0.0 else 0.0
        total, value = totals[2, q], step[3, q]
        for s in range(live.shape[0]):
            size = value[s] if live[s] > 0.0 else 0.0
            total[s] = size if size > total[s] else total[s]


@inner
def accumulate_curves(step, live, last, steps, curve):
    """curve (>= 4, nq) takes up the sums over runs of this step: squares, their squares, errors, and the number of runs
    in [3, 0]; last (nq, S) := the squared error, steps (S,) += 1."""
    value, fourth = np.empty(live.shape[0]), np.empty(live.shape[0])
    for q in range(step.shape[1]):
        for s in range(live.shape[0]):
            on = live[s] > 0.0
            value[s] = step[0, q, s] if on else 0.0
            last[q, s] = value[s] if on else last[q, s]
            fourth[s] = value[s] * value[s]
        curve[0, q] += lane_sum(value)
        curve[1, q] += lane_sum(fourth)
        for s in range(live.shape[0]):
            value[s] = step[2, q, s] if live[s] > 0.0 else 0.0
        curve[2, q] += lane_sum(value)
    for s in range(live.shape[0]):
        steps[s] += live[s]
    curve[3, 0] += lane_sum(live)


@kernel
def add_windows(vector, truth, active, window, index, weight, owner, share, squared, steps):
    """Add the squared errors of steps b to the window (B, S) that each active run is in (-1: none) where all elements
    of a quantity are known (not NaN). Element i of the parts is index[i] of the truth, weight[i] of quantity owner[i],
    its square over share[i]. squared, steps (nq, nw, S)."""
    nq, runs = squared.shape[0], window.shape[1]
    sums, known = np.empty((nq, runs)), np.empty((nq, runs))
    for b in range(window.shape[0]):
        for q in range(nq):
            for s in range(runs):
                sums[q, s], known[q, s] = 0.0, 1.0
        for i in range(index.shape[0]):
            told, there, total, fine = vector[b, index[i]], truth[b, index[i]], sums[owner[i]], known[owner[i]]
            w, over = weight[i], share[i]
            for s in range(runs):
                error = w * (told[s] - there[s])
                total[s] += error * error / over
                fine[s] *= 1.0 if abs(there[s]) < np.inf else 0.0
        for s in range(runs):
            w = window[b, s]
            if active[b, s] and w >= 0:
                for q in range(nq):
                    if known[q, s] > 0.0:
                        steps[q, w, s] += 1.0
                        squared[q, w, s] += sums[q, s]


STANDING, COASTING = 0.05, 0.1
"""A train slower than this (m/s) stands; within +- this (m/s^2) a moving one neither accelerates nor brakes."""


@kernel
def driving_phases(truth, place, length, before, phase):
    """phase (B, S): by place in `columns.PHASES`, of steps of `length` (B, S) s; the speed at their ends is truth's
    element `place`, at the first's beginning `before` (S,), which then is the last; -1 where that is not known."""
    for b in range(phase.shape[0]):
        speed = truth[b, place]
        for s in range(phase.shape[1]):
            v, phase[b, s] = speed[s], -1
            if v <= STANDING:
                phase[b, s] = 0
            elif length[b, s] > 0.0:
                a = (v - before[s]) / length[b, s]
                phase[b, s] = 1 if a > COASTING else 3 if a < -COASTING else 2 if np.isfinite(a) else -1
            before[s] = v
