"""Numbers of the papers that are no summary of rows: gains, bounds, ratios, claims. Each names the rows it draws on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple, dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from ...estimators.random_access.bounds import CovarianceBounds
from ...estimators.random_access.covariance import covariance_sequence
from ...estimators.ultimate_bound.gains import read_gain
from ...estimators.ultimate_bound.lmi import certify, ultimate_bound
from ...estimators.ultimate_bound.system import error_system
from ...scenarios.files import load
from ...scenarios.model import DesignModel
from ...scenarios.randomness import Streams
from .rows import Book, Found, ratio

Key = tuple[str, str, str]


@dataclass(frozen=True)
class Computation:
    """value(book, *arguments) -> our number; rows(*arguments) -> the (scenario, variant, estimator)
    needed."""

    value: Callable[..., Found]
    rows: Callable[..., list[Key]] = lambda *arguments: []


@cache
def _model(name: str, variant: str, overrides: tuple[tuple[str, Any], ...] = ()) -> DesignModel:
    setting = load(name, dict(overrides)).setting(variant)
    start = setting.world(Streams(0, name, variant, (0,))).initial_mean
    return setting.design_model({}, start)


@cache
def _zou() -> tuple[Any, Any]:
    """Corollary 1 at sqrt(sum delta^2) = 7e5 N and Theorem 1 of the printed gain."""
    system = error_system(_model("cbtc-csma", "uniform", (("knowledge.delta", 7e5), ("time.steps", 2))))
    return ultimate_bound(system, 0.98), certify(system, read_gain("zou2018_gain.csv"), 0.98)


def zou_excess(book: Book) -> Found:
    """Certified bound of the printed gain over our least one."""
    ours, printed = _zou()
    return Found(printed.bound / ours.bound)


def zou_distance(book: Book, columns: str) -> Found:
    """Relative Frobenius distance of our gain from the printed one, in its position or velocity columns."""
    part = slice(0, 6) if columns == "position" else slice(6, 12)
    printed = read_gain("zou2018_gain.csv")[:, part]
    return Found(float(np.linalg.norm(_zou()[0].K[:, part] - printed) / np.linalg.norm(printed)))


def rap_gain(book: Book, variant: str, k: int, i: int, j: int) -> Found:
    """Entry (i, j) of K_k, from 1 and 0 on."""
    return Found(float(covariance_sequence(_model("rap-example-1", variant), 3)[0][k - 1][i, j]))


def rap_gain_distance(book: Book, variant: str, k: int, *printed: float) -> Found:
    """Largest deviation of K_k from the printed one (row by row)."""
    gain = covariance_sequence(_model("rap-example-1", variant), 3)[0][k - 1]
    return Found(float(np.abs(gain - np.reshape(printed, gain.shape)).max()))


@cache
def _rap_bounds() -> CovarianceBounds:
    model = _model("rap-example-2", "corrected")
    assert model.linear is not None and model.reception is not None
    return CovarianceBounds(model.linear, model.reception, model.initial_covariance[:, :, 0], 300)


def rap_constant(book: Book, name: str) -> Found:
    """q_low, q_high, a_low, a_high, r_low, r_high, c, c_hat, or the lower bound (21)."""
    return Found(float(getattr(_rap_bounds(), name)))


def rap_mu(book: Book, k: int) -> Found:
    """mu_k of Theorem 3."""
    return Found(float(_rap_bounds().mu[k]))


def rap_condition(book: Book, sigma: float, m: int) -> Found:
    """Least eigenvalue of the sum in (30) over all steps."""
    return Found(float(_rap_bounds().check(float(sigma), int(m)).least.min()))


def rap_term(book: Book, sigma: float, m: int, lag: int, i: int) -> Found:
    """Greatest value over k, with full windows, of entry (i, i) of a term of (30)."""
    return Found(float(_rap_bounds().terms(float(sigma), int(m))[lag, int(m):, i, i].max()))


BRAKING = ("braking-rate", "paper")


def braking_gain(book: Book, quantity: str, better: str, worse: str) -> Found:
    """1 - MAE(better) / MAE(worse), paired over runs (delta method)."""
    a, b = (book.values(*BRAKING, label, "mae", quantity) for label in (better, worse))
    return _one_minus_ratio(a, b)


def work_ratio(book: Book, one: str, other: str) -> Found:
    """Kalman updates per step of one estimator over another's."""
    a, b = (book.values(*BRAKING, label, "kalman-updates", "work") for label in (one, other))
    return ratio(a, b)


def gap_reduction(book: Book) -> Found:
    """1 - mean gap under moving block / under fixed block, law P, UKF in the loop."""
    a, b = (book.values("moving-block", variant, "ukf", "mean", "gap") for variant in ("law-p", "law-p-fixed-block"))
    return _one_minus_ratio(a, b)


def follower_ratio(book: Book, k_acc: float) -> Found:
    """alpha_B / beta_s = (-1 + sqrt(1 + 4 k_acc)) / 2 of (29); NaN where the root is of a negative number."""
    inner = 1 + 4 * float(k_acc)
    return Found((-1 + inner**0.5) / 2 if inner >= 0 else float("nan"))


KALMAN_LABELS = ("ekf", "ukf", "ckf")


def robust_ratio(book: Book, variant: str, quantity: str) -> Found:
    """RMSE of robust-mean-square over that of the best matched Kalman filter, paired over runs (delta method)."""
    squares = {label: book.values("ningbo-metro", variant, label, "rmse", quantity) ** 2
               for label in (*KALMAN_LABELS, "robust-mean-square")}
    best = min(KALMAN_LABELS, key=lambda label: float(np.nanmean(squares[label])))
    value, *errors = astuple(ratio(squares["robust-mean-square"], squares[best]))
    return Found(value**0.5, *(0.5 * error / value**0.5 for error in errors))


def _one_minus_ratio(a: np.ndarray, b: np.ndarray) -> Found:
    return replace(found := ratio(a, b), value=1 - found.value)


def _braking(*labels: str) -> list[Key]:
    return [(*BRAKING, label) for label in labels]


COMPUTATIONS: dict[str, Computation] = {
    "zou_excess": Computation(zou_excess),
    "zou_distance": Computation(zou_distance),
    "rap_gain": Computation(rap_gain),
    "rap_gain_distance": Computation(rap_gain_distance),
    "rap_constant": Computation(rap_constant),
    "rap_mu": Computation(rap_mu),
    "rap_condition": Computation(rap_condition),
    "rap_term": Computation(rap_term),
    "braking_gain": Computation(braking_gain, lambda quantity, better, worse: _braking(better, worse)),
    "work_ratio": Computation(work_ratio, _braking),
    "gap_reduction": Computation(gap_reduction, lambda: [("moving-block", variant, "ukf")
                                                         for variant in ("law-p", "law-p-fixed-block")]),
    "follower_ratio": Computation(follower_ratio),
    "robust_ratio": Computation(robust_ratio, lambda variant, quantity: [
        ("ningbo-metro", variant, label) for label in (*KALMAN_LABELS, "robust-mean-square")]),
}
