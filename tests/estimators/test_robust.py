"""The robust estimators against known answers and their own claims: gains, guarantees, missing packets, statuses.

The convex problems themselves are the oracle in test_robust_convex.py."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from railstate.benchmarks.running.drive import drive, prepare
from railstate.estimators.interface import Estimator, Status
from railstate.estimators.robust.estimators import RobustBounded, RobustEllipsoid, RobustMeanSquare
from railstate.scenarios.errors import Unsupported
from railstate.scenarios.files import load
from railstate.scenarios.model import Bounds, DesignModel, Linear, linear_model
from railstate.scenarios.randomness import RunRandom, Streams

from ..models import heard, part, whole

FAMILY = [RobustBounded, RobustEllipsoid, RobustMeanSquare]
T = 0.5
A = np.array([[1.0, T], [0.0, 0.9]])
G = np.array([[T * T / 2, 0.1], [T, 0.0]])


def model(runs: int, *, kappa: float = 0.02, C: Any = None, w_bar: Any = (0.3, 0.2), v_bar: Any = (1.0, 0.4),
          start: float = 1.0) -> DesignModel:
    """Two states, two disturbance channels, and an uncertain speed row: A + M Delta N, N = [0, kappa]."""
    C, v_bar = np.eye(2) if C is None else np.array(C), np.array(v_bar)
    R = np.diag(np.where(np.isfinite(v_bar), v_bar, 1.0) ** 2 / 3)
    linear = Linear(lambda k: A, lambda k: np.zeros((2, 0)), lambda k: np.zeros(2), lambda k: C,
                    lambda k: np.zeros((2, 2)), lambda k: R)
    bounds = Bounds(G, np.array(w_bar), v_bar, np.array([[0.3], [1.0]]), np.array([[0.0, 1.0]]),
                    lambda x, u, Pi: np.full(x.shape[1], kappa))
    return linear_model(linear, states=("s", "v"), measurements=("s", "v"), period=T, initial_mean=np.zeros((2, runs)),
                        initial_covariance=start * np.diag([1.0, 0.25])[:, :, None], bounds=bounds,
                        performance=np.eye(2))


def started(cls: type[Estimator], told: DesignModel, **parameters: Any) -> Estimator:
    estimator, runs = cls(parameters), told.initial_mean.shape[1]
    estimator.design(told)
    estimator.start(told, runs, RunRandom(0, ("s", "v", "e"), range(runs)))
    return estimator


def admissible(runs: int, steps: int, seed: int = 3) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Truths inside every bound, adversarial in half the runs: x (K, 2, S), y (K, 2, S), received (K, 2, S)."""
    random = np.random.default_rng(seed)
    x = random.uniform(-1, 1, (2, runs)) * np.array([[1.0], [0.5]])
    xs, ys = [], []
    for k in range(steps):
        w = random.uniform(-1, 1, (2, runs))
        w[:, ::2] = np.sign(np.sin(0.2 * k + np.arange(w[:, ::2].shape[1])))
        Delta = random.choice([-1.0, 1.0], runs)
        x = A @ x + 0.02 * Delta * np.array([[0.3], [1.0]]) * x[1] + G @ (np.array([[0.3], [0.2]]) * w)
        xs.append(x)
        ys.append(x + random.uniform(-1, 1, (2, runs)) * np.array([[1.0], [0.4]]))
    return np.array(xs), np.array(ys), random.random((steps, 2, runs)) < 0.7


def follow(estimator: Estimator, ys: np.ndarray, received: np.ndarray) -> list[Any]:
    out = []
    u = np.zeros((0, ys.shape[2]))
    for y, got in zip(ys, received, strict=True):
        estimator.predict(u, whole(0, T))
        estimator.update(heard(np.where(got, y, np.nan), got))
        out.append(replace(estimator.estimate(), mean=estimator.estimate().mean.copy()))
    return out


