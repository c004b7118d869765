"""Fastest decay under a given bound (Corollary 2 of Zou et al. 2018, and by bisection), and the trade-off of the two.

Built on the problems of `lmi`; no solution is used that is not "optimal"."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

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
    """Corollary 2's optimum: V = e' P e falls by 1 / gamma_bar a step; K (nx, ny), P (nx, nx) in the system's own
    coordinates. residual, seconds: as of a `Certificate`."""

    gamma_bar: float
    K: Array
    P: Array
    solver: str
    status: str
    residual: float
    seconds: float


def corollary2(system: ErrorSystem, varpi: float | None, T: Array | None = None, *, solver: str = "CLARABEL") -> Decay:
    """Corollary 2, eqs. (32) to (35), in the coordinates T e (T (nx, nx), nonsingular; None: the paper's own).

    varpi None: the greatest gamma_bar that (32) alone admits, without the bound of (33), (34). A decay needs
    gamma_bar > 1. Its relaxation -R'R / gamma <= gamma I - R - R' needs a Lyapunov function near gamma^2 I, so with the
    paper's data it is feasible only in coordinates such as T = P^(1/2) of a Corollary 1 solution. (33)'s Schur
    complement is written as the sum of squares that it is. Single-packet systems only. Raises Infeasible."""
    import cvxpy as cp

    begun = perf_counter()
    (node,) = system.nodes
    nx, nf = system.E.shape
    T = np.eye(nx) if T is None else T
    inverse = np.linalg.inv(T)
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
    limits = [lmi << 0]
    checked: list[Any] = [lmi]
    if varpi is not None:
        checked.append(symmetric(cp.bmat([[rho * eye(nx) - R - R.T, gamma * M.T], [gamma * M, -rho * eye(len(M))]])))
        limits += [checked[1] << 0, node.largest * cp.sum_squares(Y @ root) + two <= varpi * (gamma - 1)]
    problem = cp.Problem(cp.Maximize(gamma), limits)
    status = solve_problem(problem, solver)
    if status != "optimal" or R.value is None or Y.value is None or gamma.value is None:
        raise Infeasible(f"Corollary 2 has no solution at varpi = {varpi:g} in these coordinates ({solver}: {status}; "
                         "constraints (32) to (34)); try T = P^(1/2) of a Corollary 1 solution, or a larger varpi"
                         if varpi else f"Corollary 2: (32) alone is not solved ({solver}: {status})")
    worst = max(violation(matrix.value) for matrix in checked)
    if worst > WORST:
        raise Infeasible(f"Corollary 2: {solver} says optimal, but constraints (32), (34) are violated by {worst:.1e}")
    K = inverse @ np.linalg.solve(R.value, Y.value) * rows
    V = R.value @ T
    return Decay(float(gamma.value), K, V.T @ V, solver, status, worst, perf_counter() - begun)


def printed_decay(system: ErrorSystem, varpi: float, *, solver: str = "CLARABEL") -> Certificate:
    """Corollary 2 as it is printed. Raises Infeasible, which says what (32) alone admits: with the paper's data it has
    no solution, whatever varpi and delta are."""
    try:
        found = corollary2(system, varpi, solver=solver)
    except Infeasible as reason:
        greatest = corollary2(system, None, solver=solver).gamma_bar
        raise Infeasible(f"{reason}; (32) alone admits gamma_bar = {greatest:.4g} at most, and a decay needs more "
                         "than 1") from None
    return Certificate(1 / found.gamma_bar, varpi, found.K, found.P, solver, found.status, found.seconds,
                       found.residual)


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
