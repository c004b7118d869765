"""What estimators do where few scenarios lead: against plain loops, or in whole words.

Walks that fail, models that bend, modes without noise of their own, solvers and disks that give up."""

from __future__ import annotations

import dataclasses
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from cvxpy.error import SolverError
from railstate.benchmarks.planning.plan import make_plan
from railstate.estimators.interface import Estimate, Estimator, Status, Walk, misshapen
from railstate.estimators.mode_grid import known_states, sensor_noise
from railstate.estimators.multiple_model.hypotheses import InteractingModels
from railstate.estimators.outliers.heavy_tails import StudentKalman
from railstate.estimators.outliers.second_order import SecondOrderKalman
from railstate.estimators.random_access.bounds import critical_access
from railstate.estimators.random_access.estimators import RandomAccessFilter
from railstate.estimators.registry import estimator_class
from railstate.estimators.robust.convex import ATTEMPTS, RecursiveProblem
from railstate.estimators.ultimate_bound import decay
from railstate.estimators.ultimate_bound.decay import corollary2
from railstate.scenarios.errors import Infeasible
from railstate.scenarios.measurement import Course, Interval, Measurement, told
from railstate.scenarios.model import DesignModel, Grid, Linear, Mode, Reception, grid_modes
from railstate.scenarios.randomness import RunRandom

from .. import models
from ..models import coasting, heard, random, whole
from . import test_ultimate_bound

SINGULAR = "an innovation covariance was not positive definite"


def told_model(label: str, runs: int) -> tuple[Any, DesignModel]:
    """An entry of odometry and what it is told, a reading of each sensor alone telling its accuracy."""
    cell = make_plan(["odometry/wet"], only=[label], runs=1).cells[0]
    setting, entry = cell.setting(), cell.entries[label]
    return entry, setting.told(entry.knowledge, {}, np.zeros((2, runs)))


def both_ways(entry: Any, label: str, model: DesignModel, course: Course) -> tuple[Estimator, Walk, Estimator]:
    """Who has walked a course of three runs, what came of it, and who has gone it step by step to the same bits."""
    walked, stepped = (estimator_class(entry.plugin, label)(entry.parameters) for _ in range(2))
    for estimator in (walked, stepped):
        estimator.design(model)
        estimator.start(model, 3, random(3))
    walk = walked.walk(course, False)
    assert walk is not None
    for b, variance in enumerate(course.told):
        stepped.predict(course.u[b], whole(b, model.period))
        covariance = np.full((model.ny, model.ny, 3), np.nan)
        covariance[np.arange(model.ny), np.arange(model.ny)] = variance
        stepped.update(Measurement(course.y[b], course.received[b], b + 1, 0, course.times[b], covariance))
        found = stepped.estimate()
        np.testing.assert_array_equal(walk.mean[b], found.mean)
        np.testing.assert_array_equal(walk.covariance[b], found.covariance)  # pyright: ignore
    return walked, walk, stepped


@pytest.mark.parametrize("label", ["ekf-scale", "ekf-gated", "student-t", "imm-slip"])
def test_a_walk_that_fails_fails_as_its_steps_do(label: str) -> None:
    """Readings that tell a negative variance: their run alone is lost, with the reason, and stays so."""
    entry, model = told_model(label, 3)
    steps, rng = 4, np.random.default_rng(1)
    variance = np.full((steps, model.ny, 3), np.nan)
    variance[1, :, 1] = -1e6
    course = Course(1, model.period, model.period * np.arange(1.0, steps + 1), np.zeros((steps, 11, 3)),
                    rng.normal(0.0, 0.01, (steps, model.ny, 3)), np.ones((steps, model.ny, 3), dtype=bool), variance)
    walked, walk, stepped = both_ways(entry, label, model, course)
    assert walked.status.tolist() == stepped.status.tolist() == [Status.ok, Status.failed, Status.ok]
    assert walked.reasons == stepped.reasons == {
        1: "all modes became impossible" if label == "imm-slip" else SINGULAR}
    assert np.isfinite(walk.mean[:, :, [0, 2]]).all()


