"""The conformance test of an estimator: every rule on the small model and on a scenario; findings say how to mend."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from pydantic import ValidationError

from ...estimators.interface import Estimator
from ...scenarios.errors import Infeasible, InputError, describe
from ...scenarios.model import DesignModel
from .rules import RULES
from .tapes import scenario_case, small_case, telling_case
from .trial import DoesNotApply, Trial, feed, raised


@dataclass(frozen=True)
class Finding:
    """A broken rule."""

    rule: str
    case: str
    expected: str
    happened: str
    mend: str


@dataclass(frozen=True)
class Report:
    """Outcome of a check: rules kept per case, cases left out with their reason, findings."""

    kept: dict[str, list[str]]
    left_out: dict[str, str]
    findings: list[Finding]


def _stopped(error: BaseException, case: str) -> Finding:
    """What a class did wrong that raised."""
    inputs = next(rule for rule in RULES if rule.name == "inputs")
    if isinstance(error, ValueError) and "read-only" in str(error):
        return Finding(inputs.name, case, inputs.expected, raised(error), inputs.mend)
    return Finding("runs", case, "design, start, predict, update and estimate do their work", raised(error),
                   "see the line named above; start begins with super().start(model, runs, random)")


def conform(cls: type[Estimator], plugin: str, parameters: Mapping[str, Any], scenario: str = "") -> Report:
    """Check an estimator class on the small model and on a scenario. Raises InputError for parameters or a scenario
    that cannot be."""
    try:
        cls.Parameters.model_validate(dict(parameters))
    except ValidationError as error:
        # what is missing a scenario may give
        wrong = [line for line in describe(error, cls.Parameters, "parameters") if not line.endswith(": missing")]
        if wrong:
            raise InputError("\n".join(wrong)) from None
    report = Report({}, {}, [])
    unknown = [name for name in cls.needs if name not in {f.name for f in fields(DesignModel)}]
    if isinstance(cls.needs, str) or unknown:
        report.findings.append(Finding("description", "the class", "needs = (..) names parts of DesignModel",
                                       f"needs = {cls.needs!r}", "a tuple of names, such as needs = (\"linear\",)"))
        return report
    try:
        found = scenario_case(cls, plugin, parameters, scenario)
    except (TypeError, AttributeError) as error:
        report.findings.append(Finding("runs", "the class", "it can be made from its parameters", raised(error),
                                       "let __init__(self, parameters=None) call super().__init__(parameters)"))
        return report
    telling = [telling_case(parameters)] if "covariance" in cls.honours else []
    cases = [small_case(parameters), *telling, *([found] if found else [])]
    if not found:
        report.left_out["scenarios"] = "no built-in scenario gives what it needs"
    for case in cases:
        try:
            record = feed(cls, case, case.tape.copy())
        except Infeasible as error:
            report.left_out[case.name] = str(error)
            continue
        except ValidationError as error:
            report.left_out[case.name] = "; ".join(describe(error, cls.Parameters, "parameters"))
            continue
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # SystemExit and the like too
            report.findings.append(_stopped(error, case.name))
            continue
        trial = Trial(cls, case, record)
        for rule in RULES:
            try:
                happened = rule.test(trial)
            except DoesNotApply:
                continue
            except KeyboardInterrupt:
                raise
            except BaseException as error:
                happened = raised(error)
            if happened is None:
                report.kept.setdefault(case.name, []).append(rule.name)
            else:
                report.findings.append(Finding(rule.name, case.name, rule.expected, happened, rule.mend))
                if rule is RULES[0]:
                    break  # without the right shapes the other rules say nothing
    if not report.kept and not report.findings:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in report.left_out.items())
        report.findings.append(Finding("runs", "all", "a design model it works with", reasons,
                                       "name a scenario that gives what it needs (--scenario), or parameters that fit "
                                       "it (--parameter KEY=VALUE)"))
    return report
