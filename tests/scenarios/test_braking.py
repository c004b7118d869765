"""The braking setting: its plant against integration, its truths, its three design models, its scenario file.

Known answers come from the paper's eqs. (4) and (23) and from finite differences."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from railstate.benchmarks.running.drive import drive, prepare
from railstate.estimators.kalman import ExtendedKalman, Kalman
from railstate.estimators.multiple_model.oracle import KnownParameterKalman
from railstate.scenarios.braking.plant import discretise
from railstate.scenarios.braking.setting import Braking
from railstate.scenarios.errors import InputError
from railstate.scenarios.files import load
from railstate.scenarios.randomness import Streams

from ..models import heard, whole

TAU, LAMBDA = 0.4, 1.6667
VARIANTS = ("paper", "printed-groups", "accelerometer", "stop")


def setting(variant: str = "paper", **overrides: Any) -> Braking:
    return load("braking-rate", overrides).setting(variant)  # pyright: ignore[reportReturnType]


def streams(runs: range | list[int], variant: str = "paper") -> Streams:
    return Streams(1, "braking-rate", variant, runs)


def integrate(x: np.ndarray, f: float, target: float, period: float, parts: int = 4000) -> np.ndarray:
    """Eq. (4) by Runge and Kutta's fourth-order rule."""

    def slope(x: np.ndarray) -> np.ndarray:
        _, v, a, z = x
        return np.array([v, a, -a / TAU + f / TAU * z - f / TAU * target, -LAMBDA * z + 2 * LAMBDA * target])

    h = period / parts
    for _ in range(parts):
        k1 = slope(x)
        k2 = slope(x + h / 2 * k1)
        k3 = slope(x + h / 2 * k2)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + slope(x + h * k3))
    return x


@pytest.mark.parametrize("period", [1.0, 0.2])
def test_discretisation_is_exact_and_affine(period: float) -> None:
    plant = discretise(TAU, LAMBDA, period)
    x, target = np.array([3.0, 17.0, -0.4, -1.3]), -0.8
    for f in (0.0, 0.37, 1.0):
        A, B = plant.at(f)
        wanted = integrate(x, f, target, period)
        np.testing.assert_allclose(A @ x + B[:, 0] * target, wanted, rtol=0, atol=1e-11)
        np.testing.assert_allclose(plant.step(x[:, None], f, target)[:, 0], wanted, rtol=0, atol=1e-11)


def test_initial_values_are_the_equilibrium_at_f_1() -> None:
    plant = discretise(TAU, LAMBDA, 1.0)
    moved = plant.step(np.array([[0.0], [20.0], [-1.0], [-2.0]]), 1.0, -1.0)[:, 0]
    np.testing.assert_allclose(moved, [19.5, 19.0, -1.0, -2.0], atol=1e-12)


def test_braking_rate_follows_equation_23() -> None:
    truth = setting().world(streams(range(3))).truth
    np.testing.assert_allclose(truth[:, 4, 1], 1 - 0.005 * np.arange(1, 151), atol=1e-12)
    assert truth.shape == (150, 5, 3)


def test_truth_without_noise_is_the_plant() -> None:
    quiet = setting(**{"disturbance.speed_variance_rate": 0.0})
    truth = quiet.world(streams([5])).truth[:, :, 0]
    x = np.array([0.0, 20.0, -1.0, -2.0])
    for k in range(3):
        x = integrate(x, 1 - 0.005 * (k + 1), -1.0, 1.0)
        np.testing.assert_allclose(truth[k, :4], x, atol=1e-10)
    assert np.flatnonzero(truth[:, 1] < 0)[0] == 21  # step k = 22: the published plant does not stop


def test_measurements_have_their_variances() -> None:
    world = setting("accelerometer").world(streams(range(200), "accelerometer"))
    error = world.y - world.truth[:, :4]
    n = error[:, 0].size
    for row, variance in enumerate((0.42, 0.114, 1.764e-3, 1e-8)):
        found = np.mean(error[:, row] ** 2)
        assert abs(found / variance - 1) < 4 * np.sqrt(2 / n)


