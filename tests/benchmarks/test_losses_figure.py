"""Figures of studies, whole: covariances under losses (what grows without end, is not told, or is nothing; without a
threshold), and a metric over a swept key, of numbers and of words."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd
from railstate.benchmarks.telling.figures.data import assign_styles
from railstate.benchmarks.telling.figures.losses import covariance_under_losses
from railstate.benchmarks.telling.figures.swept import over_key
from railstate.estimators.random_access.losses import Losses

from ..expected import figure
from .test_worded import line

FOUND = [Losses(0.2, 3.0, np.inf, None, np.inf), Losses(0.5, 2.5, 40.0, 0.5, np.inf), Losses(0.7, 2.25, 9.0, 0.1, 30.0),
         Losses(1.0, 2.0, 2.0, 0.0, 2.0)]


def test_covariances_under_losses(expected: Callable[[str, str], None]) -> None:
    untold = [Losses(found.p, found.lower, None, None, np.inf) for found in FOUND]
    seldom = [Losses(0.02, 3.0, 50.0, 0.5, 90.0), *FOUND[2:]]  # shares are never on a logarithmic scale
    nothing = [Losses(found.p, np.inf, None, None, np.inf) for found in FOUND]
    expected("losses", "\n".join(figure(covariance_under_losses(found, threshold, "of a plant").svg()) for
                                 found, threshold in ((FOUND, 0.34), (untold, 0.0), (nothing, 0.5), (seldom, 0.0))))


def test_a_metric_over_a_key(expected: Callable[[str, str], None]) -> None:
    """Errors that span decades or do not; a key that does, that nearly does, that has a zero; words, of which the last
    reaches the edge."""
    out, sizes = list[str](), {"a": (0.01, 0.02, 0.05), "b": (0.03, np.nan, 0.04)}
    for keys in ([1.0, 2.0, 20.0], [1.0, 2.0, 21.0], [0.0, 2.0, 21.0], ["low", "6", "word " * 12]):
        for factor in (1.0, 30.0):
            part = pd.DataFrame([{**line(label, value * (factor if label == "b" else 1.0), 0.004), "k": key}
                                 for label, values in sizes.items() for key, value in zip(keys, values, strict=True)])
            out.append(figure(over_key(part, "k", "RMSE [cm]", assign_styles([["b", "c", "a"]])).svg()))
    expected("figures-swept", "\n".join(out))
