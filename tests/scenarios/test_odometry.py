"""The odometry setting: a quiet trip and means of a hundred against a prototype's, sensors, events, own lines."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from railstate.benchmarks.store.folder import Store
from railstate.scenarios.files import load
from railstate.scenarios.odometry import plant
from railstate.scenarios.odometry.world import OdometryWorld
from railstate.scenarios.randomness import Streams
from railstate.scenarios.sensors.gnss import fixes
from scipy.linalg import expm

from ..conftest import Command

VARIANTS = ("dry", "wet", "wet-radar", "no-balise", "gnss-only", "missed-balises")
LOW = ((2890, 3130), (5230, 5420), (8490, 8730))
# trip s, pulses of A and B, greatest speed m/s, last balise s, wheel less train m of A and B, seconds slid
QUIET = {"quiet-dry": (707.6, 329538, 329337, 21.381, 701.3, 3.36, -2.07, 0.0, 0.0),
         "quiet-wet": (711.4, 330258, 327553, 21.381, 705.0, 22.81, -50.27, 32.1, 12.2)}


def world(variant: str, runs: int | tuple[int, ...] = 100, seed: int = 1, **overrides: object) -> OdometryWorld:
    numbers = tuple(range(runs)) if isinstance(runs, int) else runs
    setting = load("odometry", {key.replace("__", "."): value for key, value in overrides.items()}).setting(variant)
    return setting.world(Streams(seed, "odometry", variant, numbers))


def test_a_driver_keeps_under_each_lower_limit_ahead_and_stands_at_the_stop() -> None:
    """The speed wanted is the least of what may be driven here and of what leaves room to brake, metre by metre."""
    edge, top, share, braking = np.array([0.0, 300.0, 500.0, 900.0]), np.array([20.0, 25.0, 9.0, 15.0]), 0.95, 0.6
    for stop in (450.0, 1200.0):
        for s in np.arange(0.0, stop + 2.0, 0.25):
            limit = int(np.flatnonzero(edge <= s).max())
            here = share * min(top[limit], 22.0)
            ahead = [(share * top[i], edge[i] - s) for i in range(limit + 1, 4)
                     if edge[i] < stop and top[i] < top[limit]]
            wanted = min([here, (2 * braking * max(stop - s, 0.0)) ** 0.5,
                          *((v**2 + 2 * braking * room) ** 0.5 for v, room in ahead)])
            found = plant._reference.py_func(s, 0.0, share, braking, stop, edge, top, limit, 22.0)  # pyright: ignore
            assert found == pytest.approx((wanted, here), abs=1e-12)


def quiet_numbers(variant: str, **overrides: object) -> tuple[float, ...]:
    made = world(variant, 1, **overrides)
    last, ride = int(made.ride.duration[0]) - 1, made.ride
    assert all(flags.dtype == bool for flags in (ride.standing, ride.active, ride.slipping))
    pulse = np.pi * 0.86 / 100
    counts = made.u[:last + 1, 3:5, 0].sum(axis=0) / pulse
    rolled = ride.wheel[last, :, 0] - made.truth[last, 0, 0]
    return ((last + 1) * made.period, *counts, made.truth[:, 1].max(), ride.passed[-1, 0], *rolled, *ride.slides[:, 0])


@pytest.mark.parametrize("variant", QUIET)
def test_the_quiet_trip(variant: str) -> None:
    np.testing.assert_allclose(quiet_numbers(variant), QUIET[variant], rtol=0.02, atol=0.005)


def test_half_the_step_moves_the_quiet_trip_little() -> None:
    halved = quiet_numbers("quiet-wet", time__period=0.05)
    np.testing.assert_allclose(halved, QUIET["quiet-wet"], rtol=0.02, atol=0.005)


def test_a_longer_period_samples_the_same_trip() -> None:
    """The plant's own step stays 0.1 s: what is read every half second is the same trip."""
    fine, coarse = world("wet", 3), world("wet", 3, time__period=0.5)
    np.testing.assert_allclose(coarse.truth[:1400, 0], fine.truth[4:7000:5, 0], rtol=0, atol=1e-6)
    np.testing.assert_allclose(coarse.ride.passed, fine.ride.passed, rtol=0, atol=1e-6)


