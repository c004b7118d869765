"""Runs that go wrong, each alone: their status, the reason in whole words, and nobody else's numbers."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from railstate.estimators.adapters import PerRunStep
from railstate.estimators.interface import Estimator, Status
from railstate.estimators.particle import BootstrapParticle
from railstate.estimators.random_access.estimators import RandomAccessFilter
from railstate.estimators.robust.estimators import RobustBounded
from railstate.estimators.set_membership.zonotope import ZonotopicFilter
from railstate.scenarios.errors import Unsupported
from railstate.scenarios.measurement import Interval
from railstate.scenarios.model import Bounds, DesignModel, Linear, Reception, linear_model

from .. import models
from ..models import heard, part, random, still, whole

HALVES = "the bounds hold for whole sampling periods only"
NO_INPUT = np.zeros((1, 3))


def driven(estimator: Estimator, model: DesignModel, intervals: list[Interval], y: np.ndarray) -> np.ndarray:
    """The means after all (nx, 3)."""
    estimator.design(model)
    estimator.start(model, 3, random(3))
    for k, interval in enumerate(intervals):
        estimator.predict(np.zeros((1, 3)), interval)
        estimator.update(heard(y, np.ones(y.shape, dtype=bool), k))
    return estimator.estimate().mean.copy()


def wild(k: int) -> DesignModel:
    """`still` whose process noise is indefinite in run 2, from step k on."""
    def process(x: np.ndarray, u: np.ndarray, interval: Interval) -> np.ndarray:
        return np.where(np.arange(3) == 2, -1.0 if interval.depart >= k else 0.0, 0.0)[None, None]

    return replace(still(3), process_covariance=process)


def growing() -> DesignModel:
    """By 80 orders a step, while a node that measures nothing transmits in half of them."""
    one = np.ones((1, 1))
    parts = (1e40 * one, np.zeros((1, 1)), np.zeros(1), one, one, one)
    return linear_model(
        Linear(*(lambda k, matrix=matrix: matrix for matrix in parts)), states=("x",), measurements=("x",), period=1.0,
        initial_mean=np.zeros((1, 3)), initial_covariance=np.ones((1, 1, 1)),
        reception=Reception(1.0, 1.0, ((0,), ()), (0.5, 0.5)), bounds=Bounds(one, np.ones(1), np.ones(1)))


def bounded() -> DesignModel:
    return replace(still(3), transition=lambda x, u, interval: x, linear=None, whole=None,
                   transition_jacobian=lambda x, u, interval: np.ones((1, 1, 1)),
                   bounds=Bounds(np.ones((1, 1)), np.ones(1), np.ones(1)))


Y = np.array([[0.5, 0.25, 0.125]])
CASES: dict[str, tuple[Callable[[], Estimator], Callable[[], DesignModel], list[Interval], np.ndarray, Status,
                       dict[int, str]]] = {
    "a reading that cannot be": (lambda: BootstrapParticle({"particles": 9}), lambda: still(3), [whole(0), whole(1)],
                                 np.array([[0.5, np.inf, 0.125]]), Status.failed,
                                 {1: "no particle has a finite likelihood"}),
    "noise that cannot be": (lambda: BootstrapParticle({"particles": 9}), lambda: wild(1), [whole(0), whole(1)], Y,
                             Status.failed, {2: "a process noise covariance is indefinite"}),
    "no noise that cannot be yet": (lambda: BootstrapParticle({"particles": 9}), lambda: wild(2), [whole(0), whole(1)],
                                    Y, Status.failed, {}),
    "a covariance without end": (RandomAccessFilter, growing, [whole(k) for k in range(5)], 0 * Y, Status.failed,
                                 dict.fromkeys(range(3), "the covariance grew beyond all bounds")),
    **{f"half a step, {kind.__name__}": (
        kind, bounded, [whole(0), part(1, np.array([1.0, 0.5, 0.0]))], Y, Status.infeasible, {1: HALVES})
       for kind in (RobustBounded, ZonotopicFilter)}}


@pytest.mark.parametrize("what", CASES)
def test_a_run_that_goes_wrong(what: str) -> None:
    make, model, intervals, y, status, reasons = CASES[what]
    estimator = make()
    with np.errstate(all="ignore"):
        means = driven(estimator, model(), intervals, y)
    assert estimator.reasons == reasons
    assert estimator.status.tolist() == [status if run in reasons else Status.ok for run in range(3)]
    sound = [run for run in range(3) if run not in reasons]
    assert np.isfinite(means[:, sound]).all()


class Mean(PerRunStep):
    """Takes whatever comes for the state."""

    def make(self, model: Any) -> Any:
        return lambda y, u: y


@pytest.mark.parametrize("intervals", [[part(0, 0.5)], [part(0, np.array([1.0, 1.0, 0.5]))], [whole(0), whole(1)]])
def test_a_step_is_a_whole_one_with_a_measurement(intervals: list[Interval]) -> None:
    estimator = Mean()
    estimator.start(models.still(3), 3, random(3))
    said = ("Mean takes whole steps with a measurement each; this scenario has part steps: write it as predict and "
            "update (PerRun) instead")
    with pytest.raises(Unsupported, match=f"^{re.escape(said)}$"):
        for interval in intervals:
            estimator.predict(NO_INPUT, interval)
    assert (driven(Mean(), models.still(3), [whole(0), whole(1)], Y) == Y).all()
