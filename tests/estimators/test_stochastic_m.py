"""RBPF, SMA and GSMA against one particle after the other in NumPy.

Each property holds for every member of the family in both forms."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from railstate.estimators.interface import Estimator, Status
from railstate.estimators.mode_grid import known_states
from railstate.estimators.reference.particle_loop import particle_loop
from railstate.estimators.stochastic_m.estimators import GroupStochasticM, RaoBlackwellizedParticle, StochasticM
from railstate.scenarios.braking.setting import Braking
from railstate.scenarios.errors import Unsupported
from railstate.scenarios.files import load
from railstate.scenarios.measurement import Measurement
from railstate.scenarios.model import DesignModel, grid_modes, grid_of
from railstate.scenarios.randomness import Streams
from railstate.scenarios.world import Trajectory
from scipy.stats import multivariate_normal

from ..models import heard, part, whole

FAMILY = [
    (StochasticM, {}),
    (StochasticM, {"prune": "heaviest", "memoryless": True}),
    (StochasticM, {"prior": "sticky", "policy": "C"}),
    (GroupStochasticM, {}),
    (GroupStochasticM, {"policy": "A", "memoryless": True}),
    (GroupStochasticM, {"prune": "heaviest", "groups": "printed"}),
    (RaoBlackwellizedParticle, {"particles": 40}),
    (RaoBlackwellizedParticle, {"particles": 40, "proposal": "bootstrap", "prior": "sticky"}),
    (RaoBlackwellizedParticle, {"particles": 40, "proposal": "static", "jitter": 0.1}),
]
FORMS = ["factorised", "full"]
family = pytest.mark.parametrize(("kind", "parameters"), FAMILY)
both_forms = pytest.mark.parametrize("form", FORMS)


def braking(variant: str = "paper", **overrides: Any) -> Braking:
    return load("braking-rate", overrides).setting(variant)  # pyright: ignore[reportReturnType]


def streams(runs: range | list[int], seed: int = 1) -> Streams:
    return Streams(seed, "braking-rate", "paper", runs)


@pytest.fixture(scope="module")
def setting() -> Braking:
    return braking()


def follow(estimator: Estimator, model: DesignModel, world: Trajectory, runs: range | list[int],
           steps: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Means (K, nx, S), parameters (K, S), covariances (K, n, n, S)."""
    estimator.start(model, len(runs), streams(runs)("estimator", "x"))
    means, parameters, covariances = [], [], []
    for k in range(steps):
        estimator.predict(world.u[k], whole(k))
        estimator.update(heard(world.y[k], world.received[k], k))
        estimate = estimator.estimate()
        assert estimate.parameter is not None and estimate.covariance is not None
        means.append(estimate.mean.copy())
        parameters.append(estimate.parameter[0].copy())
        covariances.append(estimate.covariance.copy())
    return np.array(means), np.array(parameters), np.array(covariances)


@family
@both_forms
def test_equals_one_particle_after_the_other(setting: Braking, kind: type, parameters: dict[str, Any],
                                             form: str) -> None:
    world = setting.world(streams([3]))
    model = setting.design_model({}, world.initial_mean)
    estimator = kind({**parameters, "form": form})
    steps = 6
    means, values, _ = follow(estimator, model, world, [3], steps)
    wanted, wanted_values, updates = particle_loop(kind(parameters), model, world.u[:steps, :, 0],
                                                   world.y[:steps, :, 0], streams([3])("estimator", "x"))
    np.testing.assert_allclose(means[:, :, 0], wanted, rtol=0, atol=1e-10)
    np.testing.assert_allclose(values[:, 0], wanted_values, rtol=0, atol=1e-11)
    assert estimator.counters()["kalman-updates"].tolist() == [updates]


@family
def test_factorised_equals_full(setting: Braking, kind: type, parameters: dict[str, Any]) -> None:
    runs = range(12)
    world = setting.world(streams(runs))
    model = setting.design_model({}, world.initial_mean)
    factorised, full = (follow(kind({**parameters, "form": form}), model, world, runs, 60) for form in FORMS)
    for one, other in zip(factorised, full, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-9)


