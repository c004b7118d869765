"""The robust estimators' convex problems as the page writes them, in cvxpy: the reference the fast forms answer to.

Parametrised so that cvxpy compiles each problem once (DPP); one step of one run is then a few milliseconds."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import cvxpy as cp
import numpy as np

from ...scenarios.arrays import Array, Mask

REFINED = {"iterative_refinement_max_iter": 50, "iterative_refinement_reltol": 1e-15}
ATTEMPTS = tuple((tolerance, refinement) for tolerance in (1e-10, 1e-8, 1e-6) for refinement in ({}, REFINED))
"""Tolerances asked of Clarabel, in turn, where rounding stops it short of the sharper one, each also with its linear
systems solved more exactly. Less is no solution."""


@dataclass(frozen=True)
class Solution:
    """K (nx, ny), P (nx, nx), the objective (tr P, or tr P + tr Th for F1) and cvxpy's status; NaN without solution."""

    K: Array
    P: Array
    objective: float
    status: str


class _Problem:
    """What the three share: parameters for G A, G B, G M as affine functions of K, and the solver call."""

    def __init__(self, nx: int, nw: int, ny: int) -> None:
        self.nx, self.nw, self.ny = nx, nw, ny
        self.AE, self.CAE = cp.Parameter((nx, nx)), cp.Parameter((ny, nx))
        self.B, self.CB = cp.Parameter((nx, nw)), cp.Parameter((ny, nw))
        self.M, self.CM = cp.Parameter((nx, 1)), cp.Parameter((ny, 1))
        self.D, self.NN = cp.Parameter((ny, ny)), cp.Parameter((nx, nx), PSD=True)
        self.K, self.P = cp.Variable((nx, ny)), cp.Variable((nx, nx), symmetric=True)
        self.GAE = self.AE - self.K @ self.CAE
        self.GB = self.B - self.K @ self.CB
        self.GM = self.M - self.K @ self.CM
        self.problem: Any = None

    def _set(self, A: Array, E: Array, M: Array, N: Array, B: Array, C: Array, D: Array) -> None:
        EN = E.T @ N
        for parameter, value in ((self.AE, A @ E), (self.CAE, C @ A @ E), (self.B, B), (self.CB, C @ B),
                                 (self.M, M[:, None]), (self.CM, (C @ M)[:, None]), (self.D, D),
                                 (self.NN, np.outer(EN, EN))):
            parameter.value = value

    def _solve(self) -> Solution:
        status = ""
        for tolerance, refinement in ATTEMPTS:
            goals = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), tolerance)
            try:
                with warnings.catch_warnings():
                    warnings.filterwarnings("ignore", "Solution may be inaccurate")
                    # A warm start would keep the first step's scaling: results would depend on what was solved before.
                    self.problem.solve(solver=cp.CLARABEL, warm_start=False, **goals, **refinement)
                status = str(self.problem.status)
            except cp.SolverError:
                status = "solver error"
            if status in (cp.OPTIMAL, cp.INFEASIBLE, cp.UNBOUNDED):
                break
        if status != cp.OPTIMAL or self.K.value is None or self.P.value is None:
            gap = np.full((self.nx, self.nx), np.nan)
            return Solution(np.full((self.nx, self.ny), np.nan), gap, np.nan, status)
        P = np.asarray(self.P.value)
        return Solution(np.asarray(self.K.value), 0.5 * (P + P.T), float(self.problem.value), status)


class RecursiveProblem(_Problem):
    """F3 (mean square), or F2 with `ellipsoid`: min tr P subject to the page's matrix inequality.

    Every disturbance channel has its own multiplier (|w_i| <= w_bar_i each), as has every sensor in F2."""

    def __init__(self, nx: int, nw: int, ny: int, ellipsoid: bool) -> None:
        super().__init__(nx, nw, ny)
        te, t4, tw = cp.Variable(nonneg=True), cp.Variable((1, 1), nonneg=True), cp.Variable(nw, nonneg=True)
        noise, shares = np.eye(ny), te + cp.sum(tw)
        if ellipsoid:
            tv = cp.Variable(ny, nonneg=True)
            noise, shares = cp.diag(tv), shares + cp.sum(tv)
        o = np.zeros
        block = cp.bmat([
            [self.P, self.GAE, self.GB, -self.K @ self.D, self.GM],
            [self.GAE.T, te * np.eye(nx) - t4[0, 0] * self.NN, o((nx, nw)), o((nx, ny)), o((nx, 1))],
            [self.GB.T, o((nw, nx)), cp.diag(tw), o((nw, ny)), o((nw, 1))],
            [-(self.K @ self.D).T, o((ny, nx)), o((ny, nw)), noise, o((ny, 1))],
            [self.GM.T, o((1, nx)), o((1, nw)), o((1, ny)), t4]])
        self.problem = cp.Problem(cp.Minimize(cp.trace(self.P)), [0.5 * (block + block.T) >> 0, shares <= 1])

    def solve(self, Pi: Array, A: Array, M: Array, N: Array, g: Array, C: Array, R: Array, received: Mask) -> Solution:
        """Pi, A (nx, nx); M, N (nx,), N with its kappa; g (nx, nw); C (ny, nx); R (ny, ny): the noise's second moments
        (F3) or diag(v_bar^2) (F2); received (ny,) bool. Rows not received are told apart from the truth by C = 0."""
        values, vectors = np.linalg.eigh(Pi)
        E = vectors * np.sqrt(np.maximum(values, 0.0))
        self._set(A, E, M, N, g, *_received(C, R, received))
        return _cleared(self._solve(), received)


class BoundedProblem(_Problem):
    """F1: min tr P + tr Th subject to the page's matrix inequality and P << mu I."""

    def __init__(self, nx: int, nw: int, ny: int, mu: float) -> None:
        super().__init__(nx, nw, ny)
        eps, inputs, o = cp.Variable((1, 1), nonneg=True), nw + ny, np.zeros
        Th, Ga = cp.Variable((inputs, inputs), symmetric=True), cp.Variable((nx, inputs))
        X = cp.hstack([self.GB, -self.K @ self.D])
        block = cp.bmat([
            [np.eye(nx), self.GAE, X, self.GM],
            [self.GAE.T, self.P - eps[0, 0] * self.NN, Ga, o((nx, 1))],
            [X.T, Ga.T, Th, o((inputs, 1))],
            [self.GM.T, o((1, nx)), o((1, inputs)), eps]])
        objective = cp.trace(self.P) + cp.trace(Th)
        self.problem = cp.Problem(cp.Minimize(objective), [0.5 * (block + block.T) >> 0, mu * np.eye(nx) >> self.P])

    def solve(self, A: Array, M: Array, N: Array, B: Array, D: Array, C: Array, received: Mask) -> Solution:
        """A (nx, nx); M, N (nx,), N with its kappa; B (nx, nw) channels times bounds; D (ny,) sensor bounds;
        C (ny, nx); received (ny,) bool, at least one of them true."""
        self._set(A, np.eye(self.nx), M, N, B, *_received(C, np.diag(D**2), received))
        return _cleared(self._solve(), received)


def _received(C: Array, R: Array, received: Mask) -> tuple[Array, Array]:
    """C and a root of R with the missing rows made useless: C = 0 and unit noise, so that their gain costs and is 0."""
    both = received[:, None] & received[None, :]
    values, vectors = np.linalg.eigh(np.where(both, R, np.eye(len(R))))
    root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    return np.where(received[:, None], C, 0.0), root


def _cleared(solution: Solution, received: Mask) -> Solution:
    solution.K[:, ~received] = 0.0
    return solution
