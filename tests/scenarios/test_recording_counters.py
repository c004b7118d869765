"""Counters that fall, and columns of a recording against each other: made by hand, to the edge of each rule."""

from __future__ import annotations

import math
import re
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from railstate.scenarios.recorded.against import FACTORS, against, compared
from railstate.scenarios.recorded.counters import step_of, unwound

NAN = math.nan
LOST = "m at t = 2 s: taken as a reset, the way in between is lost (if its counter wraps: wrap = METRES)"
NEITHER = "wrap = METRES where its counter wraps, or leave the place out (--without)"


@pytest.mark.parametrize(("counted", "wrap", "found", "said"), [
    ([0, 10, NAN, 5, 20], None, [0, 10, NAN, 5, 20], []),  # 5 m and the way of the fastest train: a way back
    ([1000, 1200, 20, 30], None, [1000, 1200, 1200, 1210], [f"the odometer falls from 1200 to 20 {LOST}"]),
    ([1000, 1200, 24, 30], None, [1000, 1200, 1200, 1206], [f"the odometer falls from 1200 to 24 {LOST}"]),
    ([100, 200, 5, 9], None, [100, 200, 200, 204], [f"the odometer falls from 200 to 5 {LOST}"]),
    ([900, 990, 5, 30], 1000.0, [900, 990, 1005, 1030], ["the odometer wrapped 1 times at 1000 m"]),
    ([900, 990, 160, 170], 1000.0, [900, 990, 1160, 1170], ["the odometer wrapped 1 times at 1000 m"]),
    ([900, 999, 0, NAN, 990, 985, 2], 1000.0, [900, 999, 1000, NAN, 1990, 1985, 2002],
     ["the odometer wrapped 2 times at 1000 m"]),
    ([2500, 2600, 595, 600], 1000.0, [2500, 2600, 2595, 2600], ["the odometer wrapped 1 times at 1000 m"]),
    ([9000.0, 9100.0, 9000.0], 50.0, [9000, 9100, 9000], [])])
def test_a_counter_that_falls(counted: Any, wrap: float | None, found: Any, said: list[str]) -> None:
    out, told = unwound("a.csv", np.arange(float(len(counted))), np.array(counted, dtype=float), wrap)
    np.testing.assert_array_equal(out, np.array(found, dtype=float))
    assert told == said


@pytest.mark.parametrize(("counted", "wrap", "said"), [
    ([1000, 1200, 24.1], None, f"the wheel falls from 1200 to 24.1 m at t = 2 s: {NEITHER}"),
    ([100, 200, 5.1], None, f"the wheel falls from 200 to 5.1 m at t = 2 s: {NEITHER}"),
    ([100, 200, -0.5], None, f"the wheel falls from 200 to -0.5 m at t = 2 s: {NEITHER}"),
    ([900, 990, 170], 1000.0, "the wheel falls from 990 to 170 m at t = 2 s: wrap = 1000 does not explain it"),
    ([2500, 2600, 594], 1000.0, "the wheel falls from 2600 to 594 m at t = 2 s: wrap = 1000 does not explain it"),
    ([900, 990, 600], 1000.0, "the wheel falls from 990 to 600 m at t = 2 s: wrap = 1000 does not explain it")])
def test_a_fall_that_nothing_explains(counted: Any, wrap: float | None, said: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(f'a.csv: {said}')}$"):
        unwound("a.csv", np.arange(float(len(counted))), np.array(counted, dtype=float), wrap, "wheel")


