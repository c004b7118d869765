"""The recorded setting on small recordings made here: units, gaps, outages, the kinematic model, what odometers do."""

from __future__ import annotations

from math import erf

import numpy as np
import pandas as pd
import pytest
from railstate.benchmarks.running.drive import drive, prepare
from railstate.estimators.registry import estimators
from railstate.scenarios.errors import InputError, Unsupported
from railstate.scenarios.files import load
from railstate.scenarios.measurement import Interval, untold
from railstate.scenarios.randomness import Streams
from railstate.scenarios.world import step_times

MAP = {"time": "t_s", "position": "gnss_m", "speed": "v_kmh", "odometer": "odo_m", "reference_position": "s_km",
       "reference_speed": "v_mps"}
SCALE = 0.968


def over(length: float | np.ndarray) -> Interval:
    """A whole step of so many seconds."""
    return Interval(1, 0.0, length)


def trip():
    """A hop of 900 m in 100 s, irregularly sampled; an odometer 3.2 % short in steps of 5 m; GNSS with 2 m of noise."""
    rng = np.random.default_rng(5)
    t = np.concatenate([[0.0], np.cumsum(rng.uniform(0.5, 1.5, 100))])
    t = np.delete(t, [40, 41, 42])  # a gap
    z = (t - t[-1] / 2) / (t[-1] / 5)
    s = 450 * (1 + np.vectorize(erf)(z))
    v = 900 / np.pi**0.5 * np.exp(-z**2) / (t[-1] / 5)
    return pd.DataFrame({"t_s": t, "s_km": s / 1e3, "v_mps": v, "gnss_m": s + rng.normal(0, 2, len(t)),
                         "v_kmh": 3.6 * (v + rng.normal(0, 0.1, len(t))), "odo_m": 5 * np.floor(SCALE * s / 5) + 100})


@pytest.fixture
def recording(tmp_path):
    trip().to_csv(tmp_path / "trip.csv", index=False)
    return str(tmp_path / "trip.csv")


def setting(recording, variant="outage", columns=MAP, **overrides):
    changes = {"plant.recording": recording, "plant.map": columns, "sensors.odometer_step": 5.0, **overrides}
    return load("recorded", changes).setting(variant)


def run(chosen, label, runs=10, variant="outage"):
    streams = Streams(1, "recorded", variant, range(runs))
    world, entry = chosen.world(streams), chosen.config.estimators[label]
    plugin = estimators()[entry.plugin]
    estimator, model = prepare(chosen, plugin, entry.parameters, entry.knowledge, world.initial_mean)
    estimator.design(model)
    return world, model, drive(chosen, world, estimator, model, streams("estimator", label))


LABELS = ("dead-reckoning", "kalman", "ekf", "ukf", "ckf", "robust-mean-square")


def test_estimators_of_the_page_are_listed():
    entries = load("recorded").setting("outage").config.estimators
    assert tuple(label for label, entry in entries.items() if entry.default) == LABELS


def test_units_intervals_and_readings_come_through(recording):
    table, w = trip(), setting(recording, "as-recorded").world(Streams(1, "recorded", "as-recorded", range(2)))
    assert w.lengths == pytest.approx(np.diff(table.t_s), rel=1e-9)
    assert w.truth[:, 0, 1] == pytest.approx(1e3 * table.s_km[1:], abs=1e-9)
    assert w.truth[:, 1, 0] == pytest.approx(table.v_mps[1:], abs=1e-9)
    assert w.y[:, 0, 0] == pytest.approx(table.gnss_m[1:], abs=1e-9)
    assert w.y[:, 1, 0] == pytest.approx(table.v_kmh[1:] / 3.6, abs=1e-9)
    # the odometer counts from the first position reading; half a step is what it lags on average
    assert w.y[:, 2, 0] == pytest.approx(table.gnss_m[0] + table.odo_m[1:] - table.odo_m[0] + 2.5, abs=1e-9)
    assert w.u[:, 0].sum(0) == pytest.approx(table.odo_m.iloc[-1] - table.odo_m[0])
    assert w.received.all() and w.active.all()
    assert w.truth.shape[1] == 2  # shortfall and excess are the model's own, and neither told nor scored


