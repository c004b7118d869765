"""The robust estimators' compiled forms against their convex problems, solved by cvxpy and Clarabel."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from railstate.benchmarks.running.drive import prepare
from railstate.estimators.interface import Status
from railstate.estimators.robust.convex import BoundedProblem, RecursiveProblem, Solution
from railstate.estimators.robust.estimators import RobustBounded, RobustEllipsoid, RobustMeanSquare
from railstate.estimators.robust.fast import recursive_step
from railstate.estimators.robust.memoryless import memoryless_step
from railstate.scenarios.files import load
from railstate.scenarios.measurement import Measurement
from railstate.scenarios.randomness import Streams

from ..models import heard, part
from .test_robust import A as plant_A
from .test_robust import G, T, admissible, follow, model, started

PROBLEMS = 100
FREE = 1e6
"""A mu that is never active."""


@cache
def convex(form: str, n: int, nw: int, ny: int, mu: float = FREE) -> Any:
    return BoundedProblem(n, nw, ny, mu) if form == "F1" else RecursiveProblem(n, nw, ny, form == "F2")


def draw(random: np.random.Generator, size: tuple[int, int, int] | None = None) -> dict[str, Any]:
    """A random problem with n = 2..4 states, 1..n sensors and one or two disturbance channels."""
    n = int(random.integers(2, 5))
    n, ny, nw = size or (n, int(random.integers(1, n + 1)), int(random.integers(1, 3)))
    W = random.normal(size=(n, n))
    return {"A": np.eye(n) + 0.2 * random.normal(size=(n, n)), "M": random.normal(size=n),
            "N": 0.1 * random.choice([0.0, 0.1, 1.0, 5.0]) * random.normal(size=n),
            "g": 0.3 * random.normal(size=(n, nw)), "C": random.normal(size=(ny, n)),
            "v": random.uniform(0.3, 1.0, ny), "Pi": W @ W.T,
            "received": np.ones(ny, bool)}


def reference(form: str, p: dict[str, Any], mu: float = FREE) -> Solution:
    problem = convex(form, len(p["A"]), p["g"].shape[1], len(p["C"]), mu)
    if form == "F1":
        return problem.solve(p["A"], p["M"], p["N"], p["g"], p["v"], p["C"], p["received"])
    return problem.solve(p["Pi"], p["A"], p["M"], p["N"], p["g"], p["C"], np.diag(p["v"] ** 2), p["received"])


def compiled(form: str, p: dict[str, Any], mu: float = FREE) -> tuple[np.ndarray, np.ndarray, float, int]:
    """(K, P, objective, verdict)."""
    n, ny = len(p["A"]), len(p["C"])
    K, P = np.zeros((n, ny, 1)), np.zeros((n, n, 1))
    stability, objective, verdict = np.zeros(1), np.zeros(1), np.zeros(1, dtype=np.int64)
    A, g, C, Pi = (np.ascontiguousarray(p[name][:, :, None]) for name in ("A", "g", "C", "Pi"))
    received = np.ascontiguousarray(p["received"][:, None])
    moved, one = np.ones(1, bool), np.ones(1)
    if form == "F1":
        memoryless_step(moved, A, p["M"], p["N"], one, g, p["v"], C, received, mu, K, P, objective, stability, verdict)
        return K[:, :, 0], P[:, :, 0], float(objective[0]), int(verdict[0])
    R = np.diag(p["v"] ** 2)[:, :, None]
    recursive_step(Pi, moved, A, p["M"], p["N"], one, g, C, R, received, form == "F2", K, P, stability, verdict)
    return K[:, :, 0], P[:, :, 0], float(np.trace(P[:, :, 0])), int(verdict[0])


@pytest.mark.parametrize("form", ["F1", "F2", "F3"])
def test_objective_on_random_problems(form: str) -> None:
    random = np.random.default_rng(11)
    for _ in range(PROBLEMS):
        problem = draw(random)
        solution, (_, _, objective, verdict) = reference(form, problem), compiled(form, problem)
        assert verdict == 0
        assert objective == pytest.approx(solution.objective, rel=2e-5), solution.status


@pytest.mark.parametrize("form", ["F2", "F3"])
def test_redundant_sensors_are_solved(form: str) -> None:
    """More sensors than states, and a first error far above their noise: two positions of 5 cm, a speed of 2 cm/s."""
    twice = {"A": np.array([[1.0, 0.2], [0.0, 1.0]]), "M": np.zeros(2), "N": np.zeros(2),
             "g": 0.15 * np.array([[0.02], [0.2]]), "C": np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]]),
             "v": np.array([0.05, 0.05, 0.02]), "Pi": np.diag([100.0, 1.0]), "received": np.ones(3, bool)}
    _, _, objective, verdict = compiled(form, twice)
    assert verdict == 0 and objective == pytest.approx(reference(form, twice).objective, rel=2e-5)
    if form == "F2":
        assert objective == pytest.approx((0.05 + 0.02) ** 2, rel=1e-6)  # both raw, each sensor's part its own share
    random = np.random.default_rng(3)
    for scale in (1.0, 10.0, 100.0):
        for _ in range(12):
            n = int(random.integers(2, 5))
            problem = draw(random, (n, n + int(random.integers(1, 3)), int(random.integers(1, 3))))
            problem["Pi"] *= scale**2
            _, _, objective, verdict = compiled(form, problem)
            assert verdict == 0 and objective == pytest.approx(reference(form, problem).objective, rel=2e-5)


@pytest.mark.parametrize("scale", [1.0, 1e-6])
@pytest.mark.parametrize(("n", "ny"), [(1, 3), (2, 3), (3, 2), (3, 5)])
def test_without_a_disturbance_the_gain_is_kalmans_for_noise_that_is_coupled(n: int, ny: int, scale: float) -> None:
    """In information form, which stands where sensors are redundant and S is far above their noise."""
    random = np.random.default_rng(15)
    p = draw(random, (n, ny, 1)) | {"N": np.zeros(n), "g": np.zeros((n, 1))}
    root = scale * random.normal(size=(ny, ny))
    R, K, P = root @ root.T, np.zeros((n, ny, 1)), np.zeros((n, n, 1))
    stability, verdict = np.zeros(1), np.zeros(1, dtype=np.int64)
    A, g, C, Pi = (np.ascontiguousarray(p[name][:, :, None]) for name in ("A", "g", "C", "Pi"))
    recursive_step(Pi, np.ones(1, bool), A, p["M"], p["N"], np.ones(1), g, C, np.ascontiguousarray(R[:, :, None]),
                   np.ones((ny, 1), bool), False, K, P, stability, verdict)
    H = p["C"].T @ np.linalg.inv(R)
    after = np.linalg.inv(np.linalg.inv(p["A"] @ p["Pi"] @ p["A"].T) + H @ p["C"])
    assert verdict[0] == 0
    np.testing.assert_allclose(P[:, :, 0], after, rtol=1e-6, atol=1e-7 * scale**2)
    np.testing.assert_allclose(K[:, :, 0], after @ H, rtol=1e-4, atol=1e-5)
    G = np.eye(n) - K[:, :, 0] @ p["C"]
    assert stability[0] == pytest.approx(np.linalg.norm(G @ p["A"], 2) ** 2, rel=1e-6)


def test_a_convex_problem_without_a_solution_is_a_status_and_the_prediction() -> None:
    """One sensor of two is no contraction by itself; the runs beside it are as they are alone."""
    _, ys, received = admissible(3, 3)
    received[:] = True
    received[1, 0, 1] = False
    estimator = started(RobustBounded, model(3), solver="cvxpy")
    found = follow(estimator, ys, received)
    assert estimator.status.tolist() == [Status.ok, Status.infeasible, Status.ok]
    assert estimator.reasons == {1: "the convex problem has no solution (solver: infeasible)"}
    np.testing.assert_array_equal(found[1].mean[:, 1], plant_A @ found[0].mean[:, 1])
    alone = follow(started(RobustBounded, model(1), solver="cvxpy"), ys[:, :, 2:], received[:, :, 2:])
    np.testing.assert_allclose(found[2].mean[:, 2], alone[2].mean[:, 0], rtol=1e-6)


@pytest.mark.parametrize("form", ["F1", "F2", "F3"])
def test_objective_with_missing_measurements(form: str) -> None:
    random = np.random.default_rng(12)
    for received in ([True, False, True], [False, True, False], [False, False, False]):
        problem = draw(random, (3, 3, 2)) | {"received": np.array(received)}
        solution, (K, P, objective, _) = reference(form, problem), compiled(form, problem)
        assert objective == pytest.approx(solution.objective, rel=2e-5)
        assert (K[:, ~problem["received"]] == 0).all()
        np.testing.assert_allclose(np.trace(P), np.trace(solution.P), rtol=2e-4)


@pytest.mark.parametrize("form", ["F2", "F3"])
def test_bound_holds_for_the_compiled_gain_against_sampled_disturbances(form: str) -> None:
    random = np.random.default_rng(13)
    for _ in range(20):
        p = draw(random)
        K, P, _, _ = compiled(form, p)
        n, samples = len(P), 2000
        E = np.linalg.cholesky(p["Pi"])
        z = random.normal(size=(n, samples))
        e = E @ (z / np.linalg.norm(z, axis=0))
        w = random.choice([-1.0, 1.0], (p["g"].shape[1], samples))
        Delta = random.choice([-1.0, 1.0], samples)
        v = p["v"][:, None] * random.choice([-1.0, 1.0], (len(p["v"]), samples)) * (form == "F2")
        after = (np.eye(n) - K @ p["C"]) @ (p["A"] @ e + np.outer(p["M"], Delta * (p["N"] @ e)) + p["g"] @ w) - K @ v
        # F3: the disturbance's part of the error is inside what P leaves after the noise's second moment.
        left = P if form == "F2" else P - K @ np.diag(p["v"] ** 2) @ K.T
        values, vectors = np.linalg.eigh(left)
        assert values.min() > -1e-9 * values.max()
        keep = values > 1e-7 * values.max()
        inside = ((vectors[:, keep].T @ after) ** 2 / values[keep, None]).sum(axis=0)
        assert inside.max() <= 1 + 1e-6


def test_f1_tells_where_its_stability_condition_is_active_or_hopeless() -> None:
    random = np.random.default_rng(14)
    seen = set()
    for _ in range(30):
        problem = draw(random, (2, 1, 1))
        verdict = compiled("F1", problem, 0.999)[3]
        free, bound = reference("F1", problem), reference("F1", problem, 0.999)
        assert (verdict == 3) == bool(np.linalg.eigvalsh(free.P).max() >= 0.999)
        if verdict == 0:
            assert bound.objective == pytest.approx(free.objective, rel=1e-6)
        seen.add((verdict, bound.status))
    assert {(0, "optimal"), (3, "infeasible"), (3, "optimal")} <= seen


@pytest.mark.parametrize("cls", [RobustBounded, RobustEllipsoid, RobustMeanSquare])
def test_metro_trajectories(cls: Any) -> None:
    """A whole short trip; every step's estimate and objective, both solvers fed the same measurements."""
    setting = load("ningbo-metro", {"plant.line.stops": [0.0, 400.0]}, "switching").setting("switching")
    streams = Streams(4, "ningbo-metro", "switching", [0])
    world = setting.world(streams)
    pair = []
    for solver in ("fast", "cvxpy"):
        estimator, model = prepare(setting, cls, {"solver": solver}, {}, world.initial_mean)
        estimator.start(model, 1, streams("estimator", solver))
        pair.append(estimator)
    fast, slow = pair
    for k in range(world.steps):
        step = world.step(k, world.initial_mean)
        if not step.active.any():
            break
        event = step.events[0]
        received = np.array([[True], [k % 10 != 7]]) if cls is RobustMeanSquare else event.received
        for estimator in pair:
            estimator.predict(step.u, part(k, event.share, step.length))
            estimator.update(heard(event.y, received, k))
        a, b = fast.estimate(), slow.estimate()
        np.testing.assert_allclose(a.mean, b.mean, atol=1e-5)
        if a.ellipsoid is not None and b.ellipsoid is not None:
            assert np.trace(a.ellipsoid[:, :, 0]) == pytest.approx(np.trace(b.ellipsoid[:, :, 0]), rel=2e-5)
    assert k > 200
    assert fast.extremes()["contraction"] == pytest.approx(slow.extremes()["contraction"], abs=1e-4)
    assert fast.status[0] == slow.status[0] == Status.ok


