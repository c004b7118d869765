"""Sensors aboard in the metro and on recordings: readings and truth, the model and differences, commands."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from railstate.scenarios.aboard import Instruments, Route, hearing, sense
from railstate.scenarios.aboard.rolling import roll
from railstate.scenarios.aboard.sensing import Trip
from railstate.scenarios.files import load
from railstate.scenarios.measurement import Interval
from railstate.scenarios.railway.adhesion import Adhesion
from railstate.scenarios.railway.dynamics import GRAVITY
from railstate.scenarios.randomness import Streams

from ..conftest import Command

EVERY = ("position", "speed", "wheel-a", "wheel-b", "balise", "gnss", "radar", "accelerometer")
CLEAN = Instruments.model_validate({
    "gradient": 0.0, "wheel": {"diameter": 0.86, "pulses": 100000, "diameter_error": 0.0, "phase": [0.0, 0.0]},
    "accelerometer": {"bias": 0.0, "noise": 0.0}, "radar": {"scale": 0.0, "noise": 1e-9, "least": 2.0},
    "balise": {"location": [0.0, 0.0], "platform": [0.0, 0.0], "reader": [0.0, 0.0], "missed": 0.0, "detection": 0.1},
    "gnss": {"every": 1.0, "slow": 0.0, "memory": 60.0, "white": 0.0, "told": 2.0, "jump": 0.0, "size": 0.0,
             "lasts": [5.0, 15.0], "outage": [0.0, 0.0]}})


def metro(use: tuple[str, ...], **overrides: Any) -> Any:
    return load("ningbo-metro", {"sensors.use": list(use), **overrides}, only="gaussian").setting("gaussian")


def worlds(use: tuple[str, ...], runs: int = 3, **overrides: Any) -> Any:
    return metro(use, **overrides).world(Streams(1, "ningbo-metro", "gaussian", range(runs)))


def trip(runs: int = 2) -> Trip:
    """Away at 1 m/s^2, 10 s of it, then 20 s of coasting and braking at 1 m/s^2 to a stand, flat."""
    lengths = np.full(80, 0.5)
    speed = np.minimum(10.0, np.minimum(np.arange(81) * 0.5, np.maximum(40.0 - np.arange(81) * 0.5, 0.0)))
    place = np.concatenate([[0.0], np.cumsum(0.25 * (speed[1:] + speed[:-1]))])
    return Trip(np.repeat(place[:, None], runs, axis=1), np.repeat(speed[:, None], runs, axis=1), lengths, None, None)


def test_a_gradient_begins_where_the_line_says() -> None:
    """At its edge too; the map's errors are those of the section that the train is in."""
    at, gradients = np.array([0.0, 50.0, 100.0, 249.9, 250.0, 400.0]), [0.01, -0.02, 0.03]
    error = np.array([1.0, 2.0, 4.0])
    line = SimpleNamespace(gradients=list(zip([0.0, 100.0, 250.0], gradients, strict=True)))
    way = Trip(np.concatenate([[0.0], at])[:, None], np.ones((7, 1)), np.ones(6), line, None)  # pyright: ignore
    section = [0, 0, 1, 1, 2, 2]
    np.testing.assert_array_equal(way.climb()[:, 0], GRAVITY * np.array(gradients)[section])
    np.testing.assert_array_equal(way.climb(error[:, None])[:, 0], GRAVITY * (np.array(gradients) + error)[section])


