"""The metro setting: plant and disturbances against the page's formulas, estimators' errors against its table."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from railstate.benchmarks.planning.naming import find
from railstate.scenarios.errors import InputError
from railstate.scenarios.files import load
from railstate.scenarios.measurement import untold
from railstate.scenarios.metro.disturbance import _switch, wave
from railstate.scenarios.randomness import Streams

from ..models import part, whole

BOUNDED = ("switching", "white", "sinusoid", "constant", "physical", "physical-bias", "switching-bias")
VARIANTS = (*BOUNDED, "gaussian")
UNLADEN, ROTATING = 212_904, 1.06  # kg; share of the mass that accelerates, rotating parts included
# position m / speed m/s of the Kalman filters with matched, naive and inflated process noise: 1000 runs, another seed
EXPECTED = {
    "switching": ((.1417, .1249), (.7238, .3249), (.1144, .0661)),
    "white": ((.1136, .0421), (.1763, .0642), (.1148, .0588)),
    "sinusoid": ((.1605, .1300), (1.0948, .4257), (.1144, .0653)),
    "constant": ((.2440, .1827), (2.3841, .6747), (.1153, .0725)),
    "physical": ((.1227, .0541), (.5589, .1668), (.1130, .0584)),
    "physical-bias": ((.3141, .0766), (.6203, .1698), (.3120, .0746)),
    "switching-bias": ((.3205, .1366), (.7773, .3286), (.3098, .0808)),
    "gaussian": ((.0649, .0242), (.0723, .0297), (.0658, .0428)),
}


@cache
def setting(variant="switching"):
    return load("ningbo-metro", only=variant).setting(variant)


def world(variant, runs):
    return setting(variant).world(Streams(1, "ningbo-metro", variant, runs))


def page_acceleration(s, v, u):
    """The page's a(s, v, u), written from its table, number by number; shares of the force are at most one."""
    V, mass = 3.6 * v, 250_000
    F = UNLADEN * ROTATING * 1.3 * min(1, (-0.002032 * V**3 + 0.4928 * V**2 - 42.13 * V + 1343) / 203)
    B = UNLADEN * ROTATING * 1.091 * min(1, (0.1343 * V**2 - 25.07 * V + 1300) / 166)
    w0 = 2.031 + 0.0622 * V + 0.001807 * V**2
    i = [-2, -18, 3, 6, 20, 2][sum(s >= edge for edge in (250, 600, 1000, 1400, 1650))]
    return (u * (F if u >= 0 else B) - mass * 9.81 * 1e-3 * (w0 + i)) / (mass * ROTATING)


def test_the_first_variant_is_switching_and_all_eight_are_there():
    scenario, variants = find("ningbo-metro")
    assert {name for name in scenario.requested if not name.startswith("fault-")} == {
        "late", "late-random", "whole-line", "aboard"}
    assert variants == (
        "switching", "white", "sinusoid", "constant", "physical", "physical-bias", "switching-bias", "gaussian")


def test_the_model_is_the_page_s_and_honours_parts_of_a_step():
    rng = np.random.default_rng(0)
    s, v, u = rng.uniform(0, 1900, 300), rng.uniform(0, 21.6, 300), rng.uniform(-1, 1, 300)
    model = setting().design_model({}, np.zeros((2, 300)))
    a = np.array([page_acceleration(*each) for each in zip(s, v, u, strict=True)])
    for share in (1.0, 0.5, rng.uniform(0.1, 1.0, 300)):
        h = 0.2 * share
        expected = np.array([s + h * v + h**2 * a / 2, v + h * a])
        # the source's curves leave a step of 0.1 % of the force where they begin; here they are cut at one instead
        moved = model.transition(np.array([s, v]), u[None], part(0, share, 0.2))
        assert np.allclose(moved, expected, atol=2e-4, rtol=0)
    points = rng.uniform(0, 20, (2, 5, 300))
    together = model.transition(points, u[None], whole(0, 0.2))
    for p in range(5):
        assert np.array_equal(together[:, p], model.transition(points[:, p], u[None], whole(0, 0.2)))


def test_the_unladen_train_reaches_the_paper_s_greatest_acceleration_and_deceleration():
    train = setting().config.plant.train
    assert train.rotating == pytest.approx(ROTATING - 1)
    for force, published in ((train.max_traction, 16_848.0), (train.max_braking, 14_139.36)):  # km/h^2
        assert force / (UNLADEN * (1 + train.rotating)) * 3600**2 / 1000 == pytest.approx(published, rel=1e-12)
    forces = train.model_copy(update={"mass": UNLADEN}).forces  # what the trip and the design model go by
    assert forces.drive * 12_960 == pytest.approx(16_848.0) and forces.brake * 12_960 == pytest.approx(14_139.36)


