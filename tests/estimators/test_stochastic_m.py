"""RBPF, SMA and GSMA against one particle after the other in NumPy, and the braking page's acceptance numbers.

Each property holds for every member of the family in both forms; numbers stand with their Monte Carlo error."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from railstate.benchmarks.running.drive import Driven, drive
from railstate.estimators import mode_grid as transitions
from railstate.estimators.interface import Estimator, Status
from railstate.estimators.kernels.modes import exponentials, kalman_block, normalise
from railstate.estimators.multiple_model.imm import InteractingMultipleModel
from railstate.estimators.multiple_model.oracle import KnownParameterKalman
from railstate.estimators.reference.particle_loop import particle_loop
from railstate.estimators.stochastic_m.estimators import GroupStochasticM, RaoBlackwellizedParticle, StochasticM
from railstate.estimators.stochastic_m.select import heaviest, systematic
from railstate.scenarios.braking.setting import Braking
from railstate.scenarios.errors import Unsupported
from railstate.scenarios.files import load
from railstate.scenarios.model import DesignModel, Grid, grid_modes, grid_of
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


def test_rbpf_tends_to_the_kalman_filter_as_the_grid_shrinks() -> None:
    """Values around a constant f: the estimate is a weighted mean of Kalman filters that are told one of the values
    each, and these draw together in proportion to the grid's width."""
    runs = range(4)
    setting = braking(**{"plant.rate_start": 0.6, "plant.rate_drift": 0.0})
    world = setting.world(streams(runs))
    limits = []
    for width in (1e-2, 1e-3, 1e-4):
        knowledge = {"grid": [0.6 - width, 0.6, 0.6 + width], "initial_variance": [1e-14, 1e-14, 1e-14, 0.0]}
        model = setting.design_model(knowledge, world.initial_mean)
        told = []
        for f in (0.6, 0.6 + width):
            known = KnownParameterKalman({})
            known.start(model, 4, streams(runs)("estimator", "k"))
            told.append([])
            for k in range(40):
                known.reveal(np.full_like(world.truth[k], f))
                known.predict(world.u[k], whole(k))
                known.update(heard(world.y[k], world.received[k], k))
                told[-1].append(known.estimate().mean.copy())
        true, wrong = np.array(told)
        limits.append(np.abs(wrong - true).max(axis=(0, 2))[:3])
        means, values, _ = follow(RaoBlackwellizedParticle({"proposal": "static"}), model, world, runs, 40)
        # initial particles scatter by 1e-7
        assert (np.abs(means - true).max(axis=(0, 2))[:3] <= limits[-1] + 1e-6).all()
        assert np.abs(values - 0.6).max() <= width * (1 + 1e-9)
    assert (limits[0] > 1e-3).all()
    np.testing.assert_allclose(limits[0] / limits[1], 10, rtol=1e-6)
    np.testing.assert_allclose(limits[1] / limits[2], 10, rtol=1e-5)


# The page's acceptance numbers, 200 runs.

@pytest.fixture(scope="module")
def measured(setting: Braking) -> dict[str, Driven]:
    runs = range(200)
    source = streams(runs)
    world = setting.world(source)
    model = setting.design_model({}, world.initial_mean)
    entries: dict[str, Estimator] = {
        "sma": StochasticM({}), "gsma": GroupStochasticM({}),
        "gsma-a": GroupStochasticM({"policy": "A"}), "gsma-c": GroupStochasticM({"policy": "C"}),
        "rbpf-static": RaoBlackwellizedParticle({"proposal": "static"}),
        "rbpf": RaoBlackwellizedParticle({}), "rbpf-bootstrap": RaoBlackwellizedParticle({"proposal": "bootstrap"}),
        "imm-uniform": InteractingMultipleModel({"transition": "uniform"}),
        "sma-sticky": StochasticM({"prior": "sticky"}), "gsma-sticky": GroupStochasticM({"prior": "sticky"}),
    }
    return {label: drive(setting, world, estimator, model, source("estimator", label))
            for label, estimator in entries.items()}


def error_of_f(driven: Driven) -> np.ndarray:
    assert (driven.scored.status == Status.ok).all()
    return driven.scored.metrics["mae", "f"]


def test_sma_is_the_imm_with_a_uniform_prior(measured: dict[str, Driven]) -> None:
    sma, imm = error_of_f(measured["sma"]), error_of_f(measured["imm-uniform"])
    assert abs(sma.mean() - 0.165) < 0.002
    assert abs((sma - imm).mean()) < 0.002