def test_runs_whose_sensors_tell_their_own_accuracy() -> None:
    """Of three runs, two disturbances and two sensors, both solvers; each run as if it were alone."""
    _, ys, _ = admissible(3, 4)
    own = np.stack([np.diag([0.3, 0.05]), np.diag([1.5, 0.4]), np.diag([0.1, 2.0])], axis=2)

    def went(runs: list[int], solver: str) -> list[np.ndarray]:
        told = replace(model(len(runs)), measurement_covariance=lambda measurement: measurement.covariance)
        estimator, out = started(RobustMeanSquare, told, solver=solver), []
        for k, y in enumerate(ys):
            estimator.predict(np.zeros((0, len(runs))), part(k, 1.0, T))
            estimator.update(Measurement(y[:, runs], np.ones((2, len(runs)), bool), k + 1, 0, k + 1.0,
                                         np.ascontiguousarray(own[:, :, runs])))
            out.append(estimator.estimate().mean.copy())
        return out

    fast, convex = went([0, 1, 2], "fast"), went([0, 1, 2], "cvxpy")
    np.testing.assert_allclose(fast, convex, atol=1e-5)
    assert np.abs(fast[0]).min() > 1e-3
    alone = [np.hstack(each) for each in zip(*(went([run], "fast") for run in range(3)), strict=True)]
    np.testing.assert_array_equal(fast, alone)