@pytest.mark.parametrize("variant", VARIANTS)
def test_runs_do_not_depend_on_the_batch(variant: str) -> None:
    chosen = setting(variant)
    together, alone = chosen.world(streams(range(6), variant)), chosen.world(streams([4], variant))
    for part in ("truth", "y", "active", "u", "received"):
        np.testing.assert_array_equal(getattr(together, part)[..., 4:5], getattr(alone, part))


def test_stop_ends_at_standstill() -> None:
    chosen = setting("stop")
    world = chosen.world(streams(range(50), "stop"))
    speed, displacement, f = world.truth[:, 1], world.truth[:, 0], world.truth[:, 4, 0]
    assert (speed >= 0).all() and (speed[-1] == 0).all()
    for run in range(50):
        last = np.flatnonzero(world.active[:, run])[-1]
        assert last < 249 and speed[last, run] == 0 and (speed[:last, run] > 0).all()
        assert (displacement[last:, run] == displacement[last, run]).all()
        if last:  # no further than the speed before would have carried it
            assert 0 <= displacement[last, run] - displacement[last - 1, run] <= 0.2 * speed[last - 1, run]
    drop = np.diff(f)
    np.testing.assert_allclose(f[0], 0.999)
    np.testing.assert_allclose(drop[58], -0.301)  # into t = 12.0 s
    np.testing.assert_allclose(np.delete(drop, 58), -0.001, atol=1e-12)
    np.testing.assert_allclose(world.u[[0, 5, 10, 100], 0, 0], [0.0, -0.5, -1.0, -1.0])


def test_stopping_position_error_is_the_final_displacement_error() -> None:
    chosen = setting("stop")
    source = streams(range(8), "stop")
    world = chosen.world(source)
    estimator, model = prepare(chosen, KnownParameterKalman, {}, {}, world.initial_mean)
    errors = np.full((world.steps, 8), np.nan)

    def watch(stretch: Any) -> None:
        kept = slice(stretch.count)
        errors[stretch.places[kept]] = stretch.vector[kept, 0] - stretch.truth[kept, 0]

    scored = drive(chosen, world, estimator, model, source("estimator", "x"), watch).scored
    last = world.active.sum(axis=0) - 1
    np.testing.assert_array_equal(scored.metrics["final", "displacement"], np.abs(errors[last, np.arange(8)]))
    assert (scored.metrics["final", "displacement"] < 3).all()


APPENDED = {"model": "augmented", "initial_variance": [1e-3] * 4, "target_variance_rate": 1e-8}


def test_augmented_jacobian_is_the_derivative() -> None:
    chosen = setting()
    model = chosen.design_model(APPENDED, np.zeros((4, 2)))
    assert model.transition_jacobian is not None and model.process_covariance is not None
    x = np.array([[1.0, -4.0], [20.0, 3.0], [-0.7, -0.2], [-1.9, -0.4], [0.8, 0.3]])
    u = np.array([[-1.0, -0.6]])
    jacobian = model.transition_jacobian(x, u, whole(0))
    for i in range(5):
        h = np.zeros((5, 1))
        h[i] = 1e-6
        slope = (model.transition(x + h, u, whole(0)) - model.transition(x - h, u, whole(0))) / 2e-6
        np.testing.assert_allclose(jacobian[:, i], slope, atol=1e-8)
    # f's noise acts with f itself: Q = q (df) (df)' + speed noise + 1e-8 on a_z
    noise = model.process_covariance(x, u, whole(0))[:, :, 0]
    wanted = 1e-3 * np.outer(jacobian[:, 4, 0], jacobian[:, 4, 0]) + np.diag([0, 0.05, 0, 1e-8, 0])
    np.testing.assert_allclose(noise, wanted, atol=1e-15)


def test_sigma_axes_pass_through_the_augmented_model() -> None:
    model = setting().design_model(APPENDED, np.zeros((4, 3)))
    points = np.random.default_rng(0).normal(size=(5, 11, 3))
    u = np.full((1, 3), -1.0)
    moved, seen = model.transition(points, u, whole(0)), model.measurement(points, 0)
    for j in range(11):
        np.testing.assert_array_equal(moved[:, j], model.transition(points[:, j], u, whole(0)))
        np.testing.assert_array_equal(seen[:, j], model.measurement(points[:, j], 0))


