"""Robust filters, each against a textbook loop over scalars on one run, with missing and wild readings."""

from __future__ import annotations

import math

import numpy as np
import pytest
from railstate.estimators.registry import estimators
from railstate.scenarios.errors import InputError
from railstate.scenarios.files import load
from railstate.scenarios.measurement import Interval, Measurement
from railstate.scenarios.model import DesignModel
from railstate.scenarios.randomness import Streams
from scipy.stats import chi2

STEPS = 60
CHANNEL = {"channel.kind": "bernoulli", "channel.p": 0.9, "faults.outliers.share": 0.15}


def recorded(plugin, parameters, runs=(0, 1, 2), steps=STEPS, overrides=CHANNEL):
    """Means, covariances (K, ..), rejections, and what the estimator was told, of the metro with outliers."""
    setting = load("ningbo-metro", overrides, "gaussian").setting("gaussian")
    world = setting.world(Streams(2, "ningbo-metro", "gaussian", runs))
    model = setting.design_model({}, world.initial_mean)
    estimator = estimators()[plugin](parameters)
    estimator.require(model)
    estimator.start(model, len(runs), Streams(2, "ningbo-metro", "gaussian", runs)("estimator"))
    means, covariances, rejected = [], [], []
    for k in range(steps):
        step = world.step(k, world.initial_mean)
        event = step.events[0]
        estimator.predict(step.u, Interval(step.number, step.start, step.length))
        estimator.update(Measurement(event.y, event.received, step.number, 0, step.start + step.length))
        found = estimator.estimate()
        means.append(found.mean.copy())
        covariances.append(np.broadcast_to(found.covariance, (2, 2, len(runs))).copy())
        rejected.append(None if estimator.rejected is None else estimator.rejected.copy())
    return np.array(means), np.array(covariances), rejected, world, model


def loop(world, model, run, weigh, scale=1.0, finish=lambda P, square, count: P, steps=STEPS):
    """The elementwise extended Kalman filter of one run in scalars; weigh(j, e, c, r, time) -> (noise, weight, ..)."""
    x, P = model.initial_mean[:, run].copy(), scale * model.initial_covariance[:, :, 0]
    means, covariances = [], []
    for k in range(steps):
        step = world.step(k, x)
        u, interval = step.u[:, run:run + 1], Interval(step.number, step.start, step.length)
        at = x[:, None]
        F = model.transition_jacobian(at, u, interval)[:, :, 0]
        x = model.transition(at, u, interval)[:, 0]
        P = F @ P @ F.T + scale * model.process_covariance(at, u, interval)[:, :, 0]
        square, count = 0.0, 0
        for j in range(2):
            if not world.received[k, j, run]:
                continue
            r = model.measurement_covariance(Measurement(world.y[k], world.received[k], k + 1))[j, j, 0]
            h = np.eye(2)[j]
            e, c = world.y[k, j, run] - x[j], h @ P @ h
            noise, weight, after = weigh(j, e, c, r, step.start + step.length)
            K = P @ h / (c + noise)
            x = x + weight * K * e
            rest = np.eye(2) - np.outer(K, h)
            joseph = rest @ P @ rest.T + noise * np.outer(K, K)
            P = weight * joseph + (1 - weight) * P + weight * (1 - weight) * e * e * np.outer(K, K)
            square, count = square + e * e / (c + noise), count + 1
            if after:
                x, P = after(x, P)
        P = finish(P, square, count)
        means.append(x)
        covariances.append(P)
    return np.array(means), np.array(covariances)


def huber(j, e, c, r, time):
    size = abs(e) / math.sqrt(c + r)
    return (r if size <= 1.345 else r * size / 1.345), 1.0, None


def mcc(j, e, c, r, time):
    return r / max(math.exp(-e * e / (c + r) / 18), 1e-12), 1.0, None


def student(j, e, c, r, time):
    lam = 1.0
    for _ in range(5):
        K = c / (c + r / lam)
        lam = 4 / (3 + ((e * (1 - K)) ** 2 + (1 - K) * c) / r)
    return r / lam, 1.0, None


def gate(j, e, c, r, time):
    return r, float(e * e / (c + r) <= chi2(1).ppf(0.99)), None


