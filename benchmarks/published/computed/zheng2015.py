"""Zheng, Han, Kong, Wang 2015: the a_z row, and what its tables say of each other.

Counts of Kalman updates stand for times: one filter's update is the unit of work of all three algorithms."""

from __future__ import annotations

import numpy as np
from scipy.stats import norm

from ....estimators.mode_grid import triples
from ....estimators.registry import estimator_class
from ..rows import Book, Found, summary
from .base import Computation, model_of

BRAKING = "braking-rate"
PARTICLES = {"rbpf-static-full": 250, "sma-full": 50, "gsma-full": 50}
"""N0 of section 4."""


def share(book: Book, part: float, whole: float) -> Found:
    """Of two numbers of the text."""
    return Found(part / whole)


def target_error(book: Book, reading: str, estimator: str) -> Found:
    """Mean absolute error of a_z. `measured`: of the rows, the filters starting from N(-2, .001). `unmeasured`: exact,
    of the mean of N0 starts drawn from that, which dies out by the Pade lag, the start itself counted."""
    if reading == "measured":
        return summary(book.values(BRAKING, "uncertain-start", estimator, "mae", "target-acceleration"))
    model = model_of(BRAKING, "uncertain-start")
    assert model.linear is not None
    keeps, steps = float(model.linear.A(0)[3, 3]), 150  # what is left of an error of a_z after a step
    size = np.sqrt(model.initial_covariance[3, 3, 0] / PARTICLES[estimator])
    mean = (1 - keeps ** (steps + 1)) / (1 - keeps) / (steps + 1)
    quantiles = np.abs(norm.ppf((np.arange(1000) + 0.5) / 1000))
    runs = size * mean * quantiles
    return Found(float(size * mean * np.sqrt(2 / np.pi)), 0.0, float(runs.std()), runs)


def command_window(book: Book, *ratios: float) -> Found:
    """The greatest |a_t| that all ratios of a^'s error to f's admit, over the least: under 1 there is none.

    a^ follows f a_t with the brake's lag: an error of a^ is r times the last one and 1 - r times a_t times f's, so its
    mean over f's lies in |a_t| [(1 - r) / (1 + r), 1]."""
    model = model_of(BRAKING, "paper")
    assert model.linear is not None
    r = float(model.linear.A(0)[2, 2])
    least = (1 - r) / (1 + r)
    return Found(min(ratios) / least / max(ratios))


def grid_updates(book: Book, plugin: str, values: int, other: int) -> Found:
    """Kalman updates per step with a grid of so many values over those with another, by the estimator's own design."""
    def updates(count: int) -> float:
        grid = tuple(round(1 - i / (count - 1), 9) for i in range(count))
        model = model_of(BRAKING, "paper", (("knowledge.grid", grid),))
        return float(estimator_class(plugin, "published")({}).design(model)["kalman_updates_per_step"])

    return Found(updates(values) / updates(other))


def groups_of(book: Book, values: int) -> Found:
    """How many groups of three neighbours there are of so many values."""
    return Found(float(len(np.unique(triples(np.arange(float(values)), False), axis=0))))


COMPUTATIONS = {
    "share": Computation(share),
    "target_error": Computation(target_error, lambda reading, estimator: [
        (BRAKING, "uncertain-start", estimator)] if reading == "measured" else []),
    "command_window": Computation(command_window),
    "grid_updates": Computation(grid_updates),
    "groups_of": Computation(groups_of),
}
