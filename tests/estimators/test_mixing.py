"""Interaction, weights and moments of a bank of filters, run by run in plain loops, with modes nothing leads into,
modes without weight whose numbers are none, runs that stand still or hear nothing, and runs that lose every mode."""

from __future__ import annotations

import numpy as np
import pytest
from railstate.estimators.kernels import mixing
from scipy.stats import norm

M, N, RUNS = 3, 2, 4


def bank(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """weight (m, S), mean (m, S, n), covariance (m, S, n, n)."""
    rng = np.random.default_rng(seed)
    root, weight = rng.normal(size=(M, RUNS, N, N)), rng.uniform(0.1, 1.0, (M, RUNS))
    return weight / weight.sum(axis=0), rng.normal(size=(M, RUNS, N)), root @ root.swapaxes(2, 3)


def packed(mean: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As the kernels take them: (n, m S) and (n, n, m S)."""
    return (np.ascontiguousarray(mean.reshape(M * RUNS, N).T),
            np.ascontiguousarray(covariance.reshape(M * RUNS, N, N).transpose(1, 2, 0)))


@pytest.mark.parametrize("shared", [True, False])
def test_interaction_is_the_textbook_s(shared: bool) -> None:
    """Nothing leads into the last mode: it keeps its own. Run 1 stands still."""
    weight, mean, covariance = bank(1)
    rng = np.random.default_rng(2)
    chain = rng.uniform(0.1, 1.0, (M, M, 1 if shared else RUNS))
    chain[:, 2] = 0.0
    chain /= chain.sum(axis=1, keepdims=True)
    moving = np.array([True, False, True, True])
    x, P = packed(mean, covariance)
    found = weight.copy()
    mixing.mix(chain, found, moving, x, P)
    wanted, wanted_x, wanted_P = weight.copy(), mean.copy(), covariance.copy()
    for s in np.flatnonzero(moving):
        p = chain[:, :, 0 if shared else s]
        wanted[:, s] = weight[:, s] @ p
        for j in range(2):
            mu = p[:, j] * weight[:, s] / wanted[j, s]
            centre = mu @ mean[:, s]
            off = mean[:, s] - centre
            wanted_x[j, s] = centre
            wanted_P[j, s] = np.einsum("i,iab->ab", mu, covariance[:, s] + off[:, :, None] * off[:, None])
    assert wanted[2, [0, 2, 3]].tolist() == [0.0] * 3
    for mine, theirs in zip((found, x, P), (wanted, *packed(wanted_x, wanted_P)), strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-14)
    still = np.arange(M) * RUNS + 1
    for mine, theirs in zip((x, P), packed(mean, covariance), strict=True):
        np.testing.assert_array_equal(mine[..., still], theirs[..., still])
    np.testing.assert_array_equal(P, P.swapaxes(0, 1))


def test_moments_count_no_mode_without_weight() -> None:
    weight, mean, covariance = bank(3)
    weight[2, 1], mean[2, 1], covariance[2, 1] = 0.0, np.nan, np.nan
    weight[:, 1] /= weight[:, 1].sum()
    x, P = np.empty((N, RUNS)), np.empty((N, N, RUNS))
    mixing.moments(weight, *packed(mean, covariance), x, P)
    for s in range(RUNS):
        there = weight[:, s] > 0.0
        centre = weight[there, s] @ mean[there, s]
        off = mean[there, s] - centre
        np.testing.assert_allclose(x[:, s], centre, rtol=0, atol=1e-14)
        np.testing.assert_allclose(P[:, :, s], np.einsum("i,iab->ab", weight[there, s], covariance[there, s]
                                                        + off[:, :, None] * off[:, None]), rtol=0, atol=1e-14)
    np.testing.assert_array_equal(P, P.swapaxes(0, 1))


def test_weights_of_likelihoods() -> None:
    """Far from what exp can tell; a mode whose likelihood is no number or minus infinity is impossible."""
    weight = np.array([[0.5, 0.5, 0.5, 0.2, 0.0], [0.25, 0.25, 0.5, 0.8, 1.0], [0.25, 0.25, 0.0, 0.0, 0.0]])
    logs = np.array([[-2000.0, -1.0, np.nan, -np.inf, 5.0], [-2001.0, -1.0, -3.0, np.nan, -np.inf],
                     [-1998.0, -1.0, 9.0, 0.0, 7.0]])
    heard = np.array([True, False, True, True, True])
    found, lost = weight.copy(), np.zeros(5, dtype=bool)
    said = mixing.weigh(found, logs.reshape(-1), heard, lost)
    share = weight[:, 0] * np.exp(logs[:, 0] + 1998.0)
    np.testing.assert_allclose(found[:, 0], share / share.sum(), rtol=1e-15)
    assert said[0] == pytest.approx(np.log(share.sum()) - 1998.0, rel=1e-15)
    assert found[:, 1].tolist() == weight[:, 1].tolist() and said[1] == 0.0
    assert found[:, 2].tolist() == [0.0, 1.0, 0.0] and said[2] == pytest.approx(np.log(0.5) - 3.0, rel=1e-15)
    assert np.isnan(found[:, 3:]).all() and np.isnan(said[3:]).all()
    assert lost.tolist() == [False, False, False, True, True]


def test_log_densities_and_powers() -> None:
    rng = np.random.default_rng(4)
    e, v = rng.normal(size=(2, M * RUNS)), rng.uniform(0.5, 2.0, (2, M * RUNS))
    received = np.array([[True, False, True, False], [True, True, False, False]])
    logs = np.where(np.tile(received, M), norm(0.0, np.sqrt(v)).logpdf(e), 0.0).sum(axis=0)
    np.testing.assert_allclose(mixing.log_density(np.where(np.tile(received, M), e, np.nan), v, received), logs,
                               rtol=1e-13)
    values, exponents = np.array([1.0, 0.25, 0.5]), np.array([0.0, 0.5, 1.0, 3.0])
    np.testing.assert_allclose(mixing.powers(values, exponents), values[:, None] ** exponents, rtol=1e-15)