def position_gate(j, e, c, r, time):
    return gate(j, e, c, r, time) if j == 0 else (r, 1.0, None)


def opens_by_time():
    """The gate that opens 0.6 s after the first of an unbroken row of rejections."""
    since = {}

    def weigh(j, e, c, r, time):
        outside = not gate(j, e, c, r, time)[1]
        opened = time - since.get(j, time) >= 0.6 - 1e-9
        since.update({j: since.get(j, time)}) if outside else since.pop(j, None)
        return r, float(opened or not outside), None

    return weigh


def soft(j, e, c, r, time):
    good = 0.95 * math.exp(-e * e / (c + r) / 2) / math.sqrt(c + r)
    wide = c + r + 400 * r
    bad = 0.05 * math.exp(-e * e / wide / 2) / math.sqrt(wide)
    return r, good / (good + bad), None


def roth(j, e, c, r, time):
    return r / 3, 1.0, None


def matched(P, square, count):
    gained = 3 + count
    return P * (3 + square) / gained * gained * 1 / ((gained - 2) * 3) if count else P


class Variational:
    def __init__(self):
        self.R = {}

    def __call__(self, j, e, c, r, time):
        R = self.R.get(j, r)
        alpha, beta = 0.98 * 25 + 0.5, 0.98 * 25 * R
        noise = (beta + R / 2) / alpha
        for _ in range(3):
            K = c / (c + noise)
            noise = (beta + ((e * (1 - K)) ** 2 + (1 - K) * c) / 2) / alpha
        self.R[j] = noise
        return noise, 1.0, None


class SageHusa(Variational):
    def __call__(self, j, e, c, r, time):
        self.R[j] = max(0.98 * self.R.get(j, r) + 0.02 * (e * e - c), 1e-3 * r)
        return self.R[j], 1.0, None


CASES = [("huber", {}, lambda: huber), ("mcc", {}, lambda: mcc), ("student-t", {}, lambda: student),
         ("gate", {"reopen": "never"}, lambda: gate),
         ("gate", {"reopen": "never", "sensors": ["position"]}, lambda: position_gate),
         ("gate", {"reopen": "time", "after": 0.6}, opens_by_time), ("soft-gate", {"reopen": "never"}, lambda: soft),
         ("adaptive-r", {}, Variational), ("adaptive-r", {"method": "sage-husa"}, SageHusa)]