def test_parquet_explicit_units_and_missing_readings(tmp_path):
    table = trip().rename(columns={"v_kmh": "v"})
    table.loc[10:14, "gnss_m"] = np.nan
    table.loc[20, "odo_m"] = np.nan
    table.to_parquet(tmp_path / "trip.parquet")
    chosen = setting(str(tmp_path / "trip.parquet"), "as-recorded", {**MAP, "speed": "v [km/h]"})
    w = chosen.world(Streams(1, "recorded", "as-recorded", [0]))
    missing = np.ones((len(table) - 1, 3), dtype=bool)
    missing[9:14, 0], missing[19, 2] = False, False
    assert np.array_equal(w.received[..., 0], missing)
    assert np.isfinite(w.y).all() and np.isfinite(w.u).all()
    assert w.u[19, 0, 0] == 0 and w.u[20, 0, 0] == table.odo_m[21] - table.odo_m[19]


def test_outages_where_they_belong(recording):
    sweep = setting(recording, "sweep", **{"sensors.outage.duration": 20.0})
    time = trip().t_s.to_numpy()[1:]
    placements = sum(time <= time[-1] - 20.0)
    begun = sweep.outcomes(sweep.world(Streams(1, "recorded", "sweep", range(placements))), {})["begin", "outage", "s"]
    places = np.searchsorted(time, begun + trip().t_s[0] - 1e-9)
    assert sorted(places) == list(range(placements))  # each once
    for few in (5, 13):
        assert np.diff(np.sort(places[:few]), prepend=0, append=placements).max() < 2.7 * placements / few
    w = sweep.world(Streams(1, "recorded", "sweep", [3, 11]))
    for column, start in enumerate(places[[3, 11]]):
        inside = (time >= time[start]) & (time < time[start] + 20.0)
        assert np.array_equal(~w.received[:, 0, column], inside)
        assert w.received[:, 1:, column].all()
        assert np.flatnonzero(w.window[:, column] == 1) == np.flatnonzero(inside)[-1]
    again = sweep.world(Streams(1, "recorded", "sweep", [3 + placements]))
    assert np.array_equal(again.received[..., 0], w.received[..., 0])
    windows = setting(recording, "as-recorded", **{"sensors.outage": {
        "place": "windows", "windows": [[10.0, 15.0], [50.0, 52.0]], "sensors": ["speed"]}})
    w = windows.world(Streams(1, "recorded", "as-recorded", [0]))
    since = time - trip().t_s[0]
    expected = ((since >= 10) & (since <= 15)) | ((since >= 50) & (since <= 52))
    assert np.array_equal(~w.received[:, 1, 0], expected)
    drawn = setting(recording).world(Streams(1, "recorded", "outage", range(30)))
    assert len({tuple(np.flatnonzero(column)) for column in ~drawn.received[:, 0].T}) > 10


def test_a_run_does_not_depend_on_its_batch(recording):
    chosen = setting(recording)
    whole, part = (chosen.world(Streams(1, "recorded", "outage", runs)) for runs in (range(7), [5]))
    for name in ("truth", "u", "y", "received"):
        assert np.array_equal(getattr(part, name)[..., 0], getattr(whole, name)[..., 5])
    for label in LABELS:
        one, many = (run(chosen, label, runs)[2].scored.metrics["rmse", "position"] for runs in (1, 7))
        assert one[0] == many[0], label