def test_augmented_kalman_is_exact() -> None:
    """With a_z known the extended filter of the bilinear model and the time-varying Kalman filter are the same."""
    chosen = setting()
    source = streams(range(3))
    world = chosen.world(source)
    known = {"initial_variance": [1e-3, 1e-3, 1e-3, 0.0]}
    filters = []
    for kind, knowledge in ((ExtendedKalman, "augmented"), (Kalman, "scheduled")):
        estimator, model = prepare(chosen, kind, {}, {**known, "model": knowledge}, world.initial_mean)
        estimator.start(model, 3, source("estimator", "x"))
        filters.append(estimator)
    for k in range(60):
        for estimator in filters:
            estimator.predict(world.u[k], whole(k))
            estimator.update(heard(world.y[k], world.received[k], k))
        extended, linear = (estimator.estimate() for estimator in filters)
        np.testing.assert_allclose(extended.mean, linear.mean, rtol=0, atol=1e-9)
        assert extended.covariance is not None and linear.covariance is not None
        np.testing.assert_allclose(extended.covariance, np.broadcast_to(linear.covariance, (5, 5, 3)), atol=1e-9)


def test_scenario_has_the_public_names() -> None:
    scenario = load("braking-rate")
    assert tuple(name for name in scenario.variants if name not in scenario.requested) == VARIANTS
    assert scenario.requested == {"prior-normal", "prior-uniform", "static", "held-noise", "uncertain-start",
                                  "stop-prior-normal", "stop-prior-uniform"}
    labels = {"rbpf-static", "rbpf", "rbpf-bootstrap", "sma", "sma-heaviest", "gsma", "gsma-heaviest",
              "gsma-memoryless", "gsma-2000", "imm-uniform", "imm-third", "imm-sticky", "augmented-kalman",
              "kalman-known-f", "ekf", "ukf", "ckf", "sma-sticky", "gsma-sticky", "rbpf-tuned", "sma-tuned",
              "gsma-tuned", "imm-tuned", "augmented-kalman-tuned", "ukf-tuned"}
    for variant in VARIANTS:
        chosen = scenario.setting(variant)
        assert {label for label, entry in chosen.config.estimators.items() if entry.default} == labels
        names = [quantity.name for quantity in chosen.quantities()]
        assert names == ["f", "displacement", "speed", "control-acceleration", "target-acceleration"]


def test_printed_groups_change_the_gsma_only() -> None:
    scenario = load("braking-rate")
    paper, printed = (scenario.setting(name).config.estimators for name in ("paper", "printed-groups"))
    changed = {label for label in paper if paper[label] != printed[label]}
    assert changed == {label for label, entry in paper.items() if entry.plugin == "gsma"}


@pytest.mark.parametrize(("key", "value", "words"), [
    ("knowledge.grid", [0.0, 0.2, 0.1], ("knowledge", "order")),
    ("plant.rate_drift", -0.05, ("braking rate", "-6.5", "0 or above")),
    ("plant.target", [[1.0, 0.0], [0.0, -1.0]], ("target", "order of time")),
    ("sensors.speed_variance", -1.0, ("sensors.speed_variance", "greater than 0")),
    ("plant.response_time", 0.0, ("plant.response_time", "greater than 0")),
    ("knowledge.model", "guess", ("knowledge.model", "'grid', 'augmented' or 'scheduled'")),
])
def test_mistakes_are_named(key: str, value: object, words: tuple[str, ...]) -> None:
    with pytest.raises(InputError) as caught:
        load("braking-rate", {key: value})
    for word in words:
        assert word in str(caught.value)