def test_f1_without_linearisation_error_is_the_closed_form() -> None:
    estimator = started(RobustBounded, model(1, kappa=0.0))
    estimator.predict(np.zeros((0, 1)), whole(0, T))
    y = np.array([[0.7], [-0.4]])
    estimator.update(heard(y, np.ones((2, 1), bool)))
    B = G * [0.3, 0.2]
    S = A @ A.T + B @ B.T
    K = S @ np.linalg.inv(S + np.diag([1.0, 0.16]))
    np.testing.assert_allclose(estimator.estimate().mean, K @ y, rtol=1e-12)


def test_f3_scalar_is_the_known_optimum() -> None:
    # One state, no noise model but R: min over K of ((1-K)(sqrt(Pi) + w))^2 + K^2 R is a ratio.
    told = model(1, kappa=0.0, w_bar=(0.0, 0.0))
    linear = Linear(lambda k: np.eye(1), lambda k: np.zeros((1, 0)), lambda k: np.zeros(1), lambda k: np.eye(1),
                    lambda k: np.zeros((1, 1)), lambda k: 0.5 * np.eye(1))
    told = linear_model(linear, states=("s",), measurements=("s",), period=1.0, initial_mean=np.zeros((1, 1)),
                        initial_covariance=np.full((1, 1, 1), 4.0), performance=np.eye(1),
                        bounds=Bounds(np.ones((1, 2)), np.array([0.5, 0.25]), np.ones(1)))
    estimator = started(RobustMeanSquare, told)
    estimator.predict(np.zeros((0, 1)), whole(0, T))
    estimator.update(heard(np.ones((1, 1)), np.ones((1, 1), bool)))
    spread = (2.0 + 0.5 + 0.25) ** 2
    estimate = estimator.estimate()
    assert estimate.mean[0, 0] == pytest.approx(spread / (spread + 0.5), rel=1e-9)
    assert estimate.bound is not None and estimate.bound[0] == pytest.approx(spread * 0.5 / (spread + 0.5), rel=1e-8)


@pytest.mark.parametrize("sensors", ["both", "position"])
def test_f2_contains_every_admissible_truth_before_and_after_measurements(sensors: str) -> None:
    xs, ys, received = admissible(60, 60)
    C = None if sensors == "both" else [[1.0, 0.0], [0.0, 0.0]]
    # The uncertain row acts on the state here, not on the error: its part on the estimate is a disturbance, bounded
    # because |v| stays under 4 in these truths.
    assert np.abs(xs[:, 1]).max() < 4
    told = model(60, C=C)
    bounds = told.bounds
    assert bounds is not None
    wide = Bounds(np.hstack([G, [[0.3], [1.0]]]), np.array([0.3, 0.2, 0.08]), bounds.v_bar)
    estimator = started(RobustEllipsoid, replace(told, bounds=wide))
    if C is not None:
        received = received & np.array([[True], [False]])
    for x, y, got in zip(xs, ys, received, strict=True):
        estimator.predict(np.zeros((0, 60)), whole(0, T))
        for measured in (False, True):
            if measured:
                estimator.update(heard(y, got))
            estimate = estimator.estimate()
            Pi = np.moveaxis(np.asarray(estimate.ellipsoid), 2, 0)
            assert (np.linalg.eigvalsh(Pi) > 0).all() and (np.moveaxis(Pi, 1, 2) == Pi).all()
            e = (x - estimate.mean).T[:, :, None]
            assert (np.moveaxis(e, 1, 2) @ np.linalg.solve(Pi, e)).max() <= 1 + 1e-9
    assert (estimator.status == 0).all()


def test_f3_bound_holds_in_the_mean_square() -> None:
    runs, steps = 400, 40
    random = np.random.default_rng(5)
    x = random.uniform(-1, 1, (2, runs)) * np.sqrt(3 * np.array([[1.0], [0.25]]))
    estimator = started(RobustMeanSquare, model(runs, kappa=0.0))
    side = np.array([[1.0], [1.0]])
    for k in range(steps):
        x = A @ x + G @ (np.array([[0.3], [0.2]]) * side)
        y = x + random.uniform(-1, 1, (2, runs)) * np.array([[1.0], [0.4]])
        estimator.predict(np.zeros((0, runs)), whole(k, T))
        estimator.update(heard(y, np.ones((2, runs), bool) if k % 3 else random.random((2, runs)) < 0.5, k))
        squared = ((x - estimator.estimate().mean) ** 2).sum(axis=0)
        bound = np.asarray(estimator.estimate().bound)
        assert (squared - bound).mean() < 3 * squared.std() / np.sqrt(runs)


