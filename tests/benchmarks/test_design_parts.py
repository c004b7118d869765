"""What `design` and `certify` print of designs made by hand: every column, what is known and what is not."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from railstate.benchmarks.commands import design
from railstate.benchmarks.isolation.process import Ended
from railstate.estimators.interface import Status
from railstate.estimators.random_access.losses import Losses
from railstate.estimators.ultimate_bound.moments import MeanSquare
from railstate.scenarios.channels.gilbert_elliott import GilbertElliott
from railstate.scenarios.errors import Infeasible, InputError, Unsupported
from railstate.scenarios.schema import EstimatorEntry

ENTRY, SETTING = EstimatorEntry(plugin="p"), SimpleNamespace()
GAIN = np.array([[1.0, 2.0], [3.0, 4.0]])


def designed(monkeypatch: pytest.MonkeyPatch, found: Any) -> design._Designed:
    def answer(model: Any) -> Any:
        if isinstance(found, Exception):
            raise found
        return found

    cls: Any = SimpleNamespace()
    monkeypatch.setattr(design, "_prepare", lambda *given: (SimpleNamespace(design=answer), "model"))
    return design._designed(SETTING, "s", "v", cls, ENTRY)  # type: ignore[arg-type]


def test_a_row_of_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    exact, asked = {"reception": "0.5"}, []
    monkeypatch.setattr(design, "_exact", lambda model, gain: exact if model == "model" and gain is GAIN else None)
    monkeypatch.setattr(design, "_measured", lambda *given: asked.append(given) or {"start": "soon"})
    full = {"gain": GAIN, "bound": 1234567.0, "status": "optimal", "theta": 0.98, "design_s": 0.126, "solver": "C",
            "cached": False}
    row = {"bound": "1.23457e+06", "status": "optimal", "decay theta": "0.98", "reception": "0.5", "start": "soon",
           "solver": "C", "seconds": "0.13", "from": "solver"}
    found = designed(monkeypatch, full)
    assert list(found.row.items()) == list(row.items()) and found.gain is GAIN and found.other == {}
    assert asked == [(SETTING, "s", "v", ENTRY, GAIN)]
    assert designed(monkeypatch, {**full, "cached": True}).row == {**row, "from": "cache"}
    exact = {}
    bare = {"gain": GAIN, "bound": None, "status": "none", "theta": 1 / 3}
    assert designed(monkeypatch, bare).row == {"bound": "not certified", "status": "none", "decay theta": "0.333333",
                                               "solver": "", "seconds": "", "from": ""}
    assert len(asked) == 2  # nothing is measured where nothing exact is known
    assert designed(monkeypatch, {"a": 1}) == ({}, None, {"a": 1})
    for error, words in ((Unsupported("no"), "unsupported: no"), (Infeasible("none"), "infeasible: none")):
        assert designed(monkeypatch, error) == ({"bound": "not certified", "status": words}, None, {})


def test_exact_moments_at_the_least_and_the_greatest_reception(monkeypatch: pytest.MonkeyPatch) -> None:
    node, asked = SimpleNamespace(mean=0.5, spread=0.125), list[Any]()

    def moments(system: Any, K: Any, chance: float | None) -> MeanSquare:
        asked.append((system, K, chance))
        return MeanSquare(0.9, None, 2.0) if chance != 0.625 else MeanSquare(0.81234, 0.5, None)

    monkeypatch.setattr(design, "mean_square", moments)
    for nodes, chances, said in (
            ([node], [0.375, 0.625], ("0.375 .. 0.625", "0.9 .. 0.812", "none .. 0.5", "2 .. none")),
            ([SimpleNamespace(mean=0.5, spread=0.0)], [None], ("0.5", "0.9", "none", "2")),
            ([node, node], [None], ("", "0.9", "none", "2"))):
        asked.clear()
        system = SimpleNamespace(nodes=nodes)
        monkeypatch.setattr(design, "error_system", lambda model, system=system: system)
        assert design._exact("model", GAIN) == dict(zip((  # type: ignore[arg-type]
            "reception", "exact decay", "long run, noise alone", "long run, forces at their bounds"), said,
            strict=True))
        assert asked == [(system, GAIN, chance) for chance in chances]

    def no(*_: Any) -> Any:
        raise Unsupported("no")

    for name in ("mean_square", "error_system"):
        monkeypatch.setattr(design, name, no)
        assert design._exact("model", GAIN) == {}  # type: ignore[arg-type]


def test_nested_values_as_lines() -> None:
    found = {"a": 1.23456789, "b": {"c": np.array([1.0, 22.22222]), "d": {"e": [[1, 2], [3, 4]]}}, "f": ["x"], "g": 7,
             "h": True, "i": [1.5], "j": [[True]], "k": None}
    assert design._lines(found) == [
        ("a", "1.23457"), ("b: c", "1  22.22"), ("b: d: e, row 1", "1  2"), ("b: d: e, row 2", "3  4"), ("f", "['x']"),
        ("g", "7"), ("h", "True"), ("i", "1.5"), ("j", "[[True]]"), ("k", "None")]


def test_a_plug_in_s_design_comes_back_as_plain_data(monkeypatch: pytest.MonkeyPatch) -> None:
    made = design._Designed({"bound": "1"}, GAIN, {"m": np.array([1, 2])})
    monkeypatch.setattr(design, "_designed", lambda *given: made)
    monkeypatch.setattr(design, "estimator_class", lambda plugin, where: (plugin, where))
    plain = design._plain(SETTING, "s", "v", ENTRY)  # type: ignore[arg-type]
    assert plain == [{"bound": "1"}, GAIN.tolist(), {"m": [1, 2]}] == json.loads(json.dumps(plain))

    class Process:
        def __init__(self, answer: Any) -> None:
            self.answer = answer

        def __enter__(self) -> Process:
            return self

        def __exit__(self, *_: object) -> None: ...

        def call(self, *given: Any) -> Any:
            assert given == (design._plain, SETTING, "s", "v", ENTRY)
            return self.answer

    def apart(answer: Any) -> design._Designed:
        catalogue: Any = SimpleNamespace(process=lambda plugin, limit: Process(answer if (plugin, limit) == (
            "p", design.IMPORT) else None))
        return design._designed_apart(SETTING, "s", "v", catalogue, ENTRY)  # type: ignore[arg-type]

    found = apart(plain)
    assert (found.row, found.other) == ({"bound": "1"}, {"m": [1, 2]})
    np.testing.assert_array_equal(found.gain, GAIN)  # type: ignore[arg-type]
    assert apart([{}, None, {}]) == ({}, None, {})
    assert apart(Ended(Status.timeout, "hung")) == ({"bound": "not certified", "status": "hung"}, None, {})


def printed(capsys: pytest.CaptureFixture[str]) -> list[str]:
    return [" ".join(text.split()) for text in capsys.readouterr().out.splitlines()]


@pytest.mark.parametrize(("channel", "grows", "mean", "burst"), [
    (GilbertElliott.model_validate({"kind": "gilbert-elliott", "p_good": 1.0, "p_bad": 0.0, "p_good_bad": 0.1,
                                    "p_bad_good": 0.5}), 1.5, 2.0, "0.75, so the mean is bounded"),
    (GilbertElliott.model_validate({"kind": "gilbert-elliott", "p_good": 1.0, "p_bad": 0.0, "p_good_bad": 0.1,
                                    "p_bad_good": 0.5}), 2.0, None, "1, so the mean is infinite"),
    (GilbertElliott.model_validate({"kind": "gilbert-elliott", "p_good": 1.0, "p_bad": 0.0, "p_good_bad": 0.1,
                                    "p_bad_good": 0.5}), 1.5, None, ""),
    (GilbertElliott.model_validate({"kind": "gilbert-elliott", "p_good": 0.9, "p_bad": 0.0, "p_good_bad": 0.1,
                                    "p_bad_good": 0.5}), 1.5, 2.0, ""),
    (SimpleNamespace(p_good=1.0, p_bad=0.0), 0.5, 2.0, "")])
def test_the_table_of_losses(channel: Any, grows: float, mean: float | None, burst: str,
                             capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Bursts are told of where a packet arrives in the good state alone, and the mean is known or endless."""
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setattr(design, "plant", lambda model: ("A", model))
    monkeypatch.setattr(design, "growth", lambda A: grows if A == "A" else None)
    monkeypatch.setattr(design, "mean_covariance", lambda model, p: Losses(
        p, 1.23456, mean, 0.01 if mean else None, 5.0 if p > 0.3 else np.inf))
    world = SimpleNamespace(initial_mean=0)
    setting: Any = SimpleNamespace(world=lambda streams: world, design_model=lambda told, start: (told, start),
                                   config=SimpleNamespace(channel=channel))
    design._losses(setting, "s", "v", [0.75, 0.25], "")
    said, threshold = printed(capsys), f"{1 - 1 / max(grows, 1.0):.4g}"
    middle = "2 0.02" if mean else "not known"
    assert [text for text in said if text.startswith("0.")] == [f"0.25 1.235 {middle} infinite",
                                                                f"0.75 1.235 {middle} 5"]
    last = [text for text in said if text][1:][-2 if burst else -1:]
    assert last == [f"Infinite where the share is at most 1 - 1/rho^2 = {threshold}, rho the largest |eigenvalue| of "
                    "A.", *([f"Bursts of this channel: (1 - p_bad_good) rho^2 = {burst}, whatever the mean loss."]
                      if burst else [])]


def test_the_table_of_a_trade_off(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    found = [(0.99, SimpleNamespace(bound=1.234567, status="optimal")), (0.9, Infeasible("no certificate"))]
    monkeypatch.setattr(design, "error_system", lambda model: model)
    monkeypatch.setattr(design, "trade_off", lambda system, thetas: found if (system, thetas) == (
        "model", [0.99, 0.9]) else None)
    world = SimpleNamespace(initial_mean=0)
    setting: Any = SimpleNamespace(world=lambda streams: world, design_model=lambda told, start: "model")
    design._trade_off(setting, "s", "v", [0.99, 0.9], "")
    said = printed(capsys)
    assert said[0] == "Certified bound on E |z~|^2 against decay, s/v" and said[-3:] == [
        "0.99 1.2346 optimal", "0.9 not certified no certificate", ""]
    for text in ("0.5,1", "0,0.5", "a", "", "0.5,-0.1", "nan"):
        with pytest.raises(InputError) as caught:
            design._shares(text, "--losses")
        assert str(caught.value) == f"--losses {text}: expected numbers between 0 and 1, such as 0.97,0.98,0.99"
    assert design._shares("0.5, 1e-3", "--losses") == [0.5, 1e-3]
