"""Lines and trains from files: trips over all stops keep every limit, errors come per section, bad files are named."""

from __future__ import annotations

import json

import numpy as np
import pytest
from railstate.benchmarks.running.drive import drive, prepare
from railstate.estimators.interface import Estimate, Estimator
from railstate.scenarios.errors import InputError
from railstate.scenarios.files import load
from railstate.scenarios.machine_code import njit
from railstate.scenarios.railway.dynamics import GRAVITY, climb, level
from railstate.scenarios.railway.line import Line, read_line, read_train
from railstate.scenarios.randomness import Streams

from ..models import whole

VARIANTS = ("switching", "white", "sinusoid", "constant", "physical", "physical-bias", "switching-bias", "gaussian")


def track():
    return {
        "stops": {"unit": "m", "values": [0.0, 800.0, 1.7e3, 2400.0]},
        "speed limits": {"units": {"position": "m", "velocity": "km/h"},
                         "values": [[0.0, 40], [200.0, 70], [620.0, 35], [900.0, 60], [1500.0, 45], [1900.0, 80]]},
        "gradients": {"units": {"position": "m", "slope": "permil"},
                      "values": [[0.0, 0.0], [150.0, -22.5], [500.0, 15.0], [1000.0, -10.0], [1650.0, 24.0]]},
    }


def train():
    return {
        "mass": {"unit": "kg", "value": 100000}, "rho": {"unit": "%", "value": 8},
        "max traction power": {"unit": "kW", "value": 900.0}, "max reg braking power": {"unit": "kW", "value": 1000.0},
        "max traction force": {"unit": "kN", "value": 110.0}, "max reg braking force": {"unit": "kN", "value": 90.0},
        "max pn braking force": {"unit": "kN", "value": 20.0}, "max speed": {"unit": "km/h", "value": 65},
        "rolling resistance r0": {"unit": "kN", "value": 1.5},
        "rolling resistance r1": {"unit": "kN/(km/h)", "value": 0.01},
        "rolling resistance r2": {"unit": "kN/(km/h)^2", "value": 0.0008},
    }


@pytest.fixture
def pair(tmp_path):
    (tmp_path / "track.json").write_text(json.dumps(track()))
    (tmp_path / "train.json").write_text(json.dumps(train()))
    return {"plant.line": str(tmp_path / "track.json"), "plant.train": str(tmp_path / "train.json")}


def test_the_plant_climbs_what_the_line_says():
    """Gradients a tenth of a metre apart on lines up to 60 km long, beginning before zero."""
    random = np.random.default_rng(5)
    for _ in range(40):
        edges = np.unique(np.round(random.uniform(-800, 10.0 ** random.uniform(3, 4.8), 30), 1))
        pairs = [[float(edges[0]) - 50.0, 0.01], *([float(s), float(random.uniform(-0.03, 0.03))] for s in edges)]
        line = Line(stops=[float(edges[0]), float(edges[-1])], speed_limits=[[pairs[0][0], 20.0]], gradients=pairs)
        slope = line.slope(0.1)
        at = np.concatenate([random.uniform(edges[0] - 900, edges[-1] + 900, 300), edges, edges - 0.05, edges + 0.05])
        found = np.array([climb.py_func(s, slope) for s in at])
        np.testing.assert_allclose(found, GRAVITY * line.gradient(at) / 1.1, rtol=0, atol=1e-14)


def test_loads_change_what_the_train_can_do_and_nothing_else(pair):
    """On each section the input is told as a share of the force on the train's own mass: the plant without loads,
    driven by it and by the disturbance, gives the truth again; the force itself stays within what the controller
    may ask."""
    loads = [80000.0, 130000.0, 110000.0]
    setting = load("ningbo-metro", {**pair, "plant.loads": loads}).setting("switching")
    world = setting.world(Streams(3, "ningbo-metro", "switching", range(3)))
    model = setting.design_model({}, world.initial_mean)
    gain = np.array([[0.02], [0.2]])
    x, worst = world.truth[0], 0.0
    for k in range(1, world.steps):
        expected = model.transition(x, world.u[k], whole(k, 0.2)) + gain * world.extra["disturbance"][k]
        x = world.truth[k]
        worst = max(worst, np.abs(expected - x)[:, world.active[k]].max(initial=0.0))
    assert worst < 1e-6
    share = world.u[:, 0] * np.array(loads)[world.window] / 100000.0
    assert share.max() <= 0.85 + 1e-12 and share.min() >= -1 - 1e-12
    plain = load("ningbo-metro", pair).setting("switching").world(Streams(3, "ningbo-metro", "switching", range(3)))
    assert world.active.sum() > plain.active.sum()  # the heavy sections take longer
    with pytest.raises(InputError, match="loads has 2 entries for 3 sections"):
        load("ningbo-metro", {**pair, "plant.loads": loads[:2]})


