"""Parts of the odometry setting by numbers worked out by hand: modes of slip, states of whole numbers, own lines.

What whole trips show is in `test_odometry`."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from railstate.scenarios.files import load
from railstate.scenarios.measurement import Interval, untold
from railstate.scenarios.odometry.config import Plant
from railstate.scenarios.railway.odometer.motion import counted
from railstate.scenarios.randomness import Streams
from scipy.linalg import expm


def test_whole_numbers_are_states_like_others() -> None:
    for motion in ("accelerometer", "minmax"):
        chosen = load("odometry", {"knowledge.motion": motion}).setting("wet-radar")
        model = chosen.design_model({}, np.array([[100], [10]]))
        x, u = np.arange(2 * model.nx).reshape(model.nx, 2), np.arange(14.0).reshape(7, 2) / 3
        assert model.transition_jacobian is not None and model.measurement_jacobian is not None
        for share in (1.0, np.array([0.5, 1.0])):
            over = Interval(3, 0.2, 0.1 * share, share)
            np.testing.assert_array_equal(model.transition(x, u, over), model.transition(1.0 * x, u, over))
        np.testing.assert_array_equal(model.measurement(x, 3), model.measurement(1.0 * x, 3))
        np.testing.assert_array_equal(model.measurement_jacobian(x, 3), model.measurement_jacobian(1.0 * x, 3))


def test_modes_of_slip() -> None:
    """Each axle slips and recovers by itself, over a step exactly; dead reckoning and who has no wheel have none."""
    rates = {"knowledge.slip.enter": 0.5, "knowledge.slip.leave": 2.0, "time.period": 0.2, "knowledge.slip.sd": 3.0}

    def modes(use: list[str], **more: Any) -> Any:
        setting = load("odometry", {**rates, "sensors.use": use, **more}, only="wet").setting("wet")
        return setting.design_model({}, np.zeros((2, 1))).modes

    enter, leave = expm(0.2 * np.array([[-0.5, 0.5], [2.0, -2.0]]))[[0, 1], [1, 0]]
    one = np.array([[1 - enter, enter], [leave, 1 - leave]])
    for use, names, transition in ((["wheel-a", "balise"], ["no slip", "slip of a"], one), (
            ["wheel-a", "wheel-b"], ["no slip", "slip of b", "slip of a", "slip of a and b"], np.kron(one, one))):
        found = modes(use)
        assert [mode.name for mode in found.modes] == names
        np.testing.assert_allclose(found.transition, transition, rtol=1e-12)
        assert found.prior.tolist() == [1.0] + [0.0] * (len(names) - 1)
        for mode in found.modes:
            R = mode.model.measurement_covariance(untold(1, len(use)))[:, :, 0]
            slips = [f"wheel-{axle}" in use and axle in mode.name.split()[2:] for axle in "ab"]
            assert [R[i, i] == pytest.approx((3.0 * 0.2) ** 2) for i in range(2)] == slips
    assert modes(["balise", "gnss"]) is None
    assert modes(["wheel-a", "wheel-b", "balise"], **{"knowledge.motion": "minmax"}) is None


def test_what_stands_for_places_on_a_line_of_ones_own() -> None:
    """Only beside tables that are tables, and a path; a rail without low stretches stays so."""
    other = {"balises": 500.0, "tunnels": [[1.0, 2.0]], "low": [[3.0, 4.0]]}
    table: dict[str, Any] = {"line": "a.json", "elsewhere": other, "adhesion": {"low": [[9.0, 9.5]], "open": 0.2},
                             "tunnels": [[5.0, 6.0]]}
    for change in ({"line": {}}, {"elsewhere": 5}, {"adhesion": 5}):
        assert Plant._own_line({**table, **change}) == {**table, **change}
    own = {**table, "balises": {"every": 500.0}, "tunnels": [[1.0, 2.0]]}
    assert Plant._own_line(table) == {**own, "adhesion": {"low": [[3.0, 4.0]], "open": 0.2}}
    assert Plant._own_line({**table, "adhesion": {}}) == {**own, "adhesion": {"low": []}}
    assert Plant._own_line({**table, "elsewhere": {}}) == {
        **table, "elsewhere": {}, "balises": {"every": None}, "tunnels": [], "adhesion": {"low": "stops", "open": 0.2}}
    assert Plant._own_line(5) == 5


def test_many_steps_are_those_one_by_one() -> None:
    """Until a balise is read or a run ends; none from a step with a balise inside."""
    world = load("odometry").setting("dry").world(Streams(3, "odometry", "dry", (0, 1, 2)))
    nothing, most, k, straight = np.zeros((0, 3)), 400, 0, 0
    while k < world.steps and world.active[k].any():
        parts, steps = world.straight(k, most), [world.step(k, nothing)]
        assert (parts is None) == (len(steps[0].events) > 1)
        while parts is not None and len(steps) < most and (at := k + len(steps)) < world.steps and (
                world.active[at] == world.active[k]).all() and len((step := world.step(at, nothing)).events) == 1:
            steps.append(step)
        if parts is not None:
            straight, course, last = straight + 1, parts.course, steps[-1]
            assert (course.step, course.period, parts.window) == (k + 1, last.length, None)
            for found, wanted in (
                    (course.times, [step.number * world.period for step in steps]),
                    (course.u, [step.u for step in steps]), (course.y, [step.events[0].y for step in steps]),
                    (course.received, [step.events[0].received & step.active for step in steps]),
                    *((getattr(parts, name), [getattr(step, name) for step in steps])
                      for name in ("truth", "active", "scored", "reference"))):
                np.testing.assert_allclose(np.asarray(found, float), np.asarray(wanted, float), rtol=1e-15)
            assert (parts.last.number, parts.last.start) == (last.number, last.start)
            np.testing.assert_array_equal(parts.last.truth, last.truth)
        k += len(steps)
    assert straight > 10


def test_what_wheels_count() -> None:
    """Of one wheel; of both the faster in braking, the slower in traction, else their mean; nothing in no time."""
    rng = np.random.default_rng(4)
    x, distance, speed, share = rng.normal(size=(3, 2, 8)), *rng.normal(size=(2, 2, 8)), rng.random(8)
    effort, h = np.array([0.0, 0.0, 1.0, 1.0, -1.0, -1.0, 2.0, 0.0]), np.array([1.0] * 7 + [0.0])
    speed[:, 2:6] = [[1.0, 2.0, 1.0, 2.0], [2.0, 1.0, 2.0, 1.0]]
    for which in range(3):
        out = np.full((2, 2, 8), np.nan)
        counted(x, effort, distance, speed, which, share, h, out)
        by = {0: [1.0, 0.0], 1: [0.0, 1.0]}
        for r in range(8):
            weight = by[which] if which < 2 else [0.5, 0.5] if effort[r] == 0 else by[int(np.argmax(
                -np.sign(effort[r]) * speed[:, r]))]
            for p in range(2):
                wanted = (x[0, p, r] + share[r] * (weight @ distance[:, r]), weight @ speed[:, r]) if h[r] else (
                    x[0, p, r], x[1, p, r])
                np.testing.assert_allclose(out[:, p, r], wanted, rtol=1e-14)