def test_clean_sensors_read_the_trip() -> None:
    """Without errors and slip each reads what is true; a balise is read where the train passes it, the last of two."""
    way, streams = trip(), Streams(1, "s", "v", range(2))
    out = sense(way, (*EVERY[2:],), CLEAN, Route(tunnels=[[100.0, 150.0]]), ([30.0, 31.0, 33.0, 200.0], []), streams)
    moved = np.diff(way.position, axis=0)
    assert out.names == ("wheel-a", "wheel-b", "balise", "gnss", "radar")
    np.testing.assert_allclose(out.y[:, 0], moved, atol=1e-4)
    np.testing.assert_allclose(out.y[:, 1], moved, atol=1e-4)
    np.testing.assert_allclose(out.inputs[:, 0], way.acceleration, atol=1e-12)
    np.testing.assert_allclose(out.inputs[:, 3:5].sum(axis=0)[0], way.position[-1], atol=1e-4)
    read = np.argwhere(out.there[:, 2, 0])[:, 0]
    assert out.y[read, 2, 0].tolist() == [31.0, 33.0, 200.0]  # 30 and 31 m lie in one step
    at = way.position[read, 0] + out.share[read, 0] * moved[read, 0]
    np.testing.assert_allclose(at, [31.0, 33.0, 200.0], atol=1e-9)
    told = out.references(out.there[:, 2])
    assert np.isnan(told[:read[0]]).all() and (told[read[1]:read[2], :, 0] == 33.0).all()
    np.testing.assert_allclose(out.carried(way.position).y[read, 2, 0], way.position[read + 1, 0], atol=1e-9)
    fixed, inside = np.arange(1, 80, 2), (way.position[1:, 0] >= 100.0) & (way.position[1:, 0] <= 150.0)
    assert np.argwhere(out.there[:, 3, 0])[:, 0].tolist() == [k for k in fixed if not inside[k]]
    np.testing.assert_array_equal(out.there[:, 4], way.speed[1:] >= 2.0)
    np.testing.assert_allclose(out.y[:, 4], way.speed[1:], atol=1e-7)


def test_a_reader_reaches_the_further_the_faster_it_goes() -> None:
    """Up to 150 m/s, once back by some metres: of each step's balises the last, where it is first passed."""
    runs, steps, rng = 3, 60, np.random.default_rng(3)
    speed = np.linspace(0.0, 150.0, steps + 1)[:, None] * np.array([1.0, 0.9, 0.2])
    speed[30:33] = -5.0
    place = np.cumsum(0.5 * speed, axis=0)
    balise = {"location": [0.4, 1.0], "platform": [0.05, 0.1], "reader": [0.5, 3.0], "missed": 0.3, "detection": 0.13}
    instruments = Instruments.model_validate({"balise": balise})
    where = np.sort(rng.uniform(-20.0, 2400.0, 90)).tolist()
    out = sense(Trip(place, speed, np.full(steps, 0.5), None, None), ("balise",), instruments, Route(), (where, []),
                Streams(1, "s", "v", range(runs)))
    again = Streams(1, "s", "v", range(runs))
    drawn, unit = instruments.balise.draw(where, [], again("balise")), again("reader").uniform(-1.0, 1.0, len(where))
    passed, share = np.full((steps, runs), -1), np.ones((steps, runs))
    for run in range(runs):
        furthest = [max(place[:k + 1, run]) for k in range(steps + 1)]
        for j, at in enumerate(where):
            near = next((k for k in range(steps + 1) if furthest[k] >= at), steps)
            kmh = min(max(3.6 * speed[near, run], 40.0), 500.0)
            at += unit[j, run] * (0.5 + 2.5 * (kmh - 40.0) / 460.0)
            k = next((k for k in range(steps + 1) if furthest[k] >= at), 0)
            if k and drawn.read[j, run]:
                passed[k - 1, run] = j
                share[k - 1, run] = (at - furthest[k - 1]) / (furthest[k] - furthest[k - 1])
    np.testing.assert_array_equal(out.passed, passed)
    np.testing.assert_allclose(out.share, share, rtol=1e-9)
    assert (passed >= 0).sum() > 40 and not drawn.read.all()
    told = np.where(passed >= 0, np.take_along_axis(drawn.told, np.maximum(passed, 0), axis=0), out.y[:, 0])
    np.testing.assert_array_equal(out.y[:, 0], told)
    np.testing.assert_array_equal(out.there[:, 0], passed >= 0)