def test_gsma_systematic_accumulated(measured: dict[str, Driven]) -> None:
    assert abs(error_of_f(measured["gsma"]).mean() - 0.078) < 0.002


def test_static_rbpf_degenerates(measured: dict[str, Driven], setting: Braking) -> None:
    assert abs(error_of_f(measured["rbpf-static"]).mean() - 0.273) < 0.01
    world = setting.world(streams(range(20)))
    estimator = RaoBlackwellizedParticle({"proposal": "static"})
    follow(estimator, setting.design_model({}, world.initial_mean), world, range(20), 100)
    assert (estimator.estimate().diversity == 1).all()


def test_optimal_and_bootstrap_proposals_agree(measured: dict[str, Driven]) -> None:
    optimal, bootstrap = error_of_f(measured["rbpf"]), error_of_f(measured["rbpf-bootstrap"])
    difference = optimal - bootstrap
    assert abs(difference.mean()) < 4 * difference.std() / np.sqrt(200) + 5e-4
    assert abs(optimal.mean() - 0.165) < 0.002


def test_published_order_holds_and_the_prior_decides_it(measured: dict[str, Driven]) -> None:
    mean = {label: error_of_f(driven).mean() for label, driven in measured.items()}
    assert mean["rbpf-static"] > mean["sma"] > mean["gsma"]
    sticky = error_of_f(measured["sma-sticky"]) - error_of_f(measured["gsma-sticky"])
    assert abs(sticky.mean()) < 0.002  # with equal priors SMA and GSMA tie


def test_counts_of_kalman_updates(measured: dict[str, Driven]) -> None:
    counts = {label: measured[label].outcomes["kalman-updates", "work", "1"]
              for label in ("sma", "gsma", "gsma-a", "gsma-c", "rbpf-static", "rbpf")}
    assert {label: set(count.tolist()) for label, count in counts.items()} == {
        "sma": {550.0}, "gsma": {300.0}, "gsma-a": {650.0}, "gsma-c": {150.0}, "rbpf-static": {250.0},
        "rbpf": {2750.0}}


def test_pruning_where_the_expansion_reaches_its_limit_exactly() -> None:
    """Ten values and 50 particles make Q = 500: pruned at once, as the paper has it, and not only beyond Q."""
    ten = braking().design_model({"grid": [round(0.1 * i, 1) for i in range(1, 11)]}, np.zeros((4, 1)))
    for parameters in ({}, {"policy": "A", "limit": 500}):
        assert StochasticM(parameters).design(ten)["kalman_updates_per_step"] == 500
        estimator = StochasticM(parameters)
        estimator.start(ten, 1, streams([0])("estimator", "x"))
        for k in range(1, 4):
            estimator.predict(np.zeros((1, 1)), whole(k))
            estimator.update(heard(np.zeros((ten.ny, 1)), np.ones((ten.ny, 1), dtype=bool), k))
            assert estimator.counters()["kalman-updates"][0] == 500 * k and estimator.n == 50


def test_many_particles_leave_the_prior(setting: Braking) -> None:
    """GSMA with N = 2000 against its prior without particles, and against the tridiagonal prior of the page."""
    runs = range(30)
    source = streams(runs)
    world = setting.world(source)
    model = setting.design_model({}, world.initial_mean)
    many, same, page = (error_of_f(drive(setting, world, estimator, model, source("estimator", "x")))
                        for estimator in (GroupStochasticM({"initial": 2000, "particles": 2000, "limit": 6000}),
                                          InteractingMultipleModel({"transition": "groups"}),
                                          InteractingMultipleModel({"stay": 1 / 3})))
    assert abs((many - same).mean()) < 5e-4
    difference = many - page
    # .0019 +- .0002: the prior at the two ends of the grid differs; the bound is the page's, with its error
    assert abs(difference.mean()) < 0.002 + 2 * difference.std() / np.sqrt(30)


def test_design_says_what_a_step_costs(setting: Braking) -> None:
    model = setting.design_model({}, np.zeros((4, 1)))
    said = {policy: GroupStochasticM({"policy": policy}).design(model) for policy in "ABC"}
    assert [said[policy]["kalman_updates_per_step"] for policy in "ABC"] == [650, 300, 150]
    assert StochasticM({}).design(model)["kalman_updates_per_step"] == 550


# Selection and transitions.