def test_the_switching_disturbance_is_its_pieces_one_after_another():
    disturbance, random = setting().config.disturbance, Streams(1, "a", "b", range(5))
    w, again = disturbance.draw(random("truth"), 700, 0.2), random("truth")
    sign, pieces = 2.0 * again.integers(0, 1) - 1, 48  # 140 s of at least 3 s each, and one more
    ends = np.cumsum(again.uniform(3.0, 15.0, pieces), axis=0)
    height = 0.15 * again.uniform(0.5, 1.0, pieces)
    for s in range(5):
        at = np.searchsorted(ends[:, s], 0.2 * np.arange(700), side="right")
        assert np.array_equal(w[:, s], sign[s] * np.where(at % 2, -1, 1) * height[at, s])


def test_the_jacobian_is_the_derivative_of_the_transition():
    rng = np.random.default_rng(1)
    v = np.concatenate([rng.uniform(1, 14, 100), rng.uniform(14.5, 21.2, 100)])
    x, u, e = np.array([rng.uniform(260, 590, 200), v]), rng.uniform(-1, 1, (1, 200)), 1e-5
    model = setting().design_model({}, x)
    for j in range(2):
        d = np.zeros((2, 1))
        d[j] = e
        slope = (model.transition(x + d, u, whole(0, 0.2)) - model.transition(x - d, u, whole(0, 0.2))) / (2 * e)
        assert np.allclose(model.transition_jacobian(x, u, whole(0, 0.2))[:, j], slope, atol=1e-7)


@pytest.mark.parametrize("variant", VARIANTS)
def test_truth_follows_the_model_and_keeps_the_bounds(variant):
    w = world(variant, range(20))
    model = setting(variant).design_model({}, w.initial_mean)
    bounds = model.bounds
    assert bounds is not None
    before = np.concatenate([np.array([[[0.0], [0.5]]]) + np.zeros((1, 2, 20)), w.truth[:-1]])
    for k in range(0, w.steps, 7):
        moved = model.transition(before[k], w.u[k], whole(k, 0.2))
        acted = bounds.G * w.extra["disturbance"][k]
        active = w.active[k]
        assert np.allclose((moved + acted)[:, active], w.truth[k][:, active], atol=1e-9)
    assert np.abs(w.u).max() <= 1
    noise = np.abs(w.y - w.truth)
    if variant == "gaussian":
        assert np.allclose((noise**2).mean((0, 2)), np.square(bounds.v_bar) / 9, rtol=0.06)
        assert np.isclose(np.square(w.extra["disturbance"][:500]).mean(), 0.15**2 / 9, rtol=0.06)
    else:
        assert np.abs(w.extra["disturbance"]).max() <= bounds.w_bar[0]
        assert (noise <= bounds.v_bar[None, :, None]).all()
        assert noise.max() > 0.9
    assert np.abs(w.initial_mean - [[0.0], [0.5]]).max(1) == pytest.approx([2.0, 0.3], rel=0.25)


@pytest.mark.parametrize("variant", VARIANTS)
def test_trips_end_at_the_stop_in_about_two_minutes(variant):
    w = world(variant, range(20))
    seconds = 0.2 * w.active.sum(0)
    assert ((seconds > 110) & (seconds < 130)).all()
    assert np.abs(w.truth[-1, 0] - 1900).max() < 3
    assert (w.truth[:, 1] <= w.extra["speed-limit"]).all()
    assert (w.truth[:, 1] >= 0).all()


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_run_does_not_depend_on_its_batch(variant):
    whole = world(variant, range(7))
    for runs in ([3], [6, 2, 3]):
        part = world(variant, runs)
        for name in ("truth", "u", "y", "received", "active"):
            assert np.array_equal(getattr(part, name), getattr(whole, name)[..., runs]), name
        assert np.array_equal(part.initial_mean, whole.initial_mean[:, runs])


