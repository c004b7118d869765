"""The gain of a robust step for one run: by the innovation's matrix and by least squares, against dense algebra."""

from __future__ import annotations

import numpy as np
import pytest
from railstate.estimators.robust import gain, small


@pytest.fixture(autouse=True)
def _plain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Parts of compiled code as plain functions, none of which need be compiled alone."""
    for name in ("_noise", "_root_column", "_careful_gain", "factorise_one", "solve_one"):
        monkeypatch.setattr(gain, name, getattr(gain, name).py_func)


@pytest.mark.parametrize("ellipsoid", [False, True])
@pytest.mark.parametrize("m", [1, 2, 3])
@pytest.mark.parametrize("c2", [0.0, 0.5, 1.0])
def test_the_gain_by_both_ways(ellipsoid: bool, m: int, c2: float, monkeypatch: pytest.MonkeyPatch) -> None:
    rng, n, nw, ny, sigma = np.random.default_rng(5), 3, 2, 3, 0.7
    A, B, g, C = (rng.normal(size=(3, 3)) for _ in range(4))
    L, R, p, M, share = A @ A.T, B @ B.T + np.eye(3), *rng.normal(size=(2, 3)), rng.uniform(0.1, 0.4, 1 + nw + ny)
    g = g[:, :nw]
    S = (L + (np.outer(p, p) / sigma + np.outer(M, M) * (c2 + sigma) if c2 > 0 else 0)) / share[0] + sum(
        np.outer(g[:, w], g[:, w]) / share[1 + w] for w in range(nw))
    noise = np.diag(np.diag(R) / share[1 + nw:]) if ellipsoid else R
    wanted = S @ C[:m].T @ np.linalg.inv(C[:m] @ S @ C[:m].T + noise[:m, :m])

    def found() -> np.ndarray:
        K, V, tall = np.full((n, ny), 9.0), np.full((ny, ny), 9.0), np.full((n + 2 + nw + ny, ny + n), 9.0)
        assert gain.best_gain.py_func(S, L, p, c2, sigma, M, g, C, m, R, share, ellipsoid, V, tall, K)
        assert (K[:, m:] == 9.0).all()
        return K[:, :m]

    np.testing.assert_allclose(found(), wanted, rtol=1e-9, atol=1e-12)
    monkeypatch.setattr(gain, "factorise_one", lambda V, m, least: False)
    np.testing.assert_allclose(found(), wanted, rtol=1e-9, atol=1e-12)


def test_where_there_is_no_gain_and_where_one_way_is_enough() -> None:
    """No noise and no spread: none. A pivot under a hundred-millionth of its entry: by least squares, to the digits
    that the parts have."""
    K, V, tall = np.zeros((1, 2)), np.zeros((2, 2)), np.zeros((7, 3))
    one, none = np.ones((1, 1)), np.zeros((1, 0))
    share, C = np.ones(3), np.ones((2, 1))

    def call(S: float, R: np.ndarray, m: int) -> bool:
        return gain.best_gain.py_func(S * one, S * one, np.zeros(1), 0.0, 1.0, np.zeros(1), none, C, m, R, share, False,
                                      V, tall, K)

    assert not call(0.0, np.zeros((2, 2)), 1) and not call(1.0, np.zeros((2, 2)), 2)
    for least in (1e-7, 1e-9, 1e-18):
        assert call(1.0, np.diag([least, 3 * least]), 2)
        assert K[0] == pytest.approx(np.array([0.75, 0.25]) * 1 / (1 + 0.75 * least), rel=1e-6)


def test_roots_of_semi_definite_matrices() -> None:
    root = np.zeros((3, 3))
    X = np.array([[4.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 9.0]])
    for r in range(3):
        gain._root_column(X, r, 3, root)
    assert root.tolist() == [[2, 0, 0], [1, 0, 0], [0, 0, 3]]
    for pivot, good in ((1.0, True), (2e-13, True), (0.5e-13, False), (-1.0, False)):
        V = np.array([[1.0, 9.0], [1.0, 1.0 + pivot]])
        if pivot > 0:
            V = np.array([[1.0, 9.0], [0.0, 1.0]])
            V[1, 0] = np.sqrt(1 - pivot)
        assert small.factorise_one.py_func(V, 2, small.SMALLEST_PIVOT) == good