@pytest.mark.parametrize(("kind", "parameters"), [FAMILY[0], FAMILY[6]])
def test_factorised_equals_full_wherever_known_states_act(setting: Braking, kind: type,
                                                          parameters: dict[str, Any]) -> None:
    """What is known exactly, and the input, also move the others whatever the mode is, and are in the readings."""
    runs, rng = range(3), np.random.default_rng(2)
    world = setting.world(streams(runs))
    model = setting.design_model({}, world.initial_mean)
    grid = grid_of(model, "the test")
    known = known_states(grid, model.initial_covariance[:, :, 0])
    assert known.tolist() == [False, False, False, True]
    A, B, C = grid.A.copy(), grid.B.copy(), grid.C.copy()
    A[:, ~known, 3] += rng.uniform(0.5, 1.0, 3)
    B[:, ~known, 0] += rng.uniform(0.5, 1.0, 3)
    C[:, 3] += 0.7
    own = replace(model, modes=grid_modes(replace(grid, A=A, B=B, C=C), model))
    found = [follow(kind({**parameters, "form": form}), own, world, runs, 8) for form in FORMS]
    plain = follow(kind(parameters), model, world, runs, 8)
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-9)
    assert np.abs(found[0][0] - plain[0]).max() > 1e-3


@family
@both_forms
def test_runs_do_not_depend_on_the_batch(kind: type, parameters: dict[str, Any], form: str) -> None:
    setting = braking(channel={"kind": "bernoulli", "p": 0.8})
    results = {}
    for runs in ([5], range(7), range(40)):
        world = setting.world(streams(runs))
        model = setting.design_model({}, world.initial_mean)
        where = list(runs).index(5)
        results[len(runs)] = [part[..., where]
                              for part in follow(kind({**parameters, "form": form}), model, world, runs, 15)]
    for size in (7, 40):
        for alone, together in zip(results[1], results[size], strict=True):
            np.testing.assert_array_equal(alone, together)


@both_forms
def test_two_runs_whose_sensors_tell_their_own_accuracy(setting: Braking, form: str) -> None:
    """Each as if it were alone."""
    world = setting.world(streams(range(2)))
    model = setting.design_model({}, world.initial_mean)
    grid = grid_of(model, "the test")
    told = replace(model, measurement_covariance=lambda measurement: measurement.covariance)
    own = np.ascontiguousarray(np.stack([grid.R, 9.0 * grid.R], axis=2))

    def went(runs: list[int]) -> np.ndarray:
        alone = replace(told, initial_mean=np.ascontiguousarray(told.initial_mean[:, runs]))
        estimator = GroupStochasticM({"form": form})
        estimator.design(alone)
        estimator.start(alone, len(runs), streams(runs)("estimator", "x"))
        for k in range(6):
            estimator.predict(np.ascontiguousarray(world.u[k][:, runs]), whole(k))
            estimator.update(Measurement(world.y[k][:, runs], world.received[k][:, runs], k + 1, 0, k + 1.0,
                                         own[:, :, runs]))
        return estimator.estimate().mean

    both = went([0, 1])
    np.testing.assert_array_equal(both, np.hstack([went([0]), went([1])]))


