"""Scoring as the runs go: compiled accumulators per run, and sums over runs per step for the curves.

Nothing here grows with the number of steps but the curves, and nothing grows with the number of runs but the rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from ...estimators.interface import Status
from ...scenarios.arrays import Array, Mask
from ...scenarios.setting import Quantity
from .forms import BINS, histogram_medians, score_forms, score_sets
from .kernels import score_bound, score_errors
from .stretch import Stretch, everything

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
        self.steps = np.zeros(runs)
        self.good, self.lost = np.ones(runs, dtype=bool), np.zeros(runs, dtype=bool)
        self.nees, self.nees_steps, self.nees_inside = np.zeros(runs), np.zeros(runs), np.zeros(runs)
        self.histogram, self.middle, self.outer = np.zeros((0, BINS), dtype=np.int32), np.nan, np.nan
        self.inside, self.ellipsoid_steps, self.half_width = np.zeros(runs), np.zeros(runs), np.zeros((n, runs))
        self.bound, self.bound_steps, self.performed = np.zeros(runs), np.zeros(runs), np.zeros(runs)
        self.curves = np.zeros((steps, len(CURVES), max(n, 1)))
        self.claimed: set[str] = set()
        self.estimated = max((part[0] for part in parts), default=-1) + 1
        self.nees_states = 0

    def add(self, stretch: Stretch) -> None:
        """Score steps: the elements whose truth is known (not NaN), and of claims those of the truth's own states,
        which come first."""
        take = stretch.from_place(self.skip)
        if take.start == take.stop:
            return
        self.estimated, places, vector, truth = stretch.estimated, stretch.places[take], stretch.vector, stretch.truth
        live = np.empty((stretch.count, self.steps.size))
        scored = everything(stretch.count) if stretch.scored is None else stretch.scored
        if stretch.gaps[take].any():
            truth = np.where(np.isnan(truth), np.nan_to_num(vector[:, :truth.shape[1]]), truth)
            for b in range(take.start, take.stop):
                self._partial(slice(b, b + 1), stretch, truth, scored, live)
        else:
            self._errors(take, stretch, truth[take], stretch.active[take], scored[take], live)
        if stretch.covariance is not None and self.referenced:
            claims = stretch.covariance
            if claims.states != self.nees_states:
                self.nees_states, self.histogram = claims.states, np.zeros((live.shape[1], BINS), dtype=np.int32)
                self.middle, self.outer = (2 * float(gammaincinv(claims.states / 2, share)) for share in (0.5, 0.95))
            score_forms(claims.form[take], claims.failed[take], live[take], self.lost, self.nees, self.nees_steps,
                        places, self.curves, self.middle, self.outer, self.nees_inside, self.histogram)
            self.claimed.add("nees")
        if stretch.ellipsoid is not None:
            claims = stretch.ellipsoid
            score_sets(claims.form[take], claims.failed[take], claims.diagonal[take], live[take], self.lost, self.index,
                       self.weight, self.owner, self.share, self.inside, self.ellipsoid_steps, self.half_width)
            self.claimed.add("ellipsoid")
        if stretch.bound is not None and self.performance is not None:
            score_bound(vector[take], truth[take], self.performance, stretch.bound[take], live[take], self.bound,
                        self.performed, self.bound_steps)
            self.claimed.add("bound")

    def _errors(self, take: slice, stretch: Stretch, truth: Array, active: Mask, scored: Mask, live: Array) -> None:
        score_errors(stretch.vector[take], truth, active, scored, self.index, self.weight, self.owner,
                     self.share, self.limit, self.good, live[take], self.step, self.totals, self.last, self.left_out,
                     self.steps, stretch.places[take], self.curves)

    def _partial(self, take: slice, stretch: Stretch, truth: Array, scored: Mask, live: Array) -> None:
        """A step whose truth may be unknown, filled in `truth`: there the last error of a quantity stays what it was,
        its curve has a gap, and claims are judged where all is known, live (B, S)."""
        known = ~np.isnan(stretch.truth[take])
        if known.all():
            self._errors(take, stretch, truth[take], stretch.active[take], scored[take], live)
            return
        counts = known if not scored.shape[1] else known & scored[take]
        active, last = stretch.active[take] & counts.any(axis=1), self.last.copy()
        self._errors(take, stretch, truth[take], active, counts, live)
        for q in range(len(self.quantities)):
            missing = ~known[0, self.index[self.owner == q]].all(axis=0)
            self.last[q] = np.where(missing, last[q], self.last[q])
            if (missing & (live[take.start] > 0)).any():
                self.curves[stretch.places[take.start], :3, q] = np.nan
        live[take] *= known.all(axis=1)

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