@pytest.mark.parametrize("motion", ["acceleration", "jerk", "train", "accelerometer", "odometer"])
@pytest.mark.parametrize("shortfall", ["told", "modelled"])
def test_the_model_s_jacobian_and_its_intervals(recording, motion, shortfall):
    rng, e = np.random.default_rng(0), 1e-6
    table = trip().assign(u_share=0.3, a_mps2=0.1)
    table.to_csv(recording, index=False)
    metro = load("ningbo-metro").variants["white"]["plant"]
    chosen = setting(recording, columns={**MAP, "control": "u_share", "acceleration": "a_mps2"}, **{
        "plant.line": metro["line"], "plant.train": metro["train"]})
    told = {"motion": motion, "shortfall": shortfall}
    nx = chosen.design_model(told, np.zeros((5, 4))).nx
    assert nx == {"acceleration": 4, "jerk": 5, "train": 4, "accelerometer": 5, "odometer": 2}[motion]
    x = np.concatenate([rng.uniform(5, 15, (2, 4)), rng.uniform(-.05, .05, (nx - 2, 4))])
    u = np.concatenate([rng.uniform(5, 9, (2, 4)), rng.uniform(-1, 1, (2, 4))])
    model = chosen.design_model(told, np.zeros((5, 4)))
    length = rng.uniform(0.5, 2.0, 4)
    assert model.transition_jacobian and model.process_covariance
    for j in range(nx):
        d = np.zeros((nx, 1))
        d[j] = e
        slope = (model.transition(x + d, u, over(length)) - model.transition(x - d, u, over(length))) / (2 * e)
        assert np.allclose(model.transition_jacobian(x, u, over(length))[:, j], slope, atol=1e-7)
    points = np.repeat(x[:, None], 3, axis=1)
    assert np.array_equal(model.transition(points, u, over(length))[:, 2], model.transition(x, u, over(length)))
    if motion in ("acceleration", "jerk"):
        # two intervals in a row add up to one: Q(a + b) = F(b) Q(a) F(b)' + Q(b); the shortfall is left out, it may
        # depend on where the speed is
        at = [0, 1, nx - 1] if motion == "jerk" else [0, 1]
        F = model.transition_jacobian(x, 0 * u, over(0.7))[:, :, 0][np.ix_(at, at)]
        a, b, both = (model.process_covariance(x, u, over(h))[:, :, 0][np.ix_(at, at)] for h in (1.1, 0.7, 1.8))
        assert np.allclose(F @ a @ F.T + b, both, rtol=1e-12)


@pytest.mark.parametrize("motion", ["acceleration", "jerk", "accelerometer"])
def test_the_linear_form_is_the_model(recording, motion):
    trip().assign(a_mps2=lambda table: np.sin(table.t_s)).to_csv(recording, index=False)
    chosen = setting(recording, "as-recorded", {**MAP, "acceleration": "a_mps2"})
    world = chosen.world(Streams(1, "recorded", "as-recorded", range(1)))
    model = chosen.design_model({"motion": motion, "shortfall": "told"}, world.initial_mean)
    form, steps = model.linear, len(world.lengths)
    assert form and model.process_covariance and model.measurement_jacobian and model.measurement_covariance
    x = np.array([[100.0], [8.0], [2.0], [0.03], [0.2]])[:model.nx]
    for k in (0, 7, 39, 60, steps - 1, steps + 9):
        u, length = world.u[min(k, steps - 1)], world.lengths[min(k, steps - 1)]
        moved = model.transition(x, u, over(float(length)))
        assert np.allclose(form.A(k) @ x + form.B(k) @ u + form.h(k)[:, None], moved, rtol=1e-12)
        assert np.array_equal(form.Q(k), model.process_covariance(x, u, over(length))[:, :, 0])
    assert np.array_equal(form.C(0), model.measurement_jacobian(x, 0)[:, :, 0]) and not form.constant
    assert np.array_equal(form.R(0), model.measurement_covariance(untold(0, model.ny))[:, :, 0])


def test_kalman_equals_a_textbook_loop(recording):
    chosen = setting(recording)
    world, model, driven = run(chosen, "kalman", 3)
    assert model.linear and model.measurement_covariance
    R, squared = model.measurement_covariance(untold(0, 3))[:, :, 0], np.zeros(3)
    for r in range(3):
        x, P = model.initial_mean[:, r], model.initial_covariance[:, :, 0]
        for k in range(world.steps):
            A = model.linear.A(k).copy()
            A[2, 3] = world.u[k, 0, r]
            x, P = A @ x, A @ P @ A.T + model.linear.Q(k)
            C = model.linear.C(k)[world.received[k, :, r]]
            K = P @ C.T @ np.linalg.inv(C @ P @ C.T + R[np.ix_(*[world.received[k, :, r]] * 2)])
            x, P = x + K @ (world.y[k, world.received[k, :, r], r] - C @ x), P - K @ C @ P
            squared[r] += (x[0] - world.truth[k, 0, r]) ** 2
    assert driven.scored.metrics["rmse", "position"] == pytest.approx(np.sqrt(squared / world.steps), rel=1e-9)


def test_dead_reckoning_ends_as_short_as_the_odometer(recording):
    _, _, driven = run(setting(recording, "odometer"), "dead-reckoning", 1, "odometer")
    table = trip()
    short = 1e3 * (table.s_km.iloc[-1] - table.s_km[0]) - (table.odo_m.iloc[-1] - table.odo_m[0])
    begun = table.gnss_m[0] - 1e3 * table.s_km[0]  # the start is the first reading, not the reference
    assert driven.scored.metrics["final", "position"][0] == pytest.approx(short - begun, abs=1e-9)
    assert short == pytest.approx((1 - SCALE) * 900, abs=5.0)


