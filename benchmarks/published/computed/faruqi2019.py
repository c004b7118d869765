"""Faruqi et al. 2019: the follower's acceleration, arithmetic of its tables, what the gap does."""

from __future__ import annotations

from ..rows import Book, Found
from .base import Computation


def follower_ratio(book: Book, k_acc: float) -> Found:
    """alpha_B / beta_s = (-1 + sqrt(1 + 4 k_acc)) / 2 of (29); NaN where the root is of a negative number."""
    inner = 1 + 4 * float(k_acc)
    return Found((-1 + inner**0.5) / 2 if inner >= 0 else float("nan"))


COMPUTATIONS = {"follower_ratio": Computation(follower_ratio)}
