"""Steps that a recorded world hands out many at a time, against the same steps one by one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from railstate.scenarios.world import Trajectory

K, S = 9, 3
RNG = np.random.default_rng(5)


def world(**changes: Any) -> Trajectory:
    """Measured at the start, two intervals twice as long, a run that ends after five steps and one after seven."""
    active = np.arange(K)[:, None] < np.array([K, 5, 7])
    return Trajectory(**{
        "truth": RNG.normal(size=(K, 2, S)), "u": RNG.normal(size=(K, 1, S)), "y": RNG.normal(size=(K, 2, S)),
        "received": RNG.random((K, 2, S)) < 0.7, "active": active,
        "lengths": np.array([0.0, 0.5, 0.5, 1.0, 1.0, 0.5, 0.5, 0.5, 0.5]), **changes})


@pytest.mark.parametrize("most", [1, 2, 50])
@pytest.mark.parametrize("more", [False, True])
@pytest.mark.parametrize("first", [0, 1])
def test_many_steps_are_those_one_by_one(most: int, more: bool, first: int) -> None:
    """They end where the period changes, where a run ends, and after so many; none where nobody is under way."""
    found = world(**({"window": RNG.integers(-1, 2, (K, S)).astype(np.int16), "reference": RNG.normal(size=(K, 2, S)),
                      "variance": RNG.random((K, 2, S))} if more else {}))
    found = replace(found, lengths=found.lengths[first:], **{
        name: getattr(found, name)[first:] for name in ("truth", "u", "y", "received", "active", *(
            ("window", "reference", "variance") if more else ()))})
    for k in range(K - first):
        parts, steps = found.straight(k, most), [found.step(k, found.truth[0])]
        while len(steps) < most and (at := k + len(steps)) < K - first and (
                found.active[at] == steps[0].active).all() and found.lengths[at] == steps[0].length:
            steps.append(found.step(at, found.truth[0]))
        if parts is None:
            assert steps[0].length == 0.0
            continue
        course, last = parts.course, steps[-1]
        assert len(parts.truth) == len(steps) and course.period == last.length and course.step == steps[0].number
        np.testing.assert_array_equal(course.times, [step.start + step.length for step in steps])
        for name in ("truth", "active", "window", "reference"):
            mine = getattr(parts, name)
            assert (mine is None) == (getattr(last, name) is None)
            if mine is not None:
                np.testing.assert_array_equal(mine, [getattr(step, name) for step in steps])
        np.testing.assert_array_equal(course.u, [step.u for step in steps])
        np.testing.assert_array_equal(course.y, [step.events[0].y for step in steps])
        np.testing.assert_array_equal(course.received, [step.events[0].received & step.active for step in steps])
        if more:
            np.testing.assert_array_equal(course.variance, [np.einsum("iis->is", step.events[0].covariance)
                                                            for step in steps])
        assert parts.scored is None and (course.variance is None) != more
        assert (parts.last.number, parts.last.start, parts.last.length) == (last.number, last.start, last.length)
        np.testing.assert_array_equal(parts.last.truth, last.truth)
    assert replace(found, active=found.active & False).straight(1, most) is None


@pytest.mark.parametrize("changes", [
    {"closed_loop": True}, {"covariance": np.ones((K, 2, 2, 1))}, {"late": np.zeros((K, 2, S), np.int64)},
    {"faulty": np.zeros((K, 2, S), bool)}, {"inside": (0, np.full((K, S), 0.5))},
    *({name: kind(np.ones((K, 1 if name == "u" else 2, S)))} for name in ("u", "y")
      for kind in (np.float32, np.asfortranarray)), {"received": np.asfortranarray(np.ones((K, 2, S), bool))}])
def test_other_steps_are_handed_out_one_by_one(changes: dict[str, Any]) -> None:
    assert world(**changes).straight(1, 5) is None
