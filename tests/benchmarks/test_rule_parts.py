"""The rules of `railstate check` on records changed by hand, each with its whole message; how a check itself ends.

In this process: what happens to plug-ins in theirs is in `test_check.py`."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pydantic import BaseModel, ValidationError
from railstate.benchmarks.commands.check import _print, _report
from railstate.benchmarks.conformance import checking, rules
from railstate.benchmarks.conformance.checking import Finding, Report, conform
from railstate.benchmarks.conformance.rules import RULES
from railstate.benchmarks.conformance.tapes import small_case
from railstate.benchmarks.conformance.trial import DoesNotApply, Record, Rule, Trial, feed
from railstate.benchmarks.isolation.process import Ended
from railstate.estimators.interface import Status
from railstate.estimators.kalman import Kalman
from railstate.scenarios.errors import Infeasible

RULE = {rule.name: rule for rule in RULES}


@cache
def sound() -> Trial:
    case = small_case({})
    return Trial(Kalman, case, feed(Kalman, case, case.tape.copy()))


def said(rule: str, record: Record | None = None, cls: Any = Kalman) -> str | None:
    trial = sound()
    return RULE[rule].test(Trial(cls, trial.case, trial.record if record is None else record))


def with_estimate(place: int, **parts: Any) -> Record:
    record = sound().record
    estimates = list(record.estimates)
    estimates[place] = replace(estimates[place], **parts)
    return replace(record, estimates=estimates)


def test_shapes_and_claims() -> None:
    record = sound().record
    assert said("shapes") is None and said("claims") is None
    assert said("shapes", replace(record, status=np.zeros(4, np.int8))) == "status has shape (4,) for 5 runs"
    assert said("shapes", with_estimate(4, mean=np.zeros((3, 5)))) == (
        f"{record.when[4]} mean has shape (3, 5), type float64; allowed for 2 states and 5 runs: float64 of shape "
        "(2, 5)")
    one = with_estimate(3, bound=np.array([1.0, 0.0, -2.0, 3.0, np.inf]))
    assert said("claims", one) == f"{record.when[3]} bound is [1.0, 0.0, -2.0, 3.0, inf]: a mean square is not negative"
    lost = np.where(np.arange(5) == 2, Status.failed, Status.ok).astype(np.int8)
    assert said("claims", replace(one, status=lost)) is None
    assert said("claims", with_estimate(1, bound=np.array([np.nan]))) == (
        f"{record.when[1]} bound is [nan]: a mean square is not negative")
    matrix = np.repeat(np.eye(2)[:, :, None], 5, axis=2)
    matrix[0, 0, 3] = np.nan
    assert said("claims", with_estimate(2, ellipsoid=matrix)) == f"{record.when[2]} ellipsoid of run 3 is not finite"
    last = len(record.estimates) - 1
    assert said("claims", with_estimate(last, covariance=None)) == (
        "claims lists covariance, but the last estimate has none")


def test_what_a_class_says_of_itself() -> None:
    def described(**facts: Any) -> str | None:
        return said("description", cls=SimpleNamespace(**{"summary": "s", "claims": ("covariance",), **facts}))

    parts = "parameter, covariance, ellipsoid, bound, diversity"
    assert described() is None
    assert described(summary=" \n") == "summary is empty"
    assert described(claims=("covariance", "x")) == (
        f"claims = ('covariance', 'x') holds unknown names; allowed: {parts}")
    assert described(claims="bound") == f"claims = 'bound' holds unknown names; allowed: {parts}"
    assert described(claims=()) == "estimate() gives covariance, which claims does not list"


def test_statuses_and_their_reasons() -> None:
    record = sound().record
    assert said("statuses") is None
    odd = np.array([0, 9, 0, 2, 9], np.int8)
    assert said("statuses", replace(record, status=odd)) == (
        f"status holds [0, 2, 9]; allowed: {[status.value for status in Status]}")
    some = replace(record, status=np.array([0, 2, 0, 2, 0], np.int8))
    assert said("statuses", replace(some, reasons={1: "tired", 3: ""})) == (
        "statuses are [0, 2, 0, 2, 0], but reasons says nothing of run 3")
    assert said("statuses", replace(some, reasons={1: "tired", 3: "too"})) is None
    assert said("statuses", replace(with_estimate(2, mean=np.full((2, 5), np.nan)), status=record.status)) == (
        f"{record.when[2]} mean of run 0 is not finite although its status is ok at the end")
    assert said("valid data") is None
    assert said("valid data", replace(some, reasons={3: "too"})) == "2 of 5 runs are lost; 1 is failed: "
    infeasible = np.where(np.arange(5) < 4, Status.infeasible, Status.diverged).astype(np.int8)
    assert said("valid data", replace(record, status=infeasible, reasons={4: "far"})) == (
        "1 of 5 runs are lost; 4 is diverged: far")


class Loose:
    """Parameters that are equal to nothing."""


class Unequal(Kalman):
    """One whose parameters are no data."""

    def __init__(self, parameters: Any = None) -> None:
        super().__init__(parameters)
        self.parameters = Loose()


def test_what_is_pickled() -> None:
    assert said("pickling") is None
    assert said("pickling", cls=Unequal) == "the unpickled parameters are not equal to the pickled ones"


def test_the_global_generators_stay_as_they_were() -> None:
    before = rules.random.getstate(), rules._numpy_state()
    trial, draw = sound(), [rules.random.random, np.random.random]
    assert said("global random state") is None and (rules.random.getstate(), rules._numpy_state()) == before

    class Draws(Trial):
        def feed(self, *given: Any, **how: Any) -> Record:
            draw[-1]()
            return trial.record

    while draw:
        assert RULE["global random state"].test(Draws(Kalman, trial.case, trial.record)) == (
            "the state of the global generator of random or numpy.random changed")
        assert (rules.random.getstate(), rules._numpy_state()) == before
        draw.pop()


class Never(Kalman):
    """One that no model suits."""

    def design(self, model: Any) -> dict[str, Any]:
        raise raising[0]


raising: list[BaseException] = []


def test_how_a_check_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """No model suits it, its parameters do not fit, it raises, a rule raises or does not apply; Ctrl-C is one."""
    monkeypatch.setattr(checking, "scenario_case", lambda *_: None)
    monkeypatch.setattr(Never, "honours", ())

    def of(error: BaseException) -> Report:
        raising[:] = [error]
        return conform(Never, "never", {})

    out = {"scenarios": "no built-in scenario gives what it needs"}
    found = of(Infeasible("no gain"))
    assert (found.kept, found.left_out) == ({}, {**out, "small model": "no gain"})
    assert found.findings == [Finding(
        "runs", "all", "a design model it works with",
        "scenarios: no built-in scenario gives what it needs; small model: no gain",
        "name a scenario that gives what it needs (--scenario), or parameters that fit it (--parameter KEY=VALUE)")]

    class Wanted(BaseModel):
        gain: float

    with pytest.raises(ValidationError) as caught:
        Wanted.model_validate({})
    monkeypatch.setattr(Never, "Parameters", Wanted)
    monkeypatch.setattr(Never, "__init__", lambda self, parameters=None: None)
    found = of(caught.value)
    assert found.left_out == {**out, "small model": "parameters.gain: missing"}
    for error, rule in ((ValueError("assignment destination is read-only"), "inputs"), (TypeError("read-only"), "runs"),
                        (ValueError("odd"), "runs"), (SystemExit(3), "runs")):
        (finding,) = of(error).findings
        known = RULE[rule] if rule == "inputs" else SimpleNamespace(
            expected="design, start, predict, update and estimate do their work",
            mend="see the line named above; start begins with super().start(model, runs, random)")
        assert (finding.rule, finding.case, finding.expected, finding.mend) == (
            rule, "small model", known.expected, known.mend)
        assert finding.happened.startswith(f"it raised {type(error).__name__}: {error} at {__file__}:")
        assert finding.happened.endswith(" in design")
    with pytest.raises(KeyboardInterrupt):
        of(KeyboardInterrupt())
    assert of(Infeasible("")).findings[0].rule == "runs"
    monkeypatch.setattr(Never, "needs", ("linear", "y"))
    assert of(Infeasible("")).findings == [Finding(
        "description", "the class", "needs = (..) names parts of DesignModel", "needs = ('linear', 'y')",
        "a tuple of names, such as needs = (\"linear\",)")]

    def rule(name: str, error: BaseException | str | None) -> Rule:
        def test(trial: Trial) -> str | None:
            if isinstance(error, BaseException):
                raise error
            return error

        return Rule(name, f"{name} expected", f"mend {name}", test)

    monkeypatch.setattr(Kalman, "honours", ())
    made = [rule("a", None), rule("b", DoesNotApply()), rule("c", "it happened"), rule("d", ArithmeticError("x"))]
    monkeypatch.setattr(checking, "RULES", made)
    found = conform(Kalman, "kalman", {})
    assert found.kept == {"small model": ["a"]} and found.left_out == out
    assert found.findings[0] == Finding("c", "small model", "c expected", "it happened", "mend c")
    assert found.findings[1].happened.startswith("it raised ArithmeticError: x at ") and len(found.findings) == 2
    monkeypatch.setattr(checking, "RULES", made[::-1])  # the first one broken says all
    assert [one.rule for one in conform(Kalman, "kalman", {}).findings] == ["d"]
    monkeypatch.setattr(checking, "RULES", [*made, rule("e", KeyboardInterrupt())])
    with pytest.raises(KeyboardInterrupt):
        conform(Kalman, "kalman", {})


def test_what_a_process_reports_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    plain = {"kept": {"small model": ["a", "b"]}, "left_out": {"big": "too big"},
             "findings": [dict(zip(("rule", "case", "expected", "happened", "mend"), "rcehm", strict=True))]}
    report = _report(plain)
    assert report == Report({"small model": ["a", "b"]}, {"big": "too big"}, [Finding(*"rcehm")])
    gone = "see what it does to its process, or for how long it may go on"
    for answer, why in ((7, "the process running it answered nonsense"), (Ended(Status.timeout, "it hung"), "it hung")):
        assert _report(answer) == Report({}, {}, [Finding(
            "runs", "some case", "design, start, predict, update and estimate come back", why, gone)])
    _print("mine", report)
    _print("other", replace(report, findings=[]))
    kept = " on small model: 2 rules kept: a, b\n"
    assert capsys.readouterr().out == (
        f"mine{kept}mine on big: left out: too big\n\nBROKEN r (mine on c)\n  expected: e\n  happened: h\n"
        f"  mend:     m\nmine: 1 broken\nother{kept}other on big: left out: too big\nother: all rules kept\n")
