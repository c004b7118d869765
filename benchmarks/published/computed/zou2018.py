"""Zou, Wen, Wang, Chen, Roberts 2018: the printed gain against the optimum, Corollaries 1 and 2, claims of the scheme.

The convex problems are solved where the numbers are made, not in the runs."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from ....estimators.ultimate_bound.decay import corollary2
from ....estimators.ultimate_bound.gains import read_gain
from ....estimators.ultimate_bound.lmi import Certificate, ErrorSystem, certify, ultimate_bound
from ....estimators.ultimate_bound.system import error_system
from ....scenarios.errors import Infeasible
from ..rows import Book, Found, ratio
from .base import Computation, model_of

CARS = "cbtc-csma"
SCHEME, DIRECT = "ultimate-bound-published", "direct"


def _system(forces: str) -> ErrorSystem:
    """With Remark 2's delta_i ("remark-2"), or where the noise counts for nothing beside the forces ("dominant")."""
    system = error_system(model_of(CARS, "uniform", (("time.steps", 2),)))
    return replace(system, noise_root=0 * system.noise_root) if forces == "dominant" else system


@cache
def _certificates(forces: str) -> tuple[Certificate, Certificate]:
    """Corollary 1's optimum at theta = .98, and Theorem 1 of the printed gain."""
    return ultimate_bound(_system(forces), 0.98), certify(_system(forces), read_gain("zou2018_gain.csv"), 0.98)


def zou_excess(book: Book, forces: str) -> Found:
    """Certified bound of the printed gain over our least one."""
    ours, printed = _certificates(forces)
    return Found(printed.bound / ours.bound)


def zou_distance(book: Book, forces: str, columns: str) -> Found:
    """Relative Frobenius distance of our gain from the printed one, in its position or velocity columns."""
    part = slice(0, 6) if columns == "position" else slice(6, None)
    printed = read_gain("zou2018_gain.csv")[:, part]
    return Found(float(np.linalg.norm(_certificates(forces)[0].K[:, part] - printed) / np.linalg.norm(printed)))


def zou_solvable(book: Book) -> Found:
    """1 where Corollary 1 has a solution at theta = .98, its matrix inequalities looked at; else 0."""
    try:
        return Found(float(_certificates("remark-2")[0].bound < np.inf))
    except Infeasible:
        return Found(0.0)


def zou_decay(book: Book) -> Found:
    """The greatest gamma_bar that Corollary 2's (32) alone admits; a decay needs more than 1."""
    return Found(corollary2(_system("remark-2"), None).gamma_bar)


def headway_ratio(book: Book, variant: str) -> Found:
    """Headway of the scheme over that of direct measurements, the greatest of the four speeds."""
    found = [ratio(*(book.values(CARS, variant, label, "headway", f"headway-{speed}") for label in (SCHEME, DIRECT)))
             for speed in (65, 81, 97, 113)]
    return max(found, key=lambda one: one.value)


def bound_share(book: Book, variant: str, estimator: str) -> Found:
    """Mean square of the weighted error over the bound that is certified for it."""
    measured, bound = (book.values(CARS, variant, estimator, metric, "performance") for metric in
                       ("mean-square", "bound"))
    return ratio(measured, bound)


COMPUTATIONS = {
    "zou_excess": Computation(zou_excess),
    "zou_distance": Computation(zou_distance),
    "zou_solvable": Computation(zou_solvable),
    "zou_decay": Computation(zou_decay),
    "headway_ratio": Computation(headway_ratio, lambda variant: [(CARS, variant, label) for label in (SCHEME, DIRECT)]),
    "bound_share": Computation(bound_share, lambda variant, estimator: [(CARS, variant, estimator)]),
}
