"""What a recording's values mean: missing ones, told accuracy, counters that wrap, places on a line, several trips, and
what is scored."""

from __future__ import annotations

import re
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from railstate.benchmarks.running.drive import drive, prepare
from railstate.estimators.registry import estimators
from railstate.scenarios.errors import InputError
from railstate.scenarios.files import load
from railstate.scenarios.measurement import Measurement
from railstate.scenarios.randomness import Streams

from tests.recordings import fixes, geojson, ride, track, tram
from tests.scenarios.test_recording_reading import MAP, read, refused

QUALITY = {"NARROW_INT3": 0.05, "SINGLE": 3.0, "PROPAGATED": "missing"}
PLACES = {"time": "time", "latitude": "latitude", "longitude": "longitude", "position_sd": "fix"}
OWN = {role: name for role, name in MAP.items() if not role.startswith("reference")}


def write(path, table):
    table.to_csv(path, index=False)
    return str(path)


def setting(recording, variant="as-recorded", columns=MAP, **overrides):
    changes = {"plant.recording": recording, "plant.map": columns, **overrides}
    return load("recorded", changes, variant).setting(variant)


def run(chosen, label, runs=3, variant="as-recorded"):
    streams = Streams(1, "recorded", variant, range(runs))
    world, entry = chosen.world(streams), chosen.config.estimators[label]
    plugin = estimators()[entry.plugin]
    estimator, model = prepare(chosen, plugin, entry.parameters, entry.knowledge, world.initial_mean)
    estimator.design(model)
    return world, model, drive(chosen, world, estimator, model, streams("estimator", label))


def test_a_reference_at_a_lower_rate_is_scored_where_it_is(tmp_path):
    table = tram()
    for name in ("s_ref_m", "v_ref_mps"):
        table[name] = table[name].where((table.index % 10 == 0) & ((table.t_s < 60) | (table.t_s > 100)))
    chosen = setting(write(tmp_path / "trip.csv", table))
    world, _, driven = run(chosen, "ekf", 1)
    known = table.s_ref_m[1:].notna().to_numpy()
    assert np.array_equal(np.isfinite(world.truth[:, 0, 0]), known)
    assert driven.scored.curves["active"].tolist() == known.astype(float).tolist()
    full, _, whole = run(setting(write(tmp_path / "whole.csv", tram())), "ekf", 1)
    assert np.array_equal(full.y, world.y) and np.array_equal(full.u, world.u)
    squares = whole.scored.curves["squared"][:, 0]
    assert driven.scored.metrics["rmse", "position"][0] == pytest.approx(np.sqrt(squares[known].mean()), rel=1e-12)
    assert driven.scored.metrics["max", "position"][0] == pytest.approx(np.sqrt(squares[known].max()), rel=1e-12)
    nees = whole.scored.curves["nees"][known].mean()
    assert driven.scored.nees_states == 2
    assert driven.scored.metrics["nees", "state"][0] == pytest.approx(nees, rel=1e-12)


def test_no_estimate_is_scored_by_a_reading_that_it_was_given(tmp_path):
    path = write(tmp_path / "trip.csv", tram())
    world, _, driven = run(setting(path, columns=OWN), "ekf", 2)
    assert np.isnan(world.truth).all() and not driven.scored.status.any()
    assert not {"rmse", "mae", "max", "final", "nees"} & {metric for metric, _ in driven.scored.metrics}
    assert np.isfinite(driven.scored.metrics["nis", "innovation"]).all()
    chosen = setting(path, "outage", OWN, **{"sensors.outage.duration": 20.0})
    world, _, driven = run(chosen, "ekf", 3, "outage")
    assert np.array_equal(np.isfinite(world.truth[:, 0]), ~world.received[:, 0])
    assert np.isnan(world.truth[:, 1]).all() and ("rmse", "speed") not in driven.scored.metrics
    inside = driven.outcomes["rmse", "position-outage", "m"]
    assert driven.scored.metrics["rmse", "position"] != pytest.approx(0) and np.isfinite(inside).all()
    noisy = setting(path, columns=OWN, **{"sensors.noise": {"position": 3.0}})
    assert np.isfinite(noisy.world(Streams(1, "recorded", "as-recorded", [0])).truth[:, 0]).all()
    # speed from no column of its own is the derivative of the positions, and scored where they are
    bare = setting(path, "outage", {"time": "t_s", "position": "s_gnss_m"})
    world = bare.world(Streams(1, "recorded", "outage", range(3)))
    assert np.array_equal(np.isnan(world.truth[:, 0]), np.isnan(world.truth[:, 1]))
    assert any("errors are of what was withheld" in note for note in bare.notes)


