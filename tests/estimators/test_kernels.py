"""The compiled kernels against NumPy one run at a time: values, failures, and bits that do not depend on the batch."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from decimal import Decimal, localcontext

import numpy as np
import pytest
from numpy.typing import NDArray
from railstate.estimators.kernels import core as kernels
from railstate.estimators.kernels import modes, particles
from railstate.estimators.kernels.kalman import in_turn, kalman_update, shared_kalman_update
from railstate.estimators.kernels.riccati import covariance_update
from railstate.scenarios.model import product
from scipy.stats import norm

Array = NDArray[np.float64]
SIZES = [1, 2, 3, 7]
RUNS = 601  # more than one tile from four states on


def draw(*shape: int) -> Array:
    return np.random.default_rng(sum(shape)).normal(size=shape)


def positive(n: int, runs: int = RUNS) -> Array:
    root = draw(n, n + 1, runs)
    return np.einsum("iks,jks->ijs", root, root).copy()


def each(function: Callable[..., Array], *arrays: Array) -> Array:
    """NumPy's answer, run by run; arrays with a last axis of 1 are shared."""
    runs = max(array.shape[-1] for array in arrays)
    return np.stack([function(*(array[..., min(s, array.shape[-1] - 1)] for array in arrays)) for s in range(runs)],
                    axis=-1)


