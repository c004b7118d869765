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
from railstate.estimators.interface import Estimate, Innovation
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
    """Keeps what is told of each step, by its number and name: what is claimed, and innovations of what was received.
    early: of the estimates before the measurements."""

    def __init__(self, walks: bool, early: bool) -> None:
        self.walks, self.predicted_wanted, self.updated_wanted, self.at_once = walks, early, not early, 0
        self.rows: dict[tuple[int, str], np.ndarray] = {}

    def updated(self, step: Any, event: int, estimate: Any) -> None:
        self._keep(step.number, estimate)

    predicted = updated

    def measured(self, step: Any, measurement: Any, innovation: Any) -> None:
        if measurement.event == len(step.events) - 1:
            self._told(step.number, measurement.received, innovation)

    def walked(self, k: int, straight: Any, walk: Any) -> None:
        self.at_once += len(straight.truth)
        for b, received in enumerate(straight.course.received):
            self._told(straight.course.step + b, received, Innovation(*(
                None if part is None else part[b] for part in walk.innovation)))
            self._keep(straight.course.step + b, walk.at(b))

    def _keep(self, number: int, estimate: Estimate) -> None:
        for name in ("mean", "covariance", "bound"):
            value = getattr(estimate, name)
            if value is not None:
                self.rows[number, name] = np.broadcast_to(value, (*value.shape[:-1], RUNS)).copy()

    def _told(self, number: int, received: Any, innovation: Any) -> None:
        for name in ("residual", "variance"):
            value = getattr(innovation, name)
            if value is not None:
                self.rows[number, name] = np.where(received, value, 0.0)
        if innovation.log_likelihood is not None:
            self.rows[number, "said"] = np.where(received.any(axis=0), innovation.log_likelihood, 0.0)


def seen(name: str, label: str, walks: bool, steps: int = STEPS, early: bool = False, **parameters: Any
         ) -> tuple[Seen, Any]:
    """What an observer sees of an entry in a setting's first steps. parameters: instead of the entry's."""
    cell = make_plan([name], only=[label], runs=RUNS).cells[0]
    setting, entry = cell.setting(), cell.entries[label]
    streams = Streams(4, cell.scenario, cell.variant, range(RUNS))
    world = FirstSteps(setting.world(streams), steps)
    estimator, model = prepare(setting, estimator_class(entry.plugin, label), {**entry.parameters, **parameters},
                               entry.knowledge, world.initial_mean)
    estimator.design(model)
    estimator.start(model, RUNS, streams("estimator", label))
    observer = Seen(walks, early)
    for _ in Loop(world, estimator, observer, own=model.own).steps():
        pass
    return observer, estimator


def compare(walked: Seen, one: Any, stepped: Seen, other: Any) -> None:
    """All that was seen of the one and the other, and how they end: to the bit."""
    assert stepped.at_once == 0 and sorted(walked.rows) == sorted(stepped.rows)
    for (number, name), theirs in stepped.rows.items():
        np.testing.assert_array_equal(walked.rows[number, name], theirs, err_msg=f"{name} of step {number}")
    np.testing.assert_array_equal(one.estimate().mean, other.estimate().mean)
    np.testing.assert_array_equal(one.status, other.status)


@pytest.mark.parametrize("label", WALKERS)
@pytest.mark.parametrize("variant", ["wet-radar", "gnss-only"])
def test_a_walk_is_its_steps(variant: str, label: str) -> None:
    (walked, one), (stepped, other) = (seen(f"odometry/{variant}", label, walks) for walks in (True, False))
    assert STEPS - 50 < walked.at_once < STEPS
    compare(walked, one, stepped, other)


@pytest.mark.parametrize(("label", "sensors"), [("imm-slip", "gate"), ("ekf-gated", "sensors")])
def test_a_walk_rejects_what_its_steps_do(label: str, sensors: str) -> None:
    """Where the limit lies amid the readings, half of which are beyond it."""
    amid = {sensors: ["wheel-a", "wheel-b", "radar"], "level": 0.5, "after": 1.5}
    (walked, one), (stepped, other) = (seen("odometry/wet-radar", label, walks, 200, **amid) for walks in (True, False))
    assert walked.at_once > 150
    compare(walked, one, stepped, other)
    free, _ = seen("odometry/wet-radar", label, True, 200, **{**amid, "level": 1 - 1e-9})
    assert (free.rows[200, "mean"] != walked.rows[200, "mean"]).any(axis=0).all()


@pytest.mark.parametrize("early", [True, False])
@pytest.mark.parametrize("label", ["direct", "kalman", "ultimate-bound-published"])
def test_a_walk_of_a_linear_model_is_its_steps(label: str, early: bool) -> None:
    """Whoever hears nothing among others stays to the bit as he is."""
    (walked, one), (stepped, other) = (seen("cbtc-csma/three-trains", label, walks, 100, early)
                                       for walks in (True, False))
    assert walked.at_once == (0 if early and label == "direct" else 99)
    compare(walked, one, stepped, other)


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

    course = Course(1, 0.1, np.array([0.1]), *np.zeros((2, 1, 11, 1)), np.zeros((1, 3, 1), dtype=bool),
                    np.ones((1, 3, 1)))
    for estimator in (Own({}), GatedKalman({"reopen": "median"}), RothStudent({}), ExtendedKalman({})):
        estimator.start(model, 1, RunRandom(1, ("a", "b", "c"), range(1)))
        walk = estimator.walk(course._replace(y=np.zeros((1, 3, 1))), False)
        assert (walk is None) == (type(estimator) is not ExtendedKalman)
    changed = dataclasses.replace(model, measurement_covariance=lambda measurement: np.eye(3)[:, :, None])
    assert model.over(course) is not None and changed.over(course) is None
    assert model.over(course._replace(period=0.2)) is None