def test_the_step_of_a_counter() -> None:
    """Where it stands still at more than a tenth of the samples at over 1 m/s; a standing train tells nothing."""
    counted = np.array([0.0, 5, 5, 10, NAN, 15, 25, 25, 25])
    assert step_of(counted, np.full(9, 1.1)) == 5.0 and step_of(0.1 * counted, np.full(9, 1.1)) == 0.5
    assert step_of(counted, np.array([2, 2, 1.0, 2, 2, 2, 2, 1.0, 1.0])) == 0.0
    ten = np.concatenate([[0.0], np.cumsum([3.0] * 9 + [0.0])])
    assert step_of(ten, np.full(11, 9.0)) == 0.0 and step_of(ten[1:], np.full(10, 9.0)) == 3.0
    assert step_of(np.full(5, 3.0), np.full(5, 9.0)) == 0.0 and step_of(np.zeros(0), np.zeros(0)) == 0.0


TIME = np.arange(0.0, 100.0)
PLACE = 1000.0 + np.cumsum(10 + 3 * np.sin(TIME / 7))
PACE = np.gradient(PLACE, TIME)


@pytest.mark.parametrize(("factor", "units"), FACTORS.items())
def test_a_unit_that_is_another(factor: float, units: str) -> None:
    edges = (0.955, 1.0, 1.045) if factor in (60.0, 1000.0) else (1.0,)  # others lie side by side
    for by in [edge * of for edge in edges for of in (factor, 1 / factor)]:
        found, = against(TIME, {"odometer": by * PLACE, "position": PLACE})
        assert (found.grade, found.role) == ("impossible", "odometer")
        assert found.text == (f"the way by odometer is {by:.4g} times the way by position: the factor between {units} "
                              f"({factor:g}): the unit of one of them is another")
    for by in [edge * of for edge in (0.945, 1.055) for of in (factor, 1 / factor)]:
        found, = against(TIME, {"odometer": by * PLACE, "position": PLACE})
        assert found.text.startswith(f"the way by odometer is {by:.4g} times the way by position") and (
            units not in found.text)


def told(**columns: Any) -> list[tuple[str, str, str]]:
    return [(found.grade, found.role, found.text) for found in against(TIME, {
        name.replace("wheel_", "wheel-"): values for name, values in columns.items()})]


def test_columns_that_go_apart() -> None:
    assert told(speed=PACE, position=PLACE) == told(odometer=1.249 * PLACE, position=PLACE) == []
    assert told(odometer=1.26 * PLACE, position=PLACE) == [
        ("odd", "odometer", "the way by odometer is 1.26 times the way by position")]
    assert told(odometer=0.74 * PLACE, position=PLACE) == [
        ("odd", "odometer", "the way by odometer is 0.74 times the way by position")]
    assert told(wheel_a=-PLACE, wheel_b=PLACE) == [
        ("impossible", "wheel-a", "wheel-a and wheel-b go in opposite directions: a minus turns one "
         "(--map wheel-a=-COLUMN)")]
    assert told(speed=PLACE, position=PACE) == [
        ("impossible", "speed", "speed and position do not go together: the two columns have changed places")]
    other = 1000.0 + np.cumsum(10 * np.sin(TIME / 3) + 1)
    ratio, together = compared(TIME, other, PLACE)
    assert together < 0.5 and told(odometer=other, position=PLACE) == [
        ("odd", "odometer", f"odometer and position do not go together (correlation {together:.2f})")]
    assert ratio == pytest.approx(compared(TIME, 2 * other, 2 * PLACE)[0])


def test_acceleration_against_the_change_of_speed() -> None:
    pull = np.gradient(PACE, TIME)
    assert told(acceleration=pull, speed=PACE, reference_speed=5 * PACE)[1:] == told(
        acceleration=1.1 * pull, reference_speed=PACE) == []
    assert told(acceleration=-pull, speed=PACE) == [
        ("odd", "acceleration", "acceleration has the opposite sign of the change of speed")]
    (grade, role, text), = told(acceleration=pull / 9.80665, reference_speed=PACE)
    assert (grade, role) == ("impossible", "acceleration") and text == (
        "the integral of acceleration is 0.1015 times the change of reference_speed: the factor between g and m/s^2 "
        "(9.80665)")