@pytest.mark.parametrize("label", ["kalman", "ekf", "ukf", "ckf", "robust-mean-square"])
def test_the_scale_as_a_state_beats_dead_reckoning_clearly(recording, label):
    blind = run(setting(recording, "odometer"), "dead-reckoning", 1, "odometer")[2].scored.metrics
    _, _, driven = run(setting(recording, "odometer"), label, 1, "odometer")
    for metric in ("rmse", "final"):
        assert driven.scored.metrics[metric, "position"][0] < 0.35 * blind[metric, "position"][0]
    _, _, bridged = run(setting(recording, "sweep"), label, 30, "sweep")
    assert bridged.outcomes["rmse", "position-outage-end", "m"].max() < 0.5 * blind["final", "position"][0]


def test_without_an_odometer_the_speed_is_integrated(recording):
    chosen = setting(recording, "as-recorded", {k: v for k, v in MAP.items() if k != "odometer"})
    _, model, driven = run(chosen, "ekf", 1, "as-recorded")
    assert model.states == ("position", "speed") and model.measurements == ("position", "speed")
    assert driven.scored.metrics["rmse", "position"][0] < 2.0
    world, _, reckoned = run(chosen, "dead-reckoning", 1, "as-recorded")
    speed = trip().v_kmh.to_numpy() / 3.6
    travelled = np.trapezoid(speed, trip().t_s)
    final = abs(world.initial_mean[0, 0] + travelled - world.truth[-1, 0, 0])
    assert reckoned.scored.metrics["final", "position"][0] == pytest.approx(final, abs=1e-9)


def test_the_built_in_scenario_asks_for_a_recording():
    chosen = load("recorded").setting("outage")
    assert type(chosen).needs_file == "plant.recording"
    with pytest.raises(InputError, match="--recording"):
        chosen.world(Streams(1, "recorded", "outage", [0]))


@pytest.mark.parametrize("motion", ["odometer", "acceleration"])
def test_parts_of_a_step_count_its_distance_once(recording, motion):
    model = setting(recording).design_model({"motion": motion}, np.zeros((5, 2)))
    x, u = np.full((model.nx, 2), 0.5), np.array([[10.0, 10.0], [9.0, 9.0]])
    whole = model.transition(x, u, Interval(1, 0.0, 1.0))
    share = np.array([0.3, 1.0])
    half = model.transition(x, u, Interval(1, 0.0, share, share))
    found = model.transition(half, u, Interval(1, share, 1 - share, 1 - share))
    assert np.allclose(found, whole, rtol=1e-12) and np.array_equal(half[:, 1], found[:, 1])
    if motion == "odometer":
        assert np.allclose(found[0], 10.5)


def test_a_reading_that_is_its_own_reference_gives_no_errors_but_what_innovations_say(recording):
    """Errors against it are those of the filter's own input; in an outage it is withheld, and tells."""
    scenario = load("recorded", {"plant.recording": recording, "plant.map": {"time": "t_s", "position": "gnss_m"}})
    found = run(scenario.setting("as-recorded"), "kalman", 2)[2]
    names = {metric for metric, _ in found.scored.metrics}
    assert not names & {"rmse", "mae", "max", "final", "nees"} and not found.scored.status.any()
    assert {"nis", "whiteness", "log-likelihood"} <= names
    assert np.isfinite(found.scored.metrics["log-likelihood", "innovation"]).all()
    assert ("rmse", "position-outage-end", "m") in run(scenario.setting("outage"), "kalman", 2)[2].outcomes


def test_what_is_not_heard_is_not_told_either(recording):
    """A dead odometer and speed sensor: dead reckoning stands still until they are heard again."""
    window = {"place": "windows", "windows": [[30.0, 60.0]], "sensors": ["odometer", "speed"]}
    chosen = setting(recording, "as-recorded", **{"sensors.outage": window})
    world = chosen.world(Streams(1, "recorded", "as-recorded", [0]))
    since = np.cumsum(world.lengths)
    inside = (since >= 30) & (since <= 60)
    assert (world.u[inside, 0] == 0).all() and len(np.unique(world.u[inside, 1])) == 1
    table = trip()
    assert world.u[:, 0].sum() == table.odo_m.iloc[-1] - table.odo_m[0]  # the count goes on meanwhile
    still = run(chosen, "dead-reckoning", 1, "as-recorded")[2].outcomes["rmse", "position-outage", "m"]
    heard = run(setting(recording, "as-recorded", **{"sensors.outage": {**window, "sensors": ["position"]}}),
                "dead-reckoning", 1, "as-recorded")[2].outcomes["rmse", "position-outage", "m"]
    assert still[0] > 5 * heard[0]


