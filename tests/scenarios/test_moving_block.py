"""The moving-block setting in closed loop: against plain loops, its bands, and what must not depend on the batch."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
import pytest
from railstate.benchmarks.running.drive import Driven, drive, prepare
from railstate.estimators.registry import estimators
from railstate.scenarios.files import load
from railstate.scenarios.moving_block.setting import MovingBlock
from railstate.scenarios.moving_block.trains import TwoTrains
from railstate.scenarios.randomness import Streams

from ..models import heard, part

LABELS = ("truth", "dead-reckoning", "ekf", "ukf", "ukf-printed", "ckf", "particle")
FILTERS = ("ekf", "ukf", "ckf")


def run(variant: str, label: str, runs: tuple[int, ...], changes: Mapping[str, Any] | None = None,
        ) -> tuple[Driven, TwoTrains]:
    """Drive one of the scenario's estimators through some runs of a variant."""
    setting = load("moving-block", changes).setting(variant)
    entry = setting.config.estimators[label]
    streams = Streams(1, "moving-block", variant, runs)
    world = setting.world(streams)
    parameters = {**entry.parameters, "particles": 50} if label == "particle" else entry.parameters
    estimator, model = prepare(setting, estimators()[entry.plugin], parameters, entry.knowledge, world.initial_mean)
    driven = drive(setting, world, estimator, model, streams("estimator", label))
    assert isinstance(world, TwoTrains)
    return driven, world


@cache
def hundred(variant: str, label: str) -> tuple[Driven, TwoTrains]:
    """The page's 100 runs."""
    driven, world = run(variant, label, tuple(range(100)))
    assert not driven.scored.status.any()
    return driven, world


def outcome(driven: Driven, metric: str, quantity: str) -> np.ndarray:
    return next(value for key, value in driven.outcomes.items() if key[:2] == (metric, quantity))


def mean_cm(driven: Driven, metric: str, quantity: str) -> float:
    source = driven.scored.metrics.get((metric, quantity))
    return 100 * float(np.mean(outcome(driven, metric, quantity) if source is None else source))


# -- against plain loops ------------------------------------------------------------------------------------------

def plain_loop(law: str, fixed: bool) -> tuple[list[list[float]], list[float]]:
    """Both trains without any noise, control fed by the truth, in plain Python and centimetres."""
    beta, m, phi = (160.0, 0.0, (math.sqrt(5) - 1) / 2) if law == "p" else (200.0, 3.0, (math.sqrt(5) - 1) / 2)
    lap, dt = 180 + 100 * math.pi, 0.05
    stops = [[lap / 3, lap, lap + lap / 3, 2 * lap], [2 * lap / 3, lap + 2 * lap / 3]]
    s, v, goal = [0.0, -54.0], [0.0, 0.0], [lap, lap - 54.0]
    dwell, at, done, tails, way = [0, 0], [0, 0], [0.0, 0.0], [], []

    def allowed(distance: float, speed: float) -> float:
        r = distance - speed * dt / 2
        return beta * (-dt / 2 + math.sqrt(dt * dt / 4 + 2 * r / beta)) if r > 0 else 0.0

    for k in range(600):
        done = [t or (k * dt if s[i] >= goal[i] - 1.5 else 0.0) for i, t in enumerate(done)]
        if all(done):
            break
        tails.append(s[0] - 27)
        new = []
        for i in range(2):
            if dwell[i] == 0 and v[i] == 0 and stops[i][at[i]] - s[i] < 1.5:
                dwell[i] = 11
            if dwell[i] > 0:
                dwell[i] -= 1
                if dwell[i] == 0:
                    at[i] += 1
            if dwell[i] > 0:
                new.append(0.0)
                continue
            a, top = beta, 40.0 if fixed else 120.0
            if i == 1 and not fixed:
                g, lead = s[0] - 27 - s[1], v[0]
                a = phi * beta
                if g <= 27 + m + v[1] ** 2 / (2 * beta) + 2 * v[1] * dt:
                    match = beta * (v[1] - lead) / v[1] if v[1] else 0.0
                    a = -min(max(match, -phi * beta), 1.5 * beta)
                    need = v[1] ** 2 / (2 * max(g - 27 - m - v[1] * dt / 2, 0.05))
                    if law == "r" and need > beta:
                        a = -min(max(need, match), 1.5 * beta)
                    if g <= 27 + m:
                        a = -beta if law == "p" else -1.5 * beta
            wanted = min(v[i] + a * dt, top, allowed(stops[i][at[i]] - s[i], v[i]))
            if i == 1 and fixed:
                block = math.floor((tails[max(k - 13, 0)] - 5) / (lap / 3))
                wanted = min(wanted, allowed(block * lap / 3 + 5 - s[1], v[1]))
            new.append(max(wanted, v[i] - 1.5 * beta * dt, 0.0))
        for i in range(2):
            s[i] += (v[i] + new[i]) / 2 * dt
            v[i] = new[i]
        way.append(list(s))
    return way, done


