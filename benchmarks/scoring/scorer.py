"""Scoring as the runs go: compiled accumulators per run, and sums over runs per step for the curves.

Nothing here grows with the number of steps but the curves, and nothing grows with the number of runs but the rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from ...estimators.interface import Estimate, Status
from ...scenarios.arrays import Array, Mask
from ...scenarios.setting import Quantity
from ...scenarios.world import Step
from .kernels import BINS, has_gaps, histogram_medians, quadratic_forms, score_bound, score_errors, score_forms

EVERYTHING = np.zeros((0, 0), dtype=bool)
CURVES = ("squared", "fourth", "error", "active", "nees", "nees-count")


@dataclass(frozen=True)
class Scored:
    """What one estimator did on a batch: metrics {(metric, quantity): (S,)}, NaN where the run's status is not ok, and
    the reasons (S,) of those that are not.

    curves: by the names of `CURVES`, sums over runs of each step, (K, quantities) for the first three, else (K,).
    nees_states: degrees of freedom of the NEES (0: no covariance claimed). ("nees-median", "state"): median over a
    run's steps over that of chi-square, 1 is right; ("inside", "state"): share of its steps in the 95 % ellipsoid."""

    metrics: dict[tuple[str, str], Array]
    status: NDArray[np.int8]
    reasons: list[str]
    curves: dict[str, Array]
    nees_states: int


