"""The convex problems of Zou et al. 2018 (IEEE T-ITS, doi 10.1109/TITS.2018.2835655): Theorem 1 and Corollary 1.

Numpy in, dataclass out; cvxpy is imported only when a problem is solved. No solution is used that is not "optimal"."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from time import perf_counter
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..scenarios.errors import Infeasible

Array = NDArray[np.float64]
Multipliers = Literal["scalar", "free"]

_LADDER = (1.0, 1e-2, 1e-4)
"""Scales of lambda_1, tried in turn until the solver says "optimal": the same problem, conditioned otherwise."""


@dataclass(frozen=True)
class Node:
    """Measurement elements that arrive together, with probability `mean` +- `spread` and variance at most `variance`
    (eqs. (8), (9): pbar, Delta_p bar, p^ + Delta_p^); `largest` bounds the probability (epsilon of eq. (18))."""

    elements: tuple[int, ...]
    mean: float
    spread: float
    variance: float
    largest: float


@dataclass(frozen=True)
class ErrorSystem:
    """e(k+1) = (A - K Pi(k) C) e - K Pi(k) w + E f, z = M e (eq. (11)); Pi(k) selects what arrived at step k.

    A (nx, nx), C (ny, nx), E (nx, nf), M (nz, nx), noise_root (ny, ny) with noise_root noise_root' = cov w, delta (nf,)
    with |f_i| <= delta_i in newtons. nodes: one node holding every element is the paper's packet. Several nodes, of
    which exactly one arrives each step, need exact probabilities (spread 0)."""

    A: Array
    C: Array
    E: Array
    M: Array
    noise_root: Array
    delta: Array
    nodes: tuple[Node, ...]


@dataclass(frozen=True)
class Certificate:
    """E |M e(k)|^2 <= theta^k (..) + bound for gain K (nx, ny), predictor form (eq. (31)), by V = e' P e.

    residual: largest eigenvalue of the solved LMI over its largest absolute one (0 or below: satisfied to the last
    digit). seconds: the solver's and the modelling time together. status, solver: as the solver tells them."""

    theta: float
    bound: float
    K: Array
    P: Array
    solver: str
    status: str
    seconds: float
    residual: float


def packet(p_low: float, p_high: float, ny: int, variance: float | None = None) -> Node:
    """One packet of all ny elements, arriving with a probability in [p_low, p_high] (eqs. (8), (9)).

    variance: largest Prob (1 - Prob) where better known than from the interval (p-persistent CSMA attains it at its
    least N: then mean^2 + variance is the paper's pbar^2 + p^ + Delta_p^)."""
    if variance is None:
        at = min(max(0.5, p_low), p_high)
        variance = at * (1 - at)
    return Node(tuple(range(ny)), (p_low + p_high) / 2, (p_high - p_low) / 2, variance, p_high)


def ultimate_bound(system: ErrorSystem, theta: float, *, multipliers: Multipliers = "scalar",
                   solver: str = "CLARABEL") -> Certificate:
    """Corollary 1: the gain of least certified bound at decay theta. Raises Infeasible.

    multipliers: "scalar" is the paper's lambda_1 I, lambda_2 I; "free" lets the S-procedure use any Lambda_1 >= 0 and a
    diagonal Lambda_2, which is as valid and never worse."""
    return _certificate(system, theta, None, multipliers, solver)


def certify(system: ErrorSystem, K: Array, theta: float, *, multipliers: Multipliers = "scalar",
            solver: str = "CLARABEL") -> Certificate:
    """Theorem 1 as analysis: the least bound that it certifies for the gain K at decay theta. Raises Infeasible."""
    return _certificate(system, theta, np.asarray(K, dtype=float), multipliers, solver)


def _certificate(system: ErrorSystem, theta: float, K: Array | None, multipliers: Multipliers,
                 solver: str) -> Certificate:
    begun = perf_counter()
    statuses: list[str] = []
    for ladder in _LADDER:
        form = _Form(system, theta, K, multipliers, ladder)
        status = solve(form.least_bound(), solver)
        if status == "optimal":
            residual = form.residual()
            if residual < 1e-6:
                gain = form.gain() if K is None else K
                return Certificate(theta, form.value / (1 - theta), gain, form.lyapunov(), solver, status,
                                   perf_counter() - begun, residual)
            status = f"optimal, but its LMI is violated by {residual:.1e}"
        statuses.append(status)
        if ladder == _LADDER[0]:
            excess = _Form(system, theta, K, multipliers, ladder).least_excess(solver)
            if excess > 1e-6:
                what = ("the decay constraint (14) of Theorem 1 fails for this gain" if K is not None else
                        "the decay constraint (23) of Corollary 1 has no solution")
                raise Infeasible(f"no certificate at theta = {theta:g}: {what} (least violation "
                                 f"{excess:.2g}, {solver}); try theta closer to 1, fewer "
                                 "contending trains or a narrower range of reception probabilities")
    raise Infeasible(f"no trustworthy certificate at theta = {theta:g}: {solver} ends with "
                     f"{', '.join(dict.fromkeys(statuses))} on constraints "
                     f"{'(14)' if K is not None else '(23), (24)'} and no gain is taken from that; try theta closer "
                     "to 1 or another solver")


