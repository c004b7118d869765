"""Selection of particles and how many go on, against plain sorting and sums; parameters that need another one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, get_args, get_origin

import numpy as np
import pytest
from pydantic import ValidationError
from railstate.estimators.registry import estimators
from railstate.estimators.stochastic_m import select


@pytest.fixture(autouse=True)
def _plain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Parts of compiled code as plain functions."""
    for name in ("heaviest", "systematic", "select", "distinct", "collapse"):
        monkeypatch.setattr(select, name, getattr(select, name).py_func)

    def exponentials(x: Any, n: int, shift: float, out: Any) -> None:
        out[:n] = np.exp(x[:n] - shift)

    monkeypatch.setattr(select, "exponentials", exponentials)


def test_the_heaviest_go_on_in_their_order_of_equals_the_first() -> None:
    rng = np.random.default_rng(1)
    for n in (1, 2, 5, 9):
        for keep in range(1, n + 1):
            logw, index, kept = rng.integers(-3, 1, 12).astype(float), np.full(12, -1), np.full(12, 7.0)
            chosen = sorted(sorted(range(n), key=lambda i: (-logw[i], i))[:keep])
            assert select.select(logw, None, n, 0.5, keep, True, 0.0, index, kept) == keep
            assert index[:keep].tolist() == chosen and kept[:keep].tolist() == [logw[i] - 0.5 for i in chosen]
            assert (index[keep:] == -1).all() and (kept[keep:] == 7).all()


def test_systematic_resampling_of_weights() -> None:
    rng = np.random.default_rng(2)
    for _ in range(60):
        n, keep, uniform = rng.integers(1, 6), rng.integers(1, 7), float(rng.choice([0.0, 0.5, 0.999, rng.random()]))
        w = rng.integers(0, 3, n) * 1.0
        w[rng.integers(n)] = 1.0
        w /= 2 ** np.ceil(np.log2(w.sum()))  # short of one, as after rounding
        index, kept = np.full(9, -1), np.full(9, 7.0)
        assert select.select(np.zeros(n), w, n, 0.5, keep, False, uniform, index, kept) == keep
        last = max(np.flatnonzero(w))
        wanted = [min([i for i in range(n) if w[:i + 1].sum() > (uniform + j) / keep] + [last]) for j in range(keep)]
        assert index[:keep].tolist() == wanted and all(w[i] > 0 for i in wanted) and not kept[:keep].any()
    assert select.select(np.arange(3.0), w, 3, 0.5, 0, False, 0.0, index, kept) == 3
    assert index[:3].tolist() == [0, 1, 2] and kept[:3].tolist() == [-0.5, 0.5, 1.5]


def test_children_drawn_by_their_weight() -> None:
    p = np.array([0.0, 0.25, 0.75, 0.5, 0.5, 0.0, 0.0, 0.0, 0.0])
    for draws, picked in (((0, 0.0, 0.0, 0.5), [1, 3, 6]), ((0, 0.25, 0.5, 0.5), [2, 4, 6]),
                          ((0, 0.24, 0.49, 0.9), [1, 3, 6]), ((0, 1.0, 1.0, 0.0), [2, 4, 6])):
        with np.errstate(divide="ignore"):
            logw, found = np.log(p) + np.repeat([1.0, -700.0, 0.0], 3), np.empty(3, dtype=int)
        select.collapse(logw, 3, 3, np.array(draws), found, np.empty(9))
        assert found.tolist() == picked and logw[:3] == pytest.approx([1.0, -700.0, -np.inf])


def test_how_many_values_particles_have() -> None:
    seen = np.ones(5, dtype=bool)
    theta, logw = np.array([3, 1, 3, 2, 4]), np.array([0.0, -9.0, -1.0, -np.inf, 0.0])
    assert [select.distinct(theta, logw, n, seen) for n in (0, 1, 3, 4, 5)] == [0, 1, 2, 2, 3]


