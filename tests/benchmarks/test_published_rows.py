"""Rows as published numbers take them, by formulas of the test's own; what Zou et al.'s bounds are asked of."""

from __future__ import annotations

from statistics import NormalDist
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from railstate.benchmarks.published.computed import base, faruqi2019, zheng2015, zou2018
from railstate.benchmarks.published.reproduce import plan_for
from railstate.benchmarks.published.rows import Book, Found, ratio, reduction, root
from railstate.scenarios.errors import Infeasible, InputError
from railstate.scenarios.randomness import Streams

NAN = np.nan
NONE: Any = None


def same(found: Found, value: float, error: float, spread: float, runs: list[float]) -> None:
    assert (found.value, found.error, found.spread) == pytest.approx(
        (value, error, spread), rel=1e-12, abs=1e-15, nan_ok=True)
    np.testing.assert_allclose(found.runs, runs, rtol=1e-12)  # type: ignore[arg-type]


def test_a_book_of_rows() -> None:
    book = Book(pd.DataFrame({
        "scenario": "s", "variant": "v", "estimator": ["a", "a", "b", "a"], "run": [2, 0, 0, 1],
        "mae:xy:m": 9.0, "mae:x:m": [3.0, 1.0, 5.0, NAN], "rmse:x:m": [4.0, 3.0, 5.0, NAN], "bias:x:m": NAN}))
    assert book.values("s", "v", "a", "mae", "x").tolist()[::2] == [1.0, 3.0]
    same(book.found("s", "v", "a", "mae", "x"), 2.0, 1.0, 2**0.5, [1.0, NAN, 3.0])
    same(book.found("s", "v", "b", "mae", "x"), 5.0, NAN, 0.0, [5.0])
    assert book.found("s", "v", "a", "rmse", "x").value == pytest.approx(12.5**0.5)
    same(book.found("s", "v", "a", "mae", "x").times(-2.0), -4.0, 2.0, 2 * 2**0.5, [-2.0, NAN, -6.0])
    for where in (("s", "v", "a", "bias", "x"), ("s", "v", "c", "mae", "x"), ("s", "v", "a", "mae", "z")):
        for one in (book, Book(pd.DataFrame())):
            with pytest.raises(InputError, match=f"published: {'/'.join(where[:3])} has no {':'.join(where[3:])}"):
                one.values(*where)


def test_ratios_and_their_errors() -> None:
    a, b = np.array([1.0, 4.0, NAN, 7.0, 2.0]), np.array([2.0, 4.0, 1.0, 6.0, np.inf])
    spread = np.std([1 - 2.0, 4 - 4.0, 7 - 6.0], ddof=1) / 4.0
    runs = [0.5, 1.0, NAN, 7 / 6, NAN]
    same(ratio(a, b), 1.0, spread / 3**0.5, spread, runs)
    same(ratio(a, -b), -1.0, spread / 3**0.5, spread, [-one for one in runs])
    same(reduction(a, 2 * b), 0.5, spread / 2 / 3**0.5, spread / 2, [1 - one / 2 for one in runs])
    same(root(ratio(4 * a, b)), 2.0, spread / 3**0.5, spread, [2 * one**0.5 for one in runs])


def test_what_is_asked_of_the_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    gain, told = np.arange(144.0).reshape(12, 12), list[Any]()

    def bound(what: str, value: float) -> Any:
        def found(system: Any, *given: Any) -> Any:
            told.append((what, system, *given))
            return SimpleNamespace(bound=value, K=gain + value - 1.0, gamma_bar=value)
        return found

    for what, value in (("ultimate_bound", 2.0), ("certify", 3.0), ("corollary2", 0.9)):
        monkeypatch.setattr(zou2018, what, bound(what, value))
    monkeypatch.setattr(zou2018, "read_gain", lambda name: gain if name == "zou2018_gain.csv" else None)
    made = {forces: zou2018._certificates.__wrapped__(forces) for forces in ("remark-2", "dominant")}
    book: Any = None
    assert zou2018.zou_decay(book) == Found(0.9)
    assert [(what, *given) for what, _, *given in told] == [
        ("ultimate_bound", 0.98), ("certify", gain, 0.98)] * 2 + [("corollary2", None)]
    systems = [system for _, system, *_ in told]
    assert systems[0].noise_root.any() and systems[4].noise_root.any() and not systems[2].noise_root.any()
    for one in systems:
        assert (one.A == systems[0].A).all() and (one.delta == systems[0].delta).all()
    monkeypatch.setattr(zou2018, "_certificates", lambda forces: made[forces])
    assert zou2018.zou_excess(book, "dominant") == Found(1.5) and zou2018.zou_solvable(book) == Found(1.0)
    for columns, part in (("position", gain[:, :6]), ("velocity", gain[:, 6:])):
        assert zou2018.zou_distance(book, "remark-2", columns).value == pytest.approx(
            72**0.5 / np.sqrt((part**2).sum()))

    def none(forces: str) -> Any:
        raise Infeasible("no")

    for found in (none, lambda forces: (SimpleNamespace(bound=np.inf),)):
        monkeypatch.setattr(zou2018, "_certificates", found)
        assert zou2018.zou_solvable(book) == Found(0.0)