def test_noise_is_added_on_request_only(tmp_path):
    path = write(tmp_path / "trip.csv", tram())
    for variant in ("outage", "sweep", "as-recorded", "odometer"):
        world = setting(path, variant).world(Streams(1, "recorded", variant, range(2)))
        assert np.array_equal(world.y[..., 0][world.received[..., 0] & world.received[..., 1]],
                              world.y[..., 1][world.received[..., 0] & world.received[..., 1]])
    noisy = setting(path, **{"sensors.noise": {"speed": 0.5}}).world(Streams(1, "recorded", "as-recorded", range(9)))
    assert (noisy.y[:, 1] - tram().v_kmh.to_numpy()[1:, None] / 3.6).std() == pytest.approx(0.5, rel=0.05)


def test_dead_reckoning_by_the_trapezoid_rule(tmp_path):
    """A perfect speed sensor that is heard once a second: integrated without an error but that of the trapezoid."""
    true = ride(1.0).assign(a=1)
    columns = {"time": "t_s", "position": "s_m", "speed": "v_mps", "reference_position": "s_m"}
    _, _, driven = run(setting(write(tmp_path / "a.csv", true), columns=columns), "dead-reckoning", 1)
    step = np.diff(true.t_s)
    right = np.concatenate([[0.0], np.cumsum(true.v_mps.to_numpy()[1:] * step)])
    assert np.abs(right - true.s_m).max() > 5  # what taking the speed at the end of each second would make of it
    assert driven.scored.metrics["max", "position"][0] < 0.12
    # a speed that is heard every fifth row: in between it is held, and the next one puts right what that missed
    fine = ride(0.2)
    fine["v_mps"] = fine.v_mps.where(fine.index % 5 == 0)
    slow = setting(write(tmp_path / "b.csv", fine), columns=columns).world(Streams(1, "recorded", "as-recorded", [0]))
    there = fine.v_mps.notna().to_numpy()
    expected = np.trapezoid(fine.v_mps[there], fine.t_s[there])
    assert slow.u[:np.flatnonzero(there)[-1], 0].sum() == pytest.approx(expected, rel=1e-12)


def test_the_start_comes_from_the_readings(tmp_path):
    table = tram()
    table.loc[:3, "s_gnss_m"] = np.nan
    chosen = setting(write(tmp_path / "trip.csv", table))
    world = chosen.world(Streams(1, "recorded", "as-recorded", [0]))
    assert world.initial_mean[:2, 0] == pytest.approx([table.s_gnss_m[4], table.v_kmh[4] / 3.6])
    assert world.steps == len(table) - 5 and any("Begins at t = 4 s" in note for note in chosen.notes)
    bare = {"time": "t_s", "position": "s_gnss_m"}
    late = setting(str(tmp_path / "trip.csv"), columns=bare, **{"plant.span": [30.0, 90.0]})
    world = late.world(Streams(1, "recorded", "as-recorded", [0]))
    assert world.initial_mean[1, 0] == pytest.approx(table.s_gnss_m[31] - table.s_gnss_m[30])
    model = late.design_model({}, world.initial_mean)
    assert model.initial_covariance[1, 1, 0] == pytest.approx(2 * 3.0**2)


