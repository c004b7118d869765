"""Random access protocol: both filters against textbook loops, exhaustive enumeration and their own claims.

The paper is Zou, Wang, Han, Zhou, "Recursive Filtering for Time-Varying Systems with Random Access Protocol"."""

from __future__ import annotations

import copy
import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from railstate.benchmarks.running.drive import drive, prepare
from railstate.benchmarks.running.loop import Loop, Observer
from railstate.estimators.random_access.covariance import Covariance, covariance_sequence, updated_covariance
from railstate.estimators.random_access.estimators import ConditionalRandomAccess, RandomAccessFilter
from railstate.scenarios.errors import Unsupported
from railstate.scenarios.files import load
from railstate.scenarios.linear.config import LinearConfig
from railstate.scenarios.linear.setting import LinearSystem
from railstate.scenarios.randomness import Streams
from scipy import stats

from ..linear_plants import PLANTS, plant
from ..models import heard, part, whole

BOTH = [RandomAccessFilter, ConditionalRandomAccess]

plants = pytest.mark.parametrize("shape", PLANTS.values(), ids=PLANTS)


class Seen(Observer):
    """Keeps what an estimator says after each measurement."""

    def __init__(self, nx: int, runs: int) -> None:
        self.shape, self.means, self.covariances = (nx, nx, runs), list[Any](), list[Any]()

    def updated(self, step: Any, event: int, estimate: Any) -> None:
        self.means.append(estimate.mean.copy())
        self.covariances.append(np.broadcast_to(estimate.covariance, self.shape).copy())


def outputs(setting: LinearSystem, kind: type[Any], runs: range | list[int], seed: int = 1) -> tuple[Any, Any, Any]:
    """Means (K, nx, S), covariances (K, nx, nx, S) and the world of a drive."""
    streams = Streams(seed, "trial", "default", runs)
    world = setting.world(streams)
    estimator, model = prepare(setting, kind, {}, {}, world.initial_mean)
    seen = Seen(model.nx, len(streams.runs))
    estimator.start(model, len(streams.runs), streams("estimator", "trial"))
    assert len([*Loop(world, estimator, seen).steps()]) == world.steps and not estimator.status.any()
    return np.array(seen.means), np.array(seen.covariances), world


def textbook(setting: LinearSystem, world: Any, run: int, conditional: bool) -> tuple[Any, Any]:
    """One run, as printed: (6), (10), (11), (12) with the matrices Phi_i; or the Kalman filter of the rows heard."""
    model = setting.design_model({}, world.initial_mean)
    linear, nodes, p = model.linear, model.reception.nodes, model.reception.p
    ny, nx = model.ny, model.nx
    Phi = [np.diag([1.0 if j in node else 0.0 for j in range(ny)]) for node in nodes]
    Phi_bar = sum(p_i * Phi_i for p_i, Phi_i in zip(p, Phi, strict=True))
    x, P = world.initial_mean[:, run], model.initial_covariance[:, :, 0]
    means, covariances = [], []
    for k in range(world.steps):
        x, P = linear.A(k) @ x, linear.A(k) @ P @ linear.A(k).T + linear.Q(k)
        C, R, y = linear.C(k + 1), linear.R(k + 1), world.y[k, :, run]
        heard = int(world.extra["node"][k, run])
        if conditional:
            rows = list(nodes[heard])
            K = P @ C[rows].T @ np.linalg.inv(C[rows] @ P @ C[rows].T + R[np.ix_(rows, rows)])
            x, P = x + K @ (y[rows] - C[rows] @ x), (np.eye(nx) - K @ C[rows]) @ P
        else:
            inner = sum(p_i * F @ (C @ P @ C.T + R) @ F for p_i, F in zip(p, Phi, strict=True))
            K = P @ C.T @ Phi_bar @ np.linalg.inv(inner)
            x = x + K @ (Phi[heard] @ y - Phi[heard] @ C @ x)
            left = [np.eye(nx) - K @ F @ C for F in Phi]
            P = sum(p_i * (L @ P @ L.T + K @ F @ R @ F @ K.T) for p_i, L, F in zip(p, left, Phi, strict=True))
        means.append(x)
        covariances.append(P)
    return np.array(means), np.array(covariances)


