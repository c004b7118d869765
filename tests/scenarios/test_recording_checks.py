"""What is said of columns that cannot be, or are odd: a sound ride spoilt in one way at a time, every finding whole."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from railstate.scenarios.arrays import Array
from railstate.scenarios.recorded.checks import _jumping, _offside, examine

Columns = dict[str, Array]


def ride(steps: int = 400) -> tuple[Array, Columns]:
    """A trip with a stop in its middle: uneven in no way, every column fits the others."""
    time = np.arange(steps, dtype=float)
    speed = np.clip(np.minimum(0.5 * time, 0.4 * np.abs(time - steps / 2) - 4.0), 0.0, 20.0)
    speed = np.minimum(speed, 0.6 * (steps - 1 - time)) + 1e-3 * np.sin(time) * (speed > 0)
    way = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2)])
    return time, {"position": 100.0 + way, "speed": speed, "odometer": way.copy(),
                  "acceleration": np.gradient(speed, time), "reference_position": 100.0 + way + 0.1 * np.cos(time)}


def put(columns: Columns, role: str, where: int | slice, value: float | Array, more: bool = False) -> None:
    """Change some values of a column, or add to them."""
    columns[role] = columns[role].copy()
    columns[role][where] = columns[role][where] + value if more else value


def spoilt() -> dict[str, tuple[Array, Columns, Columns]]:
    """Recordings by what is wrong with them: time, columns, what sensors tell."""
    found: dict[str, tuple[Array, Columns, Columns]] = {}

    def add(name: str, change: Callable[[Columns], object] | None = None, clock: Callable[[Array], Array] | None = None,
            told: Columns | None = None, steps: int = 400) -> None:
        time, columns = ride(steps)
        if change is not None:
            change(columns)
        found[name] = (time if clock is None else clock(time)), columns, told or {}

    add("sound")
    add("three rows", steps=3)
    add("four rows", steps=4)
    for unit, factor in (("ns", 1e9), ("ms", 1e3), ("us as s", 1e-6)):
        add(f"time in {unit}", clock=lambda time, factor=factor: factor * time)
    add("an hour off", clock=lambda time: time + 3600.0 * (time > 120))
    add("two hours off", clock=lambda time: time + 3600.0 * (time > 120) - 0.0 + 3600.0 * (time > 200) + 3600.0 * (
        time > 300))
    add("a gap", clock=lambda time: time + 11.0 * (time > 250))
    add("no gap yet", clock=lambda time: time + 9.0 * (time > 250))
    add("gaps", clock=lambda time: time + 20.0 * (time > 150) + 30.0 * (time > 300))
    for name, clock in {
            "just a gap": lambda time: time + 10.0 * (time > 250), "steps of 0.25 s": lambda time: 0.25 * time,
            "a gap of 5 s": lambda time: 0.25 * time + 4.75 * (time > 250),
            "a gap over 5 s": lambda time: 0.25 * time + 5.0 * (time > 250),
            "minutes": lambda time: 100.0 * time, "longer": lambda time: 200.0 * time, "Ms": lambda time: 1e6 * time,
            "an hour, nearly": lambda time: time + 3658.0 * (time > 120),
            "no hour": lambda time: time + 3659.0 * (time > 120),
            "an hour of steps": lambda time: 190.0 * time + 3450.0 * (time > 120),
            "an hour of many": lambda time: 170.0 * time + 3450.0 * (time > 120),
            "just even": lambda time: time - 0.5 * (time % 2),
            "few long": lambda time: time + 3.0 * np.floor(time / 18),
            "few short": lambda time: time - 0.8 * np.floor(time / 16)}.items():
        add(name, clock=clock, steps=1000 if name == "minutes" else 400)
    for value in (-9999.0, 5000.0, 9e8, 1e9):
        add(f"all but one {value:g}", lambda columns, value=value: put(columns, "position", slice(1, None), value))
        add(f"none but {value:g}", lambda columns, value=value: put(columns, "position", slice(None), value))
    for left in (2, 3, 4):
        add(f"{left} there, of them two huge", lambda columns, left=left: [
            put(columns, "position", slice(left, None), np.nan), put(columns, "position", slice(2), 2e9)])
        add(f"{left} there, far apart", lambda columns, left=left: [
            put(columns, "position", slice(left, None), np.nan), put(columns, "position", 1, 5e3)])
    add("three sound", lambda columns: [put(columns, "position", slice(4, None), np.nan), put(
        columns, "position", 0, 2e9), put(columns, "position", 3, 5e3)])
    for role in ("position", "balise", "reference_position"):
        for pace in (0.3, 0.29):
            add(f"{role} at {pace} m/s", lambda columns, role=role, pace=pace: columns.update(
                {role: pace * np.arange(400.0)}))
    add("5 m in all", lambda columns: put(columns, "position", slice(None), np.linspace(0.0, 5.0, 400)))
    add("slow for a minute", lambda columns: put(columns, "position", slice(None), np.linspace(0.0, 6.0, 61)), steps=61)
    add("slow for longer", lambda columns: put(columns, "position", slice(None), np.linspace(0.0, 6.0, 62)), steps=62)
    for pace in (3.0, 3.5):
        for name, place in (("then", np.minimum(pace * np.arange(120.0), pace * 60)),
                            ("before", np.maximum(pace * np.arange(120.0), pace * 60))):
            found[f"still {name} at {pace} m/s"] = np.arange(120.0), {"position": place}, {}
    for value in (-9999.0, 9999.0):
        for least, most in ((9100.0, 9900.0), (8000.0, 9000.0)):
            add(f"{value:g} beside {least:g} .. {most:g}", lambda columns, value=value, least=least, most=most: [
                put(columns, "position", slice(None), np.sign(value) * np.linspace(least, most, 400)),
                put(columns, "position", 7, value)])
    add("marked beside huge", lambda columns: put(columns, "position", slice(7, 9), np.array([1e9, -9999.0])))
    add("uneven", clock=lambda time: time - 0.8 * (time % 2))
    for role in ("position", "speed", "odometer", "acceleration", "reference_position"):
        add(f"{role} huge", lambda columns, role=role: put(columns, role, 77, 1e12))
        add(f"{role} marked", lambda columns, role=role: put(columns, role, slice(20, 23), -9999.0))
        add(f"{role} times 3.6", lambda columns, role=role: put(columns, role, slice(None), 3.6 * columns[role]))
        add(f"{role} turned", lambda columns, role=role: put(columns, role, slice(None), -columns[role]))
        add(f"{role} jumps once", lambda columns, role=role: put(columns, role, 100, 60.0, True))
        add(f"{role} jumps for good", lambda columns, role=role: put(columns, role, slice(100, None), 300.0, True))
        add(f"{role} jumps thrice", lambda columns, role=role: [
            put(columns, role, k, 500.0, True) for k in (60, 100, 300)])
        for name, where in (("at first", slice(0, 90)), ("inside", slice(60, 100)), ("at last", slice(310, None)),
                            ("not long", slice(60, 90)), ("just long", slice(60, 91))):
            add(f"{role} frozen {name}", lambda columns, role=role, where=where: put(
                columns, role, where, columns[role][60]))
        add(f"{role} missing", lambda columns, role=role: put(columns, role, slice(2, None), np.nan))
        add(f"{role} halved", lambda columns, role=role: put(columns, role, slice(None), 0.5 * columns[role]))
    add("frozen and on", lambda columns: put(columns, "position", slice(200, 260), columns["position"][199]))
    add("slow place", lambda columns: put(columns, "position", slice(None), 1e-3 * columns["position"]))
    add("changed places", lambda columns: columns.update(speed=columns["position"], position=columns["speed"]))
    add("backwards", lambda columns: put(columns, "odometer", slice(300, None), -40.0, True))
    add("leaps", lambda columns: put(columns, "odometer", slice(300, None), 900.0, True))
    for name, told in (("told far", 30.0), ("told near", 1.0), ("told nothing", np.nan)):
        add(name, lambda columns: put(columns, "position", 100, 60.0, True),
            told={"position": np.full(400, told)})
    across = np.zeros(400)
    across[[30, 31, 200]] = 51.0, 80.0, 60.0
    add("across", lambda columns: columns.update(across=across))
    add("across, told", lambda columns: columns.update(across=across), told={"position": np.full(400, 10.0)})
    time = np.arange(120.0)
    found["slow, then still"] = time, {"position": np.minimum(2 * time, 120.0)}, {}
    found["still, then slow"] = time, {"position": np.maximum(2 * time, 120.0)}, {}
    found["fast, then still"] = time, {"position": np.minimum(4 * time, 240.0)}, {}
    found["still, then fast"] = time, {"position": np.maximum(4 * time, 240.0)}, {}
    add("wheels", lambda columns: columns.update({"wheel-a": columns["odometer"], "wheel-b": 2 * columns["odometer"]}))
    return found


def test_what_is_said_of_columns(expected: Callable[[str, str], None]) -> None:
    lines = []
    for name, (time, columns, told) in spoilt().items():
        lines.append(f"{name}:")
        lines += [f"  {one.grade} {one.role}{' (reading)' if one.reading else ''}: {one.text}"
                  for one in examine(time, columns, told)]
    expected("recording-checks", "\n".join(lines))


def test_steps_that_no_train_makes() -> None:
    """By a loop: farther than 170 m/s and four told deviations of both ends allow, or than pace, acceleration, the
    usual scatter and the told deviations lead to."""
    rng, seen = np.random.default_rng(2), 0
    for _ in range(40):
        n = int(rng.integers(4, 30))
        time = np.cumsum(rng.choice([0.5, 1.0, 4.0], n))
        place = np.cumsum(rng.normal(8.0, 3.0, n)) + rng.choice([0.0, 0.0, 90.0, 800.0], n)
        told = rng.choice([0.0, 2.0, 30.0, np.nan], n)
        sd = [0.0 if np.isnan(one) else 4.0 * one for one in told]
        length = [time[k + 1] - time[k] for k in range(n - 1)]
        pace = [(place[k + 1] - place[k]) / length[k] for k in range(n - 1)]
        ahead = [place[k + 2] - place[k + 1] - pace[k] * length[k + 1] for k in range(n - 2)]
        usual = float(np.median(np.abs(ahead)))
        wrong = {k for k in range(n - 1) if abs(place[k + 1] - place[k]) > 170 * length[k] + sd[k] + sd[k + 1]}
        wrong |= {k + 1 for k in range(n - 2) if abs(ahead[k]) > (
            5 + 3 * length[k + 1] * (length[k] + length[k + 1]) / 2 + 12 * usual + sd[k + 1] + sd[k + 2]
            + (sd[k] + sd[k + 1]) * length[k + 1] / length[k])}
        found, far = _jumping(time, place, told)
        assert found.tolist() == sorted(wrong)
        np.testing.assert_allclose(far, ahead)
        seen += len(wrong)
    assert seen > 40
    time, told = np.array([0.0, 1.0, 1.5, 4.0, 5.0, 8.0, 8.5, 9.0, 12.0]), np.array([1.0, 2, 0.5, 3, 1, 4, 2, 0.5, 1])
    for k in range(2, 9):  # an even pace but for one step: just under and just over what may be
        before, step = time[k - 1] - time[k - 2], time[k] - time[k - 1]
        most = 5 + 3 * step * (before + step) / 2 + 4 * (
            told[k - 1] + told[k] + (told[k - 2] + told[k - 1]) * step / before)
        for share in (0.999, 1.001):
            place = 8.0 * time + share * most * (np.arange(9) >= k)
            assert (k - 1 in _jumping(time, place, told)[0]) == (share > 1)


def test_fixes_beside_the_line() -> None:
    """More than 50 m and four told deviations; rows without a fix are none."""
    time, across = 100.0 * np.arange(6), np.array([50.0, 50.1, 62.0, np.nan, 62.1, 70.0])
    told, there = np.array([0.0, np.nan, 3.0, 0.0, 3.0, 5.0]), np.array([0, 1, 2, 4, 5])
    found, = _offside(time, across, there, told)
    assert (found.grade, found.role, found.text) == (
        "odd", "position", "2 fixes are off the line, by up to 62.1 m at t = 400 s: --without 100..100 --without "
        "400..400")
    assert list(_offside(time, across, there[[0, 2, 4]], told)) == []