def test_told_accuracy_is_the_measurement_s_covariance(tmp_path):
    table = tram().assign(acc_m=np.where(np.arange(184) % 3 == 0, 2.0, 725.0), kind="good")
    table.loc[50, "acc_m"] = np.nan
    path = write(tmp_path / "trip.csv", table)
    world, model, driven = run(setting(path, columns={**MAP, "position_sd": "acc_m"}), "ekf", 1)
    assert model.tells == ("position",) and world.covariance is not None and model.measurement_covariance
    for k in (0, 1, 2, 49):
        R = model.measurement_covariance(Measurement(
            world.y[k], world.received[k], k + 1, covariance=world.covariance[k]))[:, :, 0]
        sd = 3.0 if k == 49 else table.acc_m[k + 1]
        assert np.diag(R) == pytest.approx([sd**2, 0.15**2, 9.0]) and np.count_nonzero(R) == 3
    _, _, untold = run(setting(path), "ekf", 1)
    assert driven.scored.metrics["rmse", "position"][0] != untold.scored.metrics["rmse", "position"][0]
    kinds = np.select([table.t_s < 60, table.t_s < 90], ["SINGLE", "PROPAGATED"], "NARROW_INT3")
    classes = table.assign(kind=kinds)
    found = read(write(tmp_path / "c.csv", classes), {**MAP, "position_sd": "kind"}, quality=QUALITY)
    assert np.array_equal(np.isnan(found.measured["position"]), (table.t_s >= 60) & (table.t_s < 90))
    assert set(found.told["position"][np.isfinite(found.told["position"])]) == {0.05, 3.0}
    assert "plant.quality: " in refused(tmp_path / "c.csv", {**MAP, "position_sd": "kind"}, quality={"SINGLE": 3.0})
    assert "SINGLE, PROPAGATED, NARROW_INT3 in \"kind\" without" in refused(
        tmp_path / "c.csv", {**MAP, "position_sd": "kind"})


def test_odometers_that_wrap_or_are_reset(tmp_path):
    whole, table = tram(), tram()
    table["odo_m"] = table.odo_m % 4096
    path = tmp_path / "trip.csv"
    write(path, table)
    found = read(path, wrap=4096.0)
    assert found.measured["odometer"] == pytest.approx(whole.odo_m)
    assert any("wrapped 1 times at 4096 m" in text for text in found.said)
    assert "wrap = 1000 does not explain it" in refused(path, wrap=1000.0)
    table["odo_m"] = np.where(table.index > 80, whole.odo_m - whole.odo_m[80], whole.odo_m)
    write(path, table)
    found = read(path)
    assert found.measured["odometer"][81:] - found.measured["odometer"][80] == pytest.approx(
        (whole.odo_m - whole.odo_m[81])[81:])
    assert any("taken as a reset" in text for text in found.said)
    table["odo_m"] = np.where(table.index > 80, whole.odo_m - 2000, whole.odo_m)
    write(path, table)
    assert "wrap = METRES where its counter wraps" in refused(path)


def test_order_and_duplicates_on_request(tmp_path):
    table = tram()
    path = tmp_path / "trip.csv"
    write(path, table.sample(frac=1, random_state=3))
    found, plain = read(path, order="sort"), read(write(tmp_path / "plain.csv", table))
    assert np.array_equal(found.measured["speed"], plain.measured["speed"])
    assert any("places where the time goes back, sorted" in text for text in found.said)
    double = pd.concat([table, table.assign(v_kmh=table.v_kmh + 2)]).sort_values("t_s", kind="stable")
    write(path, double)
    first, mean = read(path, duplicates="first"), read(path, duplicates="mean")
    assert np.array_equal(first.measured["speed"], plain.measured["speed"])
    assert mean.measured["speed"] == pytest.approx(plain.measured["speed"] + 1 / 3.6)
    assert len(mean.time) == len(table) and any("their mean is taken" in text for text in mean.said)


@pytest.mark.parametrize("pieces", [1, 7])
def test_fixes_on_a_track(tmp_path, pieces):
    """One line, or a network of pieces in any direction with a siding: along the way that the fixes took."""
    line, lines = track(), [track()]
    if pieces > 1:
        cuts = np.linspace(0, len(line) - 1, pieces + 1).astype(int)
        lines = [line[a:b + 1][::(-1) ** k] for k, (a, b) in enumerate(pairwise(cuts))]
        siding = line[cuts[2]:cuts[3] + 1].copy()
        siding[1:-1, 0] += 0.0009
        lines.append(siding)
    (tmp_path / "track.geojson").write_text(geojson(lines))
    table, true = fixes(), ride(0.5)
    path = write(tmp_path / "fixes.csv", table)
    found = read(path, PLACES, quality=QUALITY, track=str(tmp_path / "track.geojson"))
    lost = (table.fix == "PROPAGATED").to_numpy()
    assert np.array_equal(np.isnan(found.measured["position"]), lost)
    good = (table.fix == "NARROW_INT3").to_numpy()
    offset = (found.measured["position"] - true.s_m)[good]
    assert np.ptp(offset) < 0.4
    own = read(path, PLACES, quality=QUALITY)
    assert np.abs((own.measured["position"] - own.measured["position"][0] - true.s_m)[good]).max() < 3.0
    assert "along the track of" in found.said[-1] and "along the recording's own path" in own.said[-1]


