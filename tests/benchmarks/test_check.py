"""`railstate check`: every built-in keeps every rule, and plug-ins broken on purpose, one per rule, are each caught."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import fields
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from railstate.benchmarks.conformance import check, rules, tapes
from railstate.benchmarks.conformance.rules import RULES
from railstate.estimators.baselines import Direct
from railstate.estimators.interface import Interval
from railstate.estimators.registry import estimators
from railstate.scenarios.machine_code import SUITE

from ..conftest import Command
from ..expected import digest

TEMPLATE = '''
import random as everyone
import numpy as np
from railstate.estimators.interface import Estimate, Estimator, Interval, Measurement, Status, Walk, flag


class Broken(Estimator):
    summary = "a filter of fixed gain that draws a little noise"
    claims = ("covariance",)

    def start(self, model, runs, random):
        super().start(model, runs, random)
        self.x, self.random = model.initial_mean.copy(), random
        self.P = np.repeat(model.initial_covariance, runs, axis=2)
        self.deaf = np.zeros(runs)

    def predict(self, u, interval):
        self.x = self.model.transition(self.x, u, interval)
        moving = interval.moving(self.runs)
        self.x[0] += 1e-3 * self.random.normal(1, which=moving)[0]

    def update(self, measurement):
        y, received, step = measurement.y, measurement.received, measurement.step
        innovation = np.where(received, y - self.model.measurement(self.x, step), 0.0)
        self.x = self.x + 0.3 * innovation[:1]
        self.deaf = np.where(received.any(axis=0), 0, self.deaf + 1)

    def walk(self, course, early):
        means, covariances = [], []
        for b, (u, y, received, end) in enumerate(zip(course.u, course.y, course.received, course.times)):
            self.predict(u, Interval(course.step + b, end - course.period, course.period))
            before = self.x.copy()
            self.update(Measurement(y, received, course.step + b))
            means.append(before if early else self.x.copy())
            covariances.append(self.P)
        return Walk(np.array(means), np.array(covariances))

    def estimate(self):
        return Estimate(self.x, covariance=self.P)
'''

CHANGES: dict[str, tuple[str, str, str]] = {
    "shapes": ("Estimate(self.x,", "Estimate(self.x.T,", "mean has shape (5, 2)"),
    "description": ('    claims = ("covariance",)\n', "", "estimate() gives covariance"),
    "causality": (
        "self.x = self.x + 0.3 * innovation[:1]",
        "self.x = self.x + 0.3 * innovation[:1] + np.where(received[0] & (y.base[-1, 0] > 20), 0.01, 0.0)",
        "with other measurements from event"),
    "independence": ("innovation[:1]", "innovation[:1].mean(axis=-1, keepdims=True)", "with only the runs [3]"),
    "determinism": ("self.random.normal(1, which=moving)[0]", "np.random.default_rng().normal(size=self.runs)",
                    "a second instance"),
    "global random state": ("self.random.normal(1, which=moving)[0]", "everyone.gauss(0.0, 1.0)",
                            "the state of the global generator"),
    "missing measurements": ("np.where(received, y - self.model.measurement(self.x, step), 0.0)",
                             "received * (y - self.model.measurement(self.x, step))",
                             "with nan in the elements that were not received"),
    "inputs": ("innovation = np.where(received, y - self.model.measurement(self.x, step), 0.0)",
               "y -= self.model.measurement(self.x, step)\n        innovation = np.where(received, y, 0.0)",
               "read-only"),
    "claims": ("moving = ", "self.P = self.P - 0.5 * interval.share * np.eye(2)[:, :, None]\n        moving = ",
               "has the negative eigenvalue"),
    "statuses": ("Estimate(self.x,", "Estimate(np.where(self.deaf > 6, np.nan, self.x),",
                 "is not finite although its status is ok"),
    "valid data": ("moving = ", "flag(self, np.full(self.runs, interval.step > 9), Status.failed, \"tired\")\n"
                   "        moving = ", "5 of 5 runs are lost; 0 is failed: tired"),
    "pickling": ("    def start(", "    def __init__(self, parameters=None):\n        super().__init__(parameters)\n"
                 "        self.gain = lambda: 0.3\n\n    def start(", "pickle"),
    "parts of a step": ("which=moving", "which=None", "a run that goes no part of a step"),
    "walks": ("before if early", "before if False", "walked, after the prediction of event 0 mean[0] of run 0"),
}


LOSE_WHAT_IS_SINGULAR = ("filterpy-ckf", "filterpy-ukf")
"""Cholesky factors of a covariance that is singular, as that library takes them, do not exist."""


def told(out: str) -> str:
    """What is printed, without places, lines of the suite's own and numbers of many digits: some are drawn from
    nowhere."""
    text = out.replace(str(Path.cwd()), ".").replace(f"{SUITE}/", "")
    text = re.sub(r"(benchmarks/\w+/\w+\.py):\d+", r"\1:LINE", text)
    return re.sub(r"-?\d+\.\d{5,}(e[+-]\d+)?", "#", text)


def plugin(folder: Path, rule: str) -> Path:
    """A file with a class that breaks one rule, and only by that."""
    old, new, _ = CHANGES[rule]
    assert TEMPLATE.count(old) == 1
    file = folder / "broken.py"
    file.write_text(TEMPLATE.replace(old, new))
    return file


@pytest.fixture(scope="module")
def once() -> Iterator[None]:
    """Each built-in scenario is read once for all built-in estimators."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(tapes, "find", cache(tapes.find))
        yield


