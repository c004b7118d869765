"""Many whole periods in one call against the same estimators step by step: to the bit, whatever is in between."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from railstate.benchmarks.planning.plan import make_plan
from railstate.benchmarks.running.drive import drive, prepare
from railstate.benchmarks.running.execute import FirstSteps
from railstate.benchmarks.running.loop import Loop, Observer
from railstate.estimators.kalman import ExtendedKalman
from railstate.estimators.outliers.gate import GatedKalman
from railstate.estimators.outliers.heavy_tails import RothStudent
from railstate.estimators.registry import estimator_class
from railstate.scenarios.measurement import Course
from railstate.scenarios.odometry.world import OdometryWorld
from railstate.scenarios.randomness import RunRandom, Streams

WALKERS = ["dr-powered", "dr-trailer", "dr-minmax", "ekf-scale", "ekf-gated", "ekf-gated-both", "imm-slip", "ukf-scale",
           "student-t"]
RUNS, STEPS = 3, 900
"""So far that the first balises are read, inside steps; the gates have closed and opened by then."""


class Seen(Observer):
    """Keeps what is told of each step: mean, covariance, and of the innovations what was received."""

    def __init__(self, walks: bool) -> None:
        self.walks, self.at_once = walks, 0
        self.rows: dict[int, list[np.ndarray]] = {}

    def updated(self, step: Any, event: int, estimate: Any) -> None:
        self.rows.setdefault(step.number, []).extend([estimate.mean.copy(), estimate.covariance.copy()])

    def measured(self, step: Any, measurement: Any, innovation: Any) -> None:
        if measurement.event == len(step.events) - 1:
            self.rows.setdefault(step.number, []).extend(self._told(measurement.received, innovation))

    def walked(self, k: int, straight: Any, walk: Any) -> None:
        received = straight.course.received
        self.at_once += len(received)
        for b in range(len(received)):
            innovation = [None if part is None else part[b] for part in walk[2:]]
            told = self._told(received[b], innovation) if any(part is not None for part in innovation) else []
            self.rows[straight.course.step + b] = [*told, walk.mean[b].copy(), walk.covariance[b].copy()]

    @staticmethod
    def _told(received: Any, innovation: Any) -> list[np.ndarray]:
        residual, variance, said = innovation
        if residual is None:
            return [np.where(received.any(axis=0), said, 0.0)]
        return [np.where(received, residual, 0.0), np.where(received, variance, 0.0)]


def seen(name: str, label: str, walks: bool) -> tuple[Seen, Any]:
    """What an observer sees of an entry in a setting's first steps."""
    cell = make_plan([name], only=[label], runs=RUNS).cells[0]
    setting, entry = cell.setting(), cell.entries[label]
    streams = Streams(4, cell.scenario, cell.variant, range(RUNS))
    world = FirstSteps(setting.world(streams), STEPS)
    estimator, model = prepare(setting, estimator_class(entry.plugin, label), entry.parameters, entry.knowledge,
                               world.initial_mean)
    estimator.design(model)
    estimator.start(model, RUNS, streams("estimator", label))
    observer = Seen(walks)
    for _ in Loop(world, estimator, observer, own=model.own).steps():
        pass
    return observer, estimator


@pytest.mark.parametrize("label", WALKERS)
@pytest.mark.parametrize("variant", ["wet-radar", "gnss-only"])
def test_a_walk_is_its_steps(variant: str, label: str) -> None:
    (walked, one), (stepped, other) = (seen(f"odometry/{variant}", label, walks) for walks in (True, False))
    assert STEPS - 50 < walked.at_once < STEPS and stepped.at_once == 0
    assert sorted(walked.rows) == sorted(stepped.rows) == list(range(1, STEPS + 1))
    for number, rows in stepped.rows.items():
        assert len(rows) == len(walked.rows[number])
        for mine, theirs in zip(walked.rows[number], rows, strict=True):
            np.testing.assert_array_equal(mine, theirs, err_msg=f"step {number}")
    np.testing.assert_array_equal(one.estimate().mean, other.estimate().mean)
    np.testing.assert_array_equal(one.status, other.status)


@pytest.mark.parametrize("label", ["dr-minmax", "imm-slip"])
def test_scores_of_walks_are_those_of_steps(label: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """All metrics, outcomes and curves of a whole trip, to the bit."""
    cell = make_plan(["odometry/dry"], only=[label], runs=2).cells[0]
    setting, entry = cell.setting(), cell.entries[label]
    streams = Streams(4, cell.scenario, cell.variant, range(2))
    found = []
    for walks in (True, False):
        if not walks:
            monkeypatch.setattr(OdometryWorld, "straight", lambda world, k, most: None)
        world = setting.world(streams)
        estimator, model = prepare(setting, estimator_class(entry.plugin, label), entry.parameters, entry.knowledge,
                                   world.initial_mean)
        estimator.design(model)
        found.append(drive(setting, world, estimator, model, streams("estimator", label)))
    walked, stepped = found
    for mine, theirs in ((walked.scored.metrics, stepped.scored.metrics), (walked.outcomes, stepped.outcomes),
                         (walked.scored.curves, stepped.scored.curves)):
        assert list(mine) == list(theirs)
        for name, values in theirs.items():
            np.testing.assert_array_equal(mine[name], values, err_msg=str(name))
    np.testing.assert_array_equal(walked.steps, stepped.steps)
    assert walked.scored.nees_states == stepped.scored.nees_states


def test_who_cannot_walk_goes_step_by_step() -> None:
    """A gate that opens otherwise, or a filter of one's own made of another."""
    model = make_plan(["odometry/wet"], only=["ekf-scale"], runs=1).cells[0].setting().told({}, {}, np.zeros((2, 1)))

    class Own(ExtendedKalman):
        def update(self, measurement: Any) -> None:
            """Hears nothing."""

    course = Course(1, 0.1, *np.zeros((2, 1, 11, 1)), np.zeros((1, 3, 1), dtype=bool), np.ones((1, 3, 1)))
    for estimator in (Own({}), GatedKalman({"reopen": "median"}), RothStudent({}), ExtendedKalman({})):
        estimator.start(model, 1, RunRandom(1, ("a", "b", "c"), range(1)))
        walk = estimator.walk(course._replace(y=np.zeros((1, 3, 1))))
        assert (walk is None) == (type(estimator) is not ExtendedKalman)
    changed = dataclasses.replace(model, measurement_covariance=lambda measurement: np.eye(3)[:, :, None])
    assert model.compiled is not None and changed.compiled is None
