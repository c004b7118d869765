"""The convex problems of Zou et al. 2018 (IEEE T-ITS, doi 10.1109/TITS.2018.2835655): Theorem 1 and Corollary 1.

Numpy in, dataclass out; cvxpy is imported only when a problem is solved. No solution is used that is not "optimal"."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter
from typing import Any, Literal

import numpy as np

from ...scenarios.arrays import Array
from ...scenarios.errors import Infeasible
from .solving import WORST, solve_problem, symmetric, violation

Multipliers = Literal["scalar", "free"]

_LADDER = (1.0, 1e-2, 1e-4)
"""Scales of lambda_1, tried in turn until the solver says "optimal": the same problem, conditioned otherwise.
First-order solvers (SCS) like the last best."""


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
    which exactly one arrives each step, need exact probabilities (spread 0). mirror: orders of states, measurements
    and forces under which the system may be its own mirror image (a train turned around); used where that holds."""

    A: Array
    C: Array
    E: Array
    M: Array
    noise_root: Array
    delta: Array
    nodes: tuple[Node, ...]
    mirror: tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]] | None = None


@dataclass(frozen=True)
class Certificate:
    """E |M e(k)|^2 <= theta^k (..) + bound for gain K (nx, ny), predictor form (eq. (31)), by V = e' P e.

    residual: how far the worst of its matrix inequalities is violated by the P and the gain handed out: the eigenvalue
    on the wrong side over the largest absolute one (0 or below: satisfied to the last digit). seconds: the solver's and
    the modelling time together. status, solver: as the solver tells them."""

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
    if K is not None:
        means = np.zeros(len(system.C))
        for node in system.nodes:
            means[list(node.elements)] = node.mean
        radius = float(np.abs(np.linalg.eigvals(system.A - K @ (means[:, None] * system.C))).max())
        if radius**2 > theta:
            advice = "the gain does not make it fall" if radius > 1 - 1e-9 else "try theta closer to 1"
            raise Infeasible(f"no certificate at theta = {theta:g}: the decay constraint (14) of Theorem 1 fails for "
                             f"this gain, with which the mean error changes by a factor {radius:.6g} a step (spectral "
                             f"radius) and theta must be at least its square; {advice}")
    statuses: list[str] = []
    scales = _LADDER[::-1] if solver == "SCS" else _LADDER
    for ladder in scales:
        form = _Form(system, theta, K, multipliers, ladder)
        status = solve_problem(form.least_bound(), solver)
        if status == "optimal":
            gain = form.settle() if K is None else K
            residual = form.residual()
            if residual < WORST:
                return Certificate(theta, form.value / (1 - theta), gain, form.lyapunov(), solver, status,
                                   perf_counter() - begun, residual)
            status = f"optimal, but its matrix inequalities are violated by {residual:.1e}"
        statuses.append(status)
        if ladder == scales[0]:
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
    model's own coordinates (metres and m/s), as printed. A system with a mirror falls apart into what is symmetric and
    what is antisymmetric under it, which share lambda_1 and lambda_2 only (the average of a solution and its mirror
    image is a solution as good)."""

    def __init__(self, system: ErrorSystem, theta: float, K: Array | None, multipliers: Multipliers,
                 ladder: float) -> None:
        import cvxpy as cp

        self.cp, self.theta = cp, theta
        weights = np.linalg.norm(system.M, axis=0)
        self.t = t = np.where(weights > 0, weights, 1.0)
        free = multipliers == "free"
        C = system.C / t
        self.rows = rows = 1 / np.linalg.norm(C, axis=1)
        root = system.noise_root * rows[:, None]
        self.K = None if K is None else t[:, None] * K / rows
        size = float(np.linalg.norm(system.delta))
        E = t[:, None] * system.E * (system.delta if free else size)
        pushing = np.abs(E).sum(axis=0) > 0
        whole = _Scaled(t[:, None] * system.A / t, C * rows[:, None], E, (system.M / t).T @ (system.M / t),
                        root @ root.T, np.diag(1 / t**2))
        sectors = _sectors(system, whole) if K is None and not free else None
        self.nodes = system.nodes if sectors is None else (_whole(system.nodes[0]),)
        self.bases = sectors or [(np.eye(len(t)), np.eye(len(rows)), np.eye(len(pushing))[:, pushing])]
        self.one: Any = None if free else ladder * cp.Variable(nonneg=True)
        self.two: Any = (cp.Variable(int(pushing.sum()), nonneg=True) if free else cp.Variable(nonneg=True)
                         ) if pushing.any() else 0.0
        self.ladder, self.parts = ladder, []
        self.positive: list[Any] = []  # what must be positive semi-definite besides the LMI itself
        cost: Any = cp.sum(self.two)
        for basis in self.bases:
            part, noise = self._part(whole.within(*basis))
            self.parts.append(part)
            cost = cost + noise
        self.cost: Any = cost

    def _part(self, scaled: _Scaled) -> tuple[_Part, Any]:
        """The LMI of one sector, and its noise term of the objective."""
        cp, K = self.cp, self.K
        A, C, E, (nx, nf) = scaled.A, scaled.C, scaled.E, scaled.E.shape
        P: Any = cp.Variable((nx, nx), symmetric=True, name="P")
        Y: Any = P @ K if K is not None else cp.Variable((nx, len(C)), name="Kcal")
        self.positive.append(P - scaled.MM)
        means = np.zeros(len(C))
        second, noise, arriving, scatter = np.zeros((nx, nx)), 0.0, [], []
        for node in self.nodes:
            own = list(node.elements) or list(range(len(C)))
            means[own] = node.mean
            if K is None:
                W: Any = cp.Variable((len(own), len(own)), symmetric=True, name="W")
                self.positive.append(symmetric(cp.bmat([[W, Y[:, own].T], [Y[:, own], P]])))
                scatter.append((W, own))
            else:
                W = K[:, own].T @ P @ K[:, own]
            arriving.append(C[own].T @ W @ C[own])
            second = second + (node.mean**2 + node.variance) * arriving[-1]
            noise = noise + node.largest * cp.trace(W @ scaled.noise[np.ix_(own, own)])
        drop = Y @ (means[:, None] * C)
        blocks: list[list[Any]] = [[A.T @ P @ A - A.T @ drop - drop.T @ A + second - self.theta * P]]
        forced = [(A.T @ P - drop.T) @ E]
        spread = max(node.spread for node in self.nodes)
        if spread > 0:
            if len(arriving) > 1:
                raise ValueError("several nodes need exact probabilities (spread 0)")
            Lam: Any = None if self.one is None else self.one * scaled.unit
            if Lam is None:
                shape: Any = cp.Variable((nx, nx), symmetric=True)
                self.positive.append(shape)
                Lam = 100 * self.ladder * shape
            hit = Y @ C
            cross = self.nodes[0].mean * arriving[0] - A.T @ hit
            blocks = [[blocks[0][0] + spread**2 * Lam, cross], [cross.T, arriving[0] - Lam]]
            forced.append(-hit.T @ E)
        decay = symmetric(cp.bmat(blocks))
        if nf:
            limit = cp.diag(self.two) if self.one is None else self.two * np.eye(nf)
            blocks = [[*row, block] for row, block in zip(blocks, forced, strict=True)]
            blocks.append([*[block.T for block in forced], E.T @ P @ E - limit])
        return _Part(P, Y, scatter, decay, symmetric(cp.bmat(blocks))), noise

    def least_bound(self) -> Any:
        """Corollary 1 (26), or the same objective for a given gain."""
        return self.cp.Problem(self.cp.Minimize(self.cost), [*self._conditions, *(p.whole << 0 for p in self.parts)])

    @property
    def _conditions(self) -> list[Any]:
        return [matrix >> 0 for matrix in self.positive]

    @property
    def value(self) -> float:
        """The objective (26) at the solution."""
        return float(self.cost.value)

    def least_excess(self, solver: str) -> float:
        """How far the decay constraint is from having a solution: a problem that always has one, so that its answer
        can be trusted where the other's cannot. Forces are left out, since lambda_2 can be as large as it likes.
        -1 (the least allowed) or below 0: it has one; NaN: this problem was not solved either."""
        excess: Any = self.cp.Variable()
        margins = [part.decay << excess * np.eye(part.decay.shape[0]) for part in self.parts]
        problem = self.cp.Problem(self.cp.Minimize(excess), [*self._conditions, *margins, excess >= -1])
        return float(excess.value) if solve_problem(problem, solver) == "optimal" else np.nan

    def settle(self) -> Array:
        """The gain K = P^-1 Kcal, with which Kcal := P K and W := K'P K replace what the solver left: what is checked
        and handed out from now on is what this very gain does."""
        gain = np.zeros((len(self.t), len(self.rows)))
        for part, (U, V, _) in zip(self.parts, self.bases, strict=True):
            P = part.P.value
            K = np.linalg.lstsq(P, part.Y.value)[0]  # a singular P is found by `residual`
            part.Y.value = P @ K
            for W, own in part.scatter:
                root = K[:, own].T @ P @ K[:, own]
                W.value = (root + root.T) / 2
            gain += U @ K @ V.T
        return gain / self.t[:, None] * self.rows

    def residual(self) -> float:
        """The worst violation of the LMIs, of P >= M'M, of the W blocks and of the multipliers' signs."""
        definite = [-part.P.value for part in self.parts]
        return max(map(violation, [*(part.whole.value for part in self.parts), *definite,
                                   *(-matrix.value for matrix in self.positive)]))

    def lyapunov(self) -> Array:
        P = sum(U @ part.P.value @ U.T for part, (U, _, _) in zip(self.parts, self.bases, strict=True))
        return self.t[:, None] * P * self.t


@dataclass(frozen=True)
class _Part:
    """Variables and left-hand sides of one sector; scatter: W of each node, and its measurement elements."""

    P: Any
    Y: Any
    scatter: list[tuple[Any, list[int]]]
    decay: Any
    whole: Any


@dataclass(frozen=True)
class _Scaled:
    """The error system in scaled coordinates; MM = M'M, noise (ny, ny) covariance, unit: I in metres and m/s."""

    A: Array
    C: Array
    E: Array
    MM: Array
    noise: Array
    unit: Array

    def within(self, U: Array, V: Array, F: Array) -> _Scaled:
        """Restricted to the spans of orthonormal bases of states, measurements and forces."""
        return _Scaled(U.T @ self.A @ U, V.T @ self.C @ U, U.T @ self.E @ F, U.T @ self.MM @ U, V.T @ self.noise @ V,
                       U.T @ self.unit @ U)