@plants
@pytest.mark.parametrize("kind", BOTH)
def test_the_filters_are_the_textbooks(shape, kind):
    setting = plant(*shape)
    means, covariances, world = outputs(setting, kind, range(5))
    for run in range(5):
        mean, P = textbook(setting, world, run, kind is ConditionalRandomAccess)
        np.testing.assert_allclose(means[..., run], mean, rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(covariances[..., run], P, rtol=1e-9, atol=1e-10)


def test_what_follows_from_a_covariance_is_computed_once():
    setting = plant(3, [[0, 3], [1, 2], [4]])
    model = setting.design_model({}, np.zeros((3, 1)))
    linear, start = model.linear, Covariance.initial(model)
    now = start.predicted(0)
    np.testing.assert_array_equal(start.P, model.initial_covariance[:, :, 0])
    np.testing.assert_allclose(now.P, linear.A(0) @ start.P @ linear.A(0).T + linear.Q(0), rtol=1e-14)
    np.testing.assert_allclose(now.spread(1)[:, :, 0], linear.C(1) @ now.P @ linear.C(1).T + linear.R(1), rtol=1e-14)
    assert start.predicted(0) is now and now.spread(1) is now.spread(1) and copy.deepcopy(now) is now
    assert now.updated(1)[1] is now.updated(1)[1]
    for made, wanted in zip(now.updated(1), updated_covariance(linear, model.reception, now.P, 1), strict=True):
        np.testing.assert_array_equal(getattr(made, "P", made), wanted)
    with pytest.raises(ValueError, match="shorter"):
        updated_covariance(linear, replace(model.reception, p=(0.5, 0.5)), now.P, 1)


@plants
@pytest.mark.parametrize("kind", BOTH)
def test_covariances_are_symmetric_and_positive(shape, kind):
    covariances = np.moveaxis(outputs(plant(*shape, seed=2), kind, range(4))[1], -1, 0)
    np.testing.assert_array_equal(covariances, np.swapaxes(covariances, -1, -2))
    assert np.linalg.eigvalsh(covariances).min() > 0


@pytest.mark.parametrize("kind", BOTH)
def test_a_run_does_not_depend_on_its_batch(kind):
    setting = plant(3, [[0, 3], [1, 2], [4]], seed=3)
    means, covariances, _ = outputs(setting, kind, range(1000))
    for runs in ([17], [3, 17, 200, 999], list(range(7))):
        part_means, part_covariances, _ = outputs(setting, kind, runs)
        np.testing.assert_array_equal(part_means, means[..., runs])
        np.testing.assert_array_equal(part_covariances, covariances[..., runs])


@pytest.mark.parametrize("kind", BOTH)
def test_what_was_not_sent_is_never_read(kind):
    setting = plant(3, [[0, 3], [1, 2], [4]], seed=4)
    means, _, world = outputs(setting, kind, range(6))
    estimator, model = prepare(setting, kind, {}, {}, world.initial_mean)
    streams = Streams(1, "trial", "default", range(6))
    estimator.start(model, 6, streams("estimator", "trial"))
    for k in range(world.steps):
        estimator.predict(world.u[k], whole(k))
        estimator.update(heard(np.where(world.received[k], world.y[k], np.nan), world.received[k], k))
        np.testing.assert_array_equal(estimator.estimate().mean, means[k])


def test_one_node_leaves_nothing_to_chance():
    """With one node every sensor always arrives, and the two filters are one Kalman filter."""
    setting = plant(3, [[0, 1]], seed=5)
    (own, P_own, _), (conditional, P_conditional, _) = (outputs(setting, kind, range(3)) for kind in BOTH)
    np.testing.assert_allclose(own, conditional, rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(P_own, P_conditional, rtol=1e-9, atol=1e-10)


def test_the_covariance_is_the_expectation_over_every_order_of_nodes():
    """All 3^4 node sequences, each with its probability: E e e' with Theorem 1's gains is Theorem 1's P."""
    setting = plant(2, [[0, 2], [1], [3]], steps=4, seed=6)
    model = setting.design_model({}, np.zeros((2, 1)))
    linear, reception = model.linear, model.reception
    gains, P = covariance_sequence(model, 4)
    total = np.zeros((2, 2))
    for sequence in itertools.product(range(3), repeat=4):
        S = model.initial_covariance[:, :, 0]
        for k, i in enumerate(sequence):
            F = np.diag([1.0 if j in reception.nodes[i] else 0.0 for j in range(4)])
            L = np.eye(2) - gains[k] @ F @ linear.C(k + 1)
            S = L @ (linear.A(k) @ S @ linear.A(k).T + linear.Q(k)) @ L.T
            S = S + gains[k] @ F @ linear.R(k + 1) @ F @ gains[k].T
        total += math.prod(reception.p[i] for i in sequence) * S
    np.testing.assert_allclose(total, P[4], rtol=1e-10)


def test_a_designed_filter_can_be_copied_and_goes_on_alike():
    setting = plant(3, [[0, 2], [1]], seed=11)
    streams = Streams(1, "trial", "default", range(4))
    world = setting.world(streams)
    filter_, model = prepare(setting, RandomAccessFilter, {}, {}, world.initial_mean)
    filter_.design(model)
    filter_.start(model, 4, streams("estimator", "trial"))
    copied = copy.deepcopy(filter_)
    for k in range(3):
        for each in (filter_, copied):
            each.predict(world.u[k], whole(k))
            each.update(heard(world.y[k], world.received[k], k + 1))
        np.testing.assert_array_equal(copied.estimate().mean, filter_.estimate().mean)
        np.testing.assert_array_equal(copied.estimate().covariance, filter_.estimate().covariance)
    before = filter_.estimate().mean.copy()
    copied.predict(world.u[3], whole(3))
    np.testing.assert_array_equal(filter_.estimate().mean, before)


def test_gains_prepared_by_the_design_serve_any_order_of_events():
    """A designed filter, started twice, a measurement before the first prediction: as one that was never designed."""
    setting = plant(3, [[0, 2], [1]], seed=11)
    streams = Streams(1, "trial", "default", range(4))
    world = setting.world(streams)
    designed, model = prepare(setting, RandomAccessFilter, {}, {}, world.initial_mean)
    designed.design(model)
    fresh = RandomAccessFilter()
    for _ in range(2):
        for filter_ in (designed, fresh):
            filter_.start(model, 4, streams("estimator", "trial"))
        for k in range(6):
            for filter_ in (designed, fresh):
                filter_.update(heard(world.y[k], world.received[k], k))
                filter_.predict(world.u[k], whole(k))
            np.testing.assert_array_equal(designed.estimate().mean, fresh.estimate().mean)
            np.testing.assert_array_equal(designed.estimate().covariance, fresh.estimate().covariance)


def test_no_other_gain_has_a_smaller_trace():
    setting = plant(3, [[0, 2], [1]], steps=1, seed=7)
    model = setting.design_model({}, np.zeros((3, 1)))
    linear, reception = model.linear, model.reception
    (best,), P = covariance_sequence(model, 1)
    prior = linear.A(0) @ P[0] @ linear.A(0).T + linear.Q(0)
    C, R = linear.C(1), linear.R(1)

    def trace(K: Any) -> float:
        total = 0.0
        for node, p in zip(reception.nodes, reception.p, strict=True):
            F = np.diag([1.0 if j in node else 0.0 for j in range(3)])
            L = np.eye(3) - K @ F @ C
            total += p * np.trace(L @ prior @ L.T + K @ F @ R @ F @ K.T)
        return total

    assert trace(best) == pytest.approx(np.trace(P[1]), rel=1e-12)
    rng = np.random.default_rng(8)
    for _ in range(200):
        assert trace(best + 0.05 * rng.normal(size=best.shape)) > trace(best)


def test_p_cancels_in_a_gain_but_not_in_the_next_ones():
    setting = load("rap-example-1").setting("corrected")
    first, second = (covariance_sequence(setting.design_model({"p": p}, np.zeros((3, 1))), 2)[0]
                     for p in ([0.4, 0.6], [0.5, 0.5]))
    np.testing.assert_allclose(first[0], second[0], rtol=1e-13)
    assert np.abs(first[1] - second[1]).max() > 0.2


@pytest.mark.parametrize("kind", BOTH)
def test_another_channel_is_refused(kind):
    setting = plant(2, [[0], [1]], kind="bernoulli", p=0.5)
    with pytest.raises(Unsupported, match="random access channel"):
        prepare(setting, kind, {}, {}, np.zeros((2, 1)))


def test_a_broken_step_is_refused():
    setting = plant(2, [[0], [1]])
    estimator, model = prepare(setting, RandomAccessFilter, {}, {}, np.zeros((2, 1)))
    estimator.start(model, 1, Streams(1, "trial", "default", [0])("estimator", "trial"))
    with pytest.raises(Unsupported, match="whole sampling periods"):
        estimator.predict(np.zeros((0, 1)), part(0, 0.5))


def test_a_covariance_that_overflows_is_a_failed_run():
    table = plant(1, [[0]], steps=200).config.model_dump(exclude_unset=True)
    table["plant"] |= {"A": [[1e3]], "C": [[0.0]]}
    setting = LinearSystem(LinearConfig.model_validate(table))
    streams = Streams(1, "trial", "default", range(3))
    world = setting.world(streams)
    estimator, model = prepare(setting, RandomAccessFilter, {}, {}, world.initial_mean)
    with np.errstate(over="ignore", invalid="ignore"):
        driven = drive(setting, world, estimator, model, streams("estimator", "trial"))
    assert (driven.scored.status != 0).all()
    assert driven.scored.reasons[0]


RUNS = 1000


def squared_errors(name: str, kind: type[Any]) -> tuple[Any, Any]:
    """|e|^2 and trace P at every step and run, (K, S) each."""
    setting = load(name).setting("corrected")
    means, covariances, world = outputs(setting, kind, range(RUNS), seed=20)
    return ((means - world.truth) ** 2).sum(axis=1), sum(covariances[:, i, i] for i in range(means.shape[1]))


@pytest.mark.parametrize("name", ["rap-example-1", "rap-example-2"])
@pytest.mark.parametrize("kind", BOTH)
def test_the_mean_square_is_trace_p_at_every_step(name, kind):
    """|e|^2 - trace P has mean zero over runs: Student's t at each of the 300 steps, 1 % for all of them together
    (Bonferroni), and the same for the mean over all steps, where one run is one draw."""
    squared, trace = squared_errors(name, kind)
    excess = squared - trace
    t = excess.mean(axis=1) / (excess.std(axis=1, ddof=1) / math.sqrt(RUNS))
    assert np.abs(t).max() < stats.t.ppf(1 - 0.01 / 300 / 2, RUNS - 1)
    overall = excess.mean(axis=0)
    assert abs(overall.mean()) < stats.t.ppf(0.995, RUNS - 1) * overall.std(ddof=1) / math.sqrt(RUNS)


@pytest.mark.parametrize("name", ["rap-example-1", "rap-example-2"])
def test_the_conditional_filter_is_better(name):
    """Paired over runs, the loss in mean square is positive well beyond its 99 % interval."""
    loss = (squared_errors(name, RandomAccessFilter)[0] - squared_errors(name, ConditionalRandomAccess)[0]).mean(axis=0)
    assert loss.mean() > stats.t.ppf(0.995, RUNS - 1) * loss.std(ddof=1) / math.sqrt(RUNS)