def test_one_prior_for_all():
    """`normal` is N(1, .1^2) cut to the grid; `prior-uniform` tells those with f appended the grid's own moments."""
    scenario = load("braking-rate")
    grid = np.array(scenario.setting("paper").config.knowledge.grid)
    told = {name: scenario.setting(name).design_model({}, np.zeros((4, 1))).modes for name in ("paper", "prior-normal")}
    assert_allclose(told["paper"].prior, 1 / 11, rtol=1e-15)
    weight = np.array([math.exp(-0.5 * ((f - 1.0) / 0.1) ** 2) for f in grid])
    assert_allclose(told["prior-normal"].prior, weight / weight.sum(), rtol=1e-12)
    knowledge = scenario.setting("prior-uniform").config.knowledge
    assert_allclose([knowledge.rate_initial, knowledge.rate_initial_variance], [grid.mean(), grid.var()], rtol=1e-12)


def test_noise_held_over_a_step_is_half_of_it_on_the_way() -> None:
    """Gamma of eq. (6) by exact hold of E, [T/2, 1] per change of speed: by integration with constant d(t), in the
    truth and in every model that estimators are told."""
    impulse, held = (setting("paper", **{"disturbance.hold": hold}) for hold in ("impulse", "held"))
    truths = [each.world(streams(range(3))).truth for each in (impulse, held)]
    change = np.diff(truths[0][:, 1] - truths[1][:, 1], axis=0)
    assert_allclose(change, 0, atol=1e-12)  # the same speeds
    noise = truths[0][:, 1] - np.concatenate([[np.full(3, 20.0)], truths[0][:-1, 1]])  # plus what f does, in both
    way = truths[1][:, 0] - truths[0][:, 0]
    drawn = noise - noise.mean(axis=1, keepdims=True)  # f is the same in all runs
    assert_allclose(np.diff(way - way.mean(axis=1, keepdims=True), axis=0), drawn[1:] / 2, atol=1e-9)
    told = held.design_model({}, np.array([[0.0], [20.0], [-1.0], [-2.0]]))
    assert told.modes is not None and told.linear is not None
    wanted = 0.05 * np.outer([0.5, 1.0, 0, 0], [0.5, 1.0, 0, 0])
    assert_allclose(told.linear.Q(0), wanted)
    for name in ("augmented", "scheduled"):
        model = held.design_model({"model": name}, np.array([[0.0], [20.0], [-1.0], [-2.0]]))
        assert model.process_covariance is not None
        Q = model.process_covariance(model.initial_mean, np.array([[-1.0]]), whole(0, 1.0))[:, :, 0]
        before = impulse.design_model({"model": name}, np.array([[0.0], [20.0], [-1.0], [-2.0]]))
        assert before.process_covariance is not None
        plain = before.process_covariance(model.initial_mean, np.array([[-1.0]]), whole(0, 1.0))[:, :, 0]
        assert_allclose((Q - plain)[:2, :2], 0.05 * np.array([[0.25, 0.5], [0.5, 0.0]]), atol=1e-15)


def test_numbers_of_a_file() -> None:
    """Targets by straight lines from each step's beginning, the rate with its drift and jumps at its end."""
    config = setting().config
    steps = [[0.4 + 0.8e-9, -0.2], [0.6 + 1.2e-9, -0.1]]
    plant = config.plant.model_copy(update={"target": [[0.2, -1.0], [0.6, -2.0]], "rate_start": 0.9,
                                            "rate_drift": -0.1, "rate_steps": steps})
    assert_allclose(plant.targets(0.2, 5), [-1.0, -1.0, -1.5, -2.0, -2.0], rtol=1e-12)
    assert_allclose(plant.rates(0.2, 4), [0.88, 0.66, 0.64, 0.52], rtol=1e-12)
    assert [config.disturbance.model_copy(update={"hold": hold}).entry(0.2).tolist() for hold in ("impulse", "held")
            ] == [[0.0, 1.0, 0.0, 0.0], [0.1, 1.0, 0.0, 0.0]]
    rows = [("displacement", 0, 0.42), ("speed", 1, 0.08), ("target-acceleration", 3, 1e-8)]
    assert config.sensors.rows() == rows
    assert config.sensors.model_copy(update={"control_acceleration_variance": 0.3}).rows() == [
        *rows[:2], ("control-acceleration", 2, 0.3), rows[2]]