def test_tracks_and_fixes_that_cannot_be(tmp_path):
    path = write(tmp_path / "fixes.csv", fixes())
    far = tmp_path / "far.geojson"
    far.write_text(geojson([track() + 20, track() + 21]))
    assert "no line of it is within 10 km" in refused(path, PLACES, quality=QUALITY, track=str(far))
    far.write_text("{}")
    assert "holds no LineString" in refused(path, PLACES, quality=QUALITY, track=str(far))
    far.write_text("no json")
    assert "not GeoJSON" in refused(path, PLACES, quality=QUALITY, track=str(far))
    swapped = {**PLACES, "latitude": "longitude", "longitude": "latitude"}
    write(tmp_path / "track", fixes())
    (tmp_path / "track.geojson").write_text(geojson([track()]))
    assert "latitude and longitude have changed places" in refused(
        path, swapped, quality=QUALITY, track=str(tmp_path / "track.geojson"))
    bad = fixes()
    bad.loc[7, "latitude"] = -9999
    message = refused(write(tmp_path / "bad.csv", bad), PLACES, quality=QUALITY)
    assert "degrees are needed" in message and "missing = [-9999]" in message
    assert read(tmp_path / "bad.csv", PLACES, quality=QUALITY, missing=[-9999]).measured["position"].size == len(bad)


def test_a_reference_that_jumps_ends_a_run_and_a_reading_that_jumps_does_not(tmp_path):
    table = tram()
    table.loc[90:95, "s_gnss_m"] += 400
    path = write(tmp_path / "trip.csv", table)
    scenario = load("recorded", {"plant.recording": path, "plant.map": OWN})
    assert tuple(scenario.variants) == ("as-recorded",)
    message = scenario.unfit["outage"][0]
    assert "the reference of what is withheld is the reading itself" in message and "--without 89..97" in message
    assert any(note.startswith("Odd: the position moves at") for note in scenario.setting("as-recorded").notes)
    assert "outage" in load("recorded", {"plant.recording": path, "plant.map": MAP}).variants
    table = tram()
    table.loc[90:95, "s_ref_m"] += 400
    with pytest.raises(InputError, match=r"the reference moves at \d+ m/s at t = \d+ s \(4 such places\): --without"):
        load("recorded", {"plant.recording": write(tmp_path / "bad.csv", table), "plant.map": MAP})
    taken = load("recorded", {"plant.recording": str(tmp_path / "bad.csv"), "plant.map": MAP,
                              "plant.without": [[89.0, 97.0]]})
    assert "outage" in taken.variants


def test_periods_are_swept_by_leaving_samples_out(tmp_path):
    chosen = setting(write(tmp_path / "trip.csv", tram()), columns=OWN, **{"sensors.period": {"position": 5.0}})
    world = chosen.world(Streams(1, "recorded", "as-recorded", [0]))
    assert np.array_equal(np.flatnonzero(world.received[:, 0, 0]) + 1, np.arange(5, 184, 5))
    assert np.array_equal(np.isfinite(world.truth[:, 0, 0]), ~world.received[:, 0, 0])


def test_long_recordings_are_read_whole_or_refused(tmp_path):
    path = write(tmp_path / "trip.csv", tram())
    with pytest.raises(InputError, match="has 184 rows, more than 100 steps: take a part"):
        load("recorded", {"plant.recording": path, "plant.map": MAP, "time.steps": 100}, "as-recorded")
    part = setting(path, **{"time.steps": 100, "plant.span": [0.0, 100.0]})
    assert part.world(Streams(1, "recorded", "as-recorded", [0])).steps == 100