QUIET = {"sensors.start_sd": 0.0, "sensors.encoder.bias_mean": 0.0, "sensors.encoder.bias_sd": 0.0,
         "sensors.encoder.noise_sd": 0.0, "sensors.tags.sd": 0.0}


@pytest.mark.parametrize("law", ["p", "r"])
@pytest.mark.parametrize("fixed", [False, True])
def test_without_noise_the_loop_is_the_plain_one(law: str, fixed: bool) -> None:
    _, world = run(f"law-{law}-fixed-block" if fixed else f"law-{law}", "truth", (0,), QUIET)
    way, done = plain_loop(law, fixed)
    assert len(way) == world.records.driven[0]
    mine = np.stack([world.extra["s-a"][:len(way), 0], world.extra["s-b"][:len(way), 0]], axis=1)
    np.testing.assert_allclose(mine * 100, way, rtol=0, atol=1e-6)
    np.testing.assert_allclose(world.lap_times[:, 0], done, atol=1e-9)


def textbook_step(setting: MovingBlock, x: np.ndarray, p: np.ndarray, distance: float) -> tuple[np.ndarray, np.ndarray]:
    """One train's prediction with two states, Jacobian by differences."""
    def f(point: np.ndarray) -> np.ndarray:
        s = setting.track.arc_lengths(point[:1], point[1:])
        heading = setting.track.points(s + distance / 2)[2][0]
        return point + distance * np.array([math.cos(heading), math.sin(heading)])

    jacobian = np.stack([(f(x + h) - f(x - h)) / 2e-6 for h in 1e-6 * np.eye(2)], axis=1)
    return f(x), jacobian @ p @ jacobian.T + 3.73e-4 * distance * np.eye(2)


def test_one_state_of_both_trains_is_two_filters() -> None:
    """The generic filter on four states equals a textbook filter of two states for each train, readings in order."""
    setting = load("moving-block").setting("law-r")
    assert isinstance(setting, MovingBlock)
    streams = Streams(1, "moving-block", "law-r", (4,))
    world = setting.world(streams)
    estimator, model = prepare(setting, estimators()["ekf"], {}, {}, world.initial_mean)
    estimator.start(model, 1, streams("estimator", "ekf"))
    means = [world.initial_mean[i:i + 2, 0].copy() for i in (0, 2)]
    covariances = [9e-6 * np.eye(2) for _ in range(2)]
    readings, mean = 0, estimator.estimate().mean
    for k in range(80):
        step = world.step(k, mean)
        for event in step.events:
            estimator.predict(step.u, part(k, event.share, world.period))
            estimator.update(heard(event.y, event.received, k))
            share = float(np.broadcast_to(event.share, 1)[0])
            for i in range(2):
                x, p = textbook_step(setting, means[i], covariances[i], share * step.u[i, 0])
                if event.received[2 * i, 0]:
                    gain = p @ np.linalg.inv(p + 6.4e-5 * np.eye(2))
                    x, p = x + gain @ (event.y[2 * i:2 * i + 2, 0] - x), (np.eye(2) - gain) @ p
                    readings += 1
                means[i], covariances[i] = x, p
        mean = estimator.estimate().mean
        np.testing.assert_allclose(mean[:, 0], np.concatenate(means), rtol=0, atol=1e-7)
    covariance = estimator.estimate().covariance
    assert covariance is not None
    for i in range(2):
        block = covariance[2 * i:2 * i + 2, 2 * i:2 * i + 2, 0]
        np.testing.assert_allclose(block, covariances[i], rtol=1e-4, atol=1e-10)
    assert not covariance[:2, 2:].any()
    assert readings >= 10


# -- the batch changes nothing ------------------------------------------------------------------------------------

@pytest.mark.parametrize("label", LABELS)
def test_a_run_is_the_same_in_any_batch(label: str) -> None:
    """Bit for bit: other runs' readings split a run's steps without changing them."""
    together, world = run("law-r-missed-tags", label, tuple(range(7)))
    alone, single = run("law-r-missed-tags", label, (3,))
    for name, values in single.extra.items():
        assert np.array_equal(values[:, 0], world.extra[name][:, 3], equal_nan=True), name
    for key, value in alone.scored.metrics.items():
        assert value[0] == together.scored.metrics[key][3], key
    for key, value in alone.outcomes.items():
        assert np.array_equal(value[0], together.outcomes[key][3], equal_nan=True), key