def test_a_hundred_trips() -> None:
    """Means within four standard errors of both sides, theirs of three hundred runs, ours of a hundred."""
    dry, wet = world("dry"), world("wet")

    def close(values: np.ndarray, expected: float) -> None:
        assert abs(values.mean() - expected) < 4 * values.std() / 10 * np.sqrt(4 / 3), (values.mean(), expected)

    close(dry.ride.duration * 0.1, 708.8)
    close(wet.ride.duration * 0.1, 712.2)
    close(wet.ride.slides[0], 31.9)
    close(wet.ride.slides[1], 11.4)
    assert not dry.ride.slides.any()
    excess = wet.ride.wheel - wet.truth[:, :1]
    for (begin, end), expected in zip(LOW, ((-23.0, -20.5), (54.5, 0.0), (-24.4, -23.2)), strict=True):
        gained = np.empty((2, 100))
        for r in range(100):
            a, b = np.searchsorted(wet.truth[:, 0, r], (begin, end + 120))
            gained[:, r] = excess[b, :, r] - excess[a, :, r]
        close(gained[0], expected[0])
        if expected[1]:
            close(gained[1], expected[1])
        else:
            assert np.abs(gained[1]).max() < 0.05


def test_variants_share_their_draws() -> None:
    """Dry and wet: the same driver, balises and sensor errors; missed balises are nested in what the others read."""
    made = {variant: world(variant, 5) for variant in VARIANTS}
    dry, wet = made["dry"], made["wet"]
    stop = int(np.argmax(dry.truth[:, 0, 0] > 1400))  # before the first stop a wet rail outside tunnels has more creep
    np.testing.assert_allclose(dry.truth[:stop, 0], wet.truth[:stop, 0], rtol=0, atol=0.5)
    for other in made.values():
        np.testing.assert_array_equal(other.passages.told, dry.passages.told)
        np.testing.assert_array_equal(other.truth[0, [2, 4, 5]], dry.truth[0, [2, 4, 5]])
    missed = made["missed-balises"].passages.read
    assert missed[0].all() and not (missed & ~wet.passages.read).any()
    assert abs((~missed[1:]).mean() - 0.4) < 4 * np.sqrt(0.24 / missed[1:].size)
    np.testing.assert_array_equal(made["no-balise"].passages.read.sum(axis=0), 1)
    np.testing.assert_array_equal(made["gnss-only"].truth[:, :2], wet.truth[:, :2])


def test_a_run_is_the_same_in_any_batch() -> None:
    many, few = world("gnss-only", 6), world("gnss-only", (4, 2))
    for name in ("truth", "u", "y", "received", "variance", "active", "reference"):
        np.testing.assert_array_equal(getattr(few, name), getattr(many, name)[..., [4, 2]])
    for k in (200, *few.readings):
        mine, theirs = few.step(k, few.initial_mean), many.step(k, many.initial_mean)
        heard = [sum(int(event.received[2, run]) for event in step.events) for step, run in ((mine, 0), (theirs, 4))]
        assert heard[0] == heard[1]