def test_f1_claims_the_theorem_s_bound_and_keeps_it() -> None:
    """r+ = sqrt(lambda_max P) r + sqrt(n tr Th) with the P and Th of the convex problems themselves, n counting the
    disturbances and the sensors heard; admissible truths stay inside."""
    runs, steps = 6, 12
    xs, ys, received = admissible(runs, steps)
    received[:] = received[:, :1]  # both sensors or none: with one of them P << mu I is active
    fast, convex = (follow(started(RobustBounded, model(runs), solver=solver), ys, received)
                    for solver in ("fast", "cvxpy"))
    problem = BoundedProblem(2, 2, 2, 0.9999)
    for run in range(runs):
        r = np.sqrt(1.25)
        for k in range(steps):
            heard_of = received[k, :, run]
            B = G * [0.3, 0.2]
            if heard_of.any():
                found = problem.solve(plant_A, np.array([0.3, 1.0]), np.array([0.0, 0.02]), B, np.array([1.0, 0.4]),
                                      np.eye(2), heard_of)
                spread = found.objective - np.trace(found.P)
                r = np.sqrt(np.linalg.eigvalsh(found.P)[-1]) * r + np.sqrt((2 + heard_of.sum()) * spread)
                assert fast[k].ellipsoid[0, 0, run] == pytest.approx(r * r, rel=1e-4)
            r = np.sqrt(fast[k].ellipsoid[0, 0, run])
            assert convex[k].ellipsoid[1, 1, run] == pytest.approx(r * r, rel=1e-4)
            assert np.linalg.norm(fast[k].mean[:, run] - xs[k, :, run]) <= r
