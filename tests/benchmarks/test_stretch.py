"""Steps kept at once beside the same kept one by one: every array, whatever a step has besides, over full stretches."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from railstate.benchmarks.scoring import stretch
from railstate.benchmarks.scoring.stretch import Claims, Stretch
from railstate.estimators.interface import Estimate, Walk
from railstate.scenarios.measurement import Course
from railstate.scenarios.world import Step, Straight

B, S = 5, 3
PARTS = ("vector", "truth", "places", "gaps", "active", "length", "scored", "window", "reference", "bound")


def walked(parts: tuple[bool, ...], truths: int = 4) -> tuple[Straight, Walk, list[tuple[Estimate, Step]]]:
    """A walk of two states beside a truth of more, and its steps."""
    rng = np.random.default_rng(3)
    scored, window, reference, claimed, bound, known = parts
    truth, active = rng.normal(size=(B, truths, S)), rng.random((B, S)) < 0.7
    if not known:
        truth[1, 0, 2] = truth[3, 2, 0] = np.nan
    made: dict[str, Any] = {"scored": rng.random((B, truths, S)) < 0.5 if scored else None,
                            "window": rng.integers(-1, 3, (B, S)).astype(np.int16) if window else None,
                            "reference": rng.normal(size=(B, 2, S)) if reference else None}
    steps = [Step(np.zeros((0, S)), (), truth[b], active[b], number=b + 7, length=0.25, **{
        name: None if value is None else value[b] for name, value in made.items()}) for b in range(B)]
    root = rng.normal(size=(B, 2, 3, S))
    walk = Walk(rng.normal(size=(B, 2, S)), np.einsum("biks,bjks->bijs", root, root) if claimed else None,
                bound=np.array([2.5]) if bound else None)
    course = Course(7, 0.25, np.arange(B) * 0.25, *np.zeros((2, B, 0, S)), np.zeros((B, 0, S), dtype=bool))
    single = [Estimate(walk.mean[b], covariance=None if walk.covariance is None else walk.covariance[b],
                       bound=walk.bound) for b in range(B)]
    return Straight(course, truth, active, last=steps[-1], **made), walk, list(zip(single, steps, strict=True))


def kept(one: Stretch) -> dict[str, Any]:
    found = {name: getattr(one, name) for name in PARTS}
    if one.covariance is not None:
        found |= {name: getattr(one.covariance, name) for name in ("diagonal", "form", "failed")}
    return {name: None if value is None else value[:one.count].copy() for name, value in found.items()}


@pytest.mark.parametrize("parts", list(itertools.product([False, True], repeat=6)))
def test_steps_at_once_are_kept_as_one_by_one(parts: tuple[bool, ...]) -> None:
    straight, walk, steps = walked(parts)
    one, other = Stretch(S, 2), Stretch(S, 2)
    one.renew(*steps[0])
    other.renew(walk.at(-1), straight.last)
    assert one.room == other.room
    one.room = other.room = 4
    assert one.take(39, *steps[2]) and one.take(40, *steps[0]) and one.take(41, *steps[1]) and one.take(42, *steps[2])
    assert other.take(39, *steps[2]) and other.walk(40, straight, walk, 0) == 3
    assert one.full and other.full
    for late in (False, True):
        for name, value in kept(one).items():
            np.testing.assert_array_equal(kept(other)[name], value, err_msg=name)
        one.count = other.count = 0
        assert late or (one.take(43, *steps[3]) and one.take(44, *steps[4]) and other.walk(40, straight, walk, 3) == 2)


@pytest.mark.parametrize("estimated", [False, True])
@pytest.mark.parametrize("parts", [(True,) * 6, (False,) * 6])
def test_single_steps_of_many_runs_are_looked_at_where_they_are(parts: tuple[bool, ...], estimated: bool,
                                                                monkeypatch: pytest.MonkeyPatch) -> None:
    """As those that are copied, with a parameter that is estimated or only known; memory in whatever order."""
    _, _, steps = walked(parts)
    given = [(replace(estimate, mean=np.asfortranarray(estimate.mean), parameter=np.full((1, S), 1.5) if estimated
                      else None), step) for estimate, step in steps]
    copied, looked = Stretch(S, 2), Stretch(S, 2)
    copied.renew(*given[0])
    monkeypatch.setattr(stretch, "ROOM", 0)
    looked.renew(*given[0])
    assert (copied.room, looked.room) == (64, 1)
    for k, one in enumerate(given):
        copied.count = looked.count = 0
        assert copied.take(k, *one) and looked.take(k, *one) and looked.full
        for name, value in kept(copied).items():
            np.testing.assert_array_equal(kept(looked)[name], value, err_msg=name)
        assert looked.vector.shape == (1, 4, S) and (looked.vector[0, 2] == 1.5).all() == estimated
    with pytest.raises(TypeError, match=r"^estimate\(\): mean has shape \(1, 3\)"):
        looked.renew(replace(given[0][0], mean=given[0][0].mean[:1]), given[0][1])


def test_other_shapes_are_not_kept() -> None:
    """The estimate's, or what a step has besides; single steps neither."""
    straight, walk, steps = walked((False,) * 6)
    one = Stretch(S, 2)
    one.renew(*steps[0])
    for parts, truths in (*(((*(i == j for j in range(5)), True), 4) for i in range(5)), ((False,) * 6, 3)):
        far, wide, others = walked(parts, truths)
        assert one.walk(1, far, wide, 0) == 0 and not one.take(1, *others[0]) and one.count == 0
    whole = replace(steps[0][0], mean=walk.mean[0].astype(np.float32))
    assert not one.take(1, whole, steps[0][1])
    assert one.walk(1, straight, walk, 0) == B


@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize("states", [1, 2, 3])
@pytest.mark.parametrize("runs", [1, 2, 3])
def test_claims_beside_numpy(runs: int, states: int, shared: bool) -> None:
    """Matrices of three elements beside a truth of fewer or as many; unknown truth; an indefinite and a lost matrix."""
    rng, room, width = np.random.default_rng(5), 4, 1 if shared else runs
    root, vector = rng.normal(size=(room, 3, 4, width)), rng.normal(size=(room, 3, runs))
    matrices = np.einsum("biks,bjks->bijs", root, root)
    matrices[2, :, :, -1], matrices[3, 0, 0, 0] = -np.eye(3), np.nan
    truth = rng.normal(size=(room, states, runs))
    truth[1, 0, -1] = np.nan
    claims = Claims(room, matrices[0], states, runs)
    claims.take(slice(0, room), vector, truth, matrices)
    np.testing.assert_array_equal(claims.diagonal, np.broadcast_to(np.einsum("biis->bis", matrices), (room, 3, runs)))
    for b, s in itertools.product(range(room), range(runs)):
        matrix = matrices[b, :states, :states, min(s, width - 1)]
        error = np.nan_to_num(vector[b, :states, s] - truth[b, :, s])
        bad = not np.isfinite(matrix).all() or (np.linalg.eigvalsh(matrix) < 0).any()
        assert claims.failed[b, s] == bad
        if not bad:
            assert claims.form[b, s] == pytest.approx(error @ np.linalg.inv(matrix) @ error, rel=1e-9)