def test_wheels_slip_under_the_force_that_the_trip_takes() -> None:
    """Traction is the first axle's alone, braking both axles'; what the rail bears keeps to micro-slip."""
    way = trip()
    moved, adhesion = np.diff(way.position, axis=0), Adhesion(open=0.1)

    def rolled(adhesion: Adhesion) -> tuple[np.ndarray, np.ndarray]:
        rail = adhesion.rail([0.0, float(way.position[-1, 0])], [], Streams(1, "s", "v", range(2))("adhesion"))
        far, slides = roll(adhesion, rail, way.position, way.speed, way.pull(), way.lengths, 0.0)
        return np.diff(far, axis=0, prepend=0.0) - moved[:, None], slides

    slip, slides = rolled(adhesion)
    away, coast, brake = slice(2, 19), slice(25, 58), slice(62, 78)
    assert slides[away, 0].all() and not slides[away, 1].any() and not slides[coast].any()
    assert (slip[away, 0] > 0.2 * moved[away] * 0.4).all() and np.abs(slip[away, 1]).max() < 1e-9
    assert slides[brake, 0].all() and (slip[brake, 0] < 0.0).all()
    assert (slip[brake] + moved[brake, None] > -1e-12).all()  # a wheel does not turn backwards
    slip, slides = rolled(Adhesion(open=0.5))
    use = 1.0 / 4.0 / (0.5 * 9.81 / 8.0)
    assert not slides.any()
    np.testing.assert_allclose(slip[10:19, 0], 0.006 * use * moved[10:19], rtol=0.2)


def test_fitting_a_sensor_leaves_the_others_as_they_are() -> None:
    plain, full = worlds(("position", "speed"), 2), worlds(EVERY, 2)
    np.testing.assert_array_equal(plain.y, full.y[:, :2])
    np.testing.assert_array_equal(plain.truth, full.truth)
    for name in ("wheel-b", "balise"):
        alone = worlds(("speed", name), 2)
        i = EVERY.index(name)
        np.testing.assert_array_equal(alone.y[:, 1], full.y[:, i])
        np.testing.assert_array_equal(alone.received[:, 1], full.received[:, i])
        np.testing.assert_array_equal(alone.variance[:, 1], full.variance[:, i])
    one = metro(EVERY).world(Streams(1, "ningbo-metro", "gaussian", (1,)))
    np.testing.assert_array_equal(one.y[..., 0], full.y[..., 1])


def test_what_is_given_of_a_sensor_leaves_the_usual_rest() -> None:
    setting = metro(("balise", "radar"), **{"sensors.radar.noise": 0.3, "knowledge.odometry.initial.bias": 0.1})
    radar, told = setting.config.sensors.radar, setting.config.knowledge.odometry
    assert (radar.scale, radar.noise, radar.least) == (0.005, 0.3, 2.0) and setting.config.sensors.gnss.told == 2.24
    assert (told.initial.position, told.initial.bias, told.slip.sd) == (2.0, 0.1, 10.0)
    entry = setting.resolve_knowledge({"odometry": {"initial": {"scale": 0.1}}})
    assert (entry.odometry.initial.bias, entry.odometry.initial.scale) in {(0.1, 0.1), (0.05, 0.1)}


def test_a_balise_is_an_event_inside_its_step() -> None:
    world = worlds(("speed", "balise"), 4)
    seen = 0
    for k in np.flatnonzero(world.received[:, 1].any(axis=1)):
        first, rest = world.step(int(k), world.initial_mean).events
        np.testing.assert_allclose(first.share + rest.share, 1.0)
        who = world.received[k, 1]
        assert (first.received[1] == who).all() and not first.received[0].any() and not rest.received[1].any()
        assert (first.share[~who] == 0.0).all() and rest.received[0].all()
        before = world.truth[k - 1, 0]
        at = before + first.share * (world.truth[k, 0] - before)
        assert np.abs(at - first.y[1])[who].max() < 1.0 + 0.7 + 0.1  # the map's limit and the reader's
        assert np.isnan(first.covariance[0]).all() and (first.covariance[1, 1, who] > 0).all()
        seen += int(who.sum())
    assert seen == 4 * len(metro(("speed", "balise")).config.plant.balises.on(metro(("speed",)).config.plant.line)[0])
    assert len(world.step(0, world.initial_mean).events) == 1
    told, place = world.reference[:, 0], world.reference[:, 1]  # pyright: ignore
    known = world.received[:, 1].cumsum(axis=0) > 0
    assert (np.isnan(told) == ~known).all() and 0.01 < np.abs(told - place)[known].max() < 2.0
    np.testing.assert_array_equal(world.extra["reference-error"], told - place)
    np.testing.assert_array_equal(world.extra["since-reference"], world.truth[:, 0] - place)


