"""Liu, Wang, Yan, Wang 2025: the memoryless robust estimator (F1) against Kalman filters, and its theorem's bound."""

from __future__ import annotations

import numpy as np

from ..rows import Book, Found, ratio, root
from .base import Computation, Key

METRO = "ningbo-metro"
KALMAN = {"matched": ("ekf", "ukf", "ckf"), "naive": ("ekf-naive", "ukf-naive", "ckf-naive"),
          "inflated": ("ekf-inflated", "ukf-inflated", "ckf-inflated")}
"""What the Kalman filters are told of the disturbance."""
VARIANTS = ("switching", "white", "sinusoid", "constant", "physical", "physical-bias", "switching-bias", "gaussian")


def robust_ratio(book: Book, variant: str, quantity: str, estimator: str, told: str) -> Found:
    """RMSE of a robust estimator over that of the best Kalman filter told so, paired over runs."""
    def squares(label: str) -> np.ndarray:
        return book.values(METRO, variant, label, "rmse", quantity) ** 2

    best = min((squares(label) for label in KALMAN[told]), key=lambda found: float(np.nanmean(found)))
    return root(ratio(squares(estimator), best))


def _rows(variant: str, quantity: str, estimator: str, told: str) -> list[Key]:
    return [(METRO, variant, label) for label in (*KALMAN[told], estimator)]


def robust_claim(book: Book, metric: str, quantity: str) -> Found:
    """Of F1's rows of all variants: the least share of time inside the claim, the greatest of what must stay small."""
    runs = np.concatenate([book.values(METRO, variant, "robust-bounded", metric, quantity) for variant in VARIANTS])
    return Found(float(np.nanmin(runs) if metric == "coverage" else np.nanmax(runs)))


COMPUTATIONS = {
    "robust_ratio": Computation(robust_ratio, _rows),
    "robust_claim": Computation(robust_claim, lambda metric, quantity: [
        (METRO, variant, "robust-bounded") for variant in VARIANTS]),
}