def test_the_model_does_not_depend_on_the_batch():
    rng = np.random.default_rng(2)
    x, u = rng.uniform(0, 21, (2, 1000)), rng.uniform(-1, 1, (1, 1000))
    Pi = np.repeat(np.diag([1.0, 0.04])[:, :, None], 1000, 2)
    every = setting().design_model({}, x)
    assert every.bounds and every.bounds.kappa and every.transition_jacobian
    for some in (slice(0, 1), slice(3, 10)):
        model = setting().design_model({}, x[:, some])
        assert model.bounds and model.bounds.kappa and model.transition_jacobian
        for name in ("transition", "transition_jacobian"):
            one, all_ = (getattr(m, name) for m in (model, every))
            step = whole(0, 0.2)
            assert np.array_equal(one(x[:, some], u[:, some], step), all_(x, u, step)[..., some])
        kappa = model.bounds.kappa(x[:, some], u[:, some], Pi[:, :, some])
        assert np.array_equal(kappa, every.bounds.kappa(x, u, Pi)[some])


def test_kappa_is_the_largest_change_of_the_speed_derivative():
    """Over the whole error bound: near 77 km/h, where the braking curve bends, and 51.5 km/h, where traction does."""
    speeds = [15.0, 18.0, *np.linspace(76.0, 78.0, 12) / 3.6, *np.linspace(50.6, 52.4, 12) / 3.6]
    v, u = np.array([np.full(26, 100.0), speeds]), np.array([[0.8, -0.4, *[-0.7] * 12, *[0.85] * 12]])
    model = setting().design_model({}, v)
    Pi = np.repeat(np.diag([1.0, 0.09])[:, :, None], 26, 2)
    assert model.bounds and model.bounds.kappa

    def derivative(speed, r):
        e = 1e-5
        up, down = (page_acceleration(100.0, speed + d, u[0, r]) for d in (e, -e))
        return (up - down) / (2 * e)

    expected = [0.2 * max(abs(derivative(v[1, r] + q * 0.3, r) - derivative(v[1, r], r))
                          for q in np.linspace(-1, 1, 301)) for r in range(v.shape[1])]
    found = model.bounds.kappa(v, u, Pi)
    assert (found >= np.array(expected) * (1 - 1e-5)).all() and found == pytest.approx(expected, rel=2e-2)
    fixed = setting().design_model({"kappa": 0.01}, v)
    assert fixed.bounds and fixed.bounds.kappa
    assert np.array_equal(fixed.bounds.kappa(v, u, Pi), np.full(26, 0.01))


def textbook_ekf(w, models):
    """Mean squared error (2, S) of each run of a plain extended Kalman filter, from 5 s on, by what it is told of the
    noise."""
    model, (runs, many) = models[0], (w.initial_mean.shape[1], len(models))
    x = np.tile(w.initial_mean, many)
    P = np.tile(model.initial_covariance, many * runs).transpose(2, 0, 1)
    R = model.measurement_covariance(untold(0, 2))[:, :, 0]
    Q = np.repeat([each.process_covariance(None, None, whole(0, 0.2))[:, :, 0] for each in models], runs, axis=0)
    u, y, truth = (np.tile(array, many) for array in (w.u, w.y, w.truth))
    square = np.empty_like(truth)
    for k in range(w.steps):
        F = model.transition_jacobian(x, u[k], whole(k, 0.2)).transpose(2, 0, 1)
        x, P = model.transition(x, u[k], whole(k, 0.2)), F @ P @ F.transpose(0, 2, 1) + Q
        K = P @ np.linalg.inv(P + R)
        x, P = x + np.einsum("sij,js->is", K, y[k] - x), P - K @ P
        square[k] = (x - truth[k]) ** 2
    active = np.tile(w.active, many)[25:, None]
    return np.split((square[25:] * active).sum(axis=0) / active.sum(axis=0), many, axis=1)


@pytest.mark.parametrize("variant", VARIANTS)
def test_errors_of_the_kalman_filter_are_those_of_another_seed(variant):
    w = world(variant, range(100))
    models = [setting(variant).design_model(told, w.initial_mean) for told in ({}, {"sigma_w": 0.02}, {"sigma_w": 0.3})]
    for square, expected in zip(textbook_ekf(w, models), EXPECTED[variant], strict=True):
        rmse = np.sqrt(square.mean(1))
        error = square.std(1, ddof=1) / 10 / (2 * rmse)  # delta method
        # the expected numbers come from ten times the runs, and are rounded to 0.0001
        assert (np.abs(rmse - expected) <= 3 * 1.1**0.5 * error + 5e-5).all(), (rmse, expected, error)