def test_balises_are_events_inside_their_steps() -> None:
    made = world("wet", 4)
    heard = np.zeros((13, 4))
    for k in made.readings:
        step = made.step(k, made.initial_mean)
        gone = np.zeros(4)
        for event in step.events[:-1]:
            gone = gone + event.share
            got = event.received[2]
            assert not event.received[:2].any() and event.covariance is not None
            for run in np.flatnonzero(got):
                balise = int(np.argmin(np.abs(made.passages.told[:, run] - event.y[2, run])))
                heard[balise, run] += 1
                assert step.start + gone[run] * 0.1 == pytest.approx(made.ride.passed[balise, run], abs=1e-9)
                sd = 0.05 if balise == 12 else 0.4
                assert event.covariance[2, 2, run] == pytest.approx(sd**2 + 0.13**2)
                assert made.reference[k, 1, run] == made.passages.place[balise, run]
        np.testing.assert_allclose(gone + step.events[-1].share, 1.0, rtol=0, atol=1e-15)
        assert not step.events[-1].received[2].any()
    np.testing.assert_array_equal(heard, made.passages.read)
    # a balise is read within the reader's error of its place
    off = made.ride.place - made.passages.place
    assert np.abs(off).max() <= 0.2 + 0.5 * (3.6 * 22.2 - 40) / 460 and off.std() > 0.1


def test_two_balises_of_one_run_in_one_step() -> None:
    """Shares of the step are those since the event before, of each run by itself."""
    world: Any = SimpleNamespace(
        y=np.zeros((5, 2, 3)), variance=np.full((5, 2, 3), 4.0), balise=1, _events={},
        passages=SimpleNamespace(told=100.0 + np.arange(9.0).reshape(3, 3)), balise_variance=np.array([1.0, 2.0, 3.0]),
        readings={1: [(np.array([0, 2]), np.array([0.25, 0.5]), np.array([0, 1])),
                      (np.array([0]), np.array([0.75]), np.array([2]))]})
    assert OdometryWorld._inside(world, 0) == ((), 0.0)
    (first, second), gone = OdometryWorld._inside(world, 1)
    assert first.share.tolist() == [0.25, 0.0, 0.5] and second.share.tolist() == [0.5, 0.0, 0.0]
    assert gone.tolist() == [0.75, 0.0, 0.5]
    assert first.y.tolist() == [[0, 0, 0], [100.0, 0, 105.0]] and second.y.tolist() == [[0, 0, 0], [106.0, 0, 0]]
    assert first.received.tolist() == [[False] * 3, [True, False, True]]
    assert second.received.tolist() == [[False] * 3, [True, False, False]]
    for event, told in ((first, [1.0, 4.0, 2.0]), (second, [3.0, 4.0, 4.0])):
        assert event.covariance[0, 0].tolist() == [4.0] * 3 and event.covariance[1, 1].tolist() == told
        assert not event.covariance[0, 1].any() and not event.covariance[1, 0].any()
    assert OdometryWorld._inside(world, 1) is world._events[1]


def test_what_sensors_tell() -> None:
    made = world("wet-radar", 20)
    moving = made.active & (made.truth[:, 1] > 3)
    names = ("wheel-a", "wheel-b", "balise", "radar")
    assert names == load("odometry").setting("wet-radar").config.sensors.measured
    radar = (made.y[:, 3] - made.truth[:, 1] * (1 + made.truth[:, 6]))[moving]
    assert abs(radar.std() - 0.15) < 4 * 0.15 / np.sqrt(2 * len(radar)) and made.received[:, 3][moving].all()
    assert not made.received[:, 3][made.truth[:, 1] < 1.99].any()
    still = made.ride.standing & (made.u[:, 3] == 0)
    assert set(np.unique(made.variance[:, 0][still]).round(10)) == {4e-6, round((np.pi * 0.0086) ** 2 / 6, 10)}
    # the accelerometer reads acceleration and gradient
    off = made.u[:, 0] - made.ride.acceleration - made.truth[:, 2]
    flat = (made.truth[:, 0] < 790) & made.active
    assert abs(off[flat].std() - 0.05) < 0.003


def test_satellites_are_silent_in_tunnels_and_jump() -> None:
    made = world("gnss-only", 50)
    got, position = made.received[:, 3], made.truth[:, 0]
    inside = ((position > 1880) & (position < 2700)) | ((position > 5880) & (position < 7000))
    assert not got[inside].any()
    assert got[9::10][~inside[9::10] & made.active[9::10]].all() and got.sum() == got[9::10].sum()
    error = (made.y[:, 3] - position)[got & made.active]
    calm = np.abs(error) < 8
    assert abs(error[calm].std() - np.sqrt(5)) < 0.25
    assert 0.01 < (~calm).mean() < 0.06  # jumps of 25 m, four in a thousand fixes, ten seconds each


