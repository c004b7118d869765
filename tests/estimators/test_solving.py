"""What a convex solver answers is looked at, whatever it says of itself; a problem is halved where it has a mirror."""

from __future__ import annotations

import warnings
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from cvxpy.error import SolverError
from railstate.estimators.ultimate_bound import lmi
from railstate.estimators.ultimate_bound.solving import solve_problem, symmetric, violation


class Doubtful:
    """A problem as cvxpy has it, whose solver is not sure."""

    status = "optimal_inaccurate"

    def __init__(self, error: type[Exception] | None = None) -> None:
        self.error, self.asked = error, dict[str, Any]()

    def solve(self, **asked: Any) -> None:
        self.asked = asked
        warnings.warn("Solution may be inaccurate.", stacklevel=1)
        if self.error:
            raise self.error("gave up")


@pytest.mark.filterwarnings("error")
def test_what_a_solver_says_is_a_status_never_a_warning_or_an_exception() -> None:
    problem = Doubtful()
    assert solve_problem(problem, "CLARABEL") == "optimal_inaccurate" and problem.asked == {"solver": "CLARABEL"}
    assert solve_problem(Doubtful(SolverError), "SCS") == "solver_error"
    with pytest.raises(KeyError):
        solve_problem(Doubtful(KeyError), "SCS")


def test_how_far_a_matrix_is_from_negative_semi_definite() -> None:
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    for values, expected in (([-4.0, -2.0, -1.0], -0.25), ([-4.0, -2.0, 1.0], 0.25), ([3.0, 5.0, 8.0], 1.0)):
        assert violation(turn @ np.diag(values) @ turn.T) == pytest.approx(expected)
    assert violation(np.zeros((2, 2))) == 0.0 and violation(np.full((2, 2), np.inf)) == np.inf
    np.testing.assert_array_equal(symmetric(np.array([[1.0, 4.0], [2.0, 3.0]])), [[1.0, 3.0], [3.0, 3.0]])


def test_a_mirror_holds_to_rounding_or_not_at_all() -> None:
    """However small the numbers are: what is symmetric is found by its own size."""
    order: Any = ((1, 0), (1, 0), (1, 0))
    even, system = np.array([[2.0, 1.0], [1.0, 2.0]]), SimpleNamespace(mirror=order, nodes=[1])
    for scale in (1.0, 1e-9):
        bases = lmi._sectors(system, lmi._Scaled(*[scale * even] * 6))  # pyright: ignore
        assert bases is not None and [[basis.shape for basis in sector] for sector in bases] == [[(2, 1)] * 3] * 2
        for broken in range(5):
            parts = [scale * even for _ in range(6)]
            parts[broken] = scale * (even + np.diag([1e-6, 0.0]))
            assert lmi._sectors(system, lmi._Scaled(*parts)) is None  # pyright: ignore
    for other in (SimpleNamespace(mirror=None, nodes=[1]), SimpleNamespace(mirror=order, nodes=[1, 2])):
        assert lmi._sectors(other, lmi._Scaled(*[even] * 6)) is None  # pyright: ignore
