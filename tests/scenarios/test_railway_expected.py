"""Lines, trains and what moves them, whole, beside committed text (to renew it: `tests/expected.py`): files of every
form, forces and their slopes over a grid of speeds, friction and slip, a curve's farthest bend."""

from __future__ import annotations

import json
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from railstate.scenarios.railway import adhesion, curvature, dynamics
from railstate.scenarios.railway.line import Train, read_line, read_train

from ..expected import digest

Expected = Callable[[str, str], None]
EXAMPLES = files("railstate.scenarios.railway") / "examples"
NONE = object()
CHANGES: dict[str, list[tuple[str, Any]]] = {
    "track": [
        ("", None), ("stops", NONE), ("stops", 3), ("stops", {"values": [0, 1]}),
        ("stops", {"unit": "mile", "values": [0, 1]}),
        ("stops", {"unit": "km", "values": [0.0, 1.3]}), ("stops", {"unit": "m", "values": []}),
        ("stops", {"unit": "m", "values": [0, "x"]}), ("stops", {"unit": "m", "values": [0, True]}),
        ("stops", {"unit": "m", "values": [0, 1e16]}), ("stops", {"unit": "m", "values": [0, 1e15]}),
        ("stops", {"unit": "m", "values": [5, 5]}), ("stops", {"unit": "m", "values": [5]}),
        ("gradients", NONE),
        ("gradients", {"units": {"position": "m", "slope": "permil"}, "values": [[0, 2], [300, -4]]}),
        ("gradients", {"units": {"position": "m"}, "values": [[0, 2]]}), ("gradients", {"values": [[0, 2]]}),
        ("gradients", {"units": {"position": "m", "slope": "permil"}, "values": [[0, 2, 3]]}),
        ("gradients", {"units": {"position": "m", "slope": "permil"}, "values": []}),
        ("gradients", {"units": {"position": "m", "slope": "permil"}, "values": [[0, 201]]}),
        ("gradients", {"units": {"position": "m", "slope": "permil"}, "values": [[0, -200]]}),
        ("gradients", {"units": {"position": "m", "slope": "permil"}, "values": [[10, 2]]}),
        ("speed limits", {"units": {"position": "km", "velocity": "m/s"}, "values": [[0, 20], [0.5, 10]]}),
        ("speed limits", {"units": {"position": "m", "velocity": "km/h"}, "values": [[0, 20], [0.05, 10]]}),
        ("speed limits", {"units": {"position": "m", "velocity": "km/h"}, "values": [[0, 20], [9, 0]]}),
        ("speed limits", {"units": {"position": "m", "velocity": "kn"}, "values": [[0, 20]]})],
    "train": [
        ("", None), ("mass", NONE), ("mass", {"value": 0, "unit": "t"}), ("mass", {"value": 200, "unit": "t"}),
        ("mass", {"value": -1, "unit": "kg"}), ("mass", {"value": 2e5, "unit": "kg"}), ("mass", {"value": 1}),
        ("mass", 7),
        ("rho", NONE), ("rho", {"value": 6, "unit": "%"}), ("rho", {"value": 2.0, "unit": "1"}),
        ("max traction force", NONE),
        ("max reg braking force", NONE), ("max pn braking force", {"value": 90, "unit": "kN"}),
        ("max acceleration", {"value": 0.5, "unit": "m/s^2"}), ("max deceleration", {"value": 0.4, "unit": "m/s^2"}),
        ("max traction power", {"value": 2000, "unit": "kW"}), ("max traction power", NONE),
        ("max reg braking power", {"value": 1.5, "unit": "MW"}), ("max speed", {"value": 30, "unit": "m/s"}),
        ("max speed", {"value": 0, "unit": "m/s"}), ("rolling resistance r0", {"value": 3, "unit": "kN"}),
        ("rolling resistance r1", {"value": 30, "unit": "N/(km/h)"}),
        ("rolling resistance r1", {"value": 9, "unit": "N/(m/s)"}),
        ("rolling resistance r2", {"value": 2, "unit": "N/(m/s)^2"}),
        ("rolling resistance r2", {"value": 2, "unit": "N"})]}
"""Of the example's file: a key and what stands there in place of its own."""