class Echo(Estimator):
    """Takes the measurement for the state."""

    def start(self, model, runs, random):
        super().start(model, runs, random)
        self.mean = model.initial_mean

    def predict(self, u, interval):
        pass

    def update(self, measurement):
        self.mean = measurement.y

    def estimate(self):
        return Estimate(mean=self.mean)


def world(pair, variant, runs):
    setting = load("ningbo-metro", pair).setting(variant)
    return setting, setting.world(Streams(3, "ningbo-metro", variant, runs))


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_trip_calls_at_every_stop_and_keeps_every_limit(pair, variant):
    _, w = world(pair, variant, range(25))
    s, v = w.truth[:, 0], w.truth[:, 1]
    assert not w.active[-1].any()
    limit = np.full(s.shape, np.inf)
    for position, kmh in track()["speed limits"]["values"]:
        limit = np.where(s >= position, min(kmh, 65) / 3.6, limit)
    assert (v <= limit)[w.active].all()
    assert (v >= -0.15 * 0.2 - 1e-12).all()  # the step before a standstill may leave T w_bar
    assert np.abs(w.u).max() <= 1
    for r in range(25):
        standing = (v[:, r] == 0) & w.active[:, r] & (s[:, r] > 1)
        starts = np.flatnonzero(np.diff(standing.astype(int)) == 1) + 1
        places = s[starts, r]
        assert np.abs(places - [800, 1700]).max() < 3
        assert standing.sum() * 0.2 == pytest.approx(2 * 30.0, abs=0.5)
    if variant != "gaussian":
        assert np.abs(w.extra["disturbance"]).max() <= 0.15
    assert np.abs(s[-1] - 2400).max() < 3


def test_truth_of_a_trip_follows_the_design_model(pair):
    setting, w = world(pair, "physical", range(5))
    model = setting.design_model({}, w.initial_mean)
    for k in range(1, w.steps):
        moved = model.transition(w.truth[k - 1], w.u[k], whole(k, 0.2))
        acted = np.array([[0.02], [0.2]]) * w.extra["disturbance"][k]
        active = w.active[k]
        assert np.allclose((moved + acted)[:, active], w.truth[k][:, active], atol=1e-9)


def test_errors_of_each_section_are_reported(pair):
    setting, w = world(pair, "white", range(4))
    streams = Streams(3, "ningbo-metro", "white", range(4))
    estimator, model = prepare(setting, Echo, {}, {}, w.initial_mean)
    driven = drive(setting, w, estimator, model, streams("estimator", "echo"))
    error = w.y - w.truth
    counted = w.active & (np.arange(w.steps) >= 25)[:, None]
    assert w.windows == ("section-01", "section-02", "section-03")
    for number, name in enumerate(w.windows):
        inside = counted & (w.window == number)
        for i, (quantity, unit) in enumerate((("position", "m"), ("speed", "m/s"))):
            expected = np.sqrt(np.where(inside, error[:, i] ** 2, 0).sum(0) / inside.sum(0))
            assert driven.outcomes["rmse", f"{quantity}-{name}", unit] == pytest.approx(expected, rel=1e-12)
    room = np.where(w.active, w.extra["speed-limit"] - w.truth[:, 1], np.inf).min(0)
    assert np.array_equal(driven.outcomes["least", "room-under-limit", "m/s"], room)


def test_another_file_is_another_scenario(pair, tmp_path):
    before = load("ningbo-metro", pair).content_hash("white")
    assert load("ningbo-metro", pair).content_hash("white") == before
    longer = track()
    longer["stops"]["values"][-1] = 2500.0
    (tmp_path / "track.json").write_text(json.dumps(longer))
    assert load("ningbo-metro", pair).content_hash("white") != before


def test_a_trip_does_not_depend_on_its_batch(pair):
    _, whole = world(pair, "switching", range(7))
    _, part = world(pair, "switching", [5])
    assert np.array_equal(part.truth[..., 0], whole.truth[..., 5])
    assert np.array_equal(part.window[..., 0], whole.window[..., 5])


