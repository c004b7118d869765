"""Scoring as the runs go: compiled accumulators per run, and sums over runs per step for the curves.

Nothing here grows with the number of steps but the curves, and nothing grows with the number of runs but the rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..estimators.interface import Estimate, Status
from ..scenarios.setting import Quantity
from ..scenarios.world import Step

Array = NDArray[np.float64]

CURVES = ("active", "squared", "fourth", "error", "nees", "nees-count")


@njit(cache=True)
def _errors(vector, truth, counted, partial, scored, index, weight, owner, share, limit, squared, absolute, largest,
            last, steps, left_out, good, curve_squared, curve_fourth, curve_error, curve_count):
    """Add one step's errors. Runs whose error is not finite or above its limit get good[s] = False.

    partial: only elements with scored[i, s] enter a run's sums (the curves and the last error keep all of them);
    left_out[q, s] adds up the share of the steps that a quantity missed so."""
    rows, runs = index.shape[0], truth.shape[1]
    quantities = squared.shape[0]
    step_squared = np.zeros((quantities, runs))
    step_absolute = np.zeros((quantities, runs))
    step_error = np.zeros((quantities, runs))
    own_squared, own_absolute = step_squared, step_absolute
    if partial:
        own_squared, own_absolute = np.zeros((quantities, runs)), np.zeros((quantities, runs))
    for r in range(rows):
        i, w, q, f = index[r], weight[r], owner[r], share[r]
        for s in range(runs):
            e = w * (vector[i, s] - truth[i, s])
            step_squared[q, s] += f * e * e
            step_absolute[q, s] += f * abs(e)
            step_error[q, s] += f * e
            if counted[s] and good[s]:
                if not (abs(e) <= limit[q]):
                    good[s] = False
                elif abs(e) > largest[q, s] and (not partial or scored[i, s]):
                    largest[q, s] = abs(e)
        if partial:
            for s in range(runs):
                e = w * (vector[i, s] - truth[i, s])
                if scored[i, s]:
                    own_squared[q, s] += f * e * e
                    own_absolute[q, s] += f * abs(e)
                elif counted[s] and good[s]:
                    left_out[q, s] += f
    for q in range(quantities):
        for s in range(runs):
            if counted[s] and good[s]:
                squared[q, s] += own_squared[q, s]
                absolute[q, s] += own_absolute[q, s]
                last[q, s] = step_error[q, s]
                curve_squared[q] += step_squared[q, s]
                curve_fourth[q] += step_squared[q, s] ** 2
                curve_error[q] += step_error[q, s]
    for s in range(runs):
        if counted[s] and good[s]:
            steps[s] += 1
            curve_count[0] += 1


@njit(cache=True)
def quadratic_forms(error, matrix, out, lost):
    """out[s] = e' M^-1 e by Cholesky, NaN where M is singular; lost[s] = True where M is indefinite.

    error (n, S), matrix (n, n, S or 1), out (S,), lost (S,). A pivot under -1e-9 of its diagonal entry is indefinite,
    one under 1e-14 of it is singular."""
    n, runs = error.shape
    shared = matrix.shape[2] == 1
    factor = np.empty((n, n))
    solved = np.empty(n)
    state = 0
    for s in range(runs):
        m = 0 if shared else s
        if not shared or s == 0:
            state = 0
            for i in range(n):
                for j in range(i + 1):
                    total = matrix[i, j, m]
                    for l in range(j):
                        total -= factor[i, l] * factor[j, l]
                    if i == j:
                        scale = matrix[i, i, m]
                        if not (total >= -1e-9 * abs(scale)) or scale < 0:
                            state = 2
                        elif total <= 1e-14 * scale and state == 0:
                            state = 1
                        factor[i, i] = np.sqrt(total) if total > 0 else 1.0
                    else:
                        factor[i, j] = total / factor[j, j]
        if state == 2:
            lost[s] = True
        if state:
            out[s] = np.nan
            continue
        total = 0.0
        for i in range(n):
            value = error[i, s]
            for l in range(i):
                value -= factor[i, l] * solved[l]
            solved[i] = value / factor[i, i]
            total += solved[i] * solved[i]
        out[s] = total


@dataclass(frozen=True)
class Scored:
    """What one estimator did on a batch: metrics {(metric, quantity): (S,)}, NaN where the run's status is not ok.

    nees_states: degrees of freedom of the NEES (0: no covariance claimed)."""

    metrics: dict[tuple[str, str], Array]
    status: NDArray[np.int8]
    reason: str
    curves: dict[str, Array]
    nees_states: int


class Scorer:
    """Accumulates one estimator's scores over a batch of S runs."""

    def __init__(self, quantities: Sequence[Quantity], runs: int, steps: int, skip_steps: int,
                 limits: dict[str, float], performance: Array | None) -> None:
        self.quantities, self.skip, self.performance = tuple(quantities), skip_steps, performance
        parts = [(i, w, q, 1 / len(item.components) if item.mean else 1.0)
                 for q, item in enumerate(quantities) for i, w in item.components]
        self.index = np.array([part[0] for part in parts])
        self.weight = np.array([part[1] for part in parts], dtype=float)
        self.owner = np.array([part[2] for part in parts])
        self.share = np.array([part[3] for part in parts])
        self.limit = np.array([limits.get(item.name, np.finfo(float).max) for item in quantities])
        n = len(quantities)
        self.squared, self.absolute, self.largest, self.last = (np.zeros((n, runs)) for _ in range(4))
        self.left_out, self.everything = np.zeros((n, runs)), np.ones((1, runs), dtype=bool)
        self.steps = np.zeros(runs, dtype=np.int64)
        self.good, self.lost = np.ones(runs, dtype=bool), np.zeros(runs, dtype=bool)
        self.nees, self.nees_steps = np.zeros(runs), np.zeros(runs)
        self.inside, self.ellipsoid_steps, self.half_width = np.zeros(runs), np.zeros(runs), np.zeros((n, runs))
        self.bound, self.bound_steps, self.performed = np.zeros(runs), np.zeros(runs), np.zeros(runs)
        self.curves = {"active": np.zeros(steps), "nees": np.zeros(steps), "nees-count": np.zeros(steps),
                       "squared": np.zeros((steps, n)), "fourth": np.zeros((steps, n)), "error": np.zeros((steps, n))}
        self.claimed: set[str] = set()
        self.nees_states = 0

    def add(self, k: int, estimate: Estimate, step: Step) -> None:
        """Score the estimate of step k."""
        if k < self.skip:
            return
        mean = np.ascontiguousarray(estimate.mean)
        vector = mean if estimate.parameter is None else np.concatenate([mean, estimate.parameter])
        curves = self.curves
        partial = step.scored is not None
        _errors(vector, step.truth, step.active, partial, step.scored if step.scored is not None else self.everything,
                self.index, self.weight, self.owner, self.share, self.limit,
                self.squared, self.absolute, self.largest, self.last, self.steps, self.left_out, self.good,
                curves["squared"][k], curves["fourth"][k], curves["error"][k], curves["active"][k:k + 1])
        counted = step.active & self.good
        error = None
        if estimate.covariance is not None:
            n = estimate.covariance.shape[0]
            error = vector[:n] - step.truth[:n]
            form = self._form(error, estimate.covariance, counted)
            use = counted & ~np.isnan(form)
            self.nees += np.where(use, form, 0.0)
            self.nees_steps += use
            curves["nees"][k] = form[use].sum()
            curves["nees-count"][k] = use.sum()
            self.claimed.add("nees")
            self.nees_states = n
        if estimate.ellipsoid is not None:
            n = estimate.ellipsoid.shape[0]
            error = vector[:n] - step.truth[:n]
            form = self._form(error, estimate.ellipsoid, counted)
            use = counted & ~np.isnan(form)
            self.inside += use & (form <= 1 + 1e-9)
            self.ellipsoid_steps += use
            for i, w, q, f in zip(self.index, self.weight, self.owner, self.share, strict=True):
                if i < n:
                    self.half_width[q] += np.where(use, f * np.sqrt(w * w * np.maximum(estimate.ellipsoid[i, i], 0)), 0)
            self.claimed.add("ellipsoid")
        if estimate.bound is not None and self.performance is not None:
            n = self.performance.shape[1]
            error = vector[:n] - step.truth[:n]
            z = np.zeros(len(self.steps))
            for row in self.performance:
                z += sum((row[j] * error[j] for j in np.flatnonzero(row)), start=np.zeros_like(z)) ** 2
            self.bound += np.where(counted, estimate.bound, 0.0)
            self.performed += np.where(counted, z, 0.0)
            self.bound_steps += counted
            self.claimed.add("bound")

    def _form(self, error: Array, matrix: Array, counted: NDArray[np.bool_]) -> Array:
        out, lost = np.empty(error.shape[1]), np.zeros(error.shape[1], dtype=bool)
        quadratic_forms(np.ascontiguousarray(error), np.ascontiguousarray(matrix), out, lost)
        self.lost |= lost & counted
        return out

    def finish(self, status: NDArray[np.int8], reason: str) -> Scored:
        """The metrics per run. Runs the estimator itself gave up keep their status; then diverged, then lost ones."""
        status = status.copy()
        for bad, value, why in ((~self.good, Status.diverged, "the error left its limit or was not finite"),
                                (self.lost, Status.failed, "the covariance lost positive definiteness")):
            new = bad & (status == Status.ok)
            status[new] = value
            reason = reason or (why if new.any() else "")
        steps = np.where(self.steps > 0, self.steps, np.nan)
        metrics: dict[tuple[str, str], Array] = {}
        for q, item in enumerate(self.quantities):
            counted = steps - self.left_out[q] if item.mean else steps
            metrics["rmse", item.name] = np.sqrt(self.squared[q] / counted)
            metrics["mae", item.name] = self.absolute[q] / counted
            metrics["max", item.name] = self.largest[q].copy()
            metrics["final", item.name] = np.abs(self.last[q])
            if not item.mean:
                metrics["sum-squared", item.name] = self.squared[q].copy()
        with np.errstate(invalid="ignore", divide="ignore"):
            if "nees" in self.claimed:
                metrics["nees", "state"] = self.nees / self.nees_steps
            if "ellipsoid" in self.claimed:
                metrics["coverage", "ellipsoid"] = self.inside / self.ellipsoid_steps
                for q, item in enumerate(self.quantities):
                    metrics["half-width", item.name] = self.half_width[q] / self.ellipsoid_steps
            if "bound" in self.claimed:
                metrics["bound", "performance"] = self.bound / self.bound_steps
                metrics["mean-square", "performance"] = self.performed / self.bound_steps
        bad = status != Status.ok
        for values in metrics.values():
            values[bad] = np.nan
        return Scored(metrics, status, reason, self.curves, self.nees_states)
