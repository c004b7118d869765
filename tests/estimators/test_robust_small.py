"""Small dense linear algebra of the robust filters against NumPy: inverses by pivoting, how far a step contracts."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from railstate.estimators.robust import small


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_inverses(n: int) -> None:
    """Of every permutation, where each pivot has to be looked for, and the same with all else filled; not of others."""
    rng, invert = np.random.default_rng(n), small.invert.py_func
    inverse, work = np.empty((n, n)), np.empty((n, n))
    for order in itertools.permutations(range(n)):
        for C in (np.eye(n)[list(order)], 3e5 * np.eye(n)[list(order)] + rng.normal(size=(n, n))):
            assert invert(C, n, inverse, work)
            np.testing.assert_allclose(inverse, np.linalg.inv(C), rtol=1e-12, atol=1e-16)
    for bad in (np.zeros((n, n)), np.full((n, n), np.nan), np.ones((n, n)) if n > 1 else np.zeros((1, 1))):
        assert not invert(bad, n, inverse, work)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_contractions(n: int) -> None:
    """The greater of both sides of what is not known; one side alone is not enough."""
    rng, both = np.random.default_rng(n), set()
    for _ in range(20):
        G, A, M, N = rng.normal(size=(n, n)), rng.normal(size=(n, n)), rng.normal(size=n), rng.normal(size=n)
        sides = [np.linalg.norm(G @ (A + sign * np.outer(M, N)), 2) ** 2 for sign in (1.0, -1.0)]
        found = small.contraction(G, A, M, N, np.empty((n, n)), np.empty((n, n)))
        assert found == pytest.approx(max(sides), rel=1e-12)
        both.add(int(np.argmax(sides)))
        one = np.where(np.arange(n) == n - 1, N, 0.0)  # of which the last element alone is not 0
        assert small.contraction(G, A, M, one, np.empty((n, n)), np.empty((n, n))) == pytest.approx(max(
            np.linalg.norm(G @ (A + sign * np.outer(M, one)), 2) ** 2 for sign in (1.0, -1.0)), rel=1e-12)
    assert both == {0, 1}