def test_the_model_that_hears_agrees_with_differences() -> None:
    """Jacobians of whole steps and of both parts of one; wheels measure what was moved since their step began."""
    setting = metro(EVERY)
    model = setting.design_model({}, np.array([[100.0], [10.0]]))
    assert model.states == ("position", "speed", "travelled", "scale-a", "scale-b", "scale-radar")
    assert model.measurements == EVERY[:7] and model.appended == 4 and model.tells == ("wheel-a", "wheel-b")
    rng = np.random.default_rng(3)
    x = np.array([[130.0], [12.0], [0.7], [0.004], [-0.003], [0.002]]) + 1e-3 * rng.normal(size=(6, 4))
    u = np.concatenate([np.full((1, 4), 0.4), rng.normal(size=(7, 4))])
    for interval in (Interval(5, 0.8, 0.2), Interval(5, np.full(4, 0.8), np.full(4, 0.05), np.full(4, 0.25)),
                     Interval(5, np.full(4, 0.85), np.full(4, 0.15), np.full(4, 0.75))):
        F, H = model.transition_jacobian(x, u, interval), model.measurement_jacobian(x, 5)
        moved = model.transition(x, u, interval)
        for j in range(6):
            step = np.zeros((6, 1))
            step[j] = 1e-5
            change = (model.transition(x + step, u, interval) - model.transition(x - step, u, interval)) / 2e-5
            np.testing.assert_allclose(change, np.broadcast_to(F[:, j], (6, 4)), atol=2e-6)
            change = (model.measurement(x + step, 5) - model.measurement(x - step, 5)) / 2e-5
            np.testing.assert_allclose(change, H[:, j], atol=1e-6)
        since = x[2] if np.max(interval.start) > 0.8 else 0.0
        np.testing.assert_allclose(moved[2], moved[0] - x[0] + since)
        Q = model.process_covariance(x, u, interval)
        np.testing.assert_array_equal(Q[2, 2], Q[0, 0])
        assert np.linalg.eigvalsh(Q[:, :, 0]).min() > -1e-12
    y = model.measurement(x, 5)
    np.testing.assert_allclose(y, np.stack([x[0], x[1], (1 + x[3]) * x[2], (1 + x[4]) * x[2], x[0], x[0],
                                            (1 + x[5]) * x[1]]))
    same = setting.design_model({}, np.array([[100.0], [10.0]]))
    assert hearing(same, (), setting.config.sensors, 0.1) is same


def test_what_is_noted_of_sliding() -> None:
    """Of each axle where wheels are aboard and may slip."""
    for use, slippery, noted in ((("speed",), True, False), (("speed", "wheel-a"), False, False),
                                 (("speed", "balise"), True, True)):
        extra = worlds(use, 1, **({"plant.adhesion": {"open": 0.1}} if slippery else {})).extra
        assert ({"slide-a", "slide-b"} <= set(extra)) == noted == ("slide-a" in extra)


@pytest.mark.parametrize("use", [("speed", "balise"), ("balise", "radar"), ("wheel-a", "wheel-b", "balise"), EVERY])
def test_filters_that_hear_are_as_sure_as_they_may_be(railstate: Command, use: tuple[str, ...]) -> None:
    """Nothing slips, all else is drawn as told (uniform diameters by their variance): NEES near its two states; the
    interval's bounds hold."""
    done = railstate("run", "ningbo-metro/white", "--set", f"sensors.use={json.dumps(use)}", "--estimators",
                     "ekf,ckf,interval", "--runs", 16, "--jobs", 1, "--quiet", "--out", "out")
    assert done.code == 0, done.err
    rows = pd.concat(map(pd.read_parquet, Path("out/rows").glob("*.parquet"))).set_index("estimator")
    assert (rows["status"] == "ok").all()
    means = rows.groupby(level=0)[["nees:state:1", "rmse:position:m", "coverage:ellipsoid:1"]].mean()
    assert means.loc[["ekf", "ckf"], "nees:state:1"].between(1.0, 3.0).all()
    assert (means.loc[["ekf", "ckf"], "rmse:position:m"] < 1.5).all()
    assert means.loc["interval", "coverage:ellipsoid:1"] == 1.0