@pytest.mark.parametrize("trips", ["turn", "draw"])
def test_several_trips_as_one_scenario(tmp_path, trips):
    paths = [write(tmp_path / "a.csv", tram(1)), write(tmp_path / "b.csv", tram(2).head(150)),
             write(tmp_path / "c.csv", tram(3, 0.5))]
    chosen = setting(paths, "outage", **{"plant.trips": trips, "sensors.outage.duration": 20.0})
    runs = range(12)
    world = chosen.world(Streams(1, "recorded", "outage", runs))
    which = chosen.trip_of(Streams(1, "recorded", "outage", runs))
    assert (which == np.arange(12) % 3).all() if trips == "turn" else len(set(which)) > 1
    assert world.active.sum(axis=0).tolist() == [[183, 149, 366][trip] for trip in which]
    for label in ("ekf", "ukf", "dead-reckoning"):
        _, _, driven = run(chosen, label, 12, "outage")
        assert not driven.scored.status.any()
        for trip in range(3):
            alone = setting(paths[trip], "outage", **{"sensors.outage.duration": 20.0})
            if trips == "draw":  # where the outage falls is drawn from the same stream
                one = run(alone, label, 12, "outage")[2].scored.metrics["rmse", "position"]
                mine = which == trip
                assert driven.scored.metrics["rmse", "position"][mine] == pytest.approx(one[mine], rel=1e-9)
    assert sum("Read as" in note for note in chosen.notes) == 3
    assert any("ekf with knowledge = { shortfall = \"told\" } is the same" in note for note in chosen.notes)


def test_an_accelerometer_bridges_better(tmp_path):
    """Position and speed out for 20 s: with the accelerometer as input the error at the end is a fraction."""
    table = tram(4, 0.5)
    path = write(tmp_path / "trip.csv", table)
    chosen = setting(path, "sweep", {k: v for k, v in MAP.items() if k != "odometer"}, **{
        "sensors.outage.duration": 20.0, "sensors.outage.sensors": ["position", "speed"]})
    ends = {label: run(chosen, label, 60, "sweep")[2].outcomes["rmse", "position-outage-end", "m"]
            for label in ("ekf", "ekf-accelerometer")}
    assert np.sqrt((ends["ekf-accelerometer"]**2).mean()) < 0.3 * np.sqrt((ends["ekf"]**2).mean())


@pytest.mark.parametrize("shift", [40.0, 3000.0])
def test_what_is_said_to_be_left_out_is_enough(tmp_path, shift):
    """A place that is off from some time on: leaving out what is named, or one side, ends the complaint."""
    table = tram()
    table.loc[90:, "s_ref_m"] += shift
    path = write(tmp_path / "trip.csv", table)
    message = refused(path)
    spans = [[float(part) for part in text.split("..")] for text in re.findall(r"--without (\S+\.\.\S+)", message)]
    ends = [float(text) for text in re.findall(r"--to (\d+)", message)]
    assert bool(spans) != bool(ends)
    assert read(path, **({"without": spans} if spans else {"span": [0.0, ends[0]]})).known["position"].all()


@pytest.mark.parametrize("trips", ["turn", "draw"])
def test_a_swept_outage_goes_through_each_trip(tmp_path, trips):
    """Trips in turn: each is swept by every third run; drawn ones: a run's outage is where it is on that trip alone."""
    paths = [write(tmp_path / f"{seed}.csv", tram(seed).head(120 + 20 * seed)) for seed in range(3)]
    chosen = setting(paths, "sweep", **{"plant.trips": trips, "sensors.outage.duration": 20.0})
    streams = Streams(1, "recorded", "sweep", range(12))
    world, which = chosen.world(streams), chosen.trip_of(streams)
    for run, number in enumerate(which.tolist()):
        alone = setting(paths[number], "sweep", **{"sensors.outage.duration": 20.0}).world(
            Streams(1, "recorded", "sweep", [run // 3 if trips == "turn" else run]))
        assert np.array_equal(world.received[:alone.steps, 0, run], alone.received[:, 0, 0])
        assert not alone.received[:, 0, 0].all()