@both_forms
@pytest.mark.parametrize("kind", [StochasticM, GroupStochasticM, RaoBlackwellizedParticle])
def test_log_likelihood_is_brute_force(setting: Braking, kind: type, form: str) -> None:
    """The mixture over particles and their children, each Gaussian worked out in full; then 30 steps in both forms."""
    world = setting.world(streams(range(2)))
    model = setting.design_model({}, world.initial_mean)
    modes, P0 = grid_of(model, "this test"), model.initial_covariance[:, :, 0]
    received = world.received.copy()
    received[0, 1, 0], received[1::2, 2] = False, False
    pair = [kind({"form": name}) for name in FORMS]
    for estimator in pair:
        estimator.start(model, 2, streams(range(2))("estimator", "x"))
    full = pair[1]
    start, theta, n = full.cloud.x.copy(), full.cloud.theta.copy(), full.n
    children, prior = full.offspring(modes)
    for k in range(30):
        found = []
        for estimator in pair:
            estimator.predict(world.u[k], whole(k))
            innovation = estimator.update(heard(world.y[k], received[k], k))
            assert innovation is not None and innovation.log_likelihood is not None
            found.append(innovation.log_likelihood.copy())
        np.testing.assert_allclose(found[0], found[1], rtol=1e-9, atol=1e-9)
        for run in range(2) if k == 0 else ():
            got, total = np.flatnonzero(received[0, :, run]), 0.0
            C, R = modes.C[got], modes.R[np.ix_(got, got)]
            for i in range(n):
                for child, log_prior in zip(children[theta[run, i]], prior[theta[run, i]], strict=True):
                    A, B = modes.A[child], modes.B[child]
                    mean, P = A @ start[run, :, i] + B @ world.u[0, :, run], A @ P0 @ A.T + modes.Q
                    density = multivariate_normal(C @ mean, C @ P @ C.T + R).pdf(world.y[0, got, run])
                    total += np.exp(log_prior) * density / n
            assert found[FORMS.index(form)][run] == pytest.approx(np.log(total), rel=1e-10)


def test_weights_that_are_no_posterior_tell_no_likelihood(setting: Braking) -> None:
    world = setting.world(streams(range(2)))
    model = setting.design_model({}, world.initial_mean)
    for parameters in ({"memoryless": True}, {"prune": "heaviest"}):
        estimator = StochasticM(parameters)
        estimator.start(model, 2, streams(range(2))("estimator", "x"))
        estimator.predict(world.u[0], whole(0))
        assert estimator.update(heard(world.y[0], world.received[0])) is None


@family
@both_forms
def test_missing_elements_are_never_read(setting: Braking, kind: type, parameters: dict[str, Any], form: str) -> None:
    """Rows that do not arrive are rows the model does not have: for some runs the speed, for one run everything."""
    runs = range(3)
    world = setting.world(streams(runs))
    model = setting.design_model({}, world.initial_mean)
    received = world.received.copy()
    received[:, 1] = False
    received[4:9, :, 2] = False
    lossy = replace(world, received=received, y=np.where(received, world.y, np.nan))
    means, values, covariances = follow(kind({**parameters, "form": form}), model, lossy, runs, 12)
    grid = grid_of(model, "this test")
    rows = [0, 2]
    cut = replace(grid, C=grid.C[rows], R=grid.R[np.ix_(rows, rows)])
    short = replace(model, modes=grid_modes(cut, model), measurements=("displacement", "target-acceleration"))
    fewer = replace(world, y=world.y[:, rows], received=received[:, rows])
    wanted = follow(kind({**parameters, "form": form}), short, fewer, runs, 12)
    for one, other in zip((means, values, covariances), wanted, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-10)
    assert covariances[8, 0, 0, 2] > 2 * covariances[8, 0, 0, 1]  # five steps without news


@family
@both_forms
def test_covariances_are_symmetric_and_positive(setting: Braking, kind: type, parameters: dict[str, Any],
                                                form: str) -> None:
    runs = range(5)
    world = setting.world(streams(runs))
    model = setting.design_model({}, world.initial_mean)
    *_, covariances = follow(kind({**parameters, "form": form}), model, world, runs, 40)
    assert covariances.shape[1:] == (3, 3, 5)  # a_z is known exactly: not claimed
    matrices = np.moveaxis(covariances, -1, 1)
    np.testing.assert_allclose(matrices, np.swapaxes(matrices, -1, -2), rtol=0, atol=1e-15)
    assert np.linalg.eigvalsh(matrices).min() > 0


