"""Augmented design models: against matrices written by hand, against differences, and through the command line."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from railstate.benchmarks.planning.plan import make_plan
from railstate.benchmarks.running.drive import drive, prepare
from railstate.estimators.registry import estimators
from railstate.scenarios.augmented import Extra, augmented
from railstate.scenarios.errors import InputError, Unsupported
from railstate.scenarios.files import load
from railstate.scenarios.measurement import Interval
from railstate.scenarios.model import Bounds, Linear, linear_model
from railstate.scenarios.randomness import Streams
from railstate.scenarios.schema import Augment

from ..models import coasting, feed, linear, random, record, whole

GAIN, COLUMN = np.array([[0.3], [-0.2], [0.1]]), np.array([0.5, -1.0])
EXTRAS = (Extra("d", "1", "gauss-markov", 0.4, time_constant=3.0, gain=lambda interval: GAIN, instead=0.25),
          Extra("w", "1", "walk", 0.1, start_sd=0.7, mean=0.2, gain=lambda interval: 2 * GAIN, bound=0.3),
          Extra("b", "1", "constant", 0.6, column=COLUMN))


def by_hand(base):
    """`EXTRAS` written out for the linear test model with period 1."""
    A, C, Q = np.zeros((6, 6)), np.zeros((2, 6)), np.zeros((6, 6))
    A[:3, :3], A[:3, 3], A[:3, 4] = base.linear.A(0), GAIN[:, 0], 2 * GAIN[:, 0]
    phi = np.exp(-1 / 3.0)
    A[3, 3], A[4, 4], A[5, 5] = phi, 1.0, 1.0
    C[:, :3], C[:, 5] = base.linear.C(0), COLUMN
    Q[:3, :3], Q[3, 3], Q[4, 4] = 0.75 * base.linear.Q(0), 0.16 * (1 - phi**2), 0.01
    B, h = np.vstack([base.linear.B(0), np.zeros((3, 1))]), np.concatenate([base.linear.h(0), np.zeros(3)])
    mean = np.vstack([base.initial_mean, np.repeat([[0.0], [0.2], [0.0]], base.initial_mean.shape[1], axis=1)])
    start = np.diag([1.0, 1.0, 1.0, 0.16, 0.49, 0.36])[:, :, None]
    return linear_model(Linear(*(lambda k, matrix=matrix: matrix for matrix in (A, B, h, C, Q, base.linear.R(0)))),
                        states=(*base.states, "d", "w", "b"), measurements=base.measurements, period=1.0,
                        initial_mean=mean, initial_covariance=start)


@pytest.mark.parametrize("name", ["kalman", "ekf", "ukf"])
def test_an_augmented_linear_model_equals_the_one_written_by_hand(name):
    base = linear(4)
    ours, theirs = augmented(base, EXTRAS), by_hand(base)
    assert (ours.own, ours.nx, ours.states) == (3, 6, theirs.states)
    for part in "ABhCQR":
        assert_allclose(getattr(ours.linear, part)(2), getattr(theirs.linear, part)(2), rtol=0, atol=1e-12)
    x, u = random(4, "x").normal(6, 5), random(4, "u").normal(1)
    for ask in ("transition", "transition_jacobian", "process_covariance"):
        points = x if ask == "transition" else x[:, 0]
        assert_allclose(getattr(ours, ask)(points, u, whole(3)), getattr(theirs, ask)(points, u, whole(3)), atol=1e-12)
    assert_allclose(ours.measurement(x, 3), theirs.measurement(x, 3), atol=1e-12)
    tape = record(base, 4, 40)
    (means, covariances), (right, matrices) = (feed(estimators()[name](), model, tape) for model in (ours, theirs))
    assert_allclose(means, right, rtol=0, atol=1e-12)
    assert covariances is not None and matrices is not None
    assert_allclose(covariances, matrices, rtol=0, atol=1e-12)


def test_what_an_extra_state_costs_a_model():
    base = coasting(2)
    moving = Extra("d", "m/s^2", "walk", 0.1, gain=lambda interval: np.array([[0.5], [1.0]]))
    assert augmented(linear(2), EXTRAS[2:]).linear is not None
    assert augmented(base, ()) is base
    with pytest.raises(InputError, match="input_jacobian"):
        augmented(linear(2), [Extra("s", "1", "constant", 0.1, input=0)])
    with pytest.raises(InputError, match="exactly one of gain, column, input"):
        Extra("s", "1", "constant", 0.1)
    with pytest.raises(InputError, match="needs a time_constant"):
        Extra("s", "1", "gauss-markov", 0.1, column=COLUMN)
    cars = load("cbtc-csma").setting("uniform")
    start = np.zeros((12, 1))
    unknown = cars.told({}, {"force": Augment()}, start)
    assert unknown.bounds is None and unknown.linear is not None and unknown.nx == 18
    bounded = cars.told({}, {"force": Augment(bound=0.14)}, start).bounds
    assert bounded.G.shape == (18, 6)
    assert_array_equal(bounded.w_bar, np.full(6, 0.14))
    assert augmented(base, [moving]).process_covariance(np.ones((3, 2)), np.zeros((1, 2)), whole(0)).shape[0] == 3


@pytest.mark.parametrize(("instead", "left"), [(0.0, [0, 1]), (0.75, [0, 1]), (1.0, [])])
def test_bounds_of_what_drives_extra_states(instead, left):
    """Columns of the base's forces that are left, smaller by what is replaced, then one for each state that moves; what
    is said of the base's own states is asked of these."""
    seen, G = [], np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
    bounds = Bounds(G, np.array([0.2, 0.4]), np.array([7.0, 8.0]), np.array([[1.0], [2.0], [3.0]]),
                    np.array([[4.0, 5.0, 6.0]]), lambda x, u, Pi: seen.append((x, u, Pi)) or np.ones(2),
                    lambda interval: interval.length * np.stack([G, 2 * G], axis=2))
    base = replace(linear(2), bounds=bounds)
    extras = (replace(EXTRAS[0], instead=instead, bound=0.5), EXTRAS[2], EXTRAS[1])
    found = augmented(base, extras)
    assert found.bounds is not None and augmented(base, EXTRAS).bounds is None  # the first has no bound
    drive = np.zeros((6, 2))
    drive[3, 0], drive[5, 1] = 1.0, 1.0
    assert_array_equal(found.bounds.G, np.hstack([np.vstack([G[:, left], np.zeros((3, len(left)))]), drive]))
    assert_allclose(found.bounds.w_bar, [*((1 - instead) ** 0.5 * np.array([0.2, 0.4])[left]), 0.5, 0.3])
    assert_array_equal(found.bounds.v_bar, [7.0, 8.0])
    assert_array_equal(found.bounds.M, [[1], [2], [3], [0], [0], [0]])
    assert_array_equal(found.bounds.N, [[4, 5, 6, 0, 0, 0]])
    half = found.bounds.part(Interval(1, 0.0, 0.5, 0.5))
    for run in range(2):
        own = np.vstack([0.5 * (run + 1) * G[:, left], np.zeros((3, len(left)))])
        assert_array_equal(half[:, :, run], np.hstack([own, drive]))
    x, u, Pi = np.arange(12.0).reshape(6, 2), np.ones((1, 2)), np.arange(72.0).reshape(6, 6, 2)
    assert_array_equal(found.bounds.kappa(x, u, Pi), [1, 1])
    for mine, theirs in zip(seen[0], (x[:3], u, Pi[:3, :3]), strict=True):
        assert_array_equal(mine, theirs)
    assert seen[0][2].flags.c_contiguous
    assert_array_equal(found.performance, np.hstack([np.eye(3), np.zeros((3, 3))]))
    assert (found.appended, found.own) == (3, 3)
    assert (found.inclusion, found.densities, found.input_jacobian) == (None,) * 3
    plain = augmented(replace(base, bounds=Bounds(G, np.ones(2), np.ones(2)), performance=None), extras)
    assert plain.bounds is not None and plain.performance is None
    assert (plain.bounds.M, plain.bounds.N, plain.bounds.kappa, plain.bounds.part) == (None,) * 4