def test_normalise_works_in_logarithms() -> None:
    w = np.empty(4)
    total = normalise(np.array([-5000.0, -5001.0, -np.inf, -9000.0]), 4, w)
    np.testing.assert_allclose(w, [1 / (1 + np.exp(-1)), np.exp(-1) / (1 + np.exp(-1)), 0, 0], atol=1e-15)
    assert total == pytest.approx(-5000 + np.log1p(np.exp(-1)))
    assert np.isnan(normalise(np.full(3, -np.inf), 3, w)) and np.isnan(normalise(np.full(3, np.nan), 3, w))


def test_exponentials_are_the_library_functions() -> None:
    x = np.concatenate([-np.geomspace(1e-17, 707, 4000), [0.0, -708.5, -np.inf, np.nan]]) + 12.5
    out = np.empty_like(x)
    exponentials(x, len(x), 12.5, out)
    np.testing.assert_allclose(out[:-3], np.exp(x[:-3] - 12.5), rtol=5e-16)
    assert out[-3:].tolist() == [0.0, 0.0, 0.0]
    alone = np.empty(1)
    for i in range(0, 4000, 97):  # the same bits wherever an element stands
        exponentials(x[i:], 1, 12.5, alone)
        assert alone[0] == out[i]


def test_systematic_resampling_copies_in_proportion() -> None:
    draw = np.random.default_rng(4)
    for _ in range(200):
        n, keep = draw.integers(1, 30), draw.integers(1, 60)
        w = draw.exponential(size=n) * (draw.uniform(size=n) < 0.7)
        w[draw.integers(n)] += 0.1
        w /= w.sum()
        index = np.empty(keep, np.int64)
        systematic(w, n, keep, draw.choice([0.0, draw.uniform(), np.nextafter(1, 0)]), index)
        copies = np.bincount(index, minlength=n)
        assert copies.sum() == keep and (copies[w == 0] == 0).all()
        assert (copies >= np.floor(keep * w - 1e-9)).all() and (copies <= np.ceil(keep * w + 1e-9)).all()


def test_heaviest_keeps_the_largest_and_breaks_ties_by_order() -> None:
    logw = np.array([0.0, -1.0, -np.inf, -1.0, 2.0, -1.0, -3.0])
    for keep, wanted in ((1, [4]), (3, [0, 1, 4]), (4, [0, 1, 3, 4]), (7, list(range(7)))):
        index = np.empty(keep, np.int64)
        heaviest(logw, 7, keep, index)
        assert index.tolist() == wanted


def test_groups_are_the_papers() -> None:
    grid = np.round(np.arange(10, -1, -1) / 10, 1)
    nine, eight = transitions.triples(grid, printed=False), transitions.triples(grid, printed=True)
    assert len({tuple(row) for row in nine.tolist()}) == 9 and len({tuple(row) for row in eight.tolist()}) == 8
    assert grid[nine[0]].tolist() == grid[nine[1]].tolist() == [1.0, 0.9, 0.8]
    assert grid[eight[0]].tolist() == grid[eight[1]].tolist() == [0.9, 0.8, 0.7]
    assert grid[nine[5]].tolist() == [0.6, 0.5, 0.4] and grid[nine[10]].tolist() == [0.2, 0.1, 0.0]
    np.testing.assert_array_equal(nine[2:], eight[2:])
    backwards = transitions.triples(grid[::-1], printed=True)
    assert sorted(grid[::-1][backwards[10]].tolist()) == [0.7, 0.8, 0.9]


@pytest.mark.parametrize("matrix", [transitions.uniform(11), transitions.tridiagonal(11, 0.9),
                                    transitions.tridiagonal(1, 0.9),
                                    transitions.within(transitions.triples(np.arange(11.0), False))])
def test_transitions_are_stochastic(matrix: np.ndarray) -> None:
    np.testing.assert_allclose(matrix.sum(axis=1), 1, atol=1e-15)
    assert (matrix >= 0).all()


def test_jitter_moves_the_share_it_says(setting: Braking) -> None:
    world = setting.world(streams(range(200)))
    estimator = RaoBlackwellizedParticle({"proposal": "static", "jitter": 0.3})
    estimator.start(setting.design_model({}, world.initial_mean), 200, streams(range(200))("estimator", "x"))
    before = estimator.cloud.theta.copy()
    estimator.predict(world.u[0], whole(0))
    moved = estimator.cloud.theta - before
    assert np.abs(moved).max() == 1
    assert abs((moved != 0).mean() - 0.3) < 4 * np.sqrt(0.21 / moved.size)


