"""Fastest decay under a given bound (Corollary 2 of Zou et al. 2018, and by bisection), and the trade-off of the two.

Built on the problems of `lmi`; no solution is used that is not "optimal"."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from ...scenarios.arrays import Array
from ...scenarios.errors import Infeasible
from .lmi import Certificate, ErrorSystem, Multipliers, ultimate_bound
from .solving import WORST, solve_problem, symmetric, violation

SLOWER, FASTER = (0.985, 0.99, 0.995, 0.999, 0.9999), (0.97, 0.95, 0.9, 0.8, 0.6, 0.3)
"""Decays tried in turn from 0.98 on: until the bound is kept, until it no longer is."""


def fastest_decay(system: ErrorSystem, varpi: float, *, multipliers: Multipliers = "scalar",
                  tolerance: float = 5e-4, solver: str = "CLARABEL") -> Certificate:
    """Least theta at which Corollary 1 certifies a bound of at most varpi, by bisection to `tolerance`.

    The problem of Corollary 2 without its relaxation R'R >= rho (R + R' - rho I). The least bound falls and rises again
    over theta; where no decay tried keeps varpi, the decay of the least bound is sought. Raises Infeasible."""
    begun = perf_counter()
    found: dict[float, Certificate] = {}

    def bound(theta: float) -> float:
        """The least certified bound, infinite where there is none."""
        try:
            found[theta] = ultimate_bound(system, theta, multipliers=multipliers, solver=solver)
        except Infeasible:
            return np.inf
        return found[theta].bound

    low, high = 0.0, 0.98
    if bound(high) <= varpi:
        for theta in FASTER:
            if bound(theta) > varpi:
                low = theta
                break
            high = theta
    else:
        for theta in SLOWER:
            low, high = high, theta
            if bound(high) <= varpi:
                break
        else:
            low, high = _at_least(bound, found, tolerance)
    if high not in found or found[high].bound > varpi:
        reached = (f"the least bound found is {found[high].bound:.6g} at theta = {high:.6g}" if high in found else
                   "no decay up to 0.9999 has a certificate")
        raise Infeasible(f"no decay keeps the certified bound under varpi = {varpi:g} (constraint (33) of Corollary "
                         f"2): {reached}; try a larger varpi, a smaller delta or fewer contending trains")
    while high - low > tolerance:
        middle = (low + high) / 2
        low, high = (low, middle) if bound(middle) <= varpi else (middle, high)
    return replace(found[high], seconds=perf_counter() - begun)


def _at_least(bound: Callable[[float], float], found: Mapping[float, Certificate],
              tolerance: float) -> tuple[float, float]:
    """(a decay below, the decay of the least bound), from the decays tried so far on; (0, 1) without a certificate."""
    from scipy.optimize import minimize_scalar

    tried = (0.0, 0.98, *SLOWER, 1.0)
    place = min((theta for theta in tried if theta in found), key=lambda theta: found[theta].bound, default=None)
    if place is None:
        return 0.0, 1.0
    index = tried.index(place)
    minimize_scalar(lambda theta: min(bound(theta), 1e300), bounds=(tried[index - 1], tried[index + 1]),
                    method="bounded", options={"xatol": tolerance / 10})
    return tried[index - 1], min(found, key=lambda theta: found[theta].bound)


@dataclass(frozen=True)
class Decay:
    """Corollary 2's optimum: V = e' R' R e falls by 1 / gamma_bar a step, K (nx, ny) in the system's coordinates."""

    gamma_bar: float
    K: Array
    solver: str
    status: str
    seconds: float


def corollary2(system: ErrorSystem, varpi: float, T: Array, *, solver: str = "CLARABEL") -> Decay:
    """Corollary 2, eqs. (32) to (35), in the coordinates T e (T (nx, nx), nonsingular; the identity is the paper's).

    Its relaxation -R'R / gamma <= gamma I - R - R' needs a Lyapunov function near gamma^2 I, so with these data it is
    feasible only in coordinates such as T = P^(1/2) of a Corollary 1 solution. (33)'s Schur complement is written as
    the sum of squares that it is. Single-packet systems only. Raises Infeasible."""
    import cvxpy as cp

    begun = perf_counter()
    (node,) = system.nodes
    inverse = np.linalg.inv(T)
    nx, nf = system.E.shape
    size = float(np.linalg.norm(system.delta))
    A, E, M = T @ system.A @ inverse, T @ system.E * size, system.M @ inverse
    rows = 1 / np.linalg.norm(system.C @ inverse, axis=1)
    C, root = (system.C @ inverse) * rows[:, None], system.noise_root * rows[:, None]
    R, Y = cp.Variable((nx, nx)), cp.Variable((nx, C.shape[0]))
    one, two, rho = cp.Variable(nonneg=True), cp.Variable(nonneg=True), cp.Variable(nonneg=True)
    gamma = cp.Variable()
    eye, zero = np.eye, np.zeros
    corner = gamma * eye(nx) - R - R.T + node.spread**2 * one * eye(nx)
    drift, drop, push = R @ A - node.mean * (Y @ C), Y @ C, R @ E
    scatter = node.variance**0.5 * drop
    lmi = symmetric(cp.bmat([
        [corner, zero((nx, nx)), zero((nx, nf)), drift.T, scatter.T],
        [zero((nx, nx)), -one * eye(nx), zero((nx, nf)), -drop.T, zero((nx, nx))],
        [zero((nf, nx)), zero((nf, nx)), -two * eye(nf), push.T, zero((nf, nx))],
        [drift, -drop, push, -eye(nx), zero((nx, nx))],
        [scatter, zero((nx, nx)), zero((nx, nf)), zero((nx, nx)), -eye(nx)],
    ]))
    weight = symmetric(cp.bmat([[rho * eye(nx) - R - R.T, gamma * M.T], [gamma * M, -rho * eye(M.shape[0])]]))
    noise = node.largest * cp.sum_squares(Y @ root)
    problem = cp.Problem(cp.Maximize(gamma), [lmi << 0, weight << 0, noise + two <= varpi * (gamma - 1)])
    status = solve_problem(problem, solver)
    if status != "optimal" or R.value is None or Y.value is None or gamma.value is None:
        raise Infeasible(f"Corollary 2 has no solution at varpi = {varpi:g} in these coordinates ({solver}: {status}; "
                         "constraints (32) to (34)); try T = P^(1/2) of a Corollary 1 solution, or a larger varpi")
    worst = max(violation(lmi.value), violation(weight.value))
    if worst > WORST:
        raise Infeasible(f"Corollary 2: {solver} says optimal, but constraints (32), (34) are violated by {worst:.1e}")
    K = inverse @ np.linalg.solve(R.value, Y.value) * rows
    return Decay(float(gamma.value), K, solver, status, perf_counter() - begun)


def trade_off(system: ErrorSystem, thetas: list[float], *, multipliers: Multipliers = "scalar",
              solver: str = "CLARABEL") -> list[tuple[float, Certificate | Infeasible]]:
    """Certified bound of Corollary 1 against decay: (theta, certificate), or the reason why there is none."""
    rows: list[tuple[float, Certificate | Infeasible]] = []
    for theta in thetas:
        try:
            rows.append((theta, ultimate_bound(system, theta, multipliers=multipliers, solver=solver)))
        except Infeasible as reason:
            rows.append((theta, reason))
    return rows