def test_train_file_gives_force_power_and_resistance(pair):
    found, at = read_train(pair["plant.train"]), njit()(lambda v, u, forces: level(v, u, forces))
    for kmh in (5.0, 20.0, 45.0, 64.0):
        v = kmh / 3.6
        resistance = 1500 + 10 * kmh + 0.8 * kmh**2
        traction, braking = min(110e3, 900e3 / v), 20e3 + min(90e3, 1000e3 / v)
        assert at(v, 1.0, found.forces) == pytest.approx((traction - resistance) / 108e3, rel=1e-12)
        assert at(v, -1.0, found.forces) == pytest.approx((-braking - resistance) / 108e3, rel=1e-12)


def test_units_of_a_line_are_read(pair):
    line = read_line(pair["plant.line"])
    assert line.stops == [0.0, 800.0, 1700.0, 2400.0]
    assert line.limit(np.array([0.0, 199.9, 200.0, 5000.0])) == pytest.approx(np.array([40, 40, 70, 80]) / 3.6)
    assert line.gradient(np.array([149.0, 150.0, 2000.0])) == pytest.approx([0.0, -0.0225, 0.024])


def test_a_train_that_brakes_weakly_brakes_earlier(pair, tmp_path):
    weak = train()
    weak["max reg braking force"]["value"], weak["max pn braking force"]["value"] = 50.0, 0.0
    (tmp_path / "weak.json").write_text(json.dumps(weak))
    _, w = world({**pair, "plant.train": str(tmp_path / "weak.json")}, "constant", range(10))
    assert (w.truth[:, 1] <= w.extra["speed-limit"])[w.active].all()
    assert np.abs(w.truth[-1, 0] - 2400).max() < 3


def change(table, *path):
    """`table` with the entry at the path replaced by the last item."""
    *keys, last, value = path
    for key in keys:
        table = table[key]
    table[last] = value


@pytest.mark.parametrize(("which", "path", "message"), [
    ("track", ("stops", "values", [0.0, 900.0, 700.0]), "stops must lie one after another"),
    ("track", ("stops", "values", [-50.0, 900.0]), "lies outside the line"),
    ("track", ("stops", "values", [0.0, "x"]), "\"stops\" must be numbers"),
    ("track", ("stops", "unit", "mile"), "unit 'mile' of \"stops\" is unknown; allowed: m, km"),
    ("track", ("speed limits", "units", "velocity", "furlong/h"), "unit 'furlong/h' of \"speed limits\""),
    ("track", ("speed limits", "values", [[0.0, 40], [0.0, 50]]), "positions must increase"),
    ("track", ("speed limits", "values", [[0.0, -40]]), "speed limits must be positive"),
    ("track", ("speed limits", "values", [[0.0, 3]]), "plant.controller.margin"),
    ("track", ("speed limits", "values", [1.0]), "needs rows"),
    ("track", ("speed limits", {}), "needs units"),
    ("track", ("gradients", "values", [[0.0, 85.0]]), "cannot climb 85.0 per mille from 0 m on"),
    ("track", ("gradients", "values", [[0.0, 400.0]]), "at most 0.2"),
    ("train", ("mass", "value", -1), '"mass" must be more than 0'),
    ("train", ("mass", 180), "\"mass\" is 180; allowed: {\"value\": 1.0, \"unit\": ..}"),
    ("train", ("mass", {"value": 180}), "\"mass\" needs a unit; allowed: kg, t"),
    ("track", ("stops", [0, 900]), "\"stops\" is [0, 900]; allowed: {\"unit\": \"m\", \"values\": [0, 1300, ..]}"),
    ("train", ("max traction force", "unit", "lbf"), "unit 'lbf' of \"max traction force\""),
    ("train", ("max reg braking force", "value", -10), "cannot brake"),
])
def test_bad_files_get_one_message(pair, tmp_path, which, path, message):
    table = {"track": track, "train": train}[which]()
    change(table, *path)
    (tmp_path / f"{which}.json").write_text(json.dumps(table))
    with pytest.raises(InputError) as caught:
        load("ningbo-metro", pair)
    assert message in str(caught.value)
    assert str(caught.value).count("\n") == 0


@pytest.mark.parametrize(("content", "message"), [("{", "not a JSON file"), ("[]", "must hold a JSON object")])
def test_files_that_are_no_line(pair, tmp_path, content, message):
    (tmp_path / "track.json").write_text(content)
    with pytest.raises(InputError, match=message):
        load("ningbo-metro", pair)
    with pytest.raises(InputError, match=r"none\.json: cannot be read"):
        load("ningbo-metro", {**pair, "plant.line": str(tmp_path / "none.json")})