def test_fixes_come_at_steps_ends() -> None:
    np.testing.assert_array_equal(fixes(1.0, 0.1, 35), [9, 19, 29])
    np.testing.assert_array_equal(fixes(1.0, 0.3, 10), [3, 6, 9])
    np.testing.assert_array_equal(fixes(1.0, 2.0, 3), [0, 1, 2])


WET = {"dr-powered": (15.3, 0.761), "dr-trailer": (7.72, 0.530), "dr-minmax": (6.20, 0.432), "ekf-scale": (21.2, 0.750),
       "imm-slip": (1.20, 0.0592)}
"""A prototype's RMSE of three hundred runs on the wet rail, position m and speed m/s."""


@pytest.mark.long
def test_estimators_on_a_wet_rail(railstate: Command) -> None:
    """RMSE within four standard errors of both sides. Slides raise dead reckoning and the filter without slip over the
    allowance; slip modes stay under it, so does the gate that opens when both axles are rejected, not each on its own.
    """
    gated = ("ekf-gated", "ekf-gated-both")
    done = railstate("run", "odometry/wet", "--runs", 100, "--estimators", ",".join((*WET, *gated)), "--out", "out")
    assert done.code == 0 and "700 ok" in done.out, done.err
    rows = Store("out").rows()
    for name, expected in WET.items():
        for column, value in zip(("rmse:position:m", "rmse:speed:m/s"), expected, strict=True):
            squares = rows[rows["estimator"] == name][column] ** 2
            rmse = np.sqrt(squares.mean())
            assert abs(rmse - value) < 4 * squares.std() / (20 * rmse) * np.sqrt(4 / 3), (name, column, rmse)
    use = rows.groupby("estimator")["use:odometry:1"]
    worst, over = use.max(), use.apply(lambda used: (used > 1).mean())
    assert worst["imm-slip"] < 0.4 and worst["ekf-gated-both"] < 0.4
    assert over["dr-powered"] == over["ekf-scale"] == 1 and over["dr-trailer"] > 0.4
    assert 0 < over["ekf-gated"] < 0.2


@pytest.mark.long
@pytest.mark.parametrize("variant", ["matched", "matched-fine"])
def test_a_filter_told_the_truth_misses_no_more_than_it_claims(railstate: Command, variant: str) -> None:
    """Shares of the steps outside three standard deviations of the position, within 3 of their standard errors of the
    nominal .27 % or under it; the counter's steps only make the filter too cautious."""
    done = railstate("run", f"odometry/{variant}", "--estimators", "ekf-scale", "--runs", 400, "--out", "out")
    assert done.code == 0, done.err
    missed = 1 - Store("out").rows()["inside:confidence:1"]
    assert missed.mean() < 0.0027 + 3 * missed.std() / 20
    if variant == "matched-fine":
        assert missed.mean() > 0.0027 - 3 * missed.std() / 20


