"""What a sweep prints and writes of verdict lines made by hand, whole; its words of the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from railstate.benchmarks.commands import sweep
from railstate.benchmarks.judging.table import framed
from railstate.benchmarks.store.folder import Store
from railstate.benchmarks.telling.report.sweep import Sweep, tables
from railstate.benchmarks.telling.wording import plus_minus
from railstate.scenarios.errors import InputError

from .test_worded import line, ratio

TOLD = Sweep("s/v", ["p", "q"], [("rmse", "position")], ["a", "b", "c"], 40, 1,
             {"1 | 2": {"c": "failed: so"}, "1 | 3": {"a": "", "b": "lost: b", "c": "failed: so"}}, "railstate sweep")


def at(q: int, estimator: str, value: float, **facts: Any) -> dict[str, Any]:
    return {"p": 1, "q": q, **line(estimator, value, 0.05, **facts)}


ASKED = {"kind": "requirement", "metric": "kept", "quantity": "near", "unit": "1", "shown_unit": "1", "factor": 1.0,
         "against": "0.95"}
LINES = [
    at(2, "a", 0.01, **ratio(1.0, 1.0, 1.0, "best")), at(2, "b", 0.02, **ratio(2.0, 1.8, 2.2, "worse")),
    at(3, "a", 0.03, **ratio(1.0, 1.0, 1.0, "best")), at(3, "b", np.nan, runs=0, lost=40),
    at(2, "a", 0.9, **ASKED, verdict="met", note="P95 over runs: 2 m"),
    at(2, "b", 0.5, **ASKED, verdict="not met", note="P95 over runs: 9 m"),
    at(3, "a", 0.94, **ASKED, verdict="undecided", note="P95 over runs: 3 m", deciding=80.0),
    at(2, "a", 3.0, kind="claim", metric="bound", quantity="performance", **ratio(1.5, 1.4, 1.6, "broken")),
    at(2, "b", 3.0, kind="claim", metric="bound", quantity="performance", **ratio(0.5, 0.4, 0.6, "kept")),
    at(3, "a", 3.0, kind="claim", metric="coverage", quantity="ellipsoid", verdict="broken", note="left in 2 of 40"),
    at(2, "a", 0.0, kind="reliability", metric="lost", quantity="runs"),
    at(3, "b", 1.0, kind="reliability", metric="lost", quantity="runs", lost=40)]
TABLE = pd.concat([framed(LINES), pd.DataFrame(LINES)[["p", "q"]]], axis=1)


def test_what_a_sweep_finds_broken_and_its_grid() -> None:
    assert list(sweep._broken(TABLE, ["p", "q"])) == [
        "at p = 1, q = 2: a: measured mean square 3.00 is 1.50 times its certified bound",
        "at p = 1, q = 3: a: its claimed set does not hold: left in 2 of 40",
        "at p = 1, q = 3: b: 40 of 40 runs lost"]
    part = TOLD.part(TABLE, "rmse", "position")
    assert len(part) == 3 and TOLD.figure(part) is None
    assert sweep._grid(TOLD, TOLD.measured(part), [], plus_minus).to_dict("list") == {
        "p": ["1", "1"], "q": ["2", "3"], "a": ["1.0 ± 5.0", "3.0 ± 5.0"], "b": ["2.0 ± 5.0", "lost: b"],
        "c": ["failed: so"] * 2}
    [kept, (name, first, measured, figure)] = tables(TOLD, TABLE)
    assert (kept[0], kept[1], name, first, figure) == ("who keeps what", "requirement", "rmse position", "p", "")
    assert [(label, *(entry.data for entry in entries)) for label, entries in measured.lines] == [
        ("1", "2", "1", "2"), ("1", "3", "3", "")]
    assert [head for head, _, _ in measured.heads] == ["q", "a", "b"]
    assert [(label, *(entry.data for entry in entries)) for label, entries in kept[2].lines] == [
        ("near, 95 %", "1", "2", "0.9", "0.5"), ("near, 95 %", "1", "3", "0.94", "")]
    assert [head for head, _, _ in kept[2].heads] == ["p", "q", "a", "b"]
    assert kept[2].notes == ["Met most often, in 1 case of 2: a."]
    assert "<small>lost: b</small>" in str(measured.lines[1][1][2].html)


def test_who_keeps_what_is_printed_and_written(tmp_path: Path, capsys: pytest.CaptureFixture[str],
                                               monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    sweep._requirements(Store(tmp_path), TOLD, TABLE)
    lines = [" ".join(text.split()) for text in capsys.readouterr().out.splitlines()]
    assert lines == [
        "s/v: which estimator keeps what", "requirement p q a b", lines[2],
        "near, 95 % 1 2 ✓ 90.0 % [85.0, 95.0] ✗ 50 % [45.0, 55.0]", "near, 95 % 1 3 ? 94.0 % [89.0, 99.0] lost: b",
        "✓ met, ✗ not met, ? undecided; the share of runs or time that keep it, its 95 % interval.",
        "A verdict alone may mislead: sizes of errors and widths of claims are in requirements.md.", ""]
    assert (tmp_path / "requirements.md").read_text().splitlines() == [
        "## s/v: which estimator keeps what", "", "| requirement | p | q | a | b |",
        "| --- | ---: | ---: | --- | --- |",
        "| near, 95 % | 1 | 2 | ✓ 90.0 % [85.0, 95.0]; P95 over runs: 2 m | ✗ 50 % [45.0, 55.0]; P95 over runs: 9 m |",
        "| near, 95 % | 1 | 3 | ? 94.0 % [89.0, 99.0]; P95 over runs: 3 m | lost: b |", "",
        "- ✓ met, ✗ not met, ? undecided; the share of runs or time that keep it, its 95 % interval."]
    written = pd.read_csv(tmp_path / "requirements.csv").round(9).to_csv(index=False)
    assert written.splitlines() == [
        "p,q,estimator,requirement,asked,verdict,share,low,high,runs,deciding,sizes",
        "1,2,a,near,0.95,met,0.9,0.85,0.95,40,,P95 over runs: 2 m",
        "1,2,b,near,0.95,not met,0.5,0.45,0.55,40,,P95 over runs: 9 m",
        "1,3,a,near,0.95,undecided,0.94,0.89,0.99,40,80.0,P95 over runs: 3 m"]
    (tmp_path / "none").mkdir()
    sweep._requirements(Store(tmp_path / "none"), TOLD, TABLE[TABLE["kind"] != "requirement"])
    assert capsys.readouterr().out == "" and not list((tmp_path / "none").iterdir())


def test_words_of_a_sweep() -> None:
    for text, wanted in (("p=1,2,1", ("p", [1, 2])), ("p=[1,2],[3]", ("p", [[1, 2], [3]])),
                         ("p=true,1.5", ("p", [True, 1.5])), ("p=a=b", ("p", ["a=b"])), ("p=1,x", ("p", [1, "x"])),
                         ("k=a,b,a", ("k", ["a", "b"]))):
        assert sweep._axis(text) == wanted
    for text in ("p", "p=", "=1", ""):
        with pytest.raises(InputError) as caught:
            sweep._axis(text)
        assert str(caught.value) == f"--over {text}: expected KEY=V1,V2,.., such as channel.trains=1,2,3"
    assert [sweep._plain(item) for item in ([1, 2], {"a": 1}, "x", 2.5)] == ["[1, 2]", '{"a": 1}', "x", 2.5]
    assert sweep._wanted("rmse:position, kept:near", TABLE) == [("rmse", "position"), ("kept", "near")]
    assert sweep._wanted("", TABLE) == []
    with pytest.raises(InputError) as caught:
        sweep._wanted("rmse:position,mae:x", TABLE)
    assert str(caught.value) == ("--metric mae:x: not among the metrics here: bound:performance, coverage:ellipsoid, "
                                 "kept:near, lost:runs, rmse:position")
    rows = pd.DataFrame({"estimator": ["b", "b", "a", "c"], "status": ["failed", "ok", "timeout", "ok"],
                         "reason": ["no", "", "late", ""]})
    assert list(sweep._reasons(rows).items()) == [("b", ""), ("a", "timeout: late"), ("c", "")]
