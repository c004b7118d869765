"""Faults of sensors: nothing drawn changes nothing, outliers are nested over their share, a kind does what it says."""

from __future__ import annotations

import numpy as np
import pytest
from railstate.scenarios.errors import InputError
from railstate.scenarios.files import load
from railstate.scenarios.randomness import Streams
from railstate.scenarios.registry import scenario_files
from scipy.stats import kstest

RUNS = 6


def world(name="ningbo-metro", variant="gaussian", runs=range(RUNS), **overrides):
    found = load(name, {key.replace("__", "."): value for key, value in overrides.items()}, variant)
    return found.setting(variant).world(Streams(1, name, variant, runs))


def faulty(**overrides):
    return world(**{f"faults__{key}": value for key, value in overrides.items()})


@pytest.mark.parametrize(("key", "value"), [
    ("faults__outliers__share", 0.0), ("faults__student-t__from", 1e6), ("faults__stuck__from", 1e6),
    ("faults__drift__from", 1e6), ("faults__jump__from", 1e6), ("faults__dropout__from", 1e6),
    ("faults__burst__from", 1e6), ("faults__stamps__from", 1e6)])
def test_no_fault_drawn_changes_no_bit(key, value):
    plain, same = world(), world(**{key: value})
    for name in ("truth", "u", "y", "received", "active", "initial_mean"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(same, name))
    assert plain.faulty is None and not same.faulty.any()


def test_outliers_are_nested_over_their_share():
    plain, sd = world(), np.array([1.0, 0.2]) / 3
    few, many = faulty(outliers__share=0.05), faulty(outliers__share=0.3)
    assert (few.faulty <= many.faulty).all() and few.faulty.sum() < many.faulty.sum()
    np.testing.assert_array_equal(few.y[few.faulty], many.y[few.faulty])
    np.testing.assert_allclose(np.abs(many.y - plain.y), 20 * sd[:, None] * many.faulty, atol=1e-9)
    count = many.faulty.size
    assert abs(many.faulty.mean() - 0.3) < 4 * np.sqrt(0.3 * 0.7 / count)
    up = (many.y - plain.y)[many.faulty] > 0
    assert abs(up.mean() - 0.5) < 4 * 0.5 / np.sqrt(up.size)
    assert ((faulty(outliers__share=0.3, outliers__sign="plus").y - plain.y)[many.faulty] > 0).all()


def test_a_fault_has_its_sensors_and_its_window():
    found = faulty(outliers__share=1.0, outliers__sensors=["position"], outliers__from=5.0, outliers__to=9.0)
    time = (np.arange(found.steps) + 1) * 0.2
    np.testing.assert_array_equal(found.faulty[:, 0, 0], (time >= 5 - 1e-9) & (time < 9 - 1e-9))
    assert not found.faulty[:, 1].any()


def test_what_is_told_is_not_handed_on():
    told = faulty(outliers__share=0.2, outliers__told=True)
    np.testing.assert_array_equal(told.received, ~told.faulty)
    np.testing.assert_array_equal(told.faulty, faulty(outliers__share=0.2).faulty)


def test_bursts_take_the_readings_of_their_sensors_for_as_long_as_they_say():
    found = faulty(burst__p_good_bad=0.1, burst__p_bad_good=0.25, burst__sensors=["position"])
    lost = ~found.received[:, 0]
    assert found.received[:, 1].all()
    here = lost[:-1]
    for stays, share in ((~here & lost[1:], 0.1), (here & ~lost[1:], 0.25)):
        count = (here if share == 0.25 else ~here).sum()
        assert abs(stays.sum() / count - share) < 4 * np.sqrt(share * (1 - share) / count)


def test_student_t_multiplies_the_noise():
    plain, heavy = world(), faulty(**{"student-t__dof": 3.0})
    wide = (heavy.y - heavy.truth) / (plain.y - plain.truth)
    assert (wide > 0).all()
    noise = ((heavy.y - heavy.truth) / (np.array([1.0, 0.2]) / 3)[:, None]).ravel()
    assert kstest(noise, "t", args=(3,)).pvalue > 0.01


def test_stuck_drift_dropout_and_stamps():
    plain = world()
    time = (np.arange(plain.steps) + 1) * 0.2
    inside = (time >= 10 - 1e-9) & (time < 20 - 1e-9)
    window = {"sensors": ["position"], "from": 10.0, "to": 20.0}

    def one(kind, **more):
        return faulty(**{f"{kind}__{key}": value for key, value in {**window, **more}.items()})

    first = int(np.argmax(inside))
    np.testing.assert_array_equal(one("stuck").y[:, 0],
                                  np.where(inside[:, None], plain.y[first, 0], plain.y[:, 0]))
    np.testing.assert_allclose(one("drift", rate=0.1).y[:, 0],
                               plain.y[:, 0] + np.where(inside, 0.1 * (time - 10), 0)[:, None], atol=1e-12)
    np.testing.assert_array_equal(one("dropout").received[:, 0, 0], ~inside)
    late = one("stamps", offset=1.0)
    noise = plain.y - plain.truth
    np.testing.assert_allclose(late.y[inside, 0], (np.roll(plain.truth, 5, axis=0) + noise)[inside, 0], atol=1e-9)
    np.testing.assert_array_equal(late.y[~inside], plain.y[~inside])