def test_the_scale_of_an_encoder_against_differences():
    """df/ds and every sigma point's own input, on the ring of moving-block."""
    setting = load("moving-block").setting("law-p")
    x = np.array([[0.5, -0.5, 0.45], [0.1, -0.2, 0.6], [-0.5, 0.3, 0.5], [0.3, 0.75, 0.2]])
    model = setting.told({}, {"encoder-scale": Augment()}, x)
    assert model.linear is None and model.bounds is None and model.states[4:] == ("encoder-scale-a", "encoder-scale-b")
    u, interval = np.array([[0.05, 0.06, 0.04], [0.03, 0.05, 0.06]]), Interval(1, 0.0, 0.025, 0.5)
    state = np.vstack([x, np.full((2, 3), 0.024)])
    F = model.transition_jacobian(state, u, interval)
    for i in range(6):
        step = np.zeros((6, 1))
        step[i] = 1e-6
        slope = (model.transition(state + step, u, interval) - model.transition(state - step, u, interval)) / 2e-6
        assert_allclose(F[:, i], slope, atol=1e-8)
    points = np.stack([state, state + 1e-3, state - 1e-3], axis=1)
    moved = model.transition(points, u, interval)
    for j in range(3):
        assert_array_equal(moved[:, j], model.transition(np.ascontiguousarray(points[:, j]), u, interval))
    true = setting.design_model({}, x).transition(x, u / 1.024, interval)
    assert_allclose(model.transition(state, u, interval)[:4], true, atol=1e-15)


