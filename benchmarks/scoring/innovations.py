"""What innovations say of an estimator without any truth: NIS, whiteness, log-likelihood, per run and over time.

Estimators hand innovations out in turn (uncorrelated), so nothing here forms or inverts an innovation covariance."""

from __future__ import annotations

import numpy as np

from ...estimators.interface import Innovation, Walk
from ...estimators.kernels.core import HALF_LOG_TURN, kernel
from ...scenarios.arrays import Array, Mask
from ...scenarios.measurement import Measurement


class InnovationScore:
    """Accumulates what one estimator's innovations say over a batch of S runs.

    curve (K, 2): sums over runs of NIS and of elements received, per step."""

    def __init__(self, runs: int, steps: int, skip_steps: int) -> None:
        self.runs, self.skip, self.curve = runs, skip_steps, np.zeros((steps, 2))
        self.nis, self.likelihood, self.lag, self.square = np.zeros((4, runs))
        self.elements, self.likely, self.pairs = np.zeros((3, runs))
        self.before: Array = np.zeros((0, runs))
        self.told: set[str] = set()

    def add(self, k: int, active: Mask, measurement: Measurement, innovation: Innovation) -> None:
        """Take up the innovation of a measurement that was received in step k; runs not active (S,) do not count."""
        if k < self.skip:
            return
        parts = [None if part is None else part[None] for part in innovation]
        self._take(slice(k, k + 1), measurement.received[None], active[None], *parts)

    def walk(self, k: int, active: Mask, received: Mask, walk: Walk) -> None:
        """The same of steps from k on that were walked at once: active (B, S), received (B, ny, S)."""
        first, end = max(self.skip - k, 0), k + len(received)
        if first < len(received):
            parts = [None if part is None else part[first:] for part in walk.innovation]
            self._take(slice(k + first, end), received[first:], active[first:], *parts)

    def _take(self, steps: slice, received: Mask, active: Mask, residual: Array | None, variance: Array | None,
              said: Array | None) -> None:
        if residual is not None and variance is not None:
            if len(self.before) != residual.shape[1]:
                self.before = np.full(residual.shape[1:], np.nan)
            add_innovations(residual, variance, received, active, self.before, self.nis, self.elements, self.likelihood,
                            self.likely, self.lag, self.square, self.pairs, self.curve[steps], said is None)
            self.told.update(("nis", "log-likelihood") if said is None else ("nis",))
        if said is not None:
            add_likelihoods(said, received, active, self.likelihood, self.likely)
            self.told.add("log-likelihood")

    def finish(self) -> dict[tuple[str, str], Array]:
        """The metrics per run (S,), see `columns.py`; NaN where a run received nothing."""
        out: dict[tuple[str, str], Array] = {}
        with np.errstate(invalid="ignore", divide="ignore"):
            if "nis" in self.told:
                out["nis", "innovation"] = self.nis / self.elements
                out["elements", "innovation"] = self.elements.copy()
                out["whiteness", "innovation"] = self.lag / self.square
                out["pairs", "innovation"] = self.pairs.copy()
            if "log-likelihood" in self.told:
                out["log-likelihood", "innovation"] = self.likelihood / self.likely
        return out


@kernel
def add_innovations(residual, variance, received, active, before, nis, elements, likelihood, likely, lag, square, pairs,
                    curve, logarithms):
    """Take up residual (B, ny, S), variance (B, ny, S or 1) where received (B, ny, S) and active (B, S).

    nis, elements, likelihood, likely, lag, square, pairs (S,); before (ny, S): each element's last standardised
    residual, NaN before there is one. lag sums its products with the next, square its squares there. curve (B, 2): NIS
    and elements over all runs."""
    shared = variance.shape[2] == 1
    for b in range(residual.shape[0]):
        for j in range(residual.shape[1]):
            for s in range(residual.shape[2]):
                if received[b, j, s] and active[b, s]:
                    v = variance[b, j, 0 if shared else s]
                    z = residual[b, j, s] / np.sqrt(v)
                    nis[s] += z * z
                    elements[s] += 1.0
                    curve[b, 0] += z * z
                    curve[b, 1] += 1.0
                    if logarithms:
                        likelihood[s] -= 0.5 * (z * z + np.log(v)) + HALF_LOG_TURN
                        likely[s] += 1.0
                    last = before[j, s]
                    if last == last:
                        lag[s] += z * last
                        square[s] += 0.5 * (z * z + last * last)
                        pairs[s] += 1.0
                    before[j, s] = z


@kernel
def add_likelihoods(said, received, active, likelihood, likely):
    """likelihood, likely (S,) take up the log-likelihoods said (B, S), unless NaN, and the number of the elements that
    were received (B, ny, S) by runs active (B, S)."""
    for b in range(said.shape[0]):
        for s in range(said.shape[1]):
            count = 0.0
            for j in range(received.shape[1]):
                count += 1.0 if received[b, j, s] and active[b, s] else 0.0
            if count > 0.0 and said[b, s] == said[b, s]:
                likelihood[s] += said[b, s]
                likely[s] += count
