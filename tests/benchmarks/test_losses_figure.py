"""The figure of covariances under losses, whole: what grows without end, what is not told, no threshold, nothing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from railstate.benchmarks.telling.figures.losses import covariance_under_losses
from railstate.estimators.random_access.losses import Losses

from ..expected import figure

FOUND = [Losses(0.2, 3.0, np.inf, None, np.inf), Losses(0.5, 2.5, 40.0, 0.5, np.inf), Losses(0.7, 2.25, 9.0, 0.1, 30.0),
         Losses(1.0, 2.0, 2.0, 0.0, 2.0)]


def test_covariances_under_losses(expected: Callable[[str, str], None]) -> None:
    untold = [Losses(found.p, found.lower, None, None, np.inf) for found in FOUND]
    nothing = [Losses(found.p, np.inf, None, None, np.inf) for found in FOUND]
    expected("losses", "\n".join(figure(covariance_under_losses(found, threshold, "of a plant").svg()) for
                                 found, threshold in ((FOUND, 0.34), (untold, 0.0), (nothing, 0.5))))
