"""A trip run by run, in the words of controller and acceleration law: the compiled trips of all have the same bits."""

from __future__ import annotations

import numpy as np
import pytest
from railstate.benchmarks.planning.plan import make_plan
from railstate.scenarios.railway import dynamics
from railstate.scenarios.railway import trip as trips
from railstate.scenarios.randomness import Streams
from railstate.scenarios.units import KMH

FIELDS = ("state", "u", "w", "active", "section", "reference")


def one_trip(line, train, controller, plan, ease, start, T, w, factors, bound, physical):
    """(state, u, w, active, section, reference) of one run at each step; w (K,), factors (5,)."""
    f, g, slope = train.forces, dynamics.GRAVITY / (1 + train.rotating), line.slope(train.rotating)

    def share(V, *c):
        V = max(V, 0.1)
        return max(0.0, min(1.0, c[0] / V + (c[1] + V * (c[2] + V * (c[3] + V * c[4])))))

    def effect(u):
        return (f.brake, f.b0, f.b1, f.b2, f.b3, f.b4) if u < 0 else (f.drive, f.t0, f.t1, f.t2, f.t3, f.t4)

    def climb(s):
        return dynamics.climb.py_func(s, slope)

    def effort_for(a, s, v):
        V = KMH * v
        force = a + f.r0 + V * (f.r1 + V * f.r2) + climb(s)
        top, *c = effect(force)
        return force / (top * max(share(V, *c), 1e-3))

    def level(v, u):
        V = KMH * v
        top, *c = effect(u)
        return u * top * share(V, *c) - (f.r0 + V * (f.r1 + V * f.r2))

    def disturbed(s, v, u):
        mass, pull, hold, rise, wind = factors
        V, air = KMH * v, KMH * (v + wind)
        top, *c = effect(u)
        force = top * share(V, *c) * (hold if u < 0 else pull)
        return u * force / mass - (f.r0 + f.r1 * V + f.r2 * air * abs(air)) - climb(s) - g * rise

    (s, v), out = start, []
    u = 0.0 if v > 0 else effort_for(0.0, s, v)
    leg, mode, piece, departed, waited, last = 0, "running", 0, False, 0, len(plan.first) - 2
    for acts in w.tolist():
        here, wanted = mode, 0.0
        if mode == "done":
            out.append((s, v, u, 0.0, False, leg, 0.0))
            continue
        if mode == "ending":
            v = 0.0
        if mode == "running":
            while piece + 1 < plan.first[leg + 1] and s >= plan.start[piece + 1]:
                piece += 1
            square = plan.base[piece] + plan.rate[piece] * (s - plan.start[piece])
            wanted = max(square, 0.0)**0.5
            asked = effort_for(0.5 * plan.rate[piece] + controller.gain * (wanted - v) if square > 0 else -v / T, s, v)
            low, high = (limit * ease[leg] for limit in controller.effort)
            asked, change = min(max(asked, low), high), controller.slew * ease[leg] * T
            u = min(max(asked, u - change), u + change)
            V = KMH * v
            stand = -v / T + f.r0 + V * (f.r1 + V * f.r2) + climb(s)
            if departed and (stand >= 0 or stand > u * f.brake):
                u = max(u, effort_for(-v / T, s, v))
        else:
            u = effort_for(-v / T, s, v)
        a = level(v, u) - climb(s)
        if mode not in ("running", "landing"):
            acts = 0.0
        elif physical:
            acts = min(max(disturbed(s, v, u) - a, -bound), bound)
        if mode == "running" and not departed and v + T * (a + acts) < 0:
            acts = -v / T - a
        s, v = s + (T * v + 0.5 * T * T * (a + acts)), v + T * (a + acts)
        if mode in ("held", "waiting"):
            v = 0.0
        if mode == "running":
            departed = departed or v > 1
            if leg == last:
                ends = (departed and v <= controller.ended) or s > line.stops[-1] + controller.overrun
                mode = "ending" if ends else mode
            elif departed and v <= (bound - 0.5 * plan.rate[piece]) * T:
                mode = "landing"
        elif mode == "waiting":
            waited += 1
            if waited >= round(controller.dwell / T):
                mode, leg, departed, piece = "running", leg + 1, False, plan.first[leg + 1]
        else:
            mode, waited = {"landing": "held", "held": "waiting", "ending": "done"}[mode], 0
        out.append((s, v, u, acts, here != "ending", leg if here != "waiting" or mode == here else leg - 1, wanted))
    columns = [np.array(column) for column in zip(*out, strict=True)]
    return np.stack(columns[:2], axis=1), columns[2][:, None], *columns[3:]


@pytest.fixture(params=["switching", "physical", "stops", "rest"])
def told(request, monkeypatch):
    """What a world tells `simulate`."""
    seen, real = [], trips.simulate
    monkeypatch.setattr("railstate.scenarios.metro.setting.simulate",
                        lambda *told: seen.append([part.copy() if isinstance(part, np.ndarray) else part
                                                   for part in told]) or real(*told))
    changes = {"stops": {"plant.line.stops": [0.0, 420.0, 900.0], "plant.controller.dwell": 3.0},
               "rest": {"plant.start_speed": 0.0}}.get(request.param, {})
    cell = make_plan(["ningbo-metro/" + ("switching" if changes else request.param)], only=["ekf"],
                     overrides=changes).cells[0]
    cell.setting().world(Streams(1, cell.scenario, cell.variant, range(3)))
    return seen[-1]


def test_the_trips_of_all_runs_are_those_of_each(told):
    *fixed, w, factors, bound, physical = told
    found = trips.simulate(*fixed, w.copy(), factors, bound, physical)
    for r in range(w.shape[1]):
        for name, values in zip(FIELDS, one_trip(*fixed, w[:, r], factors[:, r].tolist(), bound, physical),
                                strict=True):
            assert np.array_equal(getattr(found, name)[..., r], values), (name, r)


def test_a_run_has_its_trip_in_any_block(told):
    *fixed, w, factors, bound, physical = told
    many = trips.TOGETHER + 2
    wide, among = np.repeat(w[:, :1], many, axis=1), np.repeat(factors[:, :1], many, axis=1)
    wide[:, -1], among[:, -1] = w[:, 1], factors[:, 1]
    crowd, alone = (trips.simulate(*fixed, *those, bound, physical) for those in ((wide, among), (w, factors)))
    for name in FIELDS:
        assert np.array_equal(getattr(crowd, name)[..., [0, -1]], getattr(alone, name)[..., :2])