def test_ways_that_tell_nothing() -> None:
    """Fewer than four values in common, or less than 20 m of way; increments are those over parts of the trip."""
    assert np.isnan(compared(TIME[:3], PLACE[:3], PLACE[:3])).all()
    assert compared(TIME[:4], PLACE[:4], 2 * PLACE[:4]) == pytest.approx((0.5, 1.0))
    assert np.isnan(compared(TIME, 0.19 * TIME, 0.2 * TIME)).all()
    assert compared(TIME, 0.19 * TIME, 0.21 * TIME) == pytest.approx((19 / 21, 1.0))
    assert compared(TIME, 0.19 * TIME, 0.2 * TIME, 19.0) == pytest.approx((0.95, 1.0))
    assert np.isnan(compared(TIME, np.zeros(100), PLACE)).all() and np.isnan(compared(TIME, PLACE, np.zeros(100))).all()
    jump = PLACE + 1000.0 * (TIME > 50)
    ratio, together = compared(TIME, jump, PLACE)
    assert ratio == pytest.approx(1.0) and together < 0.5


def textbook(time: Any, one: Any, other: Any, least: float) -> tuple[float, float]:
    """Ratio and correlation of two ways by loops over the parts of the trip."""
    there = [k for k in range(len(time)) if math.isfinite(one[k]) and math.isfinite(other[k])]
    if len(there) < 4:
        return NAN, NAN
    ends = np.linspace(time[there[0]], time[there[-1]], 25)
    cuts = sorted({next(k for k in there if time[k] >= end) for end in ends})
    parts = [(one[b] - one[a], other[b] - other[a]) for a, b in pairwise(cuts)]
    largest = max(max(abs(a), abs(b)) for a, b in parts)
    use = [(a, b) for a, b in parts if max(abs(a), abs(b)) > 0.02 * largest]
    ways = [sum(abs(a) for a, _ in parts), sum(abs(b) for _, b in parts)]
    if len(use) < 3 or min(ways) < 1e-3 * least or sum(max(abs(a), abs(b)) for a, b in parts) < least:
        return NAN, NAN
    ratios, passed = sorted((a / b, abs(b)) for a, b in use if b), 0.0
    for ratio, weight in ratios:  # noqa: B007
        passed += weight
        if passed >= sum(weight for _, weight in ratios) / 2:
            break
    total = math.sqrt(sum(a * a for a, _ in use) * sum((ratio * b) ** 2 for _, b in use))
    return ratio, sum(a * abs(ratio) * b for a, b in use) / total if total else 0.0