def test_episodes_begin_at_random_and_last_as_they_say():
    found = faulty(dropout__every=20.0, dropout__lasts=2.0, dropout__sensors=["speed"])
    out = ~found.received[:, 1]
    assert (out != out[:, :1]).any()
    for run in out.T:
        edges = np.flatnonzero(np.diff(np.concatenate([[False], run])))
        lengths = np.diff(edges)[::2]
        assert (lengths[:-1] % 10 == 0).all()


def test_a_true_jump_moves_truth_and_reading_a_false_one_the_reading():
    plain = world()
    time = (np.arange(plain.steps) + 1) * 0.2
    moved = np.where(time >= 60 - 1e-9, 30.0, 0.0)
    true, false = faulty(jump__from=60.0), faulty(jump__from=60.0, jump__truth=False, jump__to=80.0)
    np.testing.assert_allclose(true.truth[:, 0] - plain.truth[:, 0], moved[:, None].repeat(RUNS, 1), atol=1e-9)
    np.testing.assert_allclose(true.y[:, 0] - plain.y[:, 0], moved[:, None].repeat(RUNS, 1), atol=1e-9)
    np.testing.assert_array_equal(true.y[:, 1], plain.y[:, 1])
    assert not true.faulty.any()
    np.testing.assert_array_equal(false.truth, plain.truth)
    np.testing.assert_array_equal(false.faulty[:, 0, 0], (moved > 0) & (time < 80 - 1e-9))


@pytest.mark.parametrize("name", ["ningbo-metro", "cbtc-csma", "braking-rate", "rap-example-1", "moving-block"])
@pytest.mark.parametrize("kind", ["outliers", "drift", "dropout", "burst", "student-t", "stuck", "stamps", "jump"])
def test_every_setting_takes_faults_or_says_why_not(name, kind):
    steps = {"time.steps": 40} if name in ("cbtc-csma", "rap-example-1", "braking-rate") else {}
    try:
        found = load(name, {f"faults.{kind}.from": 0.0, **steps})
        variant = next(v for v in found.variants if v not in found.unfit)
        made = found.setting(variant).world(Streams(1, name, variant, range(2)))
        events = [event for k in range(20) for event in made.step(k, made.initial_mean).events]
        assert all(event.faulty is not None or not event.received.any() for event in events)
        assert all(np.isfinite(event.y[event.received]).all() for event in events)
    except InputError as error:
        assert f"faults.{kind}" in str(error)
        assert (name, kind) in {("moving-block", "student-t"), ("moving-block", "stuck"), ("moving-block", "stamps"),
                                ("moving-block", "jump"), ("rap-example-1", "jump")}


def test_a_run_is_the_same_in_any_company():
    keys = {"outliers__share": 0.2, "burst__p_bad_good": 0.3, "stuck__every": 30.0, "student-t__dof": 4.0}
    keys = {f"faults__{key}": value for key, value in keys.items()}
    whole, alone = world(**keys), world(runs=[4], **keys)
    for name in ("truth", "y", "received", "faulty"):
        np.testing.assert_array_equal(getattr(whole, name)[..., 4:5], getattr(alone, name))


def test_entries_go_by_name_where_a_kind_stands_twice(tmp_path):
    file = tmp_path / "mine.toml"
    two = "".join(f'[[faults]]\nkind = "outliers"\nname = "{name}"\nsensors = ["{sensor}"]\n'
                  for name, sensor in (("far", "position"), ("fast", "speed")))
    body = scenario_files()["ningbo-metro"].read_text().replace('name = "ningbo-metro"', 'name = "mine"')
    file.write_text(body + two + '[variants.gaussian.faults.far]\nshare = 0.5\n')
    found = load(str(file), {"faults.fast.size": 7.0})
    assert [fault.share for fault in found.setting("gaussian").config.faults] == [0.5, 0.1]
    assert [fault.size for fault in found.setting("white").config.faults] == [20.0, 7.0]
    with pytest.raises(InputError, match="no such entry and no such kind"):
        load(str(file), {"faults.slow.size": 7.0})
    with pytest.raises(InputError, match="give each a name"):
        file.write_text(body + two.replace('name = "far"\n', "").replace('name = "fast"\n', ""))
        load(str(file))


@pytest.mark.parametrize(("key", "value", "said"), [
    ("outliers.sensors", ["gnss"], "faults.outliers: there is no sensor gnss; allowed: position, speed"),
    ("outliers.share", 2, "faults.outliers.share"), ("outliers.from", -1, "faults.outliers.from"),
    ("outliers.rate", 1, "unknown key"), ("jump.to", 9.0, "has no meaning where the vehicle itself moves"),
    ("student-t.told", True, "faults.student-t: told"), ("dropout.lasts", 2.0, "lasts is used with every only")])
def test_mistakes_are_told(key, value, said):
    with pytest.raises(InputError) as caught:
        load("ningbo-metro", {f"faults.{key}": value})
    assert said in str(caught.value)