def _sectors(system: ErrorSystem, scaled: _Scaled) -> list[tuple[Array, Array, Array]] | None:
    """Bases of what is symmetric and antisymmetric under the mirror; None without one, or where it does not hold."""
    if system.mirror is None or len(system.nodes) > 1:
        return None
    x, y, f = (list(order) for order in system.mirror)
    pairs = ((scaled.A, x, x), (scaled.C, y, x), (scaled.E, x, f), (scaled.MM, x, x), (scaled.noise, y, y))
    if any(not np.allclose(m[np.ix_(i, j)], m, rtol=1e-10, atol=1e-13 * np.abs(m).max()) for m, i, j in pairs):
        return None
    return [(_basis(x, sign), _basis(y, sign), _basis(f, sign)) for sign in (1.0, -1.0)]


def _basis(order: list[int], sign: float) -> Array:
    """Orthonormal basis of the vectors v with v[order] = sign v."""
    columns = []
    for i, j in enumerate(order):
        if i < j or (i == j and sign > 0):
            column = np.zeros(len(order))
            column[i] = 1.0
            column[j] = sign if i < j else 1.0
            columns.append(column / np.linalg.norm(column))
    return np.array(columns).T.reshape(len(order), len(columns))


def _whole(node: Node) -> Node:
    """The node, holding whatever elements there are."""
    return Node((), node.mean, node.spread, node.variance, node.largest)
