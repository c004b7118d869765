"""Zou, Wang, Han, Zhou, random access protocol: gains with C as printed and mended, and the constants of Example 2.

All of it is exact: no runs are needed."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from scipy.optimize import least_squares

from ....estimators.random_access.bounds import CovarianceBounds
from ....estimators.random_access.covariance import covariance_sequence
from ....scenarios.arrays import Array
from ..rows import Book, Found
from .base import Computation, model_of

TABLE_I = np.array([[[0.582, -1.476], [1.059, -2.645], [0.216, 0.545]],
                    [[0.561, -2.229], [1.055, -4.201], [0.156, -0.435]],
                    [[0.534, -1.522], [1.025, -2.967], [0.068, -0.119]]])
"""K_1, K_2, K_3 as printed: what a free C is fitted to."""
TERMS = np.array([[0.039, 0.04], [0.0125, 0.0126], [0.004, 0.0039]])
"""Diagonals of the three terms that the paper sums in (30), i = k + 1, k, k - 1."""
MANY = 60


@cache
def _gains(variant: str) -> Array:
    return np.array(covariance_sequence(model_of("rap-example-1", variant), 3)[0])


def rap_gain(book: Book, variant: str, k: int, i: int, j: int) -> Found:
    """Entry (i, j) of K_k, k from 1 and i, j from 0 on."""
    return Found(float(_gains(variant)[k - 1, i, j]))


@cache
def _fit(index: str) -> tuple[Array, Array]:
    """C (2, 3) that gives the printed gains best (six unknowns, eighteen numbers), and what is left (18,)."""
    model = model_of("rap-example-1", "corrected", (("plant.index", index),))
    linear = model.linear
    assert linear is not None

    def left(c: Array) -> Array:
        C = c.reshape(2, 3)
        tried = replace(model, linear=replace(linear, C=lambda k: C))
        return (np.array(covariance_sequence(tried, 3)[0]) - TABLE_I).ravel()

    found = least_squares(left, linear.C(1).ravel(), xtol=1e-12, ftol=1e-12)
    return found.x.reshape(2, 3), found.fun


def rap_fit(book: Book, index: str) -> Found:
    """Greatest deviation of the eighteen gains with the C that gives them best; index: `arrival` (A_1 into step 1) or
    `departure` (A_0, as equation (2) has it)."""
    return Found(float(np.abs(_fit(index)[1]).max()))


def rap_fit_distance(book: Book) -> Found:
    """Greatest distance of an entry of that C from the mended one's."""
    linear = model_of("rap-example-1", "corrected").linear
    assert linear is not None
    return Found(float(np.abs(_fit("arrival")[0] - linear.C(1)).max()))


@cache
def _bounds(variant: str) -> CovarianceBounds:
    model = model_of("rap-example-2", variant)
    assert model.linear is not None and model.reception is not None
    return CovarianceBounds(model.linear, model.reception, model.initial_covariance[:, :, 0], 300)


def rap_constant(book: Book, variant: str, name: str) -> Found:
    """q_low, q_high, a_low, a_high, r_low, r_high, c, c_hat, or the lower bound (21), of Example 2."""
    return Found(float(getattr(_bounds(variant), name)))


def rap_mu(book: Book, variant: str, k: int) -> Found:
    """mu_k of Theorem 3."""
    return Found(float(_bounds(variant).mu[k]))


def rap_term(book: Book, variant: str, sigma: float, m: int, lag: int, i: int) -> Found:
    """Greatest value over k, with full windows, of entry (i, i) of a term of (30)."""
    return Found(float(_bounds(variant).terms(float(sigma), int(m))[lag, int(m):, i, i].max()))


def rap_condition(book: Book, variant: str, sigma: float, m: int) -> Found:
    """Least eigenvalue of the sum in (30) over all steps."""
    return Found(float(_bounds(variant).check(float(sigma), int(m)).least.min()))


def rap_entry(book: Book, variant: str, sigma: float, m: int, i: int) -> Found:
    """Least entry (i, i) of the sum in (30) over all steps."""
    return Found(float(_bounds(variant).terms(float(sigma), int(m)).sum(axis=0)[int(m):, i, i].min()))


def rap_once(book: Book, i: int) -> Found:
    """The same of the paper's own three terms and factors, in which C counts once."""
    k = np.arange(2, 300)
    factors = np.array([0.95 + 0.05 * np.sin(k + 1 - lag) for lag in range(3)])
    return Found(float((factors.T @ TERMS[:, i]).min()))


def rap_saturation(book: Book, variant: str, sigma: float) -> Found:
    """The greatest that the least eigenvalue in (30) becomes, over all windows m up to 60."""
    return Found(max(float(_bounds(variant).check(float(sigma), m).least.min()) for m in range(1, MANY + 1)))


def rap_radius(book: Book, variant: str) -> Found:
    """Spectral radius of A."""
    return Found(float(np.abs(np.linalg.eigvals(_bounds(variant).A[0])).max()))


def rap_eigenvalue(book: Book, variant: str, which: str) -> Found:
    """The `least` or `greatest` eigenvalue of P(k|k), k = 0 .. 300."""
    values = np.linalg.eigvalsh(covariance_sequence(model_of("rap-example-2", variant), 300)[1])
    return Found(float(values.min() if which == "least" else values.max()))


COMPUTATIONS = {function.__name__: Computation(function) for function in (
    rap_gain, rap_fit, rap_fit_distance, rap_constant, rap_mu, rap_term, rap_condition, rap_entry, rap_once,
    rap_saturation, rap_radius, rap_eigenvalue)}