def test_parts_of_a_step_add_up_for_an_extra_state():
    model = load("ningbo-metro").setting("switching").told({}, {"disturbance": Augment()}, np.zeros((2, 1)))
    one, parts = model.process_covariance, (Interval(1, 0.0, 0.15, 0.75), Interval(1, 0.15, 0.05, 0.25))
    x, u = np.array([[10.0], [5.0], [0.1]]), np.array([[0.3]])
    total, phi = one(x, u, Interval(1, 0.0, 0.2))[2, 2], np.exp(-0.05 / 8.0)
    assert_allclose(phi**2 * one(x, u, parts[0])[2, 2] + one(x, u, parts[1])[2, 2], total, rtol=1e-12)
    still = model.transition(x, u, Interval(1, 0.0, 0.0, 0.0))
    assert_array_equal(still, x)
    assert not one(x, u, Interval(1, 0.0, 0.0, 0.0)).any()


@pytest.mark.parametrize(("use", "enters"), [
    (["position", "speed", "radar"], [0.125, 0.5, 0.0]),
    (["position", "wheel-a", "radar"], [0.125, 0.5, 0.125, 0.0, 0.0])])
def test_a_disturbance_moves_the_train_and_what_it_travelled_not_scales(use: list[str], enters: list[float]) -> None:
    setting = load("ningbo-metro", {"sensors.use": use}, only="white").setting("white")
    gain = setting.extras({})["disturbance"][0].gain
    assert callable(gain) and gain(Interval(1, 0.5, 0.5)).tolist() == [[value] for value in enters]


def test_the_augmented_filter_is_scored_on_the_settings_own_states_and_beats_white_noise():
    """A constant disturbance, which white noise is not: the speed's RMSE falls to less than half."""
    setting = load("ningbo-metro").setting("constant")
    world = setting.world(Streams(3, "ningbo-metro", "constant", range(6)))
    found = {}
    for name, augment in (("white", {}), ("state", {"disturbance": Augment(sd=0.0866)})):
        estimator, model = prepare(setting, estimators()["ekf"], {}, {}, world.initial_mean,
                                   augment=augment)
        estimator.start(model, 6, Streams(3, "ningbo-metro", "constant", range(6))("estimator", "x"))
        driven = drive(setting, world, estimator, model, Streams(3, "n", "c", range(6))("estimator", "x"))
        assert not driven.scored.status.any() and driven.scored.nees_states == 2
        found[name] = driven.scored.metrics["rmse", "speed"].mean()
    assert found["state"] < 0.5 * found["white"]


def test_entries_ask_for_extra_states_and_mistakes_are_told(railstate):
    assert load("ningbo-metro").setting("switching").chosen({}, {"disturbance": Augment(sd=0.05)})[0].sd == 0.05
    for overrides, message in (
            ({"estimators.ekf.augment.wind.sd": 1.0}, "estimators.ekf.augment.wind: there is no such extra state here; "
             "allowed: disturbance, position-bias, speed-bias"),
            ({"estimators.ekf.augment.disturbance.kind": "walk"}, "needs a start_sd in m/s^2"),
            ({"estimators.ekf.augment.disturbance.sdd": 1}, "estimators.ekf.augment.disturbance.sdd")):
        with pytest.raises(InputError, match=re.escape(message)):
            load("ningbo-metro", overrides)
    plain, own = (make_plan(["ningbo-metro/switching"], only=["ekf"], runs=2, overrides=asked).configuration()
                  for asked in ({}, {"estimators.ekf.augment.disturbance.sd": 0.05}))
    assert plain != own
    assert "augment" not in plain["cells"]["ningbo-metro/switching"]["estimators"]["ekf"]
    railstate("run", "ningbo-metro/switching", "--estimators", "ekf", "--runs", 2, "--out", "found", "--jobs", 1,
              "--set", "estimators.ekf.augment.disturbance.sd=0.0866")
    assert "bit-identical" in railstate("replay", "ningbo-metro/switching/ekf/1", "--out", "found").out
    shown = railstate("show", "cbtc-csma").out
    assert "Extra states" in shown and "delta_i" in shown


def test_who_needs_what_an_augmented_model_lost_refuses():
    setting = load("cbtc-csma").setting("uniform")
    with pytest.raises(Unsupported, match="bounds"):
        prepare(setting, estimators()["ultimate-bound"], {}, {}, np.zeros((12, 1)), augment={"force": Augment()})