# -- sensors ------------------------------------------------------------------------------------------------------

def test_encoder_and_tags_are_what_the_file_says() -> None:
    """Bias 2.4 % +- 0.6 %, a reading per tag passed at the tag's place +- 0.8 cm, shares adding up to the step."""
    setting = load("moving-block").setting("law-r")
    runs = 60
    world = setting.world(Streams(5, "moving-block", "law-r", tuple(range(runs))))
    assert isinstance(world, TwoTrains)
    mean = world.initial_mean
    measured, off, seen = np.zeros((2, runs)), [], np.zeros((2, runs))
    before = world.memory.s.copy()
    for k in range(world.steps):
        step = world.step(k, mean)
        if not step.active.any():
            break
        measured += step.u
        at, total = np.zeros(runs), np.zeros(runs)
        for event in step.events:
            total += event.share
            at = at + event.share
            for i in range(2):
                heard = event.received[2 * i]
                assert np.array_equal(heard, event.received[2 * i + 1])
                tag = setting.track.arc_lengths(event.y[2 * i][heard], event.y[2 * i + 1][heard])
                place = (before[i] + at * (world.memory.s[i] - before[i]))[heard] - tag
                off.extend(place - setting.track.length * np.round(place / setting.track.length))
                seen[i] += heard
        np.testing.assert_allclose(total, 1.0, atol=1e-12)
        assert np.abs(step.u / 0.003 - np.round(step.u / 0.003)).max() < 1e-6
        before, mean = world.memory.s.copy(), step.truth
    travelled = world.memory.s - np.array([[0.0], [-0.54]])
    relative = measured / travelled - 1
    noise = 0.006**2 + 0.03**2 * 0.05 / 4  # bias, and white noise averaged over at least four seconds of travel
    assert abs(relative.mean() - 0.024) < 4 * math.sqrt(noise / relative.size)
    assert abs(np.std(off) - 0.008) < 4 * 0.008 / math.sqrt(2 * len(off))
    assert abs(np.mean(off)) < 4 * 0.008 / math.sqrt(len(off))
    spacing = setting.track.length / 12
    for i, start in enumerate((0.0, -0.54)):
        passed = np.floor(world.memory.s[i] / spacing - 0.5) - np.floor(start / spacing - 0.5)
        assert np.abs(seen[i] - passed).max() <= 1  # a nose that rests within a reading error of a tag
        assert (seen[i] == passed).mean() > 0.9


def test_missed_tags_are_missed_at_their_rate() -> None:
    world = load("moving-block").setting("law-r-missed-tags").world(
        Streams(1, "moving-block", "law-r-missed-tags", tuple(range(50))))
    assert isinstance(world, TwoTrains)
    missed = 1 - world.read.mean()
    assert abs(missed - 0.3) < 4 * math.sqrt(0.3 * 0.7 / world.read.size)


def test_random_access_lets_one_train_report_its_tags() -> None:
    """One train's reader transmits each step: half of the readings are lost, and the errors grow."""
    access = {"kind": "random-access", "p": [0.5, 0.5], "nodes": [[0, 1], [2, 3]]}
    errors = []
    for changes in ({}, {"channel": access}):
        setting = load("moving-block", changes).setting("law-r")
        streams = Streams(1, "moving-block", "law-r", tuple(range(30)))
        world = setting.world(streams)
        if changes:
            assert (world.heard.reshape(-1, 2, 2, 30).all(axis=2).sum(axis=1) == 1).all()
        estimator, model = prepare(setting, estimators()["ekf"], {}, {}, world.initial_mean)
        errors.append(drive(setting, world, estimator, model, streams("estimator", "ekf")).scored.metrics["rmse", "x"])
    assert errors[1].mean() > 1.2 * errors[0].mean()


# -- scoring ------------------------------------------------------------------------------------------------------

def test_each_train_is_scored_until_its_own_lap_is_done() -> None:
    driven, world = hundred("law-p", "ekf")
    time = np.arange(1, world.steps + 1)[:, None] * 0.05
    for axis in "xy":
        squared, count, own = np.zeros(100), np.zeros(100), []
        for i, train in enumerate("ab"):
            error = world.extra[f"estimate-{axis}-{train}"] - world.extra[f"{axis}-{train}"]
            counted = time <= world.lap_times[i] + 1e-9
            squared += np.where(counted, error**2, 0.0).sum(axis=0)
            count += counted.sum(axis=0)
            own.append(np.sqrt(np.where(counted, error**2, 0.0).sum(axis=0) / counted.sum(axis=0)))
        np.testing.assert_allclose(driven.scored.metrics["rmse", axis], np.sqrt(squared / count), rtol=1e-9)
        np.testing.assert_allclose(outcome(driven, "rmse-per-train", axis), np.mean(own, axis=0), rtol=1e-9)