def test_two_ways_by_loops() -> None:
    """Gaps, stands, jumps and ways of little more or less than what tells something."""
    rng, known = np.random.default_rng(4), 0
    for case in range(150):
        n = int(rng.integers(3, 70))
        time = np.cumsum(rng.choice([0.5, 1.0, 7.0], n))
        steps = rng.normal(1.0, 1.0, (2, n)) * rng.choice([0.0, 1.0], (2, n), p=[0.2, 0.8]) * rng.choice([1, -1, 30])
        one, other = np.cumsum(steps * rng.choice([0.02, 0.3, 1.0, 9.0]), axis=1)
        one = one if case % 3 else other * rng.choice([0.5, -3.6]) + rng.choice([0, 500]) * (time > time[n // 2])
        one, other = np.where(rng.random(n) < 0.1, NAN, one), np.where(rng.random(n) < 0.1, NAN, other)
        found = compared(time, one, other)
        assert found == pytest.approx(textbook(time, one, other, 20.0), rel=1e-9, nan_ok=True)
        known += not math.isnan(found[0])
    assert 60 < known < 140


def test_ways_that_just_tell_something() -> None:
    time, whole = np.arange(5.0), np.array([0.0, 10, 20, 30, 30.0])
    for little, ratio in ((0.019, NAN), (0.021, 7e-4)):  # 20 m and a thousandth of it
        assert compared(time, whole * little / 30, whole)[0] == pytest.approx(ratio, nan_ok=True)
        assert np.isnan(compared(time, whole, whole * little / 30)[0]) == math.isnan(ratio)
    for step, count in ((1.0, 2), (1.01, 3)):  # a fiftieth of the largest part does not count
        way = np.array([0.0, 50, 100, 100 + step])
        assert np.isnan(compared(time[:4], way, way)[0]) == (count < 3)


def mixed(together: float, by: float = 1.0) -> list[tuple[str, str, str]]:
    """Of 24 parts a way of 100 m and one that is now longer, now shorter, so that they are correlated like this."""
    sign, time = np.where(np.arange(24) % 2, 1.0, -1.0), np.arange(25.0)
    parts = by * 100.0 * (together + math.sqrt(1 - together**2) * sign)
    ways = {"odometer": np.cumsum([0.0, *parts]), "position": 100.0 * time}
    assert compared(time, *ways.values())[1] == pytest.approx(together)
    return [(found.grade, found.role, found.text) for found in against(time, ways)]


def test_how_far_columns_may_go_apart() -> None:
    turned = ("impossible", "odometer", "odometer and position go in opposite directions: a minus turns one (--map "
              "odometer=-COLUMN)")
    assert mixed(-0.51) == mixed(-0.9, 1.5) == [turned]
    for together in (-0.49, 0.0, 0.49):
        assert mixed(together, 1.5) == [
            ("odd", "odometer", f"odometer and position do not go together (correlation {together:.2f})")]
    assert mixed(0.51, 0.5) == [("odd", "odometer", "the way by odometer is 0.1751 times the way by position")]
    rare = np.where(np.arange(24) == 5, -900.0, 100.0)  # most of it along, all in all against
    time = np.arange(25.0)
    found, = against(time, {"odometer": np.cumsum([0.0, *rare]), "position": 100.0 * time})
    assert (found.grade, found.text) == ("odd", "odometer and position do not go together (correlation 0.28)")
    rare = np.where(np.arange(24) < 11, -100.0, 2.0)  # against, but for the most part a little along
    found, = against(time, {"odometer": np.cumsum([0.0, *rare]), "position": 100.0 * time})
    assert (found.grade, found.text) == ("odd", "odometer and position do not go together (correlation -0.66)")
    for by, changed in ((1.2, True), (1.3, False), (0.8, True), (0.7, False), (3.6, True), (3.0, False)):
        text, = [text for _, role, text in told(speed=PLACE / by, position=PACE) if role == "speed"]
        assert text.startswith("speed and position do not go together: the two columns have changed places") == changed


def test_an_accelerometer_that_goes_with_speed_or_does_not() -> None:
    pull, other = np.gradient(PACE, TIME), np.cos(TIME / 2.3) / 3
    seen = list[float]()
    for angle in np.linspace(0, np.pi, 60):
        reading = np.cos(angle) * pull + np.sin(angle) * other
        way = np.concatenate([[0.0], np.cumsum((reading[1:] + reading[:-1]) / 2)])
        scale = 9.80665 / abs(compared(TIME, way, PACE, 2.0)[0])
        for unit in (scale, 1.1 * scale):
            ratio, together = compared(TIME, unit * way, PACE, 2.0)
            found, seen = told(acceleration=unit * reading, speed=PACE), [*seen, together]
            if together > 0.6 and abs(ratio / 9.80665 - 1) < 0.05:
                assert found == [("impossible", "acceleration", f"the integral of acceleration is {ratio:.4g} times "
                                  "the change of speed: the factor between g and m/s^2 (9.80665)")]
            else:
                assert found == ([("odd", "acceleration", "acceleration has the opposite sign of the change of speed")]
                                 if together < -0.6 and ratio < 0 else [])
    for low, high in ((-0.9, -0.6), (-0.6, -0.4), (0.4, 0.6), (0.6, 0.9)):
        assert any(low < together < high for together in seen)
