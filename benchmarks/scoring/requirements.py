"""Scoring what a scenario requires: shares of time inside, largest use of an allowance, errors at the stop, claims.

What is looked at is kept step by step and worked out at the end, run by run, so that no batch changes a bit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...scenarios.arrays import Array, Mask
from ...scenarios.requirements import Allowance, Confidence, Percentile, Requirement, Speed, Stop
from ...scenarios.setting import Outcome, Quantity
from .requirement_kernels import claims, drifts, keep_errors, percentiles, shares
from .stretch import Stretch, everything

PERCENTILES = (50.0, 95.0, 99.0)
DISTANCES = (10.0, 100.0, 1000.0)
"""Metres travelled over which the change of a position's error is told."""


class RequirementScores:
    """Of one estimator on S runs; no requirements, no work and no memory.

    Kept, (S, K) each: the error of every quantity asked about, the half-width claimed for it (one standard deviation,
    or the whole of a set), whether the step counts; the truth of each; distance since the last reference and the error
    of its place on the map."""

    def __init__(self, requirements: Sequence[Requirement], quantities: Sequence[Quantity], runs: int,
                 steps: int) -> None:
        self.requirements, self.runs = tuple(requirements), runs
        named = {item.name: item for item in quantities if len(item.components) == 1}
        self.quantities = [named[name] for name in dict.fromkeys(
            item.quantity for item in requirements)]
        self.index = np.array([item.components[0][0] for item in self.quantities], dtype=np.int64)
        self.weight = np.array([item.components[0][1] for item in self.quantities], dtype=float)
        n = len(self.quantities)
        shape = (n, runs, steps if n else 0)
        self.error, self.claim, self.truth = (np.full(shape, np.nan) for _ in range(3))
        self.counts, self.active = np.zeros(shape, dtype=bool), np.zeros(shape[1:], dtype=bool)
        referred = any(isinstance(item, Allowance) for item in requirements)
        self.reference = np.full((2, *shape[1:]), np.nan) if referred else None
        self.sets = np.zeros(n, dtype=bool)

    def add(self, stretch: Stretch, skip: int) -> None:
        """Keep what steps from the world's step `skip` on say."""
        take = stretch.from_place(skip)
        if not self.quantities or take.start == take.stop:
            return
        places = stretch.places[take]
        self.active[:, places] = stretch.active[take].T
        claimed = stretch.covariance or stretch.ellipsoid
        scored = everything(stretch.count) if stretch.scored is None else stretch.scored
        diagonal = stretch.truth[:, :0] if claimed is None else claimed.diagonal
        keep_errors(stretch.vector[take], stretch.truth[take], stretch.active[take], scored[take], diagonal[take],
                    places, stretch.estimated, self.index, self.weight, self.error, self.truth, self.counts, self.claim)
        if claimed is not None:
            self.sets[self.index < claimed.diagonal.shape[1]] = stretch.covariance is None
        if self.reference is not None and stretch.reference is not None:
            self.reference[:, :, places] = stretch.reference[take].transpose(1, 2, 0)

    def finish(self) -> dict[Outcome, Array]:
        """{(metric, requirement or quantity, unit): (S,)}; NaN where nothing was claimed or nothing counts."""
        if not self.quantities:
            return {}
        out: dict[Outcome, Array] = {}
        kept: dict[str, tuple[Array, Array, Array, Mask]] = {}
        for q, item in enumerate(self.quantities):
            error, claim, truth = self.error[q], self.claim[q], self.truth[q]
            counts: Mask = self.counts[q]
            kept[item.name] = error, claim, truth, counts
            found = percentiles(error, counts, PERCENTILES)
            out.update({(f"p{percent:.0f}", item.name, item.unit): found[i] for i, percent in enumerate(PERCENTILES)})
            if self.reference is not None:
                drift = drifts(error, truth, counts, np.array(DISTANCES))
                out.update({(f"change-{distance:.0f}m", item.name, item.unit): drift[i]
                            for i, distance in enumerate(DISTANCES) if item.unit == "m"})
        for asked in self.requirements:
            q = next(i for i, item in enumerate(self.quantities) if item.name == asked.quantity)
            out.update(self._one(asked, *kept[asked.quantity], self.quantities[q].unit, bool(self.sets[q])))
        return out

    def _one(self, asked: Requirement, error: Array, claim: Array, truth: Array, counts: Mask, unit: str,
             is_set: bool) -> dict[Outcome, Array]:
        """The columns of one requirement."""
        name = asked.name
        if isinstance(asked, Stop):
            last = self.active.sum(axis=1) - 1
            final = np.abs(error[np.arange(self.runs), np.maximum(last, 0)])
            return {("kept", name, "1"): _known(final <= asked.within, final), ("error", name, unit): final}
        if isinstance(asked, Percentile):
            value = percentiles(error, counts, [asked.percent])[0]
            return {("kept", name, "1"): _known(value <= asked.limit, value),
                    (f"p{asked.percent:g}", name, unit): value}
        if isinstance(asked, Confidence):
            inside, median, needed = claims(error, claim, counts, 1.0 if is_set else asked.k)
            return {("kept", name, "1"): _known(inside >= 1.0, inside), ("inside", name, "1"): inside,
                    ("half-width", name, unit): median, ("k99", name, "1"): needed}
        if isinstance(asked, Speed):
            points = np.array(asked.points)
            limit = np.interp(truth, points[:, 0], points[:, 1])
        else:
            assert self.reference is not None
            told, true = self.reference
            away = truth - true
            error = error - (told - true)
            limit = asked.constant + asked.share * np.abs(away + error if asked.s == "measured" else away)
            counts = counts & np.isfinite(true)
        inside, use, over, under = shares(error, limit, counts)
        out = {("kept", name, "1"): _known(use <= 1.0, use), ("inside", name, "1"): inside, ("use", name, "1"): use}
        return {**out, ("over", name, unit): over, ("under", name, unit): under}


def _known(kept: Mask, value: Array) -> Array:
    """1 where kept, 0 where not, NaN where there is no value to go by."""
    return np.where(np.isnan(value), np.nan, np.asarray(kept, dtype=float))