def test_moments_told_to_the_estimators():
    start = np.zeros((2, 1))
    matched, naive = setting().design_model({}, start), setting().design_model({"sigma_w": 0.02}, start)
    gaussian = setting("gaussian").design_model({}, start)
    gamma = np.array([0.02, 0.2])
    for model, variance in ((matched, 0.15**2 / 3), (naive, 0.02**2), (gaussian, 0.15**2 / 9)):
        assert model.process_covariance and model.measurement_covariance
        Q = model.process_covariance(start, start, whole(0, 0.2))[:, :, 0]
        assert np.allclose(Q, variance * np.outer(gamma, gamma))
        step = part(0, np.array([0.4, 0.6, 1.0]), 0.2)
        parts = model.process_covariance(np.zeros((2, 3)), np.zeros((1, 3)), step)
        assert np.array_equal(parts[:, :, 2], Q) and np.isclose(parts[1, 1, 0] + parts[1, 1, 1], Q[1, 1])
        h = 0.08
        assert np.allclose(parts[:, :, 0], variance * 0.2 * np.array([[h**3 / 3, h**2 / 2], [h**2 / 2, h]]))
    assert np.allclose(matched.initial_covariance[:, :, 0], np.diag([4, 0.09]))


def test_packets_can_be_lost():
    lossy = load("ningbo-metro", {"channel": {"kind": "bernoulli", "p": 0.7}}, "white").setting("white")
    received = lossy.world(Streams(1, "ningbo-metro", "white", range(20))).received
    assert received.mean() == pytest.approx(0.7, abs=4 * (0.7 * 0.3 / (20 * 700)) ** 0.5)


@pytest.mark.parametrize(("key", "value", "message"), [
    ("disturbance.form", "red", "disturbance.form"),
    ("disturbance.w_bar", -1.0, "disturbance.w_bar"),
    ("disturbance.piece", [5.0, 1.0], "least <= most"),
    ("sensors.v_bar", [1.0], "sensors.v_bar"),
    ("plant.weight", 3.0, "plant.weight: unknown key"),
    ("knowledge.sigma_w", -0.1, "knowledge.sigma_w"),
    ("plant.controller.margin", 30.0, "plant.controller.margin"),
    ("plant.train.max_traction", 2e4, "cannot climb"),
    ("plant.train.max_braking", 4e4, "cannot brake"),
])
def test_mistakes_are_named(key, value, message):
    with pytest.raises(InputError, match=message):
        load("ningbo-metro", {key: value})


def test_a_piece_ends_with_the_step_at_its_end():
    out = np.empty((7, 2))
    _switch.py_func(np.array([1.0, -1.0]), np.array([[1.0, 0.5], [0.5, 1.0], [9.0, 9.0]]),
                    np.array([[1.0, 1.0], [2.0, 2.0], [3.0, 3.0]]), 0.5, out)
    assert out.T.tolist() == [[1, 1, -2, 3, 3, 3, 3], [-1, 2, 2, -3, -3, -3, -3]]


def test_a_wave_is_a_sine_of_the_period_and_phase_that_were_drawn():
    streams, again = (Streams(1, "a", "b", range(3))("truth") for _ in range(2))
    found = wave(streams, [4.0, 9.0], 50, 0.2)
    period, phase = again.uniform(4.0, 9.0), again.uniform(0.0, 2 * np.pi)
    np.testing.assert_allclose(found, np.sin(2 * np.pi * 0.2 * np.arange(1, 51)[:, None] / period + phase), atol=1e-12)


def test_balises_beside_a_line_of_several_stops():
    changes = {"plant.line.stops": [0.0, 500.0, 900.0], "plant.balises": {"positions": [950.0]}}
    with pytest.raises(InputError, match=r"aboard: plant.balises: none lies on the line, 0 .. 900 m$"):
        load("ningbo-metro", changes, only="aboard").setting("aboard")


def test_a_train_with_loads():
    plant = setting().config.plant
    loaded = plant.model_copy(update={"loads": [200e3, 260e3]})
    assert plant.heaviest is plant.train and plant.ease.tolist() == [1.0] * (len(plant.line.stops) - 1)
    assert loaded.heaviest == plant.train.model_copy(update={"mass": 260e3})
    assert loaded.ease.tolist() == [plant.train.mass / 200e3, plant.train.mass / 260e3]
    told = setting().config.knowledge
    for moments, divisor in (("uniform", 3**0.5), ("gaussian", 3.0)):
        told = told.model_copy(update={"moments": moments, "w_bar": 0.3, "v_bar": [1.0, 0.2]})
        assert told.process_sd == 0.3 / divisor and told.sensor_sd.tolist() == [1.0 / divisor, 0.2 / divisor]
    told = told.model_copy(update={"sigma_w": 0.07, "sigma_v": [0.5, 0.1]})
    assert told.process_sd == 0.07 and told.sensor_sd.tolist() == [0.5, 0.1]
