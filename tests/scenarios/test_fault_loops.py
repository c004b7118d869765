"""Each kind of fault against a loop over runs, steps and elements; when it is there, to the billionth of a second.

The loops draw what the faults draw, in the same order from the same streams."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydantic import TypeAdapter, ValidationError
from railstate.scenarios import observation
from railstate.scenarios.arrays import Array, Mask
from railstate.scenarios.channels import Channel, Sent
from railstate.scenarios.faults import Fault, Readings, base, failing, noise, place
from railstate.scenarios.randomness import RunRandom, Streams
from railstate.scenarios.world import Sensing, Trajectory
from scipy.stats import chi2

STEPS, RUNS = 40, 5
TIMES = 0.5 * np.arange(1.0, STEPS + 1) + np.resize([0.0, 8e-10, -12e-10, 0.0, -8e-10, 12e-10, 0.0], STEPS)
SENSING = Sensing(("a 1", "a 2", "b"), np.array([1.0, 0.5, 2.0]), (np.array([0.0, 1.0]), np.array([1.0, 0.0, -2.0])))
EPISODES = {"from": 2.0, "to": 17.0, "every": 3.0, "lasts": 1.5}


def made(**table: Any) -> Any:
    return TypeAdapter(Fault).validate_python(table)


def stream() -> RunRandom:
    return RunRandom(4, ("fault",), range(RUNS))


def readings(clean: bool = True, where: bool = True, sd: Array = SENSING.sd) -> Readings:
    rng = np.random.default_rng(5)
    y, without = rng.normal(size=(2, STEPS, 3, RUNS))
    none = np.zeros(y.shape, dtype=bool)
    return Readings(Sensing(SENSING.names, sd, SENSING.place if where else None), TIMES, y, rng.random(y.shape) < 0.9,
                    without if clean else None, rng.normal(size=(STEPS, 2, RUNS)), none, none.copy())


def present(fault: base.Base, random: RunRandom, times: Array = TIMES) -> tuple[Mask, Array]:
    """By the definition: within [from, to), of episodes those that begin when none goes on."""
    end = math.inf if fault.to is None else fault.to
    inside, since = np.zeros((len(times), len(random.runs)), dtype=bool), np.zeros((len(times), len(random.runs)))
    chance = None if fault.every is None else random.uniform(0.0, 1.0, len(times))
    for run in range(len(random.runs)):
        began = -math.inf
        for k, time in enumerate(times):
            within = fault.from_ - 1e-9 <= time < end - 1e-9
            if chance is None or fault.every is None:
                inside[k, run], since[k, run] = within, time - fault.from_
                continue
            length = times[max(k, 1)] - times[max(k, 1) - 1] if len(times) > 1 else 1.0
            if chance[k, run] < -math.expm1(-length / fault.every) and within and time - began >= fault.lasts - 1e-9:
                began = time
            if within and time - began < fault.lasts - 1e-9:
                inside[k, run], since[k, run] = True, time - began
    return inside, since


@pytest.mark.parametrize("window", [{}, {"from": 2.0, "to": 17.0}, {"from": 3.0}, EPISODES, {"every": 2.0}])
def test_when_a_fault_is_there(window: dict[str, Any]) -> None:
    fault = made(kind="dropout", **window)
    assert fault.ends() == window.get("to", np.inf)
    for times in (TIMES, TIMES[:1]):
        for found, wanted in zip(fault.present(stream(), times), present(fault, stream(), times), strict=True):
            assert_array_equal(found, wanted)


class Given:
    """Draws one array after the other, of one run."""

    runs = (0,)

    def __init__(self, *draws: list[float]) -> None:
        self.draws = list(draws)

    def uniform(self, low: float, high: float, *shape: int) -> Array:
        assert (low, high) == (0.0, 1.0)
        return np.reshape(self.draws.pop(0), (*shape, 1)).astype(float)


def test_where_a_fault_begins_and_ends_to_the_bit() -> None:
    """From `from`, a billionth of a second before it; to `to`, likewise; an episode as long as it lasts."""
    def there(times: list[float], *draws: list[float], **window: float) -> list[bool]:
        return made(kind="drift", **window).present(Given(*draws), np.array(times))[0][:, 0].tolist()

    begin, end = 2.0 - 1e-9, 17.0 - 1e-9
    times = [2.0 - 1.2e-9, np.nextafter(begin, 0.0), begin, 2.0, 17.0 - 1.2e-9, np.nextafter(end, 0.0), end, 17.0]
    assert there(times, **{"from": 2.0, "to": 17.0}) == [False, False, True, True, True, True, False, False]
    jump = made(**{"kind": "jump", "from": 2.0, "size": 3.0})
    assert jump.shift(np.array(times[:4])).tolist() == [0.0, 0.0, 3.0, 3.0]
    lasts = 1.5 - 1e-9
    for last, draw, inside in ((lasts, 0.0, True), (lasts, 1.0, False), (np.nextafter(lasts, 0.0), 1.0, True)):
        assert there([0.0, last], [0.0, draw], every=2.0, lasts=1.5) == [True, inside]
    assert there([0.0, 1.0, 1.5 - 1.2e-9], [0.0, 1.0, 0.0], every=2.0, lasts=1.5) == [True, True, True]
    for times, length in (([0.5, 1.0], 0.5), ([3.0], 1.0)):  # a run of one step has no other to tell its length
        share = -np.expm1(-length / 2.0)
        for draw, begins in ((share, False), (np.nextafter(share, 0.0), True)):
            assert there(times, [draw, *[1.0] * (len(times) - 1)], every=2.0)[0] is begins


def test_a_draw_that_is_the_share_is_no_outlier() -> None:
    none = np.zeros((3, 1, 1), dtype=bool)
    given = Readings(Sensing(("a",), np.ones(1)), np.arange(3.0), np.zeros((3, 1, 1)), ~none, None, None, none,
                     none.copy())
    below = [0.25, float(np.nextafter(0.25, 0)), 0.0]
    made(kind="outliers", share=0.25, size=2.0).apply(Given(below, [0.0, 0.5, float(np.nextafter(0.5, 0))]), given)
    assert given.y.ravel().tolist() == [0.0, -2.0, 2.0] and given.faulty.ravel().tolist() == [False, True, True]


def outliers(fault: noise.Outliers, random: RunRandom, given: Readings, elements: list[int]) -> Mask:
    chance, up = (random.uniform(0.0, 1.0, STEPS, len(elements)) for _ in range(2))
    hit, inside = np.zeros(given.y.shape, dtype=bool), present(fault, random)[0]
    for k, i, run in np.ndindex(STEPS, len(elements), RUNS):
        if chance[k, i, run] < fault.share and inside[k, run]:
            off = fault.size * np.broadcast_to(given.sensing.sd, (STEPS, 3))[k, elements[i]]
            given.y[k, elements[i], run] += off if up[k, i, run] < 0.5 or fault.sign == "plus" else -off
            hit[k, elements[i], run] = True
    return hit


def student(fault: noise.StudentT, random: RunRandom, given: Readings, elements: list[int]) -> None:
    chance, inside = random.uniform(0.0, 1.0, STEPS, len(elements)), present(fault, random)[0]
    wide = np.sqrt(fault.dof / chi2(fault.dof).ppf(1 - chance))
    assert given.clean is not None
    for k, i, run in np.ndindex(STEPS, len(elements), RUNS):
        if inside[k, run]:
            clean = given.clean[k, elements[i], run]
            given.y[k, elements[i], run] = clean + (given.y[k, elements[i], run] - clean) * wide[k, i, run]


def each(fault: Any, random: RunRandom, given: Readings, elements: list[int]) -> Mask:
    """Those of which all elements of the fault are faulty alike."""
    bad = np.ones((STEPS, RUNS), dtype=bool)
    if fault.kind == "burst":
        chance = random.uniform(0.0, 1.0, STEPS)
        for run in range(RUNS):
            for k in range(STEPS):
                share = fault.p_good_bad / (fault.p_good_bad + fault.p_bad_good)
                stays, turns = 1 - fault.p_bad_good, fault.p_good_bad
                bad[k, run] = (chance[k, run] < share if k == 0 else
                               chance[k, run] >= 1 - stays if bad[k - 1, run] else chance[k, run] < turns)
    inside, since = present(fault, random)
    for run in range(RUNS):
        for i in elements:
            held = np.nan
            for k in range(STEPS):
                if fault.kind in ("dropout", "burst"):
                    given.there[k, i, run] &= not (inside[k, run] and bad[k, run])
                    continue
                if not inside[k, run]:
                    continue
                if fault.kind == "drift":
                    given.y[k, i, run] += fault.rate * since[k, run]
                elif fault.kind == "jump":
                    along = 1.0 if given.sensing.place is None else given.sensing.place[1][i]
                    given.y[k, i, run] += fault.size * (along or 1.0)
                elif k == 0 or not inside[k - 1, run] or since[k, run] <= since[k - 1, run]:
                    held = given.y[k, i, run]
                else:
                    given.y[k, i, run] = held
    hit = np.zeros(given.y.shape, dtype=bool)
    hit[:, elements] = False if fault.kind in ("dropout", "burst") else inside[:, None]
    return hit


KINDS = [{"kind": "outliers", "share": 0.4, "size": 3.0}, {"kind": "outliers", "share": 0.5, "sign": "plus"},
         {"kind": "student-t", "dof": 2.5}, {"kind": "stuck"}, {"kind": "drift", "rate": 0.25}, {"kind": "dropout"},
         {"kind": "burst", "p_good_bad": 0.2, "p_bad_good": 0.6}, {"kind": "jump", "truth": False, "size": 4.0}]


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind["kind"])
@pytest.mark.parametrize("more", [
    {}, EPISODES, {"every": 1.0, "lasts": 0.25}, {"sensors": ["a"], "to": 4.0, "told": True}, {"sensors": ["a 2"]}],
    ids=["all", "episodes", "short", "told", "one"])
def test_every_kind_is_its_loop(kind: dict[str, Any], more: dict[str, Any]) -> None:
    more = {key: value for key, value in more.items() if key != "told" or kind["kind"] != "student-t"}
    fault = made(**kind, **more)
    sd = np.linspace(1.0, 2.0, 3 * STEPS).reshape(STEPS, 3) if "every" in more else SENSING.sd
    found, wanted = readings(sd=sd), readings(sd=sd)
    names = {"a": [0, 1], "a 2": [1]}
    elements = names[more["sensors"][0]] if "sensors" in more else [0, 2] if kind["kind"] == "jump" else [0, 1, 2]
    fault.check(found.sensing)
    fault.apply(stream(), found)
    loop: Any = {"outliers": outliers, "student-t": student}.get(kind["kind"], each)
    hit = loop(fault, stream(), wanted, elements)
    assert_allclose(found.y, wanted.y, rtol=1e-12, atol=1e-14)
    assert_array_equal(found.there, wanted.there)
    assert_array_equal(found.faulty, np.zeros(found.y.shape, dtype=bool) if hit is None else hit)
    assert_array_equal(found.told, found.faulty & fault.told)
    assert_array_equal(found.truth, wanted.truth)  # pyright: ignore


@pytest.mark.parametrize("clean", [True, False])
@pytest.mark.parametrize(("offset", "window"), [(0.75, EPISODES), (-1.25, EPISODES), (0.25, {}), (-0.25, {})])
def test_wrong_stamps_are_a_straight_line_between_steps(clean: bool, offset: float, window: dict[str, Any]) -> None:
    """Of the noise-free readings where those are known, the noise staying; before the first step it is the first."""
    fault = made(kind="stamps", offset=offset, sensors=["b"], **window)
    found, given = readings(clean), readings(clean)
    fault.apply(stream(), found)
    inside, wanted = present(fault, stream())[0], given.y.copy()
    for k, run in np.argwhere(inside):
        values = given.y[:, 2, run] if given.clean is None else given.clean[:, 2, run]
        wanted[k, 2, run] += np.interp(TIMES[k] - offset, TIMES, values) - values[k]
    assert_allclose(found.y, wanted, rtol=1e-12, atol=1e-12)
    assert_array_equal(found.faulty[:, 2], inside)
    assert not found.faulty[:, :2].any() and not found.told.any()
    one = Readings(SENSING, TIMES[:1], *(np.ones((1, 3, 1), dtype=kind) for kind in (float, bool)), None, None,
                   *np.zeros((2, 1, 3, 1), dtype=bool))
    made(kind="stamps", offset=offset).apply(RunRandom(1, ("f",), [0]), one)
    assert_array_equal(one.y, np.ones((1, 3, 1)))


def test_a_vehicle_that_is_somewhere_else() -> None:
    """Truth and readings move by what a metre along the line makes of them, the readings are right."""
    fault = made(**{"kind": "jump", "size": 1.0, "from": 3.0})
    assert fault.ends() == 3.0 and made(kind="jump", truth=False).ends() == np.inf
    gone = [time >= 3.0 - 1e-9 for time in TIMES]
    assert_array_equal(fault.shift(TIMES), np.where(gone, 1.0, 0.0))
    assert made(kind="jump", truth=False).shift(TIMES) == 0.0
    for clean in (True, False):
        found, wanted = readings(clean), readings(clean)
        fault.apply(stream(), found)
        assert wanted.truth is not None
        for k in np.flatnonzero(gone):
            wanted.truth[k, 1] += 1.0
            for values in (wanted.y, *([] if wanted.clean is None else [wanted.clean])):
                values[k, 0] += 1.0
                values[k, 2] -= 2.0
        for mine, theirs in ((found.truth, wanted.truth), (found.y, wanted.y), (found.clean, wanted.clean),
                             (found.there, wanted.there), (found.faulty, wanted.faulty)):
            assert (mine is None and theirs is None) or np.array_equal(mine, theirs)  # pyright: ignore
    nowhere, given = readings(where=False), readings(where=False)
    made(kind="jump", size=4.0, truth=False).apply(stream(), nowhere)
    assert_array_equal(nowhere.y, given.y + 4.0)
    assert nowhere.faulty.all()


@pytest.mark.parametrize(("table", "following", "where", "said"), [
    ({"kind": "stuck"}, False, True, "stuck is not offered where readings are made as the loop goes"),
    ({"kind": "stuck"}, True, False, ""), ({"kind": "drift"}, False, False, ""),
    ({"kind": "jump"}, False, True, "jump: the vehicle cannot be moved in a closed loop; allowed: truth = false"),
    ({"kind": "jump"}, True, False,
     "jump: this setting has no position along a line to move; allowed: truth = false"),
    ({"kind": "jump", "truth": False}, False, False, ""), ({"kind": "jump", "from": 3.0}, True, True, ""),
    ({"kind": "jump", "sensors": ["b"], "to": 9.0, "told": True, "every": 2.0, "lasts": 1.0}, True, True,
     "jump: every, lasts, sensors, to, told has no meaning where the vehicle itself moves: leave it out, or set truth "
     "= false"),
    ({"kind": "student-t", "told": True}, True, True,
     "told: heavy tails have no single faulty readings to tell of: leave it out"),
    ({"kind": "student-t"}, False, True, "student-t is not offered where readings are made as the loop goes"),
    ({"kind": "student-t", "sensors": ["c", "a 1", "d"]}, True, True,
     "there is no sensor c, d; allowed: a 1, a 2, b")])
def test_which_faults_a_setting_takes(table: dict[str, Any], following: bool, where: bool, said: str) -> None:
    sensing, fault = Sensing(SENSING.names, SENSING.sd, SENSING.place if where else None), made(**table)
    if not said:
        fault.check(sensing, following)
        return
    with pytest.raises(ValueError) as caught:
        fault.check(sensing, following)
    assert str(caught.value) == said


def test_entries_in_order() -> None:
    for table, said in (({"from": 2.0, "to": 2.0}, "needs from < to, has from = 2 and to = 2"),
                        ({"lasts": 2.0}, "lasts is used with every only: leave it out, or give every")):
        with pytest.raises(ValidationError) as caught:
            made(kind="drift", **table)
        assert [error["msg"] for error in caught.value.errors()] == [f"Value error, {said}"]
    assert made(**{"kind": "drift", "from": 2.0, "to": 2.1}).label == "drift"
    assert made(kind="drift", name="mine", every=1.0, lasts=2.0).label == "mine"


def test_what_is_heard_in_the_end() -> None:
    """After the faults the channel; the truth where the vehicle has been moved."""
    given, streams = readings(), Streams(4, "s", "v", range(RUNS))
    assert given.truth is not None
    before = Trajectory(given.truth, np.zeros((STEPS, 0, RUNS)), given.y, given.there,
                        np.ones((STEPS, RUNS), dtype=bool), np.full(STEPS, 0.5), np.zeros((2, RUNS)))
    late: Any = TypeAdapter(Channel).validate_python({"kind": "delay", "steps": [0, 2]})
    for faults in ([], [made(kind="drift", told=True, to=4.0)], [made(kind="jump", size=1.0)]):
        heard = observation.observe(before, streams, given.sensing, late, faults, given.clean)
        wrong = observation.faulted(given.y, given.there, np.cumsum(before.lengths), streams, given.sensing, faults,
                                    given.clean, given.truth)
        arrived = late.carry(streams, Sent(wrong.y, wrong.there, given.sensing.sd))
        for found, wanted in ((heard.y, arrived.y), (heard.received, arrived.received), (heard.late, arrived.late),
                              (heard.truth, wrong.truth), (heard.faulty, wrong.faulty if faults else None)):
            assert (found is None and wanted is None) or np.array_equal(found, wanted)
        assert (heard.u is before.u, heard.active is before.active) == (True, True)
    bare = observation.faulted(given.y, given.there, TIMES, streams, given.sensing, [made(kind="drift")])
    assert bare.truth is None and bare.clean is None


def test_what_faults_leave_alone() -> None:
    """Without any, the arrays themselves; with some, copies, and what is told is not there."""
    given, streams = readings(), Streams(4, "s", "v", range(RUNS))
    arrays = given.y, given.there, TIMES, streams, given.sensing
    plain = observation.faulted(*arrays, [], given.clean, given.truth)
    assert (plain.y is given.y, plain.there is given.there, plain.truth is given.truth, plain.clean is given.clean) == (
        True, True, True, True)
    assert plain.faulty.shape == plain.told.shape == (0, 3, RUNS) and plain.following
    faults: Any = [made(kind="drift", name="mine", told=True, sensors=["b"], **EPISODES), made(kind="dropout", to=2.0)]
    found = observation.faulted(*arrays, faults, given.clean, given.truth, False)
    wanted = readings()
    told = each(faults[0], streams("fault", "mine"), wanted, [2])
    each(faults[1], streams("fault", "dropout"), wanted, [0, 1, 2])
    assert_allclose(found.y, wanted.y, rtol=1e-15)
    assert_array_equal(found.there, wanted.there & ~told)
    assert_array_equal(found.faulty, told)
    assert not found.following and found.told is not found.faulty
    assert_array_equal(given.y, readings().y)
    assert_array_equal(given.there, readings().there)
    assert found.truth is not given.truth and found.clean is not given.clean
    for kind in (failing.Stuck, failing.Drift, place.Stamps, noise.StudentT):
        assert kind.beforehand == (kind is not failing.Drift)


def test_a_jump_of_which_nothing_is_said_moves_the_vehicle() -> None:
    jump = TypeAdapter(Fault).validate_python({"kind": "jump", "from": 5.0})
    assert np.asarray(jump.shift(np.array([4.0, 5.0, 6.0]))).tolist() == [0.0, 30.0, 30.0] and jump.ends() == 5.0