def test_a_coarse_odometer_is_noticed_and_begins_where_it_is_first_heard(tmp_path):
    table = trip()
    table.loc[:30, "odo_m"] = np.nan
    table.to_csv(tmp_path / "trip.csv", index=False)
    chosen = setting(str(tmp_path / "trip.csv"), "as-recorded", **{"sensors.odometer_step": None})
    assert chosen.odometer_step(chosen.trips[0]) == pytest.approx(5.0, abs=5.0)
    world = chosen.world(Streams(1, "recorded", "as-recorded", [0]))
    off = (world.y[:, 2] - world.truth[:, 0])[world.received[:, 2]]
    assert abs(off[0]) < 5 and not world.received[:30, 2].any()
    smooth = trip().assign(odo_m=SCALE * 1e3 * trip().s_km)
    smooth.to_csv(tmp_path / "smooth.csv", index=False)
    assert setting(str(tmp_path / "smooth.csv"), **{"sensors.odometer_step": None}).trips[0].odometer_step == 0.0
    assert any("odometer counts in steps of 5 m" in note for note in setting(str(tmp_path / "trip.csv")).notes)


def test_times_and_skipped_seconds_are_the_recording_s(recording):
    chosen = setting(recording, "as-recorded", **{"score.skip": 40.0})
    world, _, driven = run(chosen, "kalman", 1, "as-recorded")
    times = step_times(world)
    table = trip()
    assert times == pytest.approx(table.t_s[1:] - table.t_s[1], abs=1e-9)
    assert np.flatnonzero(driven.scored.curves["active"])[0] == np.searchsorted(times, 40.0)
    assert chosen.sampling_period == pytest.approx(np.median(np.diff(table.t_s)), rel=1e-9)


def test_the_train_s_own_model_bridges_an_outage(tmp_path):
    """A trip of the metro, recorded with its control: without any sensor for 30 s its model knows better than a
    kinematic one."""
    metro = load("ningbo-metro").setting("physical")
    w = metro.world(Streams(2, "ningbo-metro", "physical", [0]))
    n = int(w.active[:, 0].sum()) - 1
    rng = np.random.default_rng(3)
    pd.DataFrame({
        "t_s": 0.2 * np.arange(n), "s_m": w.truth[:n, 0, 0], "v_mps": w.truth[:n, 1, 0], "u_share": w.u[1:n + 1, 0, 0],
        "gps_m": w.truth[:n, 0, 0] + rng.normal(0, 2, n), "speed_mps": w.truth[:n, 1, 0] + rng.normal(0, 0.1, n),
    }).to_csv(tmp_path / "metro.csv", index=False)
    table = load("ningbo-metro").variants["physical"]["plant"]
    columns = {"time": "t_s", "position": "gps_m", "speed": "speed_mps", "control": "u_share",
               "reference_position": "s_m", "reference_speed": "v_mps"}
    chosen = setting(str(tmp_path / "metro.csv"), "sweep", columns, **{
        "sensors.outage.sensors": ["position", "speed"], "sensors.noise": {}, "plant.line": table["line"],
        "plant.train": table["train"]})
    ends = {label: run(chosen, label, 40, "sweep")[2].outcomes["rmse", "position-outage-end", "m"]
            for label in ("ekf", "ekf-train")}
    assert ends["ekf-train"].mean() < 0.25 * ends["ekf"].mean()
    bare = setting(str(tmp_path / "metro.csv"), "sweep", columns)
    with pytest.raises(Unsupported, match="--line, --train"):
        run(bare, "ekf-train", 1, "sweep")


@pytest.mark.parametrize("name", ["recorded", "recorded-odometry"])
def test_without_a_recording_everything_is_promised(name):
    """What lists show of a scenario that still waits for its file."""
    scenario = load(name)
    assert all(item.referenced for item in scenario.setting(scenario.default).quantities())
