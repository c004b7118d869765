"""Convex problems handed to a solver, and its answers looked at: no answer is taken on its word.

Shared by Corollary 1 and 2; cvxpy is imported only when a problem is solved."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from ...scenarios.arrays import Array

WORST = 1e-6
"""Violation of a matrix inequality, relative to its largest eigenvalue, at which a solution is none."""


def violation(matrix: Array) -> float:
    """Largest eigenvalue of what must be negative semi-definite, over the largest absolute one."""
    values = np.linalg.eigvalsh(matrix)
    return float(values[-1] / max(np.abs(values).max(), np.finfo(float).tiny)) if np.isfinite(values).all() else np.inf


def symmetric(block: Any) -> Any:
    """The same block matrix, symmetric to the modelling language as well."""
    return (block + block.T) / 2


def solve_problem(problem: Any, solver: str) -> str:
    """Solve a cvxpy problem and return the status; a solver that gives up is a status too, never an exception."""
    from cvxpy.error import SolverError

    options = {"eps_abs": 1e-7, "eps_rel": 1e-7, "max_iters": 30_000} if solver == "SCS" else {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # "may be inaccurate": the status says so, and it is looked at
        try:
            problem.solve(solver=solver, **options)
        except SolverError:
            return "solver_error"
    return str(problem.status)