class _Form:
    """Theorem 1 and Corollary 1 as one problem in scaled coordinates, K a variable or given.

    With Kcal = P K and W >= Kcal' P^-1 Kcal every block of (14) is *linear* in (P, Kcal, W, lambda): E (A - K Pi C)' P
    (A - K Pi C) = A'PA - A'Kcal Pbar C - (..)' + sum over nodes of E[alpha^2] C'WC. W enters with positive semidefinite
    weight, so that this is (23) and (24) without a loss, in matrices half the size; Q = Omega' W Omega.
    Coordinates: columns of M scaled to one, rows of C to one, forces by sqrt(sum delta_i^2). lambda_1 I is meant in the
    model's own coordinates (metres and m/s), as printed."""

    def __init__(self, system: ErrorSystem, theta: float, K: Array | None, multipliers: Multipliers,
                 ladder: float) -> None:
        import cvxpy as cp

        self.cp = cp
        weights = np.linalg.norm(system.M, axis=0)
        self.t = t = np.where(weights > 0, weights, 1.0)
        nx, ny, free = len(t), system.C.shape[0], multipliers == "free"
        A, C = t[:, None] * system.A / t, system.C / t
        self.rows = rows = 1 / np.linalg.norm(C, axis=1)
        C, root, M = C * rows[:, None], system.noise_root * rows[:, None], system.M / t
        size = float(np.linalg.norm(system.delta))
        E = t[:, None] * system.E * (system.delta if free else size)
        pushed = np.flatnonzero(np.abs(E).sum(axis=0))
        E = E[:, pushed]
        means = np.zeros(ny)
        for node in system.nodes:
            means[list(node.elements)] = node.mean
        P: Any = cp.Variable((nx, nx), symmetric=True)
        Y: Any = P @ (t[:, None] * K / rows) if K is not None else cp.Variable((nx, ny))
        conditions: list[Any] = [P >> M.T @ M]
        second, noise = np.zeros((nx, nx)), 0.0
        arriving: list[Any] = []
        for node in system.nodes:
            own = list(node.elements)
            Ci, Oi = C[own], root[own]
            if K is None:
                W: Any = cp.Variable((len(own), len(own)), symmetric=True)
                conditions.append(cp.bmat([[W, Y[:, own].T], [Y[:, own], P]]) >> 0)
            else:
                Ki = (t[:, None] * K / rows)[:, own]
                W = Ki.T @ P @ Ki
            arriving.append(Ci.T @ W @ Ci)
            second = second + (node.mean**2 + node.variance) * arriving[-1]
            noise = noise + node.largest * cp.trace(Oi.T @ W @ Oi)
        drop = Y @ (means[:, None] * C)
        blocks: list[list[Any]] = [[A.T @ P @ A - A.T @ drop - drop.T @ A + second - theta * P]]
        spread = max(node.spread for node in system.nodes)
        if spread > 0:
            if len(arriving) > 1:
                raise ValueError("several nodes need exact probabilities (spread 0)")
            if free:
                shape: Any = cp.Variable((nx, nx), symmetric=True)
                conditions.append(shape >> 0)
                Lam: Any = 100 * ladder * shape
            else:
                Lam = ladder * cp.Variable(nonneg=True) * np.diag(1 / t**2)
            mean, hit = system.nodes[0].mean, Y @ C
            cross = mean * arriving[0] - A.T @ hit
            blocks[0][0] = blocks[0][0] + spread**2 * Lam
            blocks[0].append(cross)
            blocks.append([cross.T, arriving[0] - Lam])
        self.decay = symmetric(cp.bmat(blocks))
        two: Any = 0.0
        if len(pushed):
            two = cp.Variable(len(pushed), nonneg=True) if free else cp.Variable(nonneg=True)
            side = [(A.T @ P - drop.T) @ E] + ([-(Y @ C).T @ E] if spread > 0 else [])
            for row, block in zip(blocks, side, strict=True):
                row.append(block)
            limit = cp.diag(two) if free else two * np.eye(len(pushed))
            blocks.append([*[block.T for block in side], E.T @ P @ E - limit])
            two = cp.sum(two)
        self.whole = symmetric(cp.bmat(blocks))
        self.P, self.Y, self.conditions = P, Y, conditions
        self.cost: Any = noise + two

    def least_bound(self) -> Any:
        """Corollary 1 (26), or the same objective for a given gain."""
        return self.cp.Problem(self.cp.Minimize(self.cost), [*self.conditions, self.whole << 0])

    @property
    def value(self) -> float:
        """The objective (26) at the solution."""
        return float(self.cost.value)

    def least_excess(self, solver: str) -> float:
        """How far the decay constraint is from having a solution: a problem that always has one, so that its answer
        can be trusted where the other's cannot. Forces are left out, since lambda_2 can be as large as it likes.
        -1 (the least allowed) or below 0: it has one; NaN: this problem was not solved either."""
        excess: Any = self.cp.Variable()
        margin = excess * np.eye(self.decay.shape[0])
        problem = self.cp.Problem(self.cp.Minimize(excess), [*self.conditions, self.decay << margin, excess >= -1])
        return float(excess.value) if solve(problem, solver) == "optimal" else np.nan

    def residual(self) -> float:
        values = np.linalg.eigvalsh(self.whole.value)
        return float(values[-1] / np.abs(values).max())

    def gain(self) -> Array:
        return np.linalg.solve(self.P.value, self.Y.value) / self.t[:, None] * self.rows

    def lyapunov(self) -> Array:
        return self.t[:, None] * self.P.value * self.t


def symmetric(block: Any) -> Any:
    """The same block matrix, symmetric to the modelling language as well."""
    return (block + block.T) / 2


def solve(problem: Any, solver: str) -> str:
    """Solve a cvxpy problem and return the status; a solver that gives up is a status too, never an exception."""
    from cvxpy.error import SolverError

    options = {"eps_abs": 1e-9, "eps_rel": 1e-9, "max_iters": 200_000} if solver == "SCS" else {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # "may be inaccurate": the status says so, and it is looked at
        try:
            problem.solve(solver=solver, **options)
        except SolverError:
            return "solver_error"
    return str(problem.status)
