"""Each sensor's readings of motions and draws made by hand, and where faults begin, end and reach, to the letter.

Draws come one after the other from a list that all runs share; what comes of them is worked out in plain loops."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError
from railstate.scenarios.aboard import Instruments, hearing
from railstate.scenarios.faults import Fault, Readings
from railstate.scenarios.measurement import Measurement, told, untold
from railstate.scenarios.model import Bounds
from railstate.scenarios.sensors.accelerometer import Accelerometer
from railstate.scenarios.sensors.balise import Balises
from railstate.scenarios.sensors.gnss import Gnss, ends, fixes
from railstate.scenarios.sensors.radar import Radar
from railstate.scenarios.sensors.wheel import Wheel, rolled
from railstate.scenarios.world import Sensing

from ..models import linear

RUNS = 2


class Drawn:
    """Numbers of a generator, remembered in the order of the calls: uniform in [low, high), normal."""

    runs = range(RUNS)

    def __init__(self) -> None:
        self.rng, self.told = np.random.default_rng(3), list[np.ndarray]()
        self.asked = list[tuple[float, float]]()

    def _kept(self, values: np.ndarray) -> np.ndarray:
        self.told.append(values.copy())
        return values

    def uniform(self, low: float, high: float, *shape: int) -> np.ndarray:
        self.asked.append((low, high))
        return self._kept(self.rng.uniform(low, high, (*shape, RUNS)))

    def normal(self, *shape: int) -> np.ndarray:
        return self._kept(self.rng.normal(size=(*shape, RUNS)))


def test_an_accelerometer() -> None:
    a, climb = np.random.default_rng(1).normal(size=(2, 5, RUNS))
    sensor = Accelerometer(bias=0.3, noise=0.2, drift=0.05)
    for period in (0.4, np.array([0.1, 0.2, 0.4, 0.1, 0.9])[:, None]):
        drawn = Drawn()
        y, bias = sensor.read(a, climb, period, drawn)  # pyright: ignore[reportArgumentType]
        own, noise, walk = drawn.told
        each, wanted = np.broadcast_to(period, (5, 1)), 0.3 * own
        moved = np.zeros(RUNS)
        for k in range(5):
            moved = moved + walk[k]
            wanted = 0.3 * own + 0.05 * math.sqrt(each[k, 0]) * moved
            np.testing.assert_allclose(bias[k], wanted, rtol=1e-14)
            np.testing.assert_allclose(y[k], a[k] + climb[k] + wanted + 0.2 * math.sqrt(0.1 / each[k, 0]) * noise[k])
    assert sensor.deviation(0.4) == pytest.approx(0.1)
    drawn = Drawn()
    _, bias = Accelerometer(bias=0.3, noise=0.2).read(a, climb, 0.4, drawn)  # pyright: ignore[reportArgumentType]
    assert len(drawn.told) == 2 and np.array_equal(bias, np.repeat(0.3 * drawn.told[0][None], 5, axis=0))


def test_a_radar() -> None:
    speed, drawn = np.array([[0.0, 2.0], [1.9, 30.0]]), Drawn()
    y, there, scale = Radar(scale=0.1, noise=0.5, least=2.0).read(speed, drawn)  # pyright: ignore[reportArgumentType]
    own, noise = drawn.told
    assert np.array_equal(scale, 0.1 * own) and there.tolist() == [[False, True], [False, True]]
    np.testing.assert_allclose(y, speed * (1 + 0.1 * own) + 0.5 * noise, rtol=1e-15)


def test_balises() -> None:
    drawn = Drawn()
    kind = Balises(location=[2.0, 1.5], platform=[0.5, 0.2], reader=[0.1, 0.7], missed=0.6, detection=3.0)
    found = kind.draw([10.0, 20.0, 35.0, 50.0], [20.0], drawn)  # pyright: ignore[reportArgumentType]
    error, chance = drawn.told
    for i, (place, sd, limit) in enumerate(((10.0, 2.0, 1.5), (20.0, 0.5, 0.2), (35.0, 2.0, 1.5), (50.0, 2.0, 1.5))):
        assert found.place[i].tolist() == [place] * RUNS and found.sd[i] == sd
        for run in range(RUNS):
            assert found.told[i, run] == place + min(max(sd * error[i, run], -limit), limit)
            assert found.read[i, run] == (i == 0 or chance[i, run] >= 0.6)
    assert not found.read.all() and (np.abs(found.told - found.place) == [[1.5], [0.2], [1.5], [1.5]]).any()
    assert kind.variance(np.array([4.0])).tolist() == [25.0] and drawn.asked == [(0.0, 1.0)]
    just = kind.model_copy(update={"missed": chance[2, 0]}).draw([10.0, 20.0, 35.0, 50.0], [], Drawn())  # pyright: ignore
    assert just.read[2, 0] and just.read.tolist() == [[True] * RUNS, *(chance[1:] >= chance[2, 0]).tolist()]


@pytest.mark.parametrize("irregular", [False, True])
def test_satellites(irregular: bool) -> None:
    steps, every, period = 60, 1.0, 0.4
    times = np.cumsum(np.random.default_rng(2).uniform(0.2, 0.6, steps)) if irregular else period * np.arange(1, 61)
    position = np.array([2.0, 3.0]) * times[:, None]
    kind = Gnss(every=every, slow=2.0, memory=7.0, white=0.5, told=3.0, jump=0.3, size=25.0, lasts=[1.5, 4.5],
                outage=[-4.0, 6.0])
    drawn, tunnels = Drawn(), [[20.0, 24.0], [40.0, 41.0]]
    y, there = kind.read(position, tunnels, period, drawn, times if irregular else None)  # pyright: ignore
    shock, white, begins, size, lasts = drawn.told
    at = sorted({int(np.flatnonzero(times > n - 1e-6)[0]) for n in range(1, int(times[-1] + 1e-6) + 1)})
    assert len(shock) == len(at) > 15
    keep, jumps = math.exp(-1.0 / 7.0), 0
    wanted, known = np.zeros_like(y), np.zeros_like(there)
    for run in range(RUNS):
        slow, left, height = 0.0, 0.0, 0.0
        for i, k in enumerate(at):
            slow = shock[i, run] if i == 0 else keep * slow + math.sqrt(1 - keep**2) * shock[i, run]
            if left <= 0 and begins[i, run] < 0.3:
                height, left, jumps = 25.0 * size[i, run], 1.5 + 3.0 * lasts[i, run], jumps + 1
            wanted[k, run] = position[k, run] + 2.0 * slow + 0.5 * white[i, run] + (height if left > 0 else 0.0)
            left -= 1.0
            known[k, run] = not any(begin - 4.0 <= position[k, run] <= end + 6.0 for begin, end in tunnels)
    np.testing.assert_allclose(y, wanted, rtol=1e-12, atol=1e-12)
    assert there.tolist() == known.tolist() and jumps > 3 and known.any() and not known[at].all()
    assert drawn.asked == [(0.0, 1.0)] * 2


def test_when_fixes_come() -> None:
    assert fixes(1.0, 0.5, 1).tolist() == [] and fixes(1.0, 0.5, 4).tolist() == [1, 3]
    assert fixes(0.3, 0.1, 9).tolist() == [2, 5, 8] and fixes(0.25, 0.1, 5).tolist() == [2, 4]
    assert fixes(1 + 0.8e-9, 1.0, 3).tolist() == [0, 2] and fixes(1 + 1.2e-9, 1.0, 3).tolist() == [1, 2]
    assert ends(1.0, np.array([0.5, 1.0, 1.6, 2.0])).tolist() == [1, 3]
    assert ends(1.0, np.array([0.5, 1.2, 3.5, 3.9])).tolist() == [1, 2]
    assert ends(1.0, np.array([0.5, 0.9])).tolist() == []


@pytest.mark.parametrize("spread", ["uniform", "gaussian"])
def test_a_wheel(spread: Any) -> None:
    kind, drawn = Wheel(diameter=2.0, pulses=10, diameter_error=0.1, spread=spread, phase=[0.25, 0.75], creep=0.2,
                        quiet=0.5, quiet_sd=0.3), Drawn()
    far = np.cumsum(np.random.default_rng(5).uniform(0.0, 2.0, (6, 3, RUNS)), axis=0)
    counts, too_far = kind.count(far, drawn)  # pyright: ignore[reportArgumentType]
    scale, phase = 1 + 0.1 * drawn.told[0], 0.25 + 0.5 * drawn.told[1]
    assert (np.abs(drawn.told[0]).max() > 1) == (spread == "gaussian")
    q = math.pi * 0.2
    assert kind.pulse == pytest.approx(q) and np.array_equal(too_far, 1 / scale - 1)
    assert drawn.asked == [(-1.0, 1.0)] * (spread == "uniform") + [(0.0, 1.0)]
    assert np.array_equal(counts, np.floor(far / (scale * kind.pulse) + phase))
    np.testing.assert_allclose(kind.travelled(counts)[1:], q * (counts[1:] - counts[:-1]))
    np.testing.assert_allclose(kind.travelled(counts)[0], q * counts[0])
    for period, span in ((0.2, 2), (0.13, 4), (2.0, 1)):
        before = np.concatenate([np.zeros((span, 3, RUNS)), counts])
        np.testing.assert_allclose(kind.speed(counts, period), q * (counts - before[:6]) / (span * period))
    assert rolled(np.array([0.0, 3.0]), 0.6, 0.2).tolist() == pytest.approx([0.06, 0.42])


def test_what_a_wheel_tells_of_a_stand() -> None:
    """More than half a second without a pulse, standing; a pulse or a move begins it anew."""
    kind = Wheel(diameter=2.0, pulses=10, diameter_error=0.0, creep=0.2, quiet=0.5, quiet_sd=0.3)
    distance = np.array([1.0, 0, 0, 0, 0, 0, 0.6, 0, 0, 0, 0, 0])[:, None, None]
    standing = np.array([0, 1, 1, 1, 1, 1, 1, 1, 1, 1, 0, 1], dtype=bool)[:, None]
    found = kind.variance(distance, standing, 0.25)[:, 0, 0]
    quiet = [False, False, False, True, True, True, False, False, False, True, False, False]
    noise = kind.pulse**2 / 6 + (0.2 * distance[:, 0, 0]) ** 2
    np.testing.assert_allclose(found, np.where(quiet, (0.3 * 0.25) ** 2, noise))


def fault(**table: Any) -> Any:
    return TypeAdapter(Fault).validate_python(table)


def readings(steps: int = 8, place: Any = None, clean: bool = True) -> Readings:
    rng = np.random.default_rng(7)
    y, truth = rng.normal(size=(steps, 3, RUNS)), rng.normal(size=(steps, 2, RUNS))
    names, none = ("position 1", "position 2", "speed"), np.zeros((steps, 3, RUNS), dtype=bool)
    return Readings(Sensing(names, np.array([1.0, 2.0, 0.5]), place), 1.0 + np.arange(steps), y, ~none,
                    rng.normal(size=y.shape) if clean else None, truth, none.copy(), none.copy())


def test_when_a_fault_is_there() -> None:
    time = np.arange(1.0, 13.0)
    inside, since = fault(kind="drift", **{"from": 3.0, "to": 6.0}).present(Drawn(), time)
    assert inside[:, 0].tolist() == [3 <= t < 6 for t in time] and (since == (time - 3.0)[:, None]).all()
    drawn = Drawn()
    kind = fault(kind="drift", every=3.0, lasts=2.0, **{"from": 2.0, "to": 11.0})
    inside, since = kind.present(drawn, time)
    chance = 1 - math.exp(-1 / 3)
    for run in range(RUNS):
        began = -math.inf
        for k, t in enumerate(time):
            if 2 <= t < 11 and t - began >= 2 and drawn.told[0][k, run] < chance:
                began = t
            assert inside[k, run] == (t - began < 2 and t < 11)
            assert since[k, run] == (t - began if inside[k, run] else 0.0)
    assert inside.any(axis=0).all() and not inside.all(axis=0).any()
    one = Drawn()  # a single step counts as a second
    assert (kind.present(one, time[4:5])[0][0] == (one.told[0][0] < chance)).all()


@pytest.mark.parametrize("told", [False, True])
@pytest.mark.parametrize("place", [None, (np.array([1.0, 0.0]), np.array([1.0, -2.0, 0.0]))])
def test_a_reading_that_jumps(place: Any, told: bool) -> None:
    """By its own unit, along the line where there is one; of named sensors also those that the line does not move."""
    for sensors, sizes in (((), [5.0, -10.0, 0.0] if place else [5.0] * 3), (("position",), [5.0, -10.0, 0.0] if place
                            else [5.0, 5.0, 0.0]), (("speed",), [0.0, 0.0, 5.0])):
        given = readings(place=place)
        before, truth = given.y.copy(), given.truth.copy()
        fault(kind="jump", size=5.0, truth=False, sensors=sensors, told=told, **{"from": 3.0, "to": 5.0}).apply(
            Drawn(), given)
        inside = np.array([t in (3.0, 4.0) for t in given.time])[:, None, None]
        np.testing.assert_array_equal(given.y, np.where(inside, before + np.array(sizes)[:, None], before))
        wrong = np.repeat(inside & (np.array(sizes) != 0)[:, None], RUNS, axis=2)
        assert np.array_equal(given.faulty, wrong) and np.array_equal(given.told, wrong & told)
        assert np.array_equal(given.truth, truth)


def test_a_vehicle_that_jumps() -> None:
    given = readings(place=(np.array([1.0, 0.0]), np.array([1.0, -2.0, 0.0])))
    before = given.truth.copy(), given.y.copy(), given.clean.copy()
    kind = fault(kind="jump", size=5.0, **{"from": 3.0})
    kind.apply(Drawn(), given)
    moved = np.where(given.time >= 3, 5.0, 0.0)[:, None, None]
    for found, old, along in zip((given.truth, given.y, given.clean), before, ([1.0, 0.0], [1.0, -2.0, 0.0],
                                                                              [1.0, -2.0, 0.0]), strict=True):
        np.testing.assert_array_equal(found, old + moved * np.array(along)[:, None])
    assert not given.faulty.any() and kind.ends() == 3.0 and kind.shift(3.0) == 5.0 and kind.shift(2.9) == 0.0
    assert fault(kind="jump", truth=False).ends() == math.inf and fault(kind="jump", truth=False).shift(9.0) == 0.0


@pytest.mark.parametrize("offset", [0.25, 2.0, -1.5, 100.0, -100.0])
@pytest.mark.parametrize("clean", [True, False])
def test_stamps_that_are_wrong(offset: float, clean: bool) -> None:
    given = readings(clean=clean)
    before = given.y.copy()
    fault(kind="stamps", offset=offset, sensors=["speed"], **{"from": 2.0, "to": 7.0}).apply(Drawn(), given)
    wanted = before.copy()
    for run in range(RUNS):
        base = before[:, 2, run] if given.clean is None else given.clean[:, 2, run]
        then = np.interp(given.time - offset, given.time, base)
        noise = 0.0 if given.clean is None else before[:, 2, run] - base
        wanted[1:6, 2, run] = (then + noise)[1:6]
    np.testing.assert_allclose(given.y, wanted, rtol=0, atol=1e-14)
    assert np.array_equal(np.argwhere(given.faulty), [[k, 2, run] for k in range(1, 6) for run in range(RUNS)])


@pytest.mark.parametrize(("table", "said"), [
    ({"kind": "drift", "from": 4.0, "to": 4.0}, "needs from < to, has from = 4 and to = 4"),
    ({"kind": "drift", "lasts": 4.0}, "lasts is used with every only: leave it out, or give every"),
    ({"kind": "drift", "lasts": 4.0, "every": 9.0}, ""), ({"kind": "drift", "from": 4.0, "to": 4.1}, "")])
def test_tables_of_faults_that_are_none(table: dict[str, Any], said: str) -> None:
    if not said:
        fault(**table)
        return
    with pytest.raises(ValidationError) as caught:
        fault(**table)
    assert [error["msg"] for error in caught.value.errors()] == [f"Value error, {said}"]


@pytest.mark.parametrize(("table", "following", "place", "said"), [
    ({"kind": "stuck"}, False, True, "stuck is not offered where readings are made as the loop goes"),
    ({"kind": "stuck"}, True, False, ""), ({"kind": "jump"}, True, True, ""), ({"kind": "drift"}, False, False, ""),
    ({"kind": "jump"}, False, True, "jump: the vehicle cannot be moved in a closed loop; allowed: truth = false"),
    ({"kind": "jump"}, True, False,
     "jump: this setting has no position along a line to move; allowed: truth = false"),
    ({"kind": "jump", "told": True, "to": 4.0}, True, True,
     "jump: to, told has no meaning where the vehicle itself moves: leave it out, or set truth = false"),
    ({"kind": "jump", "told": True, "to": 4.0, "truth": False}, False, False, ""),
    ({"kind": "jump", "truth": False, "sensors": ["x", "speed", "z"]}, True, True,
     "there is no sensor x, z; allowed: position 1, position 2, speed")])
def test_faults_that_fit_no_setting(table: dict[str, Any], following: bool, place: bool, said: str) -> None:
    along = (np.array([1.0, 0.0]), np.array([1.0, -2.0, 0.0])) if place else None
    sensing = readings(place=along).sensing
    if not said:
        fault(**table).check(sensing, following)
        return
    with pytest.raises(ValueError, match=f"^{re.escape(said)}$"):
        fault(**table).check(sensing, following)


@pytest.mark.parametrize("inflate", [0.5, 1.0, 1.5, 2.0])
def test_a_covariance_that_sensors_tell_stands_for_the_models(inflate: float) -> None:
    """Where it is told; a mode inflates either."""
    own = np.array([[2.0, 0.5], [0.5, 3.0]])[:, :, None]
    r = told(lambda step: step * own, inflate)
    here = Measurement(np.zeros((2, 2)), np.ones((2, 2), dtype=bool), 4)
    np.testing.assert_array_equal(r(here), inflate * 4 * own)
    said = np.full((2, 2, 2), np.nan)
    said[0, 0], said[1, :, 1], said[0, 1, 1] = [5.0, 6.0], [0.0, 7.0], 0.0
    expected = np.array([[[5.0, 6.0], [2.0, 0.0]], [[2.0, 0.0], [12.0, 7.0]]])
    np.testing.assert_array_equal(r(here._replace(covariance=said)), inflate * expected)


def test_places_heard_beside_a_linear_model() -> None:
    """They are of its first state and leave it linear and bounded, by three deviations; a radar's scale does not."""
    balise = {"location": [0.06, 1.0], "detection": 0.08}
    instruments = Instruments.model_validate({"gnss": {"told": 2.0}, "balise": balise})
    plain = linear(2)
    plain = replace(plain, bounds=Bounds(np.eye(3), np.ones(3), np.array([4.0, 5.0])))
    model, x = hearing(plain, ("balise", "gnss"), instruments, 0.1), np.ones((3, 2))
    form, old, bounds = model.linear, plain.linear, model.bounds
    assert form is not None and old is not None and bounds is not None and model.states == plain.states
    assert model.measurement_jacobian is not None and model.measurement_covariance is not None
    np.testing.assert_array_equal(form.C(3), np.concatenate([old.C(3), [[1.0, 0.0, 0.0]] * 2]))
    np.testing.assert_array_equal(form.C(3), model.measurement_jacobian(x, 3)[:, :, 0])
    R = np.diag([0.0, 0.0, 0.01, 4.0])
    R[:2, :2] = old.R(3)
    np.testing.assert_allclose(form.R(3), R, rtol=1e-12)
    np.testing.assert_allclose(model.measurement_covariance(untold(3, 4))[:, :, 0], R, rtol=1e-12)
    np.testing.assert_allclose(bounds.v_bar, [4.0, 5.0, 0.3, 6.0])
    for name in "ABhQ":
        np.testing.assert_array_equal(getattr(form, name)(3), getattr(old, name)(3))
    scaled = hearing(plain, ("balise", "radar"), instruments, 0.1)
    assert scaled.linear is None and scaled.bounds is None and scaled.states == (*plain.states, "scale-radar")
