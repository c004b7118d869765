"""What particles over a grid of modes are made of: weights, selection, transitions; modes of any kind and size.

Each piece against a library function, a count or a dense computation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from railstate.estimators import mode_grid as transitions
from railstate.estimators.interface import Status
from railstate.estimators.kernels.modes import exponentials, kalman_block, normalise
from railstate.estimators.multiple_model.imm import InteractingMultipleModel
from railstate.estimators.multiple_model.oracle import KnownParameterKalman
from railstate.estimators.reference.particle_loop import particle_loop
from railstate.estimators.stochastic_m.estimators import GroupStochasticM, RaoBlackwellizedParticle, StochasticM
from railstate.estimators.stochastic_m.select import heaviest, systematic
from railstate.scenarios.errors import Unsupported
from railstate.scenarios.model import Grid, grid_modes

from ..models import heard, whole
from .test_stochastic_m import braking, follow, streams


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


def _walked(w: np.ndarray, keep: int, uniform: float) -> list[int]:
    """The particle under each of the targets (uniform + j) / keep, one after the other."""
    out, i, reached, last = [], 0, w[0], int(np.flatnonzero(w).max())
    for j in range(keep):
        while reached <= (uniform + j) / keep and i < last:
            i += 1
            reached += w[i]
        out.append(i)
    return out


def test_systematic_resampling_copies_in_proportion() -> None:
    draw = np.random.default_rng(4)
    for _ in range(400):
        n, keep = draw.integers(1, 30), draw.integers(1, 60)
        w = draw.choice([draw.exponential(size=n), np.ones(n)]) * (draw.uniform(size=n) < 0.7)
        w[draw.integers(n)] += 0.1 if draw.uniform() < 0.7 else 1.0  # of equal weights sums fall upon targets
        w /= w.sum()
        index = np.empty(keep, np.int64)
        uniform = draw.choice([0.0, draw.uniform(), np.nextafter(1, 0)])
        systematic(w, n, keep, uniform, index)
        assert index.tolist() == _walked(w, keep, uniform)
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
    assert (matrix >= 0).all() and len(set(matrix.shape)) == 1


def test_one_value_up_or_down() -> None:
    for expected in ([[1]], [[0.9, 0.1], [0.1, 0.9]], [[0.9, 0.1, 0], [0.05, 0.9, 0.05], [0, 0.1, 0.9]]):
        np.testing.assert_allclose(transitions.tridiagonal(len(expected), 0.9), expected, atol=1e-15)


def test_jitter_moves_the_share_it_says() -> None:
    setting = braking()
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


@pytest.mark.parametrize(("part", "state", "unknown"), [
    ("none", 0, ""), ("variance", 0, "0123"), ("variance", 2, "23"), ("noise", 1, "123"), ("rule", 3, "3"),
    ("rule", 0, "0123"), ("input", 4, "4")])
@pytest.mark.parametrize("backwards", [False, True])
def test_known_states_lean_on_known_ones_only(part: str, state: int, unknown: str, backwards: bool) -> None:
    """States 0 to 3 are a chain, each moves the next; 4 moves nothing and nothing moves it."""
    A, B, Q, P = np.repeat(np.eye(5)[None], 2, axis=0), np.ones((2, 5, 1)), np.zeros((5, 5)), np.zeros((5, 5))
    A[:, [1, 2, 3], [0, 1, 2]] = 0.1
    for name, changed in (("variance", P), ("noise", Q), ("rule", A[1]), ("input", B[1])):
        if part == name:
            changed[state, min(state, changed.shape[1] - 1)] = 2.0
    way = np.arange(5)[::-1 if backwards else 1]
    modes = Grid("none", np.zeros(2), A[:, way][:, :, way], B[:, way], np.eye(5)[:1], Q[way][:, way], np.eye(1),
                 np.full(2, 0.5))
    known = transitions.known_states(modes, P[way][:, way])
    assert known[way].tolist() == [str(i) not in unknown for i in range(5)]


@pytest.mark.parametrize(("values", "printed", "least"), [(2, False, 3), (3, True, 4), (1, False, 3), (2, True, 4)])
def test_groups_of_three_need_as_many_values(values: int, printed: bool, least: int) -> None:
    with pytest.raises(Unsupported) as caught:
        transitions.triples(np.arange(float(values)), printed)
    assert str(caught.value) == f"groups of three need a grid of at least {least} values; this one has {values}"
    grid = np.arange(float(least))
    assert transitions.triples(grid, printed).tolist() == [[0, 1, 2]] * least


def test_groups_nearest_to_each_value() -> None:
    """Of centres 1, 2, 4, 7 (the last left out as printed); of two as near the first."""
    grid = np.array([0.0, 1.0, 2.0, 3.0, 7.0, 11.0])
    assert transitions.triples(grid, False)[:, 0].tolist() == [0, 0, 1, 1, 3, 3]
    assert transitions.triples(grid, True)[:, 0].tolist() == [0, 0, 1, 1, 2, 2]
    assert transitions.triples(-grid, True)[:, 0].tolist() == [1, 1, 1, 1, 3, 3]
    even = np.array([0.0, 0.1, 0.2, 0.3]) + 1e-12 * np.array([0, 1, -1, 0])
    assert transitions.triples(even, False)[:, 0].tolist() == [0, 0, 1, 1]


@pytest.mark.parametrize("kind", [StochasticM, RaoBlackwellizedParticle])
@pytest.mark.parametrize("form", ["factorised", "full"])
def test_a_grid_of_one_value_is_the_kalman_filter(kind: type[StochasticM], form: str) -> None:
    runs, setting = range(2), braking()
    world = setting.world(streams(runs))
    model = setting.design_model({"grid": [0.8], "initial_variance": [1e-14, 1e-14, 1e-14, 0.0]}, world.initial_mean)
    known = KnownParameterKalman({})
    known.start(model, 2, streams(runs)("estimator", "k"))
    means, values, _ = follow(kind({"form": form, **({"prior": "uniform"} if kind is not StochasticM else {})}), model,
                              world, runs, 20)
    for k in range(20):
        known.reveal(np.full_like(world.truth[k], 0.8))
        known.predict(world.u[k], whole(k))
        known.update(heard(world.y[k], world.received[k], k))
        np.testing.assert_allclose(means[k], known.estimate().mean, rtol=0, atol=1e-6)  # particles scatter by 1e-7
    np.testing.assert_allclose(values, 0.8, rtol=1e-13)