@pytest.mark.parametrize("kind", [InteractingMultipleModel, StochasticM, GroupStochasticM, RaoBlackwellizedParticle])
def test_determinants_of_any_size_weigh_the_modes(kind: type) -> None:
    """40 states measured one by one, first variances 1e4, noise 1e-4: det S is 1e320 relative to R. The modes differ in
    how far all states move, so the dense log-likelihood of each is known; against it stand the estimate and weights."""
    n, grid = 40, np.array([0.0, 1e-5, 2e-5])
    A, eye = np.repeat(np.eye(n)[None], 3, axis=0), np.eye(n)
    modes = Grid("shift", grid, A, np.repeat(grid[:, None, None], n, axis=1), eye, 1e-12 * eye, 1e-4 * eye,
                 np.full(3, 1 / 3))
    names = tuple(f"x{i}" for i in range(n))
    model = replace(braking().design_model({}, np.zeros((4, 1))), states=names, measurements=names,
                    initial_mean=np.zeros((n, 1)), initial_covariance=1e4 * eye[:, :, None],
                    measurement_covariance=lambda measurement: 1e-4 * eye[:, :, None])
    model = replace(model, modes=grid_modes(modes, model))
    parameters = {"transition": "uniform"} if kind is InteractingMultipleModel else {"form": "full"}
    estimator = kind(parameters)
    estimator.start(model, 1, streams([0])("estimator", "x"))
    y = np.random.default_rng(4).normal(0.0, 100.0, n)
    for k in range(3):
        estimator.predict(np.ones((1, 1)), whole(k))
        estimator.update(heard(y[:, None], np.ones((n, 1), dtype=bool), k))
        estimate = estimator.estimate()
        assert estimator.status[0] == Status.ok, estimator.reasons
        np.testing.assert_allclose(estimate.mean[:, 0], y, atol=1e-4)
    S = 1e4 * eye + (1e-12 + 1e-4) * eye
    Cw, yw = eye / 1e-2, y / 1e-2
    loglik, x, P = np.empty(1), np.zeros((n, 1)), 1e4 * eye[:, :, None].copy()
    kalman_block(eye[:, :, None], np.zeros((n, 1)), eye != 0, 1e-12 * eye, Cw, yw, x, P, loglik, 1)
    dense = -0.5 * (y @ np.linalg.solve(S, y) + np.linalg.slogdet(S)[1] - n * np.log(1e-4))
    assert loglik[0] == pytest.approx(dense, rel=1e-12)


def test_general_modes_go_through_the_full_form() -> None:
    """Modes that differ in how fast a state decays, no known state: only the full form serves, and it is the loop."""
    grid = np.array([0.5, 0.7, 0.9])
    A = np.array([[[1.0, 1.0], [0.0, value]] for value in grid])
    modes = Grid("decay", grid, A, np.zeros((3, 2, 1)), np.array([[1.0, 0.0]]), np.diag([0.01, 0.2]),
                  np.array([[0.3]]), np.full(3, 1 / 3))
    base = braking().design_model({}, np.zeros((4, 1)))
    model = replace(base, states=("x", "v"), measurements=("x",), initial_mean=np.array([[0.0], [1.0]]),
                    initial_covariance=np.eye(2)[:, :, None],
                    measurement_covariance=lambda measurement: modes.R[:, :, None])
    model = replace(model, modes=grid_modes(modes, model))
    with pytest.raises(Unsupported, match="factorised"):
        StochasticM({}).start(model, 1, streams([0])("estimator", "x"))
    y = np.cumsum(np.random.default_rng(2).normal(size=(8, 1)), axis=0)
    estimator = StochasticM({"form": "full", "initial": 9, "particles": 9, "limit": 30})
    wanted, values, _ = particle_loop(estimator, model, np.zeros((8, 1)), y, streams([0])("estimator", "x"))
    estimator.start(model, 1, streams([0])("estimator", "x"))
    for k in range(8):
        estimator.predict(np.zeros((1, 1)), whole(k))
        estimator.update(heard(y[k][:, None], np.ones((1, 1), dtype=bool), k))
        estimate = estimator.estimate()
        np.testing.assert_allclose(estimate.mean[:, 0], wanted[k], rtol=0, atol=1e-11)
        assert estimate.parameter is not None
        np.testing.assert_allclose(estimate.parameter[0, 0], values[k], rtol=0, atol=1e-11)