@both_forms
def test_two_updates_at_one_instant_equal_one(setting: Braking, form: str) -> None:
    world = setting.world(streams(range(4)))
    model = setting.design_model({}, world.initial_mean)
    spacious = {"form": form, "limit": 6000}
    once, twice = StochasticM(spacious), StochasticM(spacious)
    for estimator in (once, twice):
        estimator.start(model, 4, streams(range(4))("estimator", "x"))
        estimator.predict(world.u[0], whole(0))
    once.update(heard(world.y[0], world.received[0]))
    first = np.zeros_like(world.received[0])
    first[0] = True
    twice.update(heard(world.y[0], first))
    twice.update(heard(world.y[0], ~first))
    one, other = once.estimate(), twice.estimate()
    np.testing.assert_allclose(one.mean, other.mean, rtol=0, atol=1e-11)
    assert one.parameter is not None and other.parameter is not None
    np.testing.assert_allclose(one.parameter, other.parameter, rtol=0, atol=1e-12)
    assert one.covariance is not None and other.covariance is not None
    np.testing.assert_allclose(one.covariance, other.covariance, rtol=0, atol=1e-12)


@both_forms
def test_prediction_can_be_asked_for(setting: Braking, form: str) -> None:
    """Before the update the estimate is the mean over the children; asking for it changes nothing."""
    world = setting.world(streams(range(3)))
    model = setting.design_model({}, world.initial_mean)
    asked, silent = GroupStochasticM({"form": form}), GroupStochasticM({"form": form})
    for estimator in (asked, silent):
        estimator.start(model, 3, streams(range(3))("estimator", "x"))
    np.testing.assert_allclose(asked.estimate().mean, world.initial_mean, atol=0.02)  # 50 draws of variance 1e-3
    for k in range(4):
        for estimator in (asked, silent):
            estimator.predict(world.u[k], whole(k))
        before = asked.estimate()
        for estimator in (asked, silent):
            estimator.update(heard(world.y[k], world.received[k], k))
        np.testing.assert_array_equal(asked.estimate().mean, silent.estimate().mean)
        assert before.parameter is not None and np.isfinite(before.mean).all()
    nothing = GroupStochasticM({"form": form})
    nothing.start(model, 3, streams(range(3))("estimator", "x"))
    nothing.predict(world.u[0], whole(0))
    predicted = nothing.estimate().mean.copy()
    nothing.update(heard(world.y[0], np.zeros((3, 3), dtype=bool)))
    np.testing.assert_array_equal(nothing.estimate().mean, predicted)


@both_forms
def test_a_run_without_weights_is_flagged_alone(setting: Braking, form: str) -> None:
    world = setting.world(streams(range(3)))
    model = setting.design_model({}, world.initial_mean)
    y = world.y.copy()
    y[3, 0, 1] = 1e200
    healthy, ill = StochasticM({"form": form}), StochasticM({"form": form})
    wanted, _, _ = follow(healthy, model, world, range(3), 6)
    found, _, _ = follow(ill, model, replace(world, y=y), range(3), 6)
    assert ill.status.tolist() == [Status.ok, Status.failed, Status.ok]
    assert any("weights of all particles vanished" in why for why in ill.reasons.values())
    np.testing.assert_array_equal(found[:, :, [0, 2]], wanted[:, :, [0, 2]])
    assert np.isnan(found[3:, :, 1]).all() and np.isfinite(found[:3]).all()


def test_factorised_refuses_what_it_cannot_do(setting: Braking) -> None:
    world = setting.world(streams([0]))
    uncertain = setting.design_model({"initial_variance": [1e-3] * 4}, world.initial_mean)
    random = streams([0])("estimator", "x")
    with pytest.raises(Unsupported, match="known exactly"):
        StochasticM({}).start(uncertain, 1, random)
    StochasticM({"form": "full"}).start(uncertain, 1, random)
    model = setting.design_model({}, world.initial_mean)
    estimator = StochasticM({})
    estimator.start(model, 1, random)
    with pytest.raises(Unsupported, match="whole sampling periods"):
        estimator.predict(world.u[0], part(0, 0.5))
    with pytest.raises(Unsupported, match="at least 4 values"):
        GroupStochasticM({"groups": "printed"}).start(
            setting.design_model({"grid": [0.0, 0.5, 1.0]}, world.initial_mean), 1, random)