def test_odometers_in_the_metro_on_a_line_of_ones_own(railstate: Command) -> None:
    """Wheels that slip on a line and train from files: who models slip stays within the allowance."""
    Path("track.json").write_text(json.dumps({
        "stops": {"unit": "m", "values": [0, 1500, 2600]},
        "speed limits": {"units": {"position": "m", "velocity": "km/h"}, "values": [[0, 70]]},
        "gradients": {"units": {"position": "m", "slope": "permil"}, "values": [[0, 0], [800, 12]]}}))
    done = railstate("run", "ningbo-metro/aboard", "--line", "track.json", "--runs", 4, "--jobs", 1, "--quiet",
                     "--estimators", "imm-slip,gate,dr-minmax,ekf-accelerometer", "--out", "out")
    assert done.code == 0, done.err
    rows = pd.concat(map(pd.read_parquet, Path("out/rows").glob("*.parquet"))).set_index("estimator")
    assert (rows["status"] == "ok").all()
    use = rows.groupby(level=0)["use:odometry:1"].max()
    assert use["imm-slip"] < 0.6 and use["gate"] < 1.0 < use["ekf-accelerometer"]
    done = railstate("sweep", "ningbo-metro/aboard", "--line", "track.json", "--over", "time.period=0.2,0.5", "--over",
                     "plant.balises.every=300,900", "--estimators", "imm-slip,dr-minmax", "--runs", 2, "--jobs", 1,
                     "--out", "swept")
    assert done.code == 0, done.err
    part = pd.read_csv("swept/requirements.csv")
    assert len(part) == 8 and set(part["requirement"]) == {"odometry"}


@pytest.mark.parametrize(("words", "expected"), [
    (("sensors.use=[\"sonar\"]",), "'gnss', 'radar' or 'accelerometer' (got 'sonar')"),
    (("sensors.use=[\"accelerometer\"]",), "sensors: use has the accelerometer alone"),
    (("sensors.use=[\"radar\"]", "knowledge.odometry.motion=minmax"),
     "knowledge.odometry.motion = \"minmax\" needs wheel-a and wheel-b in sensors.use"),
    (("sensors.use=[\"balise\"]", "plant.balises={positions=[5000]}"), "plant.balises: none lies on the line"),
    (("plant.tunnels=[[5, 2]]",), "tunnels = [[from, to], ..] needs stretches in order"),
    (("requirements=[{name=\"o\",form=\"allowance\",constant=5,share=0.05}]",), "an allowance needs references"),
])
def test_what_does_not_fit_is_one_message(railstate: Command, words: tuple[str, ...], expected: str) -> None:
    pairs = [word for pair in words for word in ("--set", pair)]
    done = railstate("run", "ningbo-metro/gaussian", *pairs, "--runs", 1, "--out", "out")
    assert done.code == 2 and expected in done.err and "Traceback" not in done.err, done.err


def test_an_entry_whose_motion_lacks_a_sensor_says_so(railstate: Command) -> None:
    done = railstate("run", "ningbo-metro/aboard", "--set", "sensors.use=[\"wheel-a\", \"balise\"]", "--runs", 1,
                     "--jobs", 1, "--estimators", "ekf,dr-minmax", "--quiet", "--out", "out")
    rows = pd.concat(map(pd.read_parquet, Path("out/rows").glob("*.parquet"))).set_index("estimator")
    assert done.code == 0 and rows["status"].to_dict() == {"ekf": "ok", "dr-minmax": "infeasible"}
    assert "needs wheel-a and wheel-b" in rows["reason"].to_dict()["dr-minmax"]