def test_outcomes_follow_from_the_gap() -> None:
    driven, world = hundred("law-p", "truth")
    gap = world.extra["gap"]
    np.testing.assert_allclose(outcome(driven, "mean", "gap"), np.nanmean(gap, axis=0), rtol=1e-9)
    np.testing.assert_array_equal(outcome(driven, "min", "gap"), np.nanmin(gap, axis=0))
    np.testing.assert_array_equal(outcome(driven, "violations", "gap"), np.nanmin(gap, axis=0) < 0.27 - 1e-9)
    np.testing.assert_allclose(outcome(driven, "mean", "lap"), world.lap_times.mean(axis=0))


def test_a_run_out_of_steps_has_no_lap_time() -> None:
    driven, _ = run("law-p", "truth", (0, 1), {"time.steps": 100})
    assert np.isnan(outcome(driven, "mean", "lap")).all()
    assert outcome(driven, "unfinished", "lap").tolist() == [1.0, 1.0]


# -- the bands of Table II and Figs. 10, 11 -----------------------------------------------------------------------

METRICS = pytest.mark.parametrize("metric", ["rmse", "rmse-per-train"])


@METRICS
def test_encoder_alone(metric: str) -> None:
    driven, _ = hundred("law-p", "dead-reckoning")
    assert abs(mean_cm(driven, metric, "x") - 3.9) <= 0.4
    assert abs(mean_cm(driven, metric, "y") - 5.1) <= 0.5


@METRICS
@pytest.mark.parametrize("label", FILTERS)
def test_sensor_fusion(label: str, metric: str) -> None:
    driven, _ = hundred("law-p", label)
    assert abs(mean_cm(driven, metric, "x") - 0.62) <= 0.06
    assert abs(mean_cm(driven, metric, "y") - 0.77) <= 0.06
    per_train = float(np.mean(driven.scored.metrics["nees", "state"])) / 2
    assert 0.7 <= per_train <= 1.2


def test_filters_tie() -> None:
    """Paired, x and y together: under 0.01 cm."""
    totals = {label: np.hypot(*(hundred("law-p", label)[0].scored.metrics["rmse", axis] for axis in "xy"))
              for label in FILTERS}
    for label in ("ekf", "ckf"):
        assert abs(100 * np.mean(totals[label] - totals["ukf"])) < 0.01


@pytest.mark.parametrize(("law", "gap", "reduction"), [("p", 73.5, 0.55), ("r", 75.0, 0.54)])
def test_moving_block_halves_the_gap(law: str, gap: float, reduction: float) -> None:
    moving, _ = hundred(f"law-{law}", "ukf")
    fixed, _ = hundred(f"law-{law}-fixed-block", "ukf")
    assert abs(mean_cm(moving, "mean", "gap") - gap) <= 2
    assert abs(mean_cm(fixed, "mean", "gap") - 163) <= 2
    assert abs(1 - mean_cm(moving, "mean", "gap") / mean_cm(fixed, "mean", "gap") - reduction) <= 0.015


def test_laps() -> None:
    for variant, lap, band in (("law-p", 6.9, 0.2), ("law-p-fixed-block", 15.9, 0.3)):
        driven, _ = hundred(variant, "ukf")
        assert abs(outcome(driven, "mean", "lap").mean() - lap) <= band


def test_at_equal_speed_the_laps_are_nearly_the_same() -> None:
    moving, _ = hundred("law-p", "ukf")
    fixed, _ = hundred("law-p-fixed-block-equal-speed", "ukf")
    assert abs(outcome(fixed, "mean", "lap").mean() - 7.4) <= 0.15
    assert abs(1 - mean_cm(moving, "mean", "gap") / mean_cm(fixed, "mean", "gap") - 0.535) <= 0.015


def test_law_r_keeps_the_distance() -> None:
    for label in ("truth", "ukf"):
        assert outcome(hundred("law-r", label)[0], "violations", "gap").sum() == 0
    encoder, _ = run("law-r", "dead-reckoning", tuple(range(500)))
    assert 0.02 <= outcome(encoder, "violations", "gap").mean() <= 0.06