@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize("shared", [True, False])
def test_products(n: int, shared: bool) -> None:
    width = 1 if shared else RUNS
    f, p, q, x = draw(n + 1, n, width), positive(n), positive(n + 1, width), draw(n, RUNS)
    out = np.empty((n + 1, n + 1, RUNS))
    kernels.congruence(f, p, q, out)
    np.testing.assert_allclose(out, each(lambda f, p, q: f @ p @ f.T + q, f, p, q), rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(out, out.swapaxes(0, 1))
    moved = np.empty((n + 1, RUNS))
    kernels.apply(f, x, moved)
    np.testing.assert_allclose(moved, each(np.matmul, f, x), rtol=1e-12, atol=1e-12)


def test_congruence_in_place() -> None:
    f, p, q = draw(5, 5, RUNS), positive(5), positive(5, 1)
    out = np.empty_like(p)
    kernels.congruence(f, p, q, out)
    kernels.congruence(f, p, q, p)
    np.testing.assert_array_equal(p, out)


@pytest.mark.parametrize("n", SIZES)
def test_cholesky(n: int) -> None:
    p, failed = positive(n), np.zeros(RUNS, dtype=bool)
    factor = np.empty_like(p)
    assert kernels.cholesky(p, factor, failed) == 0
    np.testing.assert_allclose(factor, each(np.linalg.cholesky, p), rtol=1e-9, atol=1e-12)
    assert not failed.any()


def test_cholesky_of_singular_and_indefinite() -> None:
    """Rank one and zero are factored, an indefinite or NaN run fails alone."""
    v = np.array([1.0, 2.0, -3.0])
    p = np.stack([np.eye(3), np.outer(v, v), np.zeros((3, 3)), np.diag([1.0, -1e-3, 1.0]), np.full((3, 3), np.nan)],
                 axis=-1).copy()
    factor, failed = np.empty_like(p), np.zeros(5, dtype=bool)
    assert kernels.cholesky(p, factor, failed) == 2
    assert failed.tolist() == [False, False, False, True, True]
    np.testing.assert_allclose(each(lambda l: l @ l.T, factor)[..., :3], p[..., :3], rtol=0, atol=1e-14)
    assert np.isnan(factor[..., 3:]).any(axis=(0, 1)).all()


def test_what_counts_as_without_uncertainty_does_not_hang_on_units() -> None:
    """A pivot of zero to rounding, and what is correlated with it to rounding, in units from 1e-6 to 1e6."""
    small, slack = kernels.SMALLEST_PIVOT_RATIO, kernels.INDEFINITE
    units = np.array(list(itertools.product([1e-6, 1.0, 1e6], repeat=2))).T
    for part, bad in ((0.5 * slack**0.5, False), (-0.5 * slack**0.5, False), (2 * slack**0.5, True), (0.1, True)):
        known = np.array([[0.0, part], [part, 1.0]])  # nothing may go with what is known for certain
        assert failing(known[:, :, None] * units[:, None] * units[None]) == [True] * units.shape[1]
        third = np.array([[1.0, 1.0, 0.5], [1.0, 1.0, 0.5 + part], [0.5, 0.5 + part, 1.0]])
        scale = np.vstack([units, units[:1]])
        assert failing(third[:, :, None] * scale[:, None] * scale[None]) == [bad] * units.shape[1]
    for last, bad in ((1.0 + 0.5 * small, False), (1.0 - 0.5 * slack, False), (1.0 - 2 * slack, True)):
        two = np.array([[1.0, 1.0], [1.0, last]])[:, :, None] * units[:, None] * units[None]
        assert failing(two) == [bad] * units.shape[1]


def failing(p: Array) -> list[bool]:
    factor, failed = np.empty_like(p), np.zeros(p.shape[2], dtype=bool)
    kernels.cholesky(p, factor, failed)
    return failed.tolist()


@pytest.mark.parametrize("width", [1, 2, 7, 100])
def test_bits_do_not_depend_on_the_batch(width: int) -> None:
    f, p, q = draw(6, 6, RUNS), positive(6), positive(6, 1)

    def work(f: Array, p: Array) -> list[Array]:
        moved, factor = np.empty_like(p), np.empty_like(p)
        kernels.congruence(f, p, q, moved)
        kernels.cholesky(moved, factor, np.zeros(p.shape[2], dtype=bool))
        return [moved, factor]

    for first in (3, 300):  # 320 are a tile
        small = work(*(np.ascontiguousarray(a[..., first:first + width]) for a in (f, p)))
        for all_, some in zip(work(f, p), small, strict=True):
            np.testing.assert_array_equal(all_[..., first:first + width], some)


@pytest.mark.parametrize("shared_h", [True, False])
@pytest.mark.parametrize("noise", ["correlated", "diagonal", "per run", "some runs correlated"])
def test_kalman_update_is_the_conditional_gaussian(shared_h: bool, noise: str) -> None:
    """And what it hands out in turn has the log-likelihood of the whole."""
    n, ny = 4, 3
    x, p, y, h = draw(n, RUNS), positive(n), draw(ny, RUNS), draw(ny, n, 1 if shared_h else RUNS)
    r = {"correlated": positive(ny, 1), "per run": positive(ny)}.get(noise, np.diag([0.5, 1.0, 2.0])[:, :, None].copy())
    if noise == "some runs correlated":
        r = np.where(np.arange(RUNS) % 3 == 0, positive(ny), r * (1 + np.arange(RUNS)))
    received = np.random.default_rng(3).uniform(size=(ny, RUNS)) < 0.6
    guess = each(np.matmul, h, x)

    def textbook(x: Array, p: Array, y: Array, h: Array, got: Array, r: Array) -> Array:
        h, y, s = h[got], y[got], r[np.ix_(got, got)]
        spread = h @ p @ h.T + s
        gain, e = p @ h.T @ np.linalg.inv(spread), y - h @ x
        logp = -0.5 * (e @ np.linalg.inv(spread) @ e + np.linalg.slogdet(2 * np.pi * spread)[1])
        return np.hstack([(x + gain @ e)[:, None], p - gain @ h @ p, np.full((n, 1), logp)])

    expected = each(textbook, x, p, y, h, received, np.broadcast_to(r, (ny, ny, RUNS)))
    failed, residual, variance = np.zeros(RUNS, dtype=bool), np.full((ny, RUNS), np.nan), np.full((ny, RUNS), np.nan)
    seen, alone = np.where(received, y, np.nan), p.copy()
    covariance_update(alone, received, h, r, failed)
    assert kalman_update(x, p, seen, guess, received, h, r, residual, variance, failed) == 0
    np.testing.assert_allclose(x, expected[:, 0], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(p, expected[:, 1:-1], rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(alone, p)
    logs = np.where(received, norm(0.0, np.sqrt(np.where(received, variance, 1.0))).logpdf(residual), 0.0)
    np.testing.assert_allclose(logs.sum(axis=0), expected[0, -1], rtol=1e-10, atol=1e-10)


def exact_variances(h: Array, r: float, start: float) -> Array:
    """Diagonal of the covariance after measurements h (ny, n) of variance r, from start times I, in 60 digits."""
    n = h.shape[1]
    with localcontext(prec=60):
        p = [[Decimal(start) * (a == b) for b in range(n)] for a in range(n)]
        for row in h:
            weights = [Decimal(float(value)) for value in row]
            ph = [sum(p[a][k] * weights[k] for k in range(n)) for a in range(n)]
            s = sum(weights[a] * ph[a] for a in range(n)) + Decimal(r)
            p = [[p[a][b] - ph[a] * ph[b] / s for b in range(n)] for a in range(n)]
        return np.array([float(p[a][a]) for a in range(n)])


@pytest.mark.parametrize("noise", [1e-12, 1e-10, 1e-8])
@pytest.mark.parametrize("ny", [3, 6])
def test_no_variance_is_negative_or_wrong(noise: float, ny: int) -> None:
    """Oblique sensors, exact beside what was known: here P - K S K' and Joseph's form go wrong."""
    n = 4
    h = draw(ny, n, RUNS)
    x, p, failed = np.zeros((n, RUNS)), np.repeat(1e6 * np.eye(n)[:, :, None], RUNS, axis=2), np.zeros(RUNS, dtype=bool)
    told, received = np.zeros((2, ny, RUNS)), np.ones((ny, RUNS), dtype=bool)
    r = noise * np.eye(ny)[:, :, None]
    assert kalman_update(x, p, np.zeros((ny, RUNS)), np.zeros((ny, RUNS)), received, h, r, *told, failed) == 0
    for run in range(0, RUNS, 20):
        np.testing.assert_allclose(p[:, :, run].diagonal(), exact_variances(h[:, :, run], noise, 1e6), rtol=1e-10)


@pytest.mark.parametrize("there", [[True, False, True], [False, False, False]])
def test_shared_update_has_the_bits_of_the_other(there: list[bool]) -> None:
    n, ny = 4, 3
    x, one, y, h = draw(n, RUNS), positive(n, 1), draw(ny, RUNS), draw(ny, n, 1)
    received = np.repeat(np.array(there)[:, None], RUNS, axis=1)
    y[1], r, failed = np.nan, np.diag([0.5, 1.0, 2.0])[:, :, None].copy(), np.zeros(RUNS, dtype=bool)
    guess, other, p = each(np.matmul, h, x), x.copy(), np.repeat(one, RUNS, axis=2)
    residual, variance, left, spread = np.zeros((4, ny, RUNS))
    kalman_update(x, p, y, guess, received, h, r, residual, variance, failed)
    shared_kalman_update(other, one, y, guess, received, h, r, left, spread[:, :1].copy(), failed)
    np.testing.assert_array_equal(x, other)
    np.testing.assert_array_equal(p, np.broadcast_to(one, p.shape))


def test_a_negative_innovation_variance_is_a_failure_where_it_is_received() -> None:
    p = np.repeat(-np.eye(2)[:, :, None], 3, axis=2)
    p[:, :, 0] = np.eye(2)
    x, failed = np.zeros((2, 3)), np.zeros(3, dtype=bool)
    received = np.array([[True, True, False], [False, False, False]])
    h, r = np.eye(2)[:, :, None].copy(), 0.5 * np.eye(2)[:, :, None]
    told, alone, lost = np.zeros((2, 2, 3)), p.copy(), failed.copy()
    assert kalman_update(x, p, np.ones((2, 3)), x.copy(), received, h, r, *told, failed) == 1
    covariance_update(alone, received, h, r, lost)
    np.testing.assert_array_equal(alone, p)
    assert failed.tolist() == lost.tolist() == [False, True, False]
    np.testing.assert_allclose(x[:, 0], [2 / 3, 0.0])
    assert np.isnan(x[:, 1]).all() and np.isnan(p[:, :, 1]).all()
    np.testing.assert_array_equal(x[:, 2], 0.0)
    p, noise = -np.repeat(np.eye(2)[:, :, None], 3, axis=2), np.repeat(r, 3, axis=2)
    p[:, :, 2], noise[0, 1, 1], noise[1, 0, 1] = np.eye(2), 0.1, 0.1  # one failure of each kind of noise
    x, y, guess, failed[:] = np.zeros((2, 3)), np.ones((2, 3)), np.zeros((2, 3)), False
    assert kalman_update(x, p, y, guess, y > 0, h, noise, *told, failed) == 2
    assert failed.tolist() == [True, True, False]


def test_model_product_equals_numpy() -> None:
    matrix = draw(3, 5) * (draw(3, 5, 1)[:, :, 0] > 0)
    for shape in ((5, 1), (5, 4, 9), (5, 0)):
        x = draw(*shape)
        np.testing.assert_allclose(product(matrix, x), np.tensordot(matrix, x, 1), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("ny", [1, 2, 3])
def test_innovations_in_turn_are_conditional_gaussians(ny: int) -> None:
    """Of correlated elements each after those received before it: without what is expected of it, and its variance."""
    rng = np.random.default_rng(4)
    root = rng.normal(size=(ny, ny + 1))
    spread, runs = root @ root.T, 2**ny
    received = np.array(list(itertools.product([False, True], repeat=ny))).T
    given = np.where(received, rng.normal(size=(ny, runs)), 0.0)
    found, variance = given.copy(), np.empty((ny, runs))
    in_turn(spread[:, :, None].copy(), received, found, variance)
    for s in range(runs):
        for j in np.flatnonzero(received[:, s]):
            before = np.flatnonzero(received[:j, s])
            gain = np.linalg.solve(spread[np.ix_(before, before)], spread[before, j])
            assert found[j, s] == pytest.approx(given[j, s] - gain @ given[before, s], rel=1e-10)
            assert variance[j, s] == pytest.approx(spread[j, j] - gain @ spread[before, j], rel=1e-10)


def test_sums_and_greatest_entries_in_lanes() -> None:
    """Of every length about the lanes, wherever the greatest stands."""
    dot, largest = particles.dot.py_func, modes.greatest.py_func
    for n in range(21):
        a, b = draw(n), draw(n)[::-1].copy()
        np.testing.assert_allclose(dot(a, b), a @ b, rtol=1e-12, atol=1e-12)
        for place in range(n):
            one = np.where(np.arange(n) % 5 == 4, np.nan, -np.abs(a))
            one[place] = 0.5
            assert largest(one, n) == 0.5 and largest(one, place) < 0.5
    assert largest(np.full(9, np.nan), 9) == largest(np.empty(0), 0) == -np.inf