def test_files_of_lines_and_trains(expected: Expected, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    out = list[str]()
    for kind, changes in CHANGES.items():
        whole = json.loads((EXAMPLES / f"{kind}.json").read_text())
        read = read_line if kind == "track" else read_train
        cases = [(f"{key} {'left out' if value is NONE else value}",
                  json.dumps({name: part for name, part in {**whole, **({key: value} if key else {})}.items()
                              if part is not NONE})) for key, value in changes]
        for name, text in [*cases, ("a list", "[]"), ("no JSON", "{"), ("nothing", "")]:
            Path("file.json").write_text(text)
            try:
                said = repr(read("file.json"))
                if kind == "train":
                    said += f" {read_train('file.json').forces}"
            except ValueError as error:
                said = str(error)
            out.append(f"{kind}, {name}: {said}")
        try:
            read("none.json")
        except ValueError as error:
            out.append(str(error))
    expected("lines-and-trains", "\n".join(out))


def trains() -> dict[str, Train]:
    file = read_train(str(EXAMPLES / "train.json"))
    return {"file": file, "curved": file.model_copy(update={
        "traction": [20.0, 0.9, -0.004, 0.00002, 1e-8], "braking": [3.0, 1.1, -0.006, 0.0, 2e-8], "rotating": 0.08})}


def test_what_moves_a_train(expected: Expected) -> None:
    """Over speeds from standing on, both ways, steps of no length, and climbs."""
    out = list[str]()
    slope = dynamics.slope_grid(np.array([0.0, 100.0, 350.5, 351.0]), np.array([0.0, 0.01, -0.02, 0.005]), 0.06)
    out.append(f"slope {[digest(part) for part in slope]}")
    places = np.array([-5.0, 0.0, 99.99, 100.0, 200.0, 350.5, 350.9, 351.0, 9e3])
    climbs = np.empty_like(places)
    dynamics.climbs(places, slope, climbs)
    out.append(f"climbs {climbs.tolist()}")
    v = np.array([0.0, 1e-4, 0.02, 0.1, 1.0, 5.0, 10.0, 19.9, 20.0, 25.0])
    for name, train in trains().items():
        forces = train.forces
        out.append(f"{name} {[f'{number:.8e}' for number in forces]}")
        for u in (-1.0, -0.3, 0.0, 0.4, 1.0):
            control, h = np.full(len(v), u), np.where(np.arange(len(v)) % 4 == 3, 0.0, 0.2)
            x = np.stack([np.linspace(0.0, 400.0, len(v)), v])[:, None, :]
            moved = np.empty_like(x)
            dynamics.transition(x, control, h, forces, slope, len(v), moved)
            jacobian = np.empty((2, 2, len(v)))
            dynamics.transition_jacobian(v, control, h, forces, len(v), jacobian)
            out.append(f"  {u}: {digest(moved)} {digest(jacobian)} {[f'{one:.8e}' for one in moved[1, 0]]}")
        curves = curvature.pieces(forces)
        out.append(f"  pieces {[np.asarray(part).tolist() for part in curves]}")
        for sd in (0.0, 0.1, 2.0, 8.0):
            Pi = sd**2 * np.eye(2)[:, :, None] * np.ones(len(v))
            for u in (-0.7, 0.0, 0.9):
                each, shared = np.empty(len(v)), np.empty(len(v))
                for P, change in ((Pi, each), (np.ascontiguousarray(Pi[:, :, :1]), shared)):
                    curvature.slope_change(v, np.full(len(v), u), P, 0.2, forces, curves, change)
                assert (each == shared).all()
                out.append(f"  bends {sd} {u}: {[f'{one:.8e}' for one in each]}")
    for friction in (0.03, 0.1, 0.3):
        for speed in (0.0, 1.0, 15.0):
            creep = [adhesion.polach(one, friction, speed) for one in (0.0, 1e-4, 0.002, 0.05, 0.5)]
            use = [adhesion.polach_slip(one, friction, speed) for one in (0.0, 0.2, 0.5, 0.9, 0.99)]
            out.append(f"polach {friction} {speed}: {[f'{one:.8e}' for one in creep]} {[f'{one:.8e}' for one in use]}")
    expected("moves", "\n".join(out))
