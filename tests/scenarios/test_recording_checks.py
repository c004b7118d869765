"""What is said of columns that cannot be, or are odd: a sound ride spoilt in one way at a time, every finding whole."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from railstate.scenarios.arrays import Array
from railstate.scenarios.recorded.checks import examine

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

    def add(name: str, change: Callable[[Columns], None] | None = None, clock: Callable[[Array], Array] | None = None,
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
    add("uneven", clock=lambda time: time - 0.8 * (time % 2))
    for role in ("position", "speed", "odometer", "acceleration", "reference_position"):
        add(f"{role} huge", lambda columns, role=role: put(columns, role, 77, 1e12))
        add(f"{role} marked", lambda columns, role=role: put(columns, role, slice(20, 23), -9999.0))
        add(f"{role} times 3.6", lambda columns, role=role: put(columns, role, slice(None), 3.6 * columns[role]))
        add(f"{role} turned", lambda columns, role=role: put(columns, role, slice(None), -columns[role]))
        add(f"{role} jumps once", lambda columns, role=role: put(columns, role, 100, 60.0, True))
        add(f"{role} jumps for good", lambda columns, role=role: put(columns, role, slice(100, None), 300.0, True))
        add(f"{role} jumps thrice", lambda columns, role=role: [
            put(columns, role, k, 500.0, True) for k in (60, 100, 300)] and None)
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