@pytest.mark.usefixtures("once")
@pytest.mark.parametrize("name", sorted(estimators()))
def test_every_built_in_keeps_every_rule(name: str, expected: Callable[[str, str], None]) -> None:
    report = check(estimators()[name], name, {})
    cases = [f"{case}: {' '.join(rule[:5] for rule in kept)}" for case, kept in report.kept.items()]
    expected(f"kept:{name}", "\n".join([*cases, *map(str, report.findings), *map(": ".join, report.left_out.items())]))
    if name in LOSE_WHAT_IS_SINGULAR:
        assert [(found.rule, found.case) for found in report.findings] == [("valid data", "braking-rate/paper")]
        return
    assert report.findings == [] and "scenarios" not in report.left_out
    assert ("telling model" in {**report.kept, **report.left_out}) == ("covariance" in estimators()[name].honours)
    everywhere = [rule.name for rule in RULES[:-2]]  # parts of a step are tried on the small model; few walk
    assert report.kept and all(kept[:len(everywhere)] == everywhere for kept in report.kept.values())
    if name in ("kalman", "ekf", "ukf", "ckf", "particle", "dead-reckoning", "robust-mean-square"):
        assert "parts of a step" in report.kept["small model"]


def test_what_no_scenario_gives_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tapes, "scenario_files", lambda: ("rap-example-1",))  # it has no modes
    monkeypatch.setattr(Direct, "needs", ("linear", "modes"))
    report = check(Direct, "direct", {})
    assert report.left_out == {"scenarios": "no built-in scenario gives what it needs"} and not report.findings
    assert set(report.kept) == {"small model", "telling model"}


def test_every_rule_has_a_broken_plug_in() -> None:
    assert list(CHANGES) == [rule.name for rule in RULES]


def test_the_plug_in_they_are_made_from_keeps_every_rule(railstate: Command) -> None:
    (railstate.folder / "sound.py").write_text(TEMPLATE)
    done = railstate("check", "sound.py", "--scenario", "cart.toml/calm")
    assert done.code == 0 and done.err == "" and "sound: all rules kept" in done.out
    assert f"small model: {len(RULES)} rules kept" in done.out
    assert f"cart/calm: {len(RULES) - 1} rules kept" in done.out  # no parts of a step there


@pytest.mark.parametrize("rule", CHANGES)
def test_a_broken_plug_in_is_caught(railstate: Command, rule: str, expected: Callable[[str, str], None]) -> None:
    done = railstate("check", plugin(railstate.folder, rule), "--scenario", "cart.toml/calm")
    assert done.code == 1 and done.err == ""
    expected(f"findings:{rule}", told(done.out))
    findings = [part for part in done.out.split("\nBROKEN ") if part.startswith(f"{rule} (")]
    assert len(findings) in (1, 2), done.out
    expected, happened, mend = (line.split(":", 1)[1].strip() for line in findings[0].splitlines()[1:4])
    known = next(item for item in RULES if item.name == rule)
    assert (expected, mend) == (known.expected, known.mend)
    assert CHANGES[rule][2] in happened
    others = {part.split(" (")[0] for part in done.out.split("\nBROKEN ")[1:]} - {rule}
    # Numbers that no stream decides differ between any two feeds; the rest breaks its rule, or what follows from it.
    follow = {"causality": {"missing measurements"}, "independence": {"parts of a step"}, "determinism": others,
              "global random state": others}
    assert others <= follow.get(rule, set()), done.out


@pytest.mark.parametrize(("old", "new", "rule", "happened"), [
    ("        super().start(model, runs, random)\n", "", "runs", "in predict"),
    ("    claims = (", "    needs = \"linear\"\n    claims = (", "description", "needs = 'linear'"),
    ("    def start(", "    def __init__(self):\n        super().__init__()\n\n    def start(", "runs", "TypeError"),
    ("Estimate(self.x,", "Estimate(self.x.tolist(),", "shapes", "mean is list, not an array"),
    ("    def start(", "    def design(self, model):\n        import os\n        os._exit(3)\n\n    def start(", "runs",
     "the process running it died"),
    ("        self.deaf = np.zeros(runs)\n", "        raise GeneratorExit('no')\n", "runs", "GeneratorExit: no"),
    ("        self.deaf = np.zeros(runs)\n", "        raise KeyboardInterrupt\n", "runs", "KeyboardInterrupt"),
    ("covariance=self.P", "covariance=0.0 * self.P", "claims", "has no variance of element"),
    ("covariance=self.P", "covariance=0.0 * self.P + 0.01", "claims", "is singular, and leaves no room for the error"),
    ("0.3 * innovation[:1]", "(0.3 + 1e-15 * self.runs) * innovation[:1]", "independence", "only the last digits"),
    ("0.3 * innovation[:1]", "(0.3 + 1e-3 * self.runs) * innovation[:1]", "independence", "more than the last digits"),
    ("Estimate(self.x,", "Estimate(self.x.astype(np.float32),", "shapes", "float32"),
    ("        self.deaf = np.where(received.any(axis=0), 0, self.deaf + 1)\n",
     "        from railstate.estimators.interface import Innovation\n"
     "        return Innovation(innovation + (y.base[-1, 0] > 20))\n", "causality", "innovation.residual"),
], ids=["no-super", "needs", "init", "list", "dies", "base-exception", "interrupt", "certain", "singular", "inexact",
        "wrong", "float32", "innovation"])
