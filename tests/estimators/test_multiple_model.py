"""The IMM filter and the Kalman filter that knows the parameter, against loops written from the book.

The oracle of the IMM is Blom and Bar-Shalom's five steps in NumPy; that of the known parameter is a Kalman filter."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from railstate.estimators import mode_grid as transitions
from railstate.estimators.interface import Estimator, Status
from railstate.estimators.multiple_model.imm import InteractingMultipleModel
from railstate.estimators.multiple_model.oracle import KnownParameterKalman, _between, reached
from railstate.scenarios.braking.setting import Braking
from railstate.scenarios.errors import Unsupported
from railstate.scenarios.files import load
from railstate.scenarios.model import DesignModel, Grid, grid_of
from railstate.scenarios.randomness import Streams
from railstate.scenarios.world import Trajectory
from scipy.stats import multivariate_normal

from ..models import heard, part, whole

CASES = [(InteractingMultipleModel, {"transition": "uniform"}), (InteractingMultipleModel, {"stay": 0.9}),
         (InteractingMultipleModel, {"transition": "groups"}), (KnownParameterKalman, {})]
family = pytest.mark.parametrize(("kind", "parameters"), CASES)


def streams(runs: range | list[int]) -> Streams:
    return Streams(3, "braking-rate", "paper", runs)


@pytest.fixture(scope="module")
def setting() -> Braking:
    return load("braking-rate").setting("paper")  # pyright: ignore[reportReturnType]


def kalman(A: np.ndarray, B: np.ndarray, modes: Any, x: np.ndarray, P: np.ndarray, u: np.ndarray,
           y: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """One step of the Kalman filter and its log-likelihood; y holds NaN where nothing arrived."""
    x, P = A @ x + B @ u, A @ P @ A.T + modes.Q
    rows = np.flatnonzero(~np.isnan(y))
    C, R = modes.C[rows], modes.R[np.ix_(rows, rows)]
    S = C @ P @ C.T + R
    e = y[rows] - C @ x
    K = P @ C.T @ np.linalg.inv(S)
    loglik = -0.5 * (e @ np.linalg.inv(S) @ e + np.log(np.linalg.det(2 * np.pi * S)))
    return x + K @ e, P - K @ S @ K.T, float(loglik)


def textbook_imm(model: DesignModel, transition: np.ndarray, u: np.ndarray,
                 y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean (K, nx), parameter (K,), covariance (K, nx, nx) of one run."""
    modes = grid_of(model, "this test")
    m = len(modes.grid)
    mu = modes.prior.copy()
    x = [model.initial_mean[:, 0]] * m
    P = [model.initial_covariance[:, :, 0]] * m
    means, values, covariances = [], [], []
    for step in range(len(y)):
        c = transition.T @ mu
        share = transition * mu[:, None] / c
        mixed = [sum(share[i, j] * x[i] for i in range(m)) for j in range(m)]
        spread = [sum(share[i, j] * (P[i] + np.outer(x[i] - mixed[j], x[i] - mixed[j])) for i in range(m))
                  for j in range(m)]
        filtered = [kalman(modes.A[j], modes.B[j], modes, mixed[j], spread[j], u[step], y[step]) for j in range(m)]
        x, P = [part[0] for part in filtered], [part[1] for part in filtered]
        mu = c * np.exp([part[2] for part in filtered])
        mu /= mu.sum()
        mean = sum(mu[j] * x[j] for j in range(m))
        means.append(mean)
        values.append(mu @ modes.grid)
        covariances.append(sum(mu[j] * (P[j] + np.outer(x[j] - mean, x[j] - mean)) for j in range(m)))
    return np.array(means), np.array(values), np.array(covariances)