def test_dead_reckoning_set_anew_on_a_walk_is_its_steps() -> None:
    """By readings in whole steps, which built-in trips do not have: each run by its own, or by none."""
    entry, model = told_model("dr-minmax", 3)
    steps, rng, place = 6, np.random.default_rng(1), model.measurements.index("balise")
    received = np.zeros((steps, model.ny, 3), dtype=bool)
    received[1, place, 0] = received[3, place] = received[4, place, 2] = True
    variance = np.full((steps, model.ny, 3), np.nan)
    variance[3, place, 1] = 7.0
    inputs = np.zeros((steps, 11, 3))
    inputs[:, 3:5] = rng.uniform(0.5, 4.0, (steps, 2, 3))
    course = Course(1, model.period, model.period * np.arange(1.0, steps + 1), inputs,
                    rng.normal(50.0, 5.0, (steps, model.ny, 3)), received, variance)
    _, walk, _ = both_ways(entry, "dr-minmax", model, course)
    for b in range(steps):
        np.testing.assert_array_equal(walk.mean[b, 0, received[b, place]], course.y[b, place, received[b, place]])


def test_who_else_goes_step_by_step() -> None:
    """A filter made of another, and modes one of which is made of other functions."""
    entry, model = told_model("student-t", 1)
    course = Course(1, model.period, np.array([model.period]), *np.zeros((2, 1, 11, 1)),
                    np.zeros((1, model.ny, 1), dtype=bool))
    course = course._replace(y=np.zeros((1, model.ny, 1)))

    class Own(StudentKalman):
        """As Student's."""

    for estimator, walks in ((Own(entry.parameters), False), (StudentKalman(entry.parameters), True)):
        estimator.start(model, 1, random(1))
        assert (estimator.walk(course, False) is not None) == walks
    _, model = told_model("imm-slip", 1)
    assert model.modes is not None
    first, *others = model.modes.modes
    other = replace(first.model, transition=lambda x, u, interval: first.model.transition(x, u, interval))
    course = course._replace(y=np.zeros((1, model.ny, 1)), received=np.zeros((1, model.ny, 1), dtype=bool))
    for mode, walks in ((first, True), (Mode("another", other), False)):
        estimator = InteractingModels()
        own = replace(model, modes=dataclasses.replace(model.modes, modes=(mode, *others)))
        estimator.design(own)
        estimator.start(own, 1, random(1))
        assert (estimator.walk(course, False) is not None) == walks