def test_what_is_odd_is_a_finding(railstate: Command, old: str, new: str, rule: str, happened: str,
                                  expected: Callable[[str, str], None]) -> None:
    assert TEMPLATE.count(old) == 1
    (railstate.folder / "odd.py").write_text(TEMPLATE.replace(old, new))
    done = railstate("check", "odd.py", "--scenario", "cart.toml/calm")
    assert done.code == 1 and f"BROKEN {rule}" in done.out and happened in done.out and "Traceback" not in done.err
    expected(f"findings:{happened[:20].strip()}", told(done.out))



def test_the_tapes(expected: Callable[[str, str], None]) -> None:
    """What estimators are fed: every field, of some of the runs as well; the model: its matrices and functions."""
    out = list[str]()
    interval = Interval(3, 3.0, np.array([0.0, 0.4, 1.0]), np.array([0.0, 0.4, 1.0]))
    x, u = np.array([[1.0, 2.0, 3.0], [5.0, 7.0, 9.0]]), np.array([[0.5, -0.5, 1.0]])
    cases = [tapes.small_case({}), tapes.telling_case({})]
    cases += [tapes.scenario_case(estimators()["ekf"], "ekf", {}, wanted) for wanted in (
        "rap-example-1/late", "ningbo-metro/late", "moving-block", "odometry/wet")]
    for case in filter(None, cases):
        for tape in (case.tape, case.tape.only([2, 0])):
            out += [f"{case.name} {tape.steps} {tape.firsts} {tape.closed_loop} {case.exact_parts}",
                    *(f"  {field.name} {digest(getattr(tape, field.name))}" for field in fields(tape))]
            step = tape.step(tape.steps - 1, tape.initial_mean)
            out.append(f"  {step.number} {step.start} {step.length} {[digest(event.y) for event in step.events]}")
    for case in cases[:2]:
        assert case
        model = case.model(case.tape.initial_mean)
        out += [f"  {name} {digest(value)}" for name, value in rules._arrays(model)]
        assert model.bounds and model.bounds.part
        out += [f"  {digest(value)}" for value in (
            model.transition(x, u, interval), model.transition_jacobian(x, u, interval), model.bounds.part(interval),
            model.process_covariance(x, u, interval), model.measurement(x, 3), model.measurement_jacobian(x, 3))]
    expected("tapes", "\n".join(out))


def test_what_no_covariance_is() -> None:
    said = {name: rules._not_a_covariance(np.array(matrix)) for name, matrix in {
        "nan": [[np.nan]], "inf": [[1.0, np.inf], [np.inf, 1.0]], "zero": [[0.0]], "below": [[1.0, 0.0], [0.0, -1e-8]],
        "rounding": [[1.0, 0.0], [0.0, -1e-9]], "uneven": [[2.0, 1.0], [1.1, 2.0]], "even": [[2.0, 1.0], [1.0, 2.0]],
        "nearly": [[1.0, 1e-9], [0.0, 1.0]], "large": [[1e3, 0.0], [0.0, -2e-6]]}.items()}
    assert said == {"nan": "is not finite", "inf": "is not finite", "zero": None, "rounding": None, "even": None,
                    "nearly": None, "below": "has the negative eigenvalue -1e-08",
                    "uneven": "is not symmetric: [[2.0, 1.0], [1.1, 2.0]]",
                    "large": "has the negative eigenvalue -2e-06"}
    one, slack = np.array([[1.0, 0.0], [0.0, 0.0]]), np.array([0.1, 0.1])
    flat = np.array([[4.0, 2.0], [2.0, 1.0]])
    assert [rules._excluded(matrix, np.array(error), slack) for matrix, error in (
        (one, [9.0, 0.1]), (one, [0.0, -0.2]), (flat, [2.0, 1.0]), (flat, [4.0, -2.0]), (flat, [1.4, -0.7]),
        (np.zeros((2, 2)), [0.3, 0.2]), (np.eye(2), [9.0, 9.0]))] == [
        None, "has no variance of element 1, whose error is -0.2", None,
        "is singular, and leaves no room for the error [4.0, -2.0]", None,
        "has no variance of element 0, whose error is 0.3", None]