class Scorer:
    """Accumulates one estimator's scores over a batch of S runs."""

    def __init__(self, quantities: Sequence[Quantity], runs: int, steps: int, skip_steps: int,
                 limits: dict[str, float], performance: Array | None) -> None:
        self.quantities, self.skip = tuple(quantities), skip_steps
        self.performance = None if performance is None else np.ascontiguousarray(performance)
        parts = [(i, w, q, 1 / len(item.components) if item.mean else 1.0)
                 for q, item in enumerate(quantities) for i, w in item.components]
        self.index = np.array([part[0] for part in parts])
        self.weight = np.array([part[1] for part in parts], dtype=float)
        self.owner = np.array([part[2] for part in parts])
        self.share = np.array([part[3] for part in parts])
        none = np.finfo(float).max
        self.limit = np.array([limits.get(item.name, none) if item.referenced else none for item in quantities])
        self.referenced = all(item.referenced for item in quantities)
        n = len(quantities)
        self.totals, self.step = np.zeros((3, n, runs)), np.empty((4, n, runs))
        self.last, self.left_out = np.zeros((n, runs)), np.zeros((n, runs))
        self.steps, self.live, self.form = np.zeros(runs), np.empty(runs), np.empty(runs)
        self.good, self.lost = np.ones(runs, dtype=bool), np.zeros(runs, dtype=bool)
        self.nees, self.nees_steps, self.nees_inside = np.zeros(runs), np.zeros(runs), np.zeros(runs)
        self.histogram, self.middle, self.outer = np.zeros((0, BINS), dtype=np.int32), np.nan, np.nan
        self.inside, self.ellipsoid_steps, self.half_width = np.zeros(runs), np.zeros(runs), np.zeros((n, runs))
        self.bound, self.bound_steps, self.performed = np.zeros(runs), np.zeros(runs), np.zeros(runs)
        self.curves = np.zeros((steps, len(CURVES), max(n, 1)))
        self.claimed: set[str] = set()
        self.estimated = max((part[0] for part in parts), default=-1) + 1
        self.nees_states = 0

    def add(self, k: int, estimate: Estimate, step: Step) -> None:
        """Score the estimate of step k: the elements whose truth is known (not NaN), and of claims those of the
        truth's own states, which come first."""
        if k < self.skip:
            return
        mean = np.ascontiguousarray(estimate.mean)
        vector = mean if estimate.parameter is None else np.concatenate([mean, estimate.parameter])
        truth, live, curve = np.ascontiguousarray(step.truth), self.live, self.curves[k]
        self.estimated = len(vector)
        if len(vector) < len(truth):  # a parameter that is not estimated: no error here, no metric in `finish`
            vector = np.concatenate([vector, truth[len(vector):]])
        scored = EVERYTHING if step.scored is None else np.ascontiguousarray(step.scored)
        active, known, last, gaps = step.active, EVERYTHING, self.last, has_gaps(truth)
        if gaps:
            known = ~np.isnan(truth)
            scored = known if step.scored is None else known & step.scored
            active, last = active & scored.any(axis=0), self.last.copy()
            truth = np.where(known, truth, vector[:len(truth)])
        score_errors(vector, truth, active, scored, self.index, self.weight, self.owner, self.share, self.limit,
                     self.good, live, self.step, self.totals, self.last, self.left_out, self.steps, curve)
        if gaps:
            live = self._without_gaps(known, last, curve)
        if estimate.covariance is not None and self.referenced:
            n = min(len(truth), estimate.covariance.shape[0])
            if n != self.nees_states:
                self.nees_states, self.histogram = n, np.zeros((len(live), BINS), dtype=np.int32)
                self.middle, self.outer = (2 * float(gammaincinv(n / 2, share)) for share in (0.5, 0.95))
            quadratic_forms(vector, truth, np.ascontiguousarray(estimate.covariance[:n, :n]), live, self.form,
                            self.lost)
            score_forms(self.form, live, self.nees, self.nees_steps, curve, self.middle, self.outer, self.nees_inside,
                        self.histogram)
            self.claimed.add("nees")
        if estimate.ellipsoid is not None:
            n = min(len(truth), estimate.ellipsoid.shape[0])
            quadratic_forms(vector, truth, np.ascontiguousarray(estimate.ellipsoid[:n, :n]), live, self.form,
                            self.lost)
            use = (live > 0) & ~np.isnan(self.form)
            self.inside += use & (self.form <= 1 + 1e-9)
            self.ellipsoid_steps += use
            for i, w, q, f in zip(self.index, self.weight, self.owner, self.share, strict=True):
                wide = f * np.sqrt(w * w * np.maximum(estimate.ellipsoid[i, i], 0)) if i < n else np.nan
                self.half_width[q] += np.where(use, wide, 0)
            self.claimed.add("ellipsoid")
        if estimate.bound is not None and self.performance is not None:
            score_bound(vector, truth, self.performance, np.ascontiguousarray(estimate.bound), live, self.bound,
                        self.performed, self.bound_steps)
            self.claimed.add("bound")

    def _without_gaps(self, known: Mask, last: Array, curve: Array) -> Array:
        """After a step with unknown truth (known (nt, S)): the last error of a quantity stays what it was, `last`,
        where one of its elements is unknown, its curve has a gap, and claims are judged where all is known: live
        (S,)."""
        for q in range(len(self.quantities)):
            missing = ~known[self.index[self.owner == q]].all(axis=0)
            self.last[q] = np.where(missing, last[q], self.last[q])
            if (missing & (self.live > 0)).any():
                curve[:3, q] = np.nan
        return self.live * known.all(axis=0)

    def finish(self, status: NDArray[np.int8], reasons: Mapping[int, str]) -> Scored:
        """The metrics per run. Runs the estimator itself gave up keep their status and reason (by place in the batch);
        then diverged, then lost ones."""
        status = status.copy()
        told = [reasons.get(run, "") if bad else "" for run, bad in enumerate(status)]
        for bad, value, why in ((~self.good, Status.diverged, "the error left its limit or was not finite"),
                                (self.lost, Status.failed, "the covariance lost positive definiteness")):
            new = bad & (status == Status.ok)
            status[new] = value
            told = [why if is_new else text for text, is_new in zip(told, new, strict=True)]
        steps = np.where(self.steps > 0, self.steps, np.nan)
        metrics: dict[tuple[str, str], Array] = {}
        for q, item in enumerate(self.quantities):
            if not item.referenced or any(i >= self.estimated for i, _ in item.components):
                self.curves[:, :3, q] = np.nan
                continue
            counted = steps - self.left_out[q] if item.mean else steps
            counted = np.where(counted > 0, counted, np.nan)  # a truth that never was known has no error
            metrics["rmse", item.name] = np.sqrt(self.totals[0, q] / counted)
            metrics["mae", item.name] = self.totals[1, q] / counted
            metrics["max", item.name] = np.where(counted > 0, self.totals[2, q], np.nan)
            metrics["final", item.name] = np.where(counted > 0, np.sqrt(self.last[q]), np.nan)
            if not item.mean:
                metrics["sum-squared", item.name] = self.totals[0, q].copy()
        with np.errstate(invalid="ignore", divide="ignore"):
            if "nees" in self.claimed:
                metrics["nees", "state"] = self.nees / self.nees_steps
                metrics["nees-median", "state"] = histogram_medians(self.histogram)
                metrics["inside", "state"] = self.nees_inside / self.nees_steps
            if "ellipsoid" in self.claimed:
                metrics["coverage", "ellipsoid"] = self.inside / self.ellipsoid_steps
                for q, item in enumerate(self.quantities):  # NaN where the set does not speak of it
                    metrics["half-width", item.name] = self.half_width[q] / self.ellipsoid_steps
            if "bound" in self.claimed:
                metrics["bound", "performance"] = self.bound / self.bound_steps
                metrics["mean-square", "performance"] = self.performed / self.bound_steps
        bad = status != Status.ok
        for values in metrics.values():
            values[bad] = np.nan
        n = len(self.quantities)
        curves = {name: self.curves[:, c, :n] if c < 3 else self.curves[:, c, 0] for c, name in enumerate(CURVES)}
        return Scored(metrics, status, told, curves, self.nees_states)