def follow(estimator: Estimator, model: DesignModel, world: Trajectory,
           steps: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    runs = world.initial_mean.shape[1]
    estimator.start(model, runs, streams(range(runs))("estimator", "x"))
    means, values, covariances = [], [], []
    for k in range(steps):
        if estimator.oracle:
            estimator.reveal(world.truth[k])
        estimator.predict(world.u[k], whole(k))
        estimator.update(heard(world.y[k], world.received[k], k))
        estimate = estimator.estimate()
        assert estimate.parameter is not None and estimate.covariance is not None
        means.append(estimate.mean.copy())
        values.append(estimate.parameter[0].copy())
        covariances.append(estimate.covariance.copy())
    return np.array(means), np.array(values), np.array(covariances)


def lossy(world: Trajectory) -> Trajectory:
    """Speed lost at every third step, everything at step 5; what did not arrive is NaN. Inputs a little off, told as
    they are to all."""
    received = world.received.copy()
    received[::3, 1] = False
    received[5] = False
    size = np.linspace(0.999, 1.001, len(world.u))[:, None, None]
    return replace(world, received=received, y=np.where(received, world.y, np.nan), u=world.u * size)


@pytest.mark.parametrize(("parameters", "transition"), [
    ({"transition": "uniform"}, transitions.uniform(11)),
    ({"stay": 0.9}, transitions.tridiagonal(11, 0.9)),
    ({"stay": 1 / 3}, transitions.tridiagonal(11, 1 / 3)),
    ({"transition": "groups"}, transitions.within(transitions.triples(np.arange(11.0), False))),
])
def test_imm_is_the_textbooks(setting: Braking, parameters: dict[str, Any], transition: np.ndarray) -> None:
    world = lossy(setting.world(streams(range(2))))
    model = setting.design_model({}, world.initial_mean)
    means, values, covariances = follow(InteractingMultipleModel(parameters), model, world, 30)
    for run in range(2):
        mean, value, covariance = textbook_imm(model, transition, world.u[:30, :, run], world.y[:30, :, run])
        np.testing.assert_allclose(means[..., run], mean, rtol=0, atol=1e-9)
        np.testing.assert_allclose(values[:, run], value, rtol=0, atol=1e-10)
        np.testing.assert_allclose(covariances[..., run], covariance[:, :3, :3], rtol=0, atol=1e-10)


def test_imm_s_likelihood_is_brute_force(setting: Braking) -> None:
    """One step from a known prior: the mixture of the modes' Gaussians, each worked out in full."""
    world = lossy(setting.world(streams(range(2))))
    model = setting.design_model({}, world.initial_mean)
    modes, m = grid_of(model, "this test"), 11
    imm = InteractingMultipleModel({"stay": 0.8})
    imm.start(model, 2, streams(range(2))("estimator", "x"))
    imm.predict(world.u[0], whole(0))
    innovation = imm.update(heard(world.y[0], world.received[0]))
    assert innovation is not None and innovation.log_likelihood is not None
    chances = modes.prior @ transitions.tridiagonal(m, 0.8)
    for run in range(2):
        got = np.flatnonzero(world.received[0, :, run])
        total = 0.0
        for j in range(m):
            mean = modes.A[j] @ model.initial_mean[:, run] + modes.B[j] @ world.u[0, :, run]
            P = modes.A[j] @ model.initial_covariance[:, :, 0] @ modes.A[j].T + modes.Q
            C, R = modes.C[got], modes.R[np.ix_(got, got)]
            total += chances[j] * multivariate_normal(C @ mean, C @ P @ C.T + R).pdf(world.y[0, got, run])
        assert innovation.log_likelihood[run] == pytest.approx(np.log(total), rel=1e-12, abs=1e-12)


def test_known_parameter_is_the_kalman_filter(setting: Braking) -> None:
    world = lossy(setting.world(streams(range(2))))
    model = setting.design_model({}, world.initial_mean)
    means, values, covariances = follow(KnownParameterKalman({}), model, world, 40)
    for run in range(2):
        x, P = model.initial_mean[:, run], model.initial_covariance[:, :, 0]
        for k in range(40):
            f = 1 - 0.005 * (k + 1)  # between grid values: A and B are affine in f, so interpolation is exact
            modes = grid_of(model, "this test")
            x, P, _ = kalman(*setting.plant.at(f), modes, x, P, world.u[k, :, run], world.y[k, :, run])
            np.testing.assert_allclose(means[k, :, run], x, rtol=0, atol=1e-10)
            np.testing.assert_allclose(covariances[k, :, :, run], P[:2, :2], rtol=0, atol=1e-12)
            assert values[k, run] == pytest.approx(f, abs=1e-15)


def test_one_mode_is_the_kalman_filter(setting: Braking) -> None:
    world = setting.world(streams(range(2)))
    model = setting.design_model({"grid": [0.8]}, world.initial_mean)
    told = replace(world, truth=np.full_like(world.truth, 0.8))
    imm, known = (follow(kind({}), model, told, 20) for kind in (InteractingMultipleModel, KnownParameterKalman))
    np.testing.assert_allclose(imm[0], known[0], rtol=0, atol=1e-12)
    assert (imm[1] == 0.8).all()


@family
def test_runs_do_not_depend_on_the_batch(setting: Braking, kind: type, parameters: dict[str, Any]) -> None:
    results = []
    for runs in (5, 30):
        world = lossy(setting.world(streams(range(runs))))
        results.append(follow(kind(parameters), setting.design_model({}, world.initial_mean), world, 12))
    alone = lossy(setting.world(streams([4])))
    single = follow(kind(parameters), setting.design_model({}, alone.initial_mean), alone, 12)
    for one, five, thirty in zip(single, *results, strict=True):
        np.testing.assert_array_equal(one[..., 0], five[..., 4])
        np.testing.assert_array_equal(one[..., 0], thirty[..., 4])


@family
def test_covariances_are_symmetric_and_positive(setting: Braking, kind: type, parameters: dict[str, Any]) -> None:
    world = lossy(setting.world(streams(range(4))))
    *_, covariances = follow(kind(parameters), setting.design_model({}, world.initial_mean), world, 60)
    matrices = np.moveaxis(covariances, -1, 1)
    np.testing.assert_allclose(matrices, np.swapaxes(matrices, -1, -2), rtol=0, atol=1e-15)
    assert np.linalg.eigvalsh(matrices).min() > 0


@family
def test_an_impossible_measurement_fails_its_run_alone(setting: Braking, kind: type,
                                                       parameters: dict[str, Any]) -> None:
    world = setting.world(streams(range(3)))
    model = setting.design_model({}, world.initial_mean)
    y = world.y.copy()
    y[2, 0, 1] = 1e200
    estimator = kind(parameters)
    wanted, found = follow(kind(parameters), model, world, 5)[0], follow(estimator, model, replace(world, y=y), 5)[0]
    assert estimator.status.tolist() == [Status.ok, Status.failed, Status.ok]
    np.testing.assert_array_equal(found[:, :, [0, 2]], wanted[:, :, [0, 2]])


def test_without_transitions_it_is_a_bank_of_filters(setting: Braking) -> None:
    """stay = 1: no mixing, each value weighed by the product of its likelihoods, which would overflow but in logs."""
    world = setting.world(streams(range(1)))
    model = setting.design_model({}, world.initial_mean)
    modes = grid_of(model, "this test")
    means, values, _ = follow(InteractingMultipleModel({"stay": 1.0}), model, world, 150)
    bank = [(model.initial_mean[:, 0], model.initial_covariance[:, :, 0], 0.0) for _ in modes.grid]
    for k in range(150):
        for j, (x, P, before) in enumerate(bank):
            x, P, loglik = kalman(modes.A[j], modes.B[j], modes, x, P, world.u[k, :, 0], world.y[k, :, 0])
            bank[j] = x, P, before + loglik
        total = np.array([loglik for *_, loglik in bank])
        w = np.exp(total - total.max())
        w /= w.sum()
        np.testing.assert_allclose(values[k, 0], w @ modes.grid, rtol=0, atol=1e-9)
        np.testing.assert_allclose(means[k, :, 0], w @ np.array([x for x, *_ in bank]), rtol=0, atol=1e-8)
    assert total.max() > np.log(np.finfo(float).max)


@family
def test_only_whole_steps(setting: Braking, kind: type, parameters: dict[str, Any]) -> None:
    world = setting.world(streams([0]))
    estimator = kind(parameters)
    estimator.start(setting.design_model({}, world.initial_mean), 1, streams([0])("estimator", "x"))
    with pytest.raises(Unsupported, match="whole sampling periods"):
        estimator.predict(world.u[0], part(0, np.array([0.4])))


def test_imm_counts_its_filters(setting: Braking) -> None:
    world = setting.world(streams(range(2)))
    estimator = InteractingMultipleModel({})
    follow(estimator, setting.design_model({}, world.initial_mean), world, 7)
    assert estimator.counters()["kalman-updates"].tolist() == [77.0, 77.0]


def test_between_the_values_of_a_grid_lie_lines_that_go_on_beyond_it() -> None:
    grid, values = np.array([0.5, 1.0, 3.0, 7.0]), np.array([4.0, -2.0, 0.0, 1.0])
    theta = np.array([0.5, 0.75, 1.0, 1.5, 3.0, 6.0, 7.0])
    np.testing.assert_array_equal(_between(theta, grid, values), np.interp(theta, grid, values))
    np.testing.assert_array_equal(_between(np.array([0.0, 11.0]), grid, values), [10.0, 2.0])
    np.testing.assert_array_equal(_between(theta, grid[:1], values[:1]), [4.0] * 7)
    np.testing.assert_array_equal(_between(theta[:3], grid[:2], values[:2]), [4.0, 1.0, -2.0])


def test_noise_reaches_states_through_others_in_any_mode() -> None:
    """The last through the first, the first through the second, in one mode; the third is never reached."""
    A, Q = np.stack([np.eye(4)] * 2), np.diag([0.0, 1.0, 0.0, 0.0])
    A[1, 0, 1], A[0, 3, 0], A[0, 1, 2] = -1.0, 0.5, 2.0
    modes = Grid("f", np.arange(2.0), A, np.zeros((2, 4, 0)), np.eye(1, 4), Q, np.eye(1), np.full(2, 0.5))
    assert reached(modes).tolist() == [True, True, False, True]
    assert reached(replace(modes, Q=np.zeros((4, 4)))).tolist() == [False] * 4


@pytest.mark.parametrize(("states", "claimed"), [((False,) * 3, 0), ((True, False, False), 1), ((True, True, False), 2),
                                                 ((False, True, False), 2), ((True,) * 3, 3)])
def test_claims_go_up_to_the_last_state_that_has_one(setting: Braking, states: tuple[bool, ...], claimed: int) -> None:
    mean = setting.world(streams(range(2))).initial_mean
    estimator, model = KnownParameterKalman(), setting.told({}, {}, mean)
    estimator.start(model, 2, streams(range(2))("estimator", "x"))
    estimate = estimator.claim(np.array([*states, *[False] * (model.nx - 3)]), np.zeros((1, 2)))
    assert estimate.covariance is not None and estimate.covariance.shape == (claimed, claimed, 2)