def test_a_line_and_a_train_of_one_s_own(railstate: Command) -> None:
    line = {"stops": {"unit": "m", "values": [0, 1200, 2500]},
            "speed limits": {"units": {"position": "m", "velocity": "km/h"},
                             "values": [[0, 70], [700, 50], [1500, 80]]},
            "gradients": {"units": {"position": "m", "slope": "permil"}, "values": [[0, 0], [600, 10], [1800, -8]]}}
    train = {"mass": {"unit": "t", "value": 120}, "rho": {"unit": "%", "value": 6},
             "max speed": {"unit": "km/h", "value": 90}, "max acceleration": {"unit": "m/s^2", "value": 1.0},
             "max deceleration": {"unit": "m/s^2", "value": 1.2}, "max traction force": {"unit": "kN", "value": 120},
             "max traction power": {"unit": "kW", "value": 1500}, "max reg braking force": {"unit": "kN", "value": 90},
             "max reg braking power": {"unit": "kW", "value": 1800},
             "max pn braking force": {"unit": "kN", "value": 80},
             "rolling resistance r0": {"unit": "kN", "value": 2.0},
             "rolling resistance r1": {"unit": "kN/(km/h)", "value": 0.01},
             "rolling resistance r2": {"unit": "kN/(km/h)^2", "value": 0.0005}}
    Path("track.json").write_text(json.dumps(line))
    Path("train.json").write_text(json.dumps(train))
    done = railstate("run", "odometry/wet", "--line", "track.json", "--train", "train.json", "--runs", 3,
                     "--estimators", "dr-minmax,dr-trailer", "--out", "out")
    assert done.code == 0 and "6 ok" in done.out, done.err
    setting = load("odometry", {"plant.line": "track.json", "plant.train": "train.json"}).setting("wet")
    made = setting.world(Streams(1, "odometry", "wet", range(3)))
    last = made.active.sum(axis=0) - 1
    assert np.abs(made.truth[last, 0, range(3)] - 2500).max() < 2.0
    assert setting.config.plant.places[-1] == 2485.0 and setting.config.plant.platforms == [1185.0, 2485.0]
    assert made.ride.slides.sum() > 0
    limit = setting.config.plant.line.limit(made.truth[:, 0])
    assert (made.truth[:, 1] <= limit + 0.5).all()


@pytest.mark.parametrize(("override", "expected"), [
    ("plant.balises.positions=[10, 5]", "plant.balises"),
    ("plant.balises.every=500", "either positions = [..] or every"),
    ("plant.tunnels=[[5, 2]]", "tunnels = [[from, to], ..] needs stretches in order"),
    ("plant.driver.asked=[-0.5, 0.8]", "asked[0] = -0.5 must be under -0.85"),
    ("plant.line.gradients=[[0, 0.15]]", "cannot climb 150.0 per mille from 0 m on"),
    ("plant.adhesion.friction=[0.3, 0.1]", "plant.adhesion.friction"),
    ("sensors.use=[\"sonar\"]", "sensors.use.0"),
    ("knowledge.motion=sonar", "knowledge.motion"),
])
def test_bad_files_are_one_message(railstate: Command, override: str, expected: str) -> None:
    done = railstate("run", "odometry/dry", "--set", override, "--runs", 1, "--out", "out")
    assert done.code == 2 and expected in done.err and "Traceback" not in done.err, done.err


def test_slip_comes_and_goes_at_its_rates() -> None:
    """Over a step of each axle's chain, exactly; the axles know nothing of each other."""
    setting = load("odometry", {"knowledge.slip": {"enter": 0.4, "leave": 1.5, "sd": 10.0}}).setting("wet")
    modes = setting.design_model({}, np.zeros((2, 1))).modes
    axle = expm(np.array([[-0.4, 0.4], [1.5, -1.5]]) * setting.config.time.period)
    assert modes is not None and [mode.name for mode in modes.modes] == ["no slip", "slip of b", "slip of a",
                                                                         "slip of a and b"]
    np.testing.assert_allclose(modes.transition, np.kron(axle, axle), rtol=1e-12)
    assert modes.prior.tolist() == [1.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize("least", [10, 9000])
def test_a_world_lasts_a_twentieth_longer_than_the_slowest_trip(least: int) -> None:
    driver = {"plant__driver__courage": [0.9, 0.9], "plant__driver__braking": [0.6, 0.6],
              "plant__driver__dwell": [20.0, 20.0]}
    made = world("dry", 2, time__steps=least, **driver)
    trip = made.ride.active.sum(axis=0)
    assert trip[0] == trip[1] and made.steps == max(least, int(np.ceil(1.05 * trip[0])))