def recording(path: str) -> pd.DataFrame:
    """A hop of 40 s at 10 Hz, standstill to standstill, written as a file."""
    time = np.arange(0.0, 60.0, 0.5)
    speed = np.clip(np.minimum(time - 5.0, 55.0 - time), 0.0, 12.0)
    place = np.concatenate([[0.0], np.cumsum(0.25 * (speed[1:] + speed[:-1]))])
    frame = pd.DataFrame({"t_s": time, "s_m": place, "v_mps": speed, "odo_m": np.floor(0.97 * place)})
    frame.to_csv(path, index=False)
    return frame


@pytest.mark.parametrize(("scenario", "simulated", "labels"), [
    ("recorded/as-recorded", ("balise", "radar"), "ekf,ukf"),
    ("recorded/as-recorded", ("gnss", "balise"), "kalman,ekf,robust-mean-square"),
    ("recorded/as-recorded", ("wheel-a", "wheel-b", "balise", "accelerometer"), "ekf,ekf-accelerometer"),
    ("recorded-odometry/wheels", EVERY[2:], "dr-minmax,ekf-scale,imm-slip")])
def test_sensors_simulated_on_a_recording(railstate: Command, scenario: str, simulated: tuple[str, ...], labels: str
                                          ) -> None:
    recording("hop.csv")
    done = railstate("run", scenario, "--recording", "hop.csv", "--map",
                     "time=t_s,reference_position=s_m,reference_speed=v_mps", "--set",
                     f"sensors.simulated={json.dumps(simulated)}", "--set", "plant.every=150", "--estimators", labels,
                     "--runs", 3, "--jobs", 1, "--out", "out")
    assert done.code == 0, done.err
    assert f"Simulated on the recording's reference: {', '.join(simulated)}" in " ".join(done.out.split())
    rows = pd.concat(map(pd.read_parquet, Path("out/rows").glob("*.parquet")))
    assert (rows["status"] == "ok").all() and rows["rmse:position:m"].max() < 3.0


def test_simulated_sensors_beside_recorded_ones(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is recorded is heard as before, whatever is simulated; of several trips each has its own."""
    monkeypatch.chdir(tmp_path)
    recording("one.csv")
    frame = recording("two.csv").iloc[:80]
    frame.to_csv("two.csv", index=False)
    base = {"plant.map": {"time": "t_s", "reference_position": "s_m", "odometer": "odo_m"},
            "plant.recording": ["one.csv", "two.csv"], "sensors.outage.place": "none"}

    def world(**more: Any) -> Any:
        setting = load("recorded", {**base, **more}).setting("as-recorded")
        return setting.world(Streams(1, "recorded", "as-recorded", range(4)))

    plain, full = world(), world(**{"sensors.simulated": ["balise", "radar"], "plant.every": 150.0})
    np.testing.assert_array_equal(plain.y, full.y[:, :1])
    np.testing.assert_array_equal(plain.u, full.u[:, :4])
    np.testing.assert_array_equal(plain.truth, full.truth)
    assert not full.received[80:, :, 1::2].any() and full.received[:, 1:].any(axis=(0, 2)).all()
    assert np.isnan(full.variance[:, 0]).all() and np.isfinite(full.reference[-1, :, 0]).all()


@pytest.mark.parametrize(("mapped", "simulated", "expected"), [
    ("wheel-a=odo_m", "wheel-b", "sensors.simulated has wheel-b, but"),
    ("odometer=odo_m,balise=s_m", "balise", "has balise of its own: leave one of them out"),
    ("acceleration=v_mps2", "accelerometer", "acceleration"),
    ("odometer=odo_m", "sonar", "got 'sonar'")])
def test_what_is_recorded_is_not_simulated_too(railstate: Command, mapped: str, simulated: str, expected: str) -> None:
    recording("hop.csv")
    done = railstate("run", "recorded-odometry" if "wheel" in mapped else "recorded", "--recording", "hop.csv", "--map",
                     f"time=t_s,reference_position=s_m,{mapped}", "--set", f"sensors.simulated=[\"{simulated}\"]",
                     "--set", "sensors.outage.place=none", "--runs", 1, "--out", "out")
    assert done.code == 2 and expected in done.err and "Traceback" not in done.err, done.err
