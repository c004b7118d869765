"""What a computation of a published number is: a function of the rows, and which rows those are.

What several papers need lies here: ratios of rows, arithmetic on printed numbers, a variant's design model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from ....scenarios.files import load
from ....scenarios.model import DesignModel
from ....scenarios.randomness import Streams
from ..rows import Book, Found, ratio, reduction, root

Key = tuple[str, str, str]
"""(scenario, variant, estimator) of rows."""


@dataclass(frozen=True)
class Computation:
    """value(book, *arguments) -> our number; rows(*arguments) -> the rows needed."""

    value: Callable[..., Found]
    rows: Callable[..., list[Key]] = lambda *arguments: []


@cache
def model_of(name: str, variant: str, overrides: tuple[tuple[str, Any], ...] = ()) -> DesignModel:
    """What estimators are told in a variant, with single keys changed."""
    setting = load(name, dict(overrides)).setting(variant)
    start = setting.world(Streams(0, name, variant, (0,))).initial_mean
    return setting.design_model({}, start)


def error_ratio(book: Book, scenario: str, variant: str, metric: str, quantity: str, one: str, other: str) -> Found:
    """One estimator's number over another's, paired over the runs; RMSE as the root of mean squares."""
    a, b = (book.values(scenario, variant, label, metric, quantity) for label in (one, other))
    return root(ratio(a**2, b**2)) if metric == "rmse" else ratio(a, b)


def _both(scenario: str, variant: str, metric: str, quantity: str, one: str, other: str) -> list[Key]:
    return [(scenario, variant, one), (scenario, variant, other)]


def error_reduction(book: Book, scenario: str, variant: str, metric: str, quantity: str, one: str,
                    other: str) -> Found:
    """1 - one estimator's number over another's, paired over the runs."""
    return reduction(*(book.values(scenario, variant, label, metric, quantity) for label in (one, other)))


def variant_reduction(book: Book, scenario: str, estimator: str, metric: str, quantity: str, one: str,
                      other: str) -> Found:
    """1 - an estimator's number in one variant over that in another."""
    return reduction(*(book.values(scenario, variant, estimator, metric, quantity) for variant in (one, other)))


def average(book: Book, *printed: float) -> Found:
    """Of printed numbers."""
    return Found(float(np.mean(printed)))


def fall(book: Book, before: float, after: float) -> Found:
    """1 - after / before, of two printed numbers."""
    return Found(1 - after / before)


COMPUTATIONS = {
    "error_ratio": Computation(error_ratio, _both),
    "error_reduction": Computation(error_reduction, _both),
    "variant_reduction": Computation(variant_reduction, lambda scenario, estimator, metric, quantity, one, other: [
        (scenario, one, estimator), (scenario, other, estimator)]),
    "average": Computation(average),
    "fall": Computation(fall),
}
