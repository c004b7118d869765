"""Some steps of a drive in a row, copied as they come, so that scores take up many in one call.

Of a claimed matrix only its diagonal and the quadratic form of the error are kept: they are all that scores ask."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...estimators.interface import Estimate, Walk, misshapen
from ...scenarios.arrays import Array, Index, Mask
from ...scenarios.world import Step, Straight
from .forms import quadratic_forms
from .kernels import has_gaps

ROOM, LONGEST = 1 << 16, 64
"""How many numbers are kept at the most, and how many steps; single steps of many runs are not even copied."""


class Claims:
    """What a claimed matrix (n, n, S or 1) says of B steps: diagonal (B, n, S) and form (B, S), e' M^-1 e in the
    leading `states` that the truth has; failed (B, S): the matrix is indefinite or not finite."""

    def __init__(self, room: int, matrix: Array, truth: int, runs: int) -> None:
        self.states = min(len(matrix), truth)
        self.diagonal, self.form = np.empty((room, len(matrix), runs)), np.empty((room, runs))
        self.failed = np.zeros((room, runs), dtype=bool)

    def take(self, steps: slice, vector: Array, truth: Array, matrices: Array) -> None:
        """Matrices (B, n, n, S or 1) of some steps; vector, truth of the same."""
        quadratic_forms(vector, truth, np.ascontiguousarray(matrices), self.states, self.diagonal[steps],
                        self.form[steps], self.failed[steps])


class Stretch:
    """The latest steps of S runs. places (B,): which steps of the world they are; vector (B, n, S): the mean, then the
    parameters, then the truth of what is not estimated; estimated: how many elements are; truth (B, nt, S), NaN where
    unknown; gaps (B,): whether it is anywhere; length, active (B, S). scored (B, nt, S), window (B, S), reference
    (B, 2, S), bound (B, S or 1), diversity (B, S): None where there is none. All of them up to `count`, for reading."""

    def __init__(self, runs: int, nx: int, least: int = 1) -> None:
        """least: room for so many steps at the least; where it is for one, that is not even copied."""
        self.runs, self.nx, self.least, self.count, self.room = runs, nx, least, 0, 0
        self.known: Estimate | None = None
        self.form, self.around = tuple[object, ...](), tuple[object, ...]()
        self.covariance: Claims | None = None
        self.ellipsoid: Claims | None = None

    @property
    def full(self) -> bool:
        return self.count == self.room

    def take(self, k: int, estimate: Estimate, step: Step) -> bool:
        """Keep step k; False, and nothing happens, where it has arrays of other shapes than those before it."""
        if estimate is not self.known:
            if _form(estimate) != self.form:
                return False
            self.known = estimate
        if _around(step) != self.around:
            return False
        b, own = self.count, len(estimate.mean)
        if self.room == 1:  # no copy of many runs: a look at the arrays themselves
            mean, truth = np.ascontiguousarray(estimate.mean), np.ascontiguousarray(step.truth)
            if self.vector.shape[1] > own:
                parameter = () if estimate.parameter is None else (estimate.parameter,)
                mean = np.concatenate([mean, *parameter, truth[self.estimated:]])
            self.vector, self.truth = mean[None], truth[None]
        else:
            self.vector[b, :own], self.truth[b] = estimate.mean, step.truth
            if self.vector.shape[1] > own:
                if estimate.parameter is not None:
                    self.vector[b, own:self.estimated] = estimate.parameter
                self.vector[b, self.estimated:] = step.truth[self.estimated:]
        self.count = b + 1
        this = slice(b, b + 1)
        vector, truth = self.vector[this], self.truth[this]
        self.gaps[b] = has_gaps(truth[0])
        self.places[b], self.active[b], self.length[b] = k, step.active, step.length
        if self.scored is not None:
            self.scored[b] = step.scored
        if self.reference is not None:
            self.reference[b] = step.reference
        if self.window is not None and step.window is not None:
            self.window[b] = step.window
        for claims, matrix in ((self.covariance, estimate.covariance), (self.ellipsoid, estimate.ellipsoid)):
            if claims is not None and matrix is not None:
                claims.take(this, vector, truth, matrix[None])
        if self.bound is not None:
            self.bound[b] = estimate.bound
        if self.diversity is not None:
            self.diversity[b] = estimate.diversity
        return True

    def walk(self, k: int, straight: Straight, walk: Walk, done: int) -> int:
        """Keep steps that were walked at once, of which `done` are kept already: how many there is room for. 0, and
        nothing happens, where they have arrays of other shapes than those before them."""
        if _form(walk.at(-1)) != self.form or _around(straight.last) != self.around:
            return 0
        b, own, count = self.count, walk.mean.shape[1], min(len(straight.truth) - done, self.room - self.count)
        this, part = slice(b, b + count), slice(done, done + count)
        self.count = b + count
        vector, truth = self.vector[this], self.truth[this]
        truth[:] = straight.truth[part]
        vector[:, :own] = walk.mean[part]
        vector[:, own:] = truth[:, own:]
        self.gaps[this] = [has_gaps(one) for one in truth] if has_gaps(truth.reshape(count, -1)) else False
        self.places[this], self.active[this] = np.arange(k + done, k + done + count), straight.active[part]
        self.length[this] = straight.last.length
        if self.scored is not None and straight.scored is not None:
            self.scored[this] = straight.scored[part]
        if self.reference is not None and straight.reference is not None:
            self.reference[this] = straight.reference[part]
        if self.window is not None and straight.window is not None:
            self.window[this] = straight.window[part]
        if self.covariance is not None and walk.covariance is not None:
            self.covariance.take(this, vector, truth, walk.covariance[part])
        if self.bound is not None:
            self.bound[this] = walk.bound
        return count

    def from_place(self, k: int) -> slice:
        """The steps kept from the world's step k on."""
        return slice(int(np.searchsorted(self.places[:self.count], k)), self.count)

    def renew(self, estimate: Estimate, step: Step) -> None:
        """Give up what is kept and make room for steps like this. Raises TypeError for a malformed estimate."""
        runs, nt = self.runs, len(step.truth)
        wrong = misshapen(estimate, self.nx, runs, nt - self.nx)
        if wrong:
            raise TypeError(f"estimate(): {wrong}")
        self.count, self.known, self.form, self.around = 0, estimate, _form(estimate), _around(step)
        self.estimated = len(estimate.mean) + (0 if estimate.parameter is None else len(estimate.parameter))
        nv = max(self.estimated, nt)
        claims = sum(len(matrix) + 1 for matrix in (estimate.covariance, estimate.ellipsoid) if matrix is not None)
        self.room = room = max(self.least, min(LONGEST, ROOM // ((nv + nt + 2 + claims) * runs)))

        def like(value: object, *shape: int, kind: type = float) -> Any:
            return None if value is None else np.empty((room, *shape), dtype=kind)

        self.vector: Array = np.empty((room, nv, runs))
        self.truth: Array = np.empty((room, nt, runs))
        self.places: Index = np.empty(room, dtype=np.int64)
        self.gaps: Mask = np.zeros(room, dtype=bool)
        self.active: Mask = np.empty((room, runs), dtype=bool)
        self.length: Array = np.empty((room, runs))
        self.scored: Mask | None = like(step.scored, nt, runs, kind=bool)
        self.window: NDArray[np.int16] | None = like(step.window, runs, kind=np.int16)
        self.reference: Array | None = like(step.reference, 2, runs)
        self.bound: Array | None = like(estimate.bound, 0 if estimate.bound is None else len(estimate.bound))
        self.diversity: Array | None = like(estimate.diversity, runs)
        self.covariance, self.ellipsoid = (None if matrix is None else Claims(room, matrix, nt, runs)
                                           for matrix in (estimate.covariance, estimate.ellipsoid))


def _form(estimate: Estimate) -> tuple[object, ...]:
    """Shapes and types of an estimate's arrays."""
    return tuple([None if value is None else (getattr(value, "shape", None), getattr(value, "dtype", None))
                  for value in (estimate.mean, estimate.covariance, estimate.parameter, estimate.ellipsoid,
                                estimate.bound, estimate.diversity)])


def everything(count: int) -> Mask:
    """What stands for `Stretch.scored` where all elements of all steps count, (count, 0, 0)."""
    return np.zeros((count, 0, 0), dtype=bool)


def _around(step: Step) -> tuple[object, ...]:
    """What a step has besides."""
    return step.truth.shape, step.scored is None, step.window is None, step.reference is None