@pytest.mark.parametrize("cls", FAMILY)
def test_results_do_not_depend_on_the_batch(cls: type[Estimator]) -> None:
    _, ys, received = admissible(9, 25)
    if cls is RobustBounded:
        received[:] = received[:, :1]
    whole = started(cls, model(9))
    follow(whole, ys, received)
    for some in ([4], [1, 2, 7], list(range(8))):
        part = started(cls, model(len(some)))
        follow(part, np.ascontiguousarray(ys[:, :, some]), np.ascontiguousarray(received[:, :, some]))
        a, b = whole.estimate(), part.estimate()
        assert (a.mean[:, some] == b.mean).all()
        for name in cls.claims:
            assert (getattr(a, name)[..., some] == getattr(b, name)).all()
        assert (whole.extremes()["contraction"][some] == part.extremes()["contraction"]).all()


@pytest.mark.parametrize("cls", FAMILY)
def test_runs_whose_portion_is_zero_stay_as_they_are(cls: type[Estimator]) -> None:
    told = replace(model(2), bounds=Bounds(G, np.array([0.3, 0.2]), np.array([1.0, 0.4])))
    # linear_model knows whole steps only; here a run either makes one or none.
    estimator = started(cls, replace(told, transition=lambda x, u, interval: told.transition(x, u, whole(0, T))))
    everything = np.ones((2, 2), bool)
    estimator.predict(np.zeros((0, 2)), whole(0, T))
    estimator.update(heard(np.ones((2, 2)), everything))
    before = estimator.estimate()
    kept = [np.array(part[..., 0]) for part in (before.mean, before.ellipsoid, before.bound) if part is not None]
    estimator.predict(np.zeros((0, 2)), part(0, np.array([0.0, 1.0]), T))
    estimator.update(heard(np.full((2, 2), 2.0), everything & [[False, True]]))
    after = estimator.estimate()
    now = [part[..., 0] for part in (after.mean, after.ellipsoid, after.bound) if part is not None]
    assert all((a == b).all() for a, b in zip(kept, now, strict=True))
    assert (after.mean[:, 1] != after.mean[:, 0]).all()


@pytest.mark.parametrize("cls", FAMILY)
def test_a_run_without_measurements_is_the_prediction_alone(cls: type[Estimator]) -> None:
    estimator = started(cls, replace(model(1), initial_mean=np.array([[1.0], [2.0]])))
    for _ in range(3):
        estimator.predict(np.zeros((0, 1)), whole(0, T))
        estimator.update(heard(np.full((2, 1), np.nan), np.zeros((2, 1), bool)))
    np.testing.assert_allclose(estimator.estimate().mean[:, 0], np.linalg.matrix_power(A, 3) @ [1.0, 2.0], rtol=1e-14)
    assert estimator.status[0] == Status.ok
    worst = max(np.linalg.norm(A + s * 0.02 * np.outer([0.3, 1.0], [0.0, 1.0]), 2) ** 2 for s in (-1, 1))
    assert estimator.extremes()["contraction"][0] == pytest.approx(worst, rel=1e-12)


@pytest.mark.parametrize("cls", FAMILY)
@pytest.mark.parametrize(("changes", "status"), [
    ({"w_bar": (0.0, 0.0)}, Status.ok),
    ({"v_bar": (0.0, 0.0)}, Status.ok),
    ({"C": [[1.0, 0.0], [1.0, 0.0]]}, Status.ok),
    ({"C": [[1.0, 0.0], [1.0, 0.0]], "v_bar": (0.0, 0.0)}, Status.infeasible),
    ({"kappa": 1e200}, Status.infeasible),
    ({"kappa": np.nan}, Status.infeasible),
    ({"start": 0.0}, Status.ok),
])
def test_degenerate_problems_end_in_a_status(cls: type[Estimator], changes: dict[str, Any], status: Status) -> None:
    estimator = started(cls, model(3, **changes))
    for estimate in follow(estimator, admissible(3, 4)[1], np.ones((4, 2, 3), bool)):
        assert np.isfinite(estimate.mean).all()
    assert (estimator.status == status).all()
    assert bool(estimator.reasons) == (status != Status.ok)