@pytest.mark.parametrize(("gain", "ratio"), [(-1.0, NAN), (-0.2501, NAN), (-0.25, -0.5), (-0.16, -0.2), (0.0, 0.0),
                                             (0.75, 0.5), (2.0, 1.0), (6.0, 2.0)])
def test_the_follower_s_ratio(gain: float, ratio: float) -> None:
    """The greater root of x^2 + x = k_acc, where there is one."""
    assert faruqi2019.follower_ratio(NONE, gain).value == pytest.approx(ratio, rel=1e-12, nan_ok=True)


def test_a_variant_s_design_model_starts_as_its_run_0_of_seed_0(monkeypatch: pytest.MonkeyPatch) -> None:
    def setting(variant: str) -> Any:
        return SimpleNamespace(
            world=lambda streams: SimpleNamespace(initial_mean=("start", streams("truth").normal(1).tolist())),
            design_model=lambda told, start: (variant, told, *start))

    monkeypatch.setattr(base, "load", lambda name, overrides: SimpleNamespace(setting=setting))
    drawn = Streams(0, "s", "v", (0,))("truth").normal(1).tolist()
    assert base.model_of.__wrapped__("s", "v", (("k", 1),)) == ("v", {}, "start", drawn)


@pytest.mark.parametrize(("runs", "seed", "said"), [(0, 1, "--runs: must be at least 1"),
                                                    (2, -1, "--seed: must be at least 0")])
def test_numbers_of_no_run_are_not_planned(runs: int, seed: int, said: str) -> None:
    paper = SimpleNamespace(cells=[SimpleNamespace(compute="", scenario="rap-example-1", variant="printed",
                                                   estimator="kalman")],
                            readings_of=lambda cell: [""], under=lambda cell, reading: cell)
    chosen: Any = [paper]
    with pytest.raises(InputError) as caught:
        plan_for(chosen, runs, seed)
    assert str(caught.value) == said


def test_grids_and_starts_of_zheng2015(monkeypatch: pytest.MonkeyPatch) -> None:
    """Evenly from 1 down to 0; the runs' means as the quantiles of a normal start's size, which dies out."""
    told = list[Any]()

    def model(*given: Any) -> Any:
        told.append(given)
        return SimpleNamespace(linear=SimpleNamespace(A=lambda k: np.diag([1.0, 1.0, 1.0, 0.5])),
                               initial_covariance=np.diag([1.0, 1.0, 1.0, 9.0])[:, :, None])

    def updates(design: Any) -> Any:
        return {"kalman_updates_per_step": len(told[-1][2][0][1]) ** 2}

    monkeypatch.setattr(zheng2015, "model_of", model)
    monkeypatch.setattr(zheng2015, "estimator_class", lambda *_: lambda parameters: SimpleNamespace(design=updates))
    assert zheng2015.grid_updates(NONE, "sma", 4, 2) == Found(4.0)
    assert told == [("braking-rate", "paper", (("knowledge.grid", grid),)) for grid in (
        (1.0, 0.666666667, 0.333333333, 0.0), (1.0, 0.0))]
    found = zheng2015.target_error(NONE, "unmeasured", "sma-full")
    share = 3.0 / 50**0.5 * sum(0.5**k for k in range(151)) / 151
    runs = [share * abs(NormalDist().inv_cdf((k + 0.5) / 1000)) for k in range(1000)]
    same(found, share * (2 / np.pi) ** 0.5, 0.0, float(np.std(runs)), runs)