@pytest.mark.parametrize(("plugin", "parameters", "weigh"), CASES)
def test_against_a_scalar_loop(plugin, parameters, weigh):
    means, covariances, _, world, model = recorded(plugin, parameters)
    for run in range(3):
        x, P = loop(world, model, run, weigh())
        np.testing.assert_allclose(means[..., run], x, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(covariances[..., run], P, rtol=1e-7, atol=1e-12)


def points(x, P):
    """Weights and points of the unscented transform with kappa = 3 - n."""
    n, columns = len(x), np.linalg.cholesky(3 * P).T
    return np.array([1 - n / 3] + [1 / 6] * (2 * n)), [x, *(x + c for c in columns), *(x - c for c in columns)]


def test_the_unscented_filter_by_correntropy_against_a_scalar_loop():
    """The metro, whose h is linear, through the points."""
    means, covariances, rejected, world, model = recorded("ukf-mcc", {})
    for run in range(3):
        x, P = model.initial_mean[:, run].copy(), model.initial_covariance[:, :, 0]
        for k in range(STEPS):
            step = world.step(k, x)
            u, interval = step.u[:, run:run + 1], Interval(step.number, step.start, step.length)
            w, X = points(x, P)
            Q = model.process_covariance(x[:, None], u, interval)[:, :, 0]
            moved = [model.transition(p[:, None], u, interval)[:, 0] for p in X]
            x = sum(a * p for a, p in zip(w, moved, strict=True))
            P = Q + sum(a * np.outer(p - x, p - x) for a, p in zip(w, moved, strict=True))
            R = model.measurement_covariance(Measurement(world.y[k], world.received[k], k + 1))[:, :, 0]
            x, P, alarms = by_points(x, P, world.y[k, :, run], world.received[k, :, run], lambda p: p, R)
            np.testing.assert_allclose(means[k, :, run], x, rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(covariances[k, ..., run], P, rtol=1e-7, atol=1e-12)
            assert rejected[k][:, run].tolist() == alarms
    assert np.array(rejected).any()


def by_points(x, P, y, received, h, R):
    """An element after the other: points drawn, weighed by exp(-nu^2 / 18), P- - K S K'."""
    alarms = [False] * len(y)
    for j in np.flatnonzero(received):
        w, X = points(x, P)
        images = [h(p)[j] for p in X]
        middle = sum(a * z for a, z in zip(w, images, strict=True))
        spread = sum(a * (z - middle) ** 2 for a, z in zip(w, images, strict=True))
        cross = sum(a * (p - x) * (z - middle) for a, p, z in zip(w, X, images, strict=True))
        # What is linear of h in the points, and what it bends, which counts as noise.
        straight = cross @ np.linalg.solve(P, cross)
        noise = R[j, j] + spread - straight
        weight = max(math.exp(-((y[j] - middle) ** 2) / (straight + noise) / 18), 1e-12)
        alarms[j] = weight < 0.5
        S = straight + noise / weight
        x, P = x + cross / S * (y[j] - middle), P - np.outer(cross, cross) / S
    return x, P, alarms


def test_correntropy_of_ranges():
    """Two ranges to a point in the plane, drawn anew for the second."""
    posts = np.array([[0.0, 0.0], [30.0, 0.0]])

    def ranges(x):
        return np.stack([np.hypot(x[0] - a, x[1] - b) for a, b in posts])

    R = np.diag([0.25, 0.25])
    model = DesignModel(
        states=("x", "y"), measurements=("a", "b"), period=1.0, transition=lambda x, u, interval: x,
        measurement=lambda x, step: ranges(x), transition_jacobian=None, measurement_jacobian=None,
        process_covariance=lambda x, u, interval: np.zeros((2, 2, 1)),
        measurement_covariance=lambda measurement: R[:, :, None], initial_mean=np.array([[10.0, 11.0], [12.0, 9.0]]),
        initial_covariance=np.array([[9.0, 2.0], [2.0, 4.0]])[:, :, None])
    y = np.array([[15.0, 16.0], [24.0, 70.0]])
    estimator = estimators()["ukf-mcc"]({})
    estimator.start(model, 2, Streams(1, "a", "b", range(2))("estimator"))
    estimator.update(Measurement(y, np.ones((2, 2), dtype=bool), 1))
    for run in range(2):
        x, P, alarms = by_points(model.initial_mean[:, run], model.initial_covariance[..., 0], y[:, run], [True, True],
                                 ranges, R)
        np.testing.assert_allclose(estimator.estimate().mean[:, run], x, rtol=1e-10)
        np.testing.assert_allclose(estimator.estimate().covariance[..., run], P, rtol=1e-9)
        assert estimator.rejected[:, run].tolist() == alarms
    assert estimator.rejected[:, 1].tolist() == [False, True]


def test_roth_against_a_scalar_loop():
    means, covariances, _, world, model = recorded("student-t-roth", {})
    for run in range(3):
        x, P = loop(world, model, run, roth, 1 / 3, matched)
        np.testing.assert_allclose(means[..., run], x, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(covariances[..., run], 3 * P, rtol=1e-7, atol=1e-12)


class Reopens:
    """The gate with the median rule: 14 of the last 20 received readings rejected, within 3 sd of their median."""

    def __init__(self):
        self.ring = {0: [], 1: []}

    def __call__(self, j, e, c, r, time):
        outside = e * e / (c + r) > chi2(1).ppf(0.99)
        ring = self.ring[j] = [*self.ring[j], e if outside else None][-20:]
        rejected = np.array([value for value in ring if value is not None])
        after = None
        if len(rejected) >= 14:
            near = rejected[np.abs(rejected - np.median(rejected)) <= 3 * math.sqrt(r)]
            if len(near) >= 14:
                ring.clear()

                def after(x, P):
                    x, P = x.copy(), P.copy()
                    x[j] += near.mean()
                    own = P[j, j] + r / len(near)
                    P[j], P[:, j] = 0.0, 0.0
                    P[j, j] = own
                    return x, P
        return r, float(not outside), after


JUMP = {"faults.jump.from": 10.0, "faults.outliers.share": 0.1, "faults.outliers.sensors": ["position"]}


def test_the_median_rule_finds_the_vehicle_again():
    means, covariances, rejected, world, model = recorded("gate", {}, steps=120, overrides=JUMP)
    for run in range(3):
        x, P = loop(world, model, run, Reopens(), steps=120)
        np.testing.assert_allclose(means[..., run], x, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(covariances[..., run], P, rtol=1e-7, atol=1e-12)
    error = np.abs(means[:, 0] - world.truth[:120, 0])
    assert (error[51:60] > 25).all() and (error[80:] < 3).all()
    assert np.array(rejected)[52:58, 0].all()
    never = recorded("gate", {"reopen": "never"}, steps=120, overrides=JUMP)
    assert (np.abs(never[0][:, 0] - world.truth[:120, 0])[80:] > 25).all()


def test_the_time_rule_opens_after_its_time_and_together():
    """Alone it opens 4 s after the first rejection; together never, while the speed sensor stays within its gate."""
    def reached(**parameters):
        opens = {"reopen": "time", "after": 4.0, **parameters}
        means, *_, world, _ = recorded("gate", opens, steps=120, overrides=JUMP)
        return np.abs(means[:, 0] - world.truth[:120, 0])

    alone, together = reached(), reached(together=("position", "speed"))
    assert (alone[51:65] > 20).all() and (alone[-10:] < 25).any()
    assert (together[60:] > 25).all()
    with pytest.raises(ValueError, match="together must be among sensors"):
        reached(sensors=["position"], together=["speed"])
    with pytest.raises(InputError, match="sensors: there is no measurement sonar; allowed: position, speed"):
        reached(sensors=["sonar"])


def test_second_order_filter_on_a_square():
    """x+ = x + c x^2, P- = F P F' + 1/2 (2 c P)^2 + Q, x- = f + c P: exact for a quadratic model."""
    c, q = 0.03, 0.1
    model = DesignModel(
        states=("x",), measurements=("x",), period=1.0, transition=lambda x, u, interval: x + c * x * x,
        measurement=lambda x, step: x, transition_jacobian=lambda x, u, interval: (1 + 2 * c * x)[None],
        measurement_jacobian=lambda x, step: np.ones((1, 1, 1)),
        process_covariance=lambda x, u, interval: np.full((1, 1, 1), q),
        measurement_covariance=lambda measurement: np.full((1, 1, 1), 0.5), initial_mean=np.array([[1.0, -2.0]]),
        initial_covariance=np.full((1, 1, 1), 2.0))
    estimator = estimators()["ekf-second-order"]({})
    estimator.start(model, 2, Streams(1, "a", "b", range(2))("estimator"))
    x, P = np.array([1.0, -2.0]), np.array([2.0, 2.0])
    for k in range(5):
        estimator.predict(np.zeros((0, 2)), Interval(k + 1, float(k), 1.0))
        P, x = (1 + 2 * c * x) ** 2 * P + 0.5 * (2 * c * P) ** 2 + q, x + c * x * x + c * P
        np.testing.assert_allclose(estimator.estimate().mean[0], x, rtol=1e-6)
        np.testing.assert_allclose(estimator.estimate().covariance[0, 0], P, rtol=1e-6)
        estimator.update(Measurement(np.zeros((1, 2)), np.ones((1, 2), dtype=bool), k + 1))
        x, P = x - P / (P + 0.5) * x, P * 0.5 / (P + 0.5)


@pytest.mark.parametrize("plugin", ["gate", "soft-gate", "huber", "mcc", "student-t", "student-t-roth", "adaptive-r",
                                    "ekf-second-order", "ukf-mcc"])
def test_a_run_is_the_same_in_any_company(plugin):
    whole, part = recorded(plugin, {}, steps=30), recorded(plugin, {}, runs=(2,), steps=30)
    np.testing.assert_array_equal(whole[0][..., 2:], part[0])
    np.testing.assert_array_equal(whole[1][..., 2:], part[1])