@pytest.mark.parametrize("cls", FAMILY)
def test_a_bad_run_leaves_the_others_alone(cls: type[Estimator]) -> None:
    told = model(3)
    assert told.bounds is not None
    poisoned = replace(told.bounds, kappa=lambda x, u, Pi: np.array([0.02, np.nan, 0.02]))
    _, ys, _ = admissible(3, 5)
    everything = np.ones(ys.shape, bool)
    bad, good = started(cls, replace(told, bounds=poisoned)), started(cls, told)
    follow(bad, ys, everything)
    follow(good, ys, everything)
    assert bad.status.tolist() == [0, Status.infeasible, 0] and "finite" in bad.reasons[1]
    assert (bad.estimate().mean[:, ::2] == good.estimate().mean[:, ::2]).all()


def test_sensors_without_bounds() -> None:
    told = model(2, v_bar=(np.inf, np.inf))
    for cls in (RobustBounded, RobustEllipsoid):
        with pytest.raises(Unsupported, match="sigmas"):
            cls().design(told)
        cls({"sigmas": 3.0}).design(told)
    RobustMeanSquare().design(told)
    # One bounded sensor: the other is not used, whatever it says.
    _, ys, _ = admissible(2, 6)
    half = started(RobustEllipsoid, model(2, v_bar=(1.0, np.inf)))
    wild = ys.copy()
    wild[:, 1] = 1e6
    only = started(RobustEllipsoid, model(2, v_bar=(1.0, np.inf)))
    everything = np.ones(ys.shape, bool)
    follow(half, ys, everything)
    follow(only, wild, everything)
    assert (half.estimate().mean == only.estimate().mean).all()


SAME: list[tuple[dict[str, Any], dict[str, Any], dict[str, Any], dict[str, Any]]] = [
    ({"kappa": 0.3}, {"kappa": 0.02}, {"kappa": 0.02}, {}),  # a parameter instead of the model's
    ({"start": 3.0}, {"initial_scale": 1.0}, {}, {"initial_scale": 3.0}),
    ({}, {"initial_scale": 4.0, "kappa": 0.0}, {"start": 4.0, "kappa": 0.0}, {"initial_scale": 1.0}),
    ({"v_bar": (np.inf, 0.4)}, {"sigmas": 2.0}, {"v_bar": (2.0 / 3**0.5, 0.4)}, {}),  # told a variance of v_bar^2 / 3
    ({"v_bar": (1.0, 0.4)}, {"sigmas": 9.0}, {"v_bar": (1.0, 0.4)}, {})]
"""A model and parameters, and others that say the same."""


@pytest.mark.parametrize("cls", FAMILY)
@pytest.mark.parametrize("one", SAME)
def test_what_is_said_in_two_ways_is_the_same(cls: type[Estimator], one: tuple[dict[str, Any], ...]) -> None:
    _, ys, received = admissible(2, 8)
    received[:] = received[:, :1]
    told, parameters, other, others = one
    known = cls.Parameters.model_fields
    if not {*parameters, *others} <= set(known):
        with pytest.raises(ValueError, match="xtra inputs are not permitted"):
            cls({**parameters, **others})
        return
    found, right = (started(cls, model(2, **facts), **words) for facts, words in ((told, parameters), (other, others)))
    for a, b in zip(follow(found, ys, received), follow(right, ys, received), strict=True):
        for name in ("mean", *cls.claims):
            np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-12, atol=1e-300)
    np.testing.assert_array_equal(found.status, right.status)