@pytest.mark.parametrize(("policy", "counts"), [("A", (0, 0, 0, 6, 6)), ("B", (0, 0, 6, 6, 6)), ("C", (0, 6, 6, 6, 6))])
def test_who_is_pruned(policy: str, counts: tuple[int, ...]) -> None:
    found: Any = estimators()["sma"]({"policy": policy, "particles": 6, "limit": 30})
    assert tuple(found.goes_on(children, 3) for children in (6, 7, 11, 30, 31)) == counts
    assert found.goes_on(10, 3) == (6 if policy == "C" else 0)
    assert found.first() == found.parameters.initial


def test_draws_of_a_rao_blackwellized_step() -> None:
    for parameters, draws, transition in (
            ({"proposal": "static"}, 1, None), ({"proposal": "static", "jitter": 0.2}, 8, [0.8, 0.2, 0.0]),
            ({"proposal": "bootstrap"}, 8, [1 / 3] * 3), ({}, 8, [1 / 3] * 3),
            ({"prior": "sticky", "stay": 0.6}, 8, [0.6, 0.4, 0.0])):
        found: Any = estimators()["rbpf"]({"particles": 7, **parameters})
        assert (found.draws_per_step(), found.first(), found.goes_on(99, 3)) == (draws, 7, 7)
        moves = found._transition(3)
        assert (moves is None) if transition is None else moves[0] == pytest.approx(transition)


def test_parameters_that_need_another_one(expected: Callable[[str, str], None]) -> None:
    """Each parameter given, by each choice there is beside it."""
    said = list[str]()
    for name, cls in sorted(estimators().items()):
        known = cls.Parameters.model_fields
        choices = {key: get_args(field.annotation) for key, field in known.items()
                   if get_origin(field.annotation) is Literal}
        for key, options in choices.items():
            for option in options:
                refused = []
                for other, field in known.items():
                    try:
                        if other != key and not field.is_required():
                            cls.Parameters.model_validate({key: option, other: field.get_default()})
                    except ValueError:
                        refused.append(other)
                said += [f"{name}.{key} = {option}: not {' '.join(refused)}"] if refused else []
    expected("parameters-together", "\n".join(said))


GATED = "level and after are used with a gate only: name its sensors, or leave them out"
JULIER = 'points = "julier" has no alpha and beta: leave them out, or use points = "scaled"'


@pytest.mark.parametrize(("name", "parameters", "said"), [
    ("imm-models", {"level": 0.9}, GATED), ("imm-models", {"after": 3.0}, GATED),
    ("imm-models", {"level": 0.9, "gate": ["gnss"]}, ""), ("imm-models", {"stay": 0.5}, ""),
    ("ukf", {"points": "julier", "alpha": 0.5}, JULIER), ("ukf", {"points": "julier", "beta": 2.0}, JULIER),
    ("ukf", {"points": "julier", "kappa": 1.0}, ""), ("ukf", {"alpha": 0.5, "beta": 2.0}, ""),
    ("gate", {"memory": 5, "needed": 6}, "needed = 6 cannot be more than memory = 5"),
    ("gate", {"memory": 5, "needed": 5}, ""), ("gate", {"memory": 13}, "needed = 14 cannot be more than memory = 13"),
    ("gate", {"reopen": "time", "sensors": ["a"], "together": ["a", "b"]},
     'together must be among sensors = ["a"]: others are never rejected'),
    ("gate", {"reopen": "time", "sensors": ["a", "b"], "together": ["b"]}, ""),
    ("gate", {"reopen": "time", "together": ["b"]}, ""),
    ("gate", {"after": 3.0}, 'after is used with reopen = "time" only: leave it out'),
    ("imm", {"transition": "uniform", "stay": 0.9}, 'stay is used with transition = "tridiagonal" only: leave it out'),
    ("filterpy-ukf", {"redraw": False}, "redraw = false: filterpy always redraws the points; only ukf can reuse them"),
    ("filterpy-ukf", {"redraw": True}, "")])
def test_parameters_that_do_not_go_together(name: str, parameters: dict[str, Any], said: str) -> None:
    cls = estimators()[name].Parameters
    if not said:
        cls.model_validate(parameters)
        return
    with pytest.raises(ValidationError) as caught:
        cls.model_validate(parameters)
    assert [error["msg"] for error in caught.value.errors()] == [f"Value error, {said}"]