def test_the_second_order_filter_is_the_textbook_s() -> None:
    """Coasting, whose motion and reading bend: its Hessians by hand, over sums of scalars, readings lost."""
    runs, steps, drag, mast = 2, 8, 0.02, 40.0
    model = coasting(runs)
    data = models.record(model, runs, steps)
    means, covariances = models.feed(SecondOrderKalman(), model, data)
    assert covariances is not None and model.process_covariance is not None
    assert model.transition_jacobian is not None and model.measurement_jacobian is not None
    assert model.measurement_covariance is not None

    def curved(hessians: list[np.ndarray], P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return (np.array([0.5 * np.trace(a @ P) for a in hessians]),
                np.array([[0.5 * np.trace(a @ P @ b @ P) for b in hessians] for a in hessians]))

    bends = False
    for run in range(runs):
        x, P, t = model.initial_mean[:, run:run + 1].copy(), model.initial_covariance[:, :, 0].copy(), model.period
        for k in range(steps):
            u, between, slowed = data.u[k, :, run:run + 1], whole(k, t), 1 + drag * x[1, 0] * t
            shift, spread = curved([np.diag([0.0, -drag * t**2 / slowed**2]),
                                    np.diag([0.0, -2 * drag * t / slowed**3])], P)
            F = model.transition_jacobian(x, u, between)[:, :, 0]
            P = F @ P @ F.T + model.process_covariance(x, u, between)[:, :, 0] + spread
            x = model.transition(x, u, between) + shift[:, None]
            shift, spread = curved([np.diag([mast**2 / (x[0, 0]**2 + mast**2)**1.5, 0.0]), np.zeros((2, 2))], P)
            got = np.flatnonzero(data.received[k, :, run])
            bends |= bool(len(got) and spread[got[0], got[0]] > 1e-6)
            if len(got):
                H = model.measurement_jacobian(x, k + 1)[got, :, 0]
                R = model.measurement_covariance(heard(data.y[k], data.received[k]))[:, :, 0] + spread
                R = R[np.ix_(got, got)]
                K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
                left = np.eye(2) - K @ H
                x = x + K @ (data.y[k, got, run:run + 1] - (model.measurement(x, k + 1) + shift[:, None])[got])
                P = left @ P @ left.T + K @ R @ K.T
            np.testing.assert_allclose(means[k, :, run], x[:, 0], rtol=0, atol=1e-6)
            np.testing.assert_allclose(covariances[k, ..., run], P, rtol=0, atol=1e-6)
    assert bends
    wrong = replace(model, measurement_covariance=told(lambda step: -1e3 * np.eye(2)[:, :, None]))
    models.feed(estimator := SecondOrderKalman(), wrong, models.record(model, runs, 1, loss=0.0))
    assert estimator.status.tolist() == [Status.failed] * 2 and estimator.reasons == dict.fromkeys(range(2), SINGULAR)


def test_states_that_are_known_exactly() -> None:
    """Of random modes, against a search through all that each state leans on."""
    rng, seen = np.random.default_rng(4), set[tuple[bool, ...]]()
    for _ in range(60):
        A = np.repeat(rng.integers(0, 2, (1, 4, 4)) * (rng.uniform(size=(4, 4)) < 0.5), 2, axis=0).astype(float)
        B, Q = np.ones((2, 4, 1)), np.zeros((4, 4))
        for array in (A, B):
            i = rng.integers(0, 8)
            array[1, i % 4, 0] += i < 2
        j, start = rng.integers(0, 6), np.diag((rng.uniform(size=4) < 0.3).astype(float))
        if j < 4:
            Q[j, j] = 1.0
        modes = Grid("f", np.arange(2.0), A, B, np.eye(1, 4), Q, np.eye(1), np.full(2, 0.5))

        def exact(i: int, modes: Grid = modes, start: np.ndarray = start) -> bool:
            leaning, waiting = {i}, [i]
            while waiting:
                at = waiting.pop()
                more = [c for c in range(4) if modes.A[0, at, c] != 0 and c not in leaning]
                leaning.update(more)
                waiting += more
            return all(start[c, c] == 0 and not modes.Q[c].any() and (modes.A[0, c] == modes.A[1, c]).all()
                       and (modes.B[0, c] == modes.B[1, c]).all() for c in leaning)

        wanted = tuple(map(exact, range(4)))
        assert tuple(known_states(modes, start).tolist()) == wanted
        seen.add(wanted)
    assert len(seen) > 8


def test_noise_of_modes_is_the_grid_s_where_the_model_tells_none() -> None:
    model, R = models.linear(2), np.array([[2.0, 0.5], [0.5, 1.0]])
    grid = Grid("f", np.ones(1), np.eye(3)[None], np.zeros((1, 3, 1)), np.eye(2, 3), np.eye(3), R, np.ones(1))
    own = replace(model, modes=grid_modes(grid, model), measurement_covariance=None)
    measurement = heard(np.zeros((2, 2)), np.ones((2, 2), dtype=bool))
    np.testing.assert_array_equal(sensor_noise(own, measurement), R[:, :, None])
    told_too = replace(own, measurement_covariance=told(lambda step: 3 * R[:, :, None]))
    np.testing.assert_array_equal(sensor_noise(told_too, measurement), 3 * R[:, :, None])


@pytest.mark.parametrize("name", ["sma", "rbpf", "imm"])
def test_two_steps_without_a_measurement_between(name: str) -> None:
    """Are two steps with one that nobody hears."""
    cell = make_plan(["braking-rate/paper"], only=[name], runs=1).cells[0]
    setting, entry, means = cell.setting(), cell.entries[name], []
    model = setting.told(entry.knowledge, {}, np.repeat(np.array(setting.config.plant.initial)[:4, None], 2, axis=1))
    for silent in (False, True):
        estimator = estimator_class(entry.plugin, name)(entry.parameters)
        estimator.design(model)
        estimator.start(model, 2, random(2))
        for k in range(4):
            estimator.predict(np.full((1, 2), -0.5), whole(k, model.period))
            if k % 2 or silent:
                estimator.update(heard(np.array([[9.0, 8.0]] * model.ny), np.full((model.ny, 2), k % 2 > 0), k))
        found = estimator.estimate()
        means.append((found.mean.copy(), found.covariance, found.parameter))
    for alone, together in zip(*means, strict=True):
        np.testing.assert_allclose(alone, together, rtol=1e-9)


class Silent(Estimator):
    """Says no more than it has to."""

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        super().start(model, runs, random)

    def predict(self, u: Any, interval: Interval) -> None: ...

    def update(self, measurement: Measurement) -> None: ...

    def estimate(self) -> Estimate:
        return Estimate(self.model.initial_mean)


def test_an_estimator_that_says_no_more_than_it_has_to() -> None:
    model = models.still(3)
    estimator = Silent()
    assert estimator.design(model) == {}
    estimator.start(model, 3, random(3))
    assert (estimator.past(), list(estimator.finish()), estimator.counters(), estimator.extremes()) == (
        None, [], {}, {})
    assert (Silent.memory(3, 5), estimator.status.tolist(), estimator.reasons, estimator.rejected) == (
        0, [Status.ok] * 3, {}, None)
    assert estimator.walk(Course(1, 1.0, np.ones(1), *np.zeros((2, 1, 1, 3)), np.ones((1, 1, 3), dtype=bool)),
                          False) is None
    zeros: Any = np.zeros
    for estimate, said in (
            (Estimate([[0.0]]), "mean is list, not an array"),  # pyright: ignore
            (Estimate(None), "mean is NoneType, not an array"),  # pyright: ignore
            (Estimate(zeros((2, 3)), parameter=zeros((1, 3))), "parameter has shape (1, 3), type float64; allowed for "
             "2 states and 3 runs: float64 of shape none"),
            (Estimate(zeros((2, 3)), covariance=zeros((2, 1, 3))), "covariance has shape (2, 1, 3), type float64; "
             "allowed for 2 states and 3 runs: float64 of shape (2, 2, 1) or (2, 2, 3) or (1, 1, 1) or (1, 1, 3)"),
            (Estimate(zeros((2, 3)), bound=zeros(2)), "bound has shape (2,), type float64; allowed for 2 states and 3 "
             "runs: float64 of shape (1,) or (3,)"),
            (Estimate(zeros((2, 3)), diversity=zeros(1, dtype=int)), "diversity has shape (1,), type int64; allowed "
             "for 2 states and 3 runs: float64 of shape (3,)"),
            (Estimate(zeros((2, 3)), diversity=zeros(3, dtype=int)), None)):
        assert misshapen(estimate, 2, 3, 0) == said


def test_what_no_access_can_hold_and_windows_that_are_too_long() -> None:
    """A state that grows and is in no reading; a claim whose window reaches beyond the horizon of the bounds."""
    parts = np.diag([1.25, 0.5]), np.zeros((2, 1)), np.zeros(2), np.array([[0.0, 1.0]]), np.eye(2), np.eye(1)
    linear = Linear(*(lambda k, matrix=matrix: matrix for matrix in parts))
    reception = Reception(1.0, 1.0, ((0,),), (1.0,))
    assert critical_access(linear, reception) == 1.0
    few = models.linear(1)
    assert few.linear is not None
    known = replace(few, linear=replace(few.linear, steps=6), reception=Reception(1.0, 1.0, ((0, 1),), (1.0,)))
    told_of = RandomAccessFilter({"sigma": 20.0, "m": 8}).design(known)
    assert told_of["claimed (30), (31)"] == "not checked: m = 8 needs more than 6 steps"


def test_solvers_that_give_up_or_claim_too_much(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, asked = RecursiveProblem(2, 1, 1, False), list[Any]()

    def gives_up(**how: Any) -> None:
        asked.append(how)
        raise SolverError("gave up")

    monkeypatch.setattr(problem, "problem", SimpleNamespace(solve=gives_up))
    found = problem._solve()
    assert found.status == "solver error" and len(asked) == len(ATTEMPTS)
    assert all(how["warm_start"] is False and how["solver"] == "CLARABEL" for how in asked)
    assert np.isnan(found.K).all() and found.K.shape == (2, 1) and np.isnan(found.P).all() and found.P.shape == (2, 2)

    def careless(problem: Any, solver: str) -> str:
        for variable in problem.variables():
            variable.value = np.ones(variable.shape)
        return "optimal"

    monkeypatch.setattr(decay, "solve_problem", careless)
    said = r"Corollary 2: CLARABEL says optimal, but constraints \(32\), \(34\) are violated by \d\.\de[-+]\d\d"
    with pytest.raises(Infeasible, match=f"^{said}$"):
        corollary2(test_ultimate_bound.system(), 5.0)


def test_a_constant_gain_of_one_s_own_goes_step_by_step(tmp_path: Path) -> None:
    fixed: Any = estimator_class("fixed-gain", "fixed")

    class Own(fixed):
        def update(self, measurement: Measurement) -> None:
            """Hears nothing."""

    np.savetxt(tmp_path / "gain.csv", np.zeros((4, 4)), delimiter=",")
    model = test_ultimate_bound.model()
    course = Course(1, model.period, np.ones(1), np.zeros((1, len(model.linear.B(0)[0]), 2)),
                    np.zeros((1, model.ny, 2)), np.zeros((1, model.ny, 2), dtype=bool))
    for kind in (fixed, Own):
        estimator = kind({"gain": str(tmp_path / "gain.csv")})
        estimator.design(model)
        estimator.start(model, 2, random(2))
        assert (estimator.walk(course, False) is None) == (kind is Own)