def test_a_first_bound_holds_the_box_or_is_the_covariance() -> None:
    """The ellipsoid's default is the number of states, times P0; the mean square's is P0 itself."""
    for cls, scale in ((RobustEllipsoid, 2.0), (RobustMeanSquare, 1.0)):
        first = started(cls, model(2, start=3.0)).estimate()
        bound = first.ellipsoid[:, :, 1] if first.ellipsoid is not None else first.bound[1]
        np.testing.assert_allclose(bound, scale * 3.0 * (np.diag([1.0, 0.25]) if first.ellipsoid is not None else 1.25))
    with pytest.raises(Unsupported, match="RobustBounded needs finite disturbance bounds w_bar"):
        RobustBounded().design(model(2, w_bar=(0.3, np.inf)))


def test_portions_need_bounds_for_them() -> None:
    told = model(1, kappa=0.0)
    told = replace(told, transition=lambda x, u, interval: x)
    estimator = started(RobustMeanSquare, told)
    estimator.predict(np.zeros((0, 1)), part(0, 0.5, T))
    assert estimator.status[0] == Status.infeasible and "whole sampling periods" in estimator.reasons[0]
    bounds = Bounds(G, np.array([0.3, 0.2]), np.array([1.0, 0.4]), part=lambda interval: G[:, :, None] * interval.share)
    estimator = started(RobustMeanSquare, replace(told, bounds=bounds))
    estimator.predict(np.zeros((0, 1)), part(0, 0.5, T))
    assert estimator.status[0] == Status.ok


def test_refuses_kappa_where_there_is_no_linearisation_error() -> None:
    told = replace(model(1), bounds=Bounds(G, np.array([0.3, 0.2]), np.array([1.0, 0.4])))
    with pytest.raises(Unsupported, match="no linearisation error"):
        RobustMeanSquare({"kappa": 0.1}).design(told)


# Pooled RMSE (position m, speed m/s) of 100 runs by an independent prototype with other random numbers, to 5 %.
PAGE = {  # position m, speed m/s of F1, then of F3
    "white": (0.334, 0.111, 0.131, 0.078), "sinusoid": (0.334, 0.111, 0.131, 0.079),
    "switching": (0.334, 0.111, 0.131, 0.079), "constant": (0.333, 0.111, 0.130, 0.080),
    "physical": (0.333, 0.111, 0.130, 0.078), "physical-bias": (0.389, 0.090, 0.333, 0.080),
    "switching-bias": (0.389, 0.090, 0.335, 0.081), "gaussian": (0.192, 0.064, 0.075, 0.054)}
EXPECTED = {(variant, cls): row[at:at + 2] for variant, row in PAGE.items()
            for cls, at in ((RobustBounded, 0), (RobustMeanSquare, 2))}


@pytest.mark.parametrize(("variant", "cls"), list(EXPECTED))
def test_metro_errors(variant: str, cls: type[Estimator]) -> None:
    driven = _metro(variant, cls, 100)
    rmse = [np.sqrt(np.mean(driven.scored.metrics["rmse", name] ** 2)) for name in ("position", "speed")]
    np.testing.assert_allclose(rmse, EXPECTED[variant, cls], rtol=0.05)
    assert (driven.outcomes["contraction", "stability", "1"] < 1).all()


@pytest.mark.parametrize("variant", ["white", "sinusoid", "switching", "constant", "physical", "physical-bias",
                                     "switching-bias"])
def test_metro_ellipsoid_covers_every_bounded_variant(variant: str) -> None:
    driven = _metro(variant, RobustEllipsoid, 30)
    assert (driven.scored.metrics["coverage", "ellipsoid"] == 1.0).all()


def _metro(variant: str, cls: type[Estimator], runs: int) -> Any:
    setting = load("ningbo-metro").setting(variant)
    streams = Streams(20261, "ningbo-metro", variant, range(runs))
    world = setting.world(streams)
    estimator, told = prepare(setting, cls, {}, {}, world.initial_mean)
    estimator.design(told)
    return drive(setting, world, estimator, told, streams("estimator", "e"))
