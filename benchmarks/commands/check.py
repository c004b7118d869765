"""`railstate check`: the conformance test of an estimator, as a table of rules kept and the findings in full."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer
from pydantic import TypeAdapter, ValidationError

from ...estimators.interface import Status
from ...estimators.registry import estimator_class, estimators
from ..conformance import Finding, Report
from ..isolation.process import Ended
from ..planning.catalogue import Catalogue
from ..planning.naming import located
from ..running.machinery import machinery
from .options import Memory, Timeout, overrides


def check(
    name: Annotated[str, typer.Argument(metavar="NAME|FILE", help="An installed estimator, or a Python file.")],
    scenario: Annotated[str, typer.Option(
        help="Scenario, NAME/VARIANT or TOML file; none: chosen by what it needs.")] = "",
    parameter: Annotated[list[str] | None, typer.Option(
        metavar="KEY=VALUE", help="A parameter of the estimator.")] = None,
    timeout: Timeout = 300.0,
    memory: Memory = 0.0,
) -> None:
    """Check that an estimator keeps the rules of the suite; exit code 1 if it does not."""
    from ..conformance import conform

    is_file = name.endswith(".py") or Path(name).is_file()
    catalogue = Catalogue([name] if is_file else [])
    how = machinery(1, timeout=timeout, memory=memory)
    given = overrides(parameter or [], "--parameter", "gain=0.5")
    broken = 0
    for plugin in catalogue.loose or [name]:
        if plugin in estimators():
            report = conform(estimators()[plugin], plugin, given, scenario)
        else:
            with catalogue.process(plugin, how.timeout, how.memory) as process:
                report = _report(process.call(_check, plugin, given, located(scenario)))
        _print(plugin, report)
        broken += len(report.findings)
    if broken:
        raise typer.Exit(1)


def _check(plugin: str, parameters: dict[str, Any], scenario: str) -> dict[str, Any]:
    """The check of a plug-in, in a process of its own, as plain data."""
    from ..conformance import conform

    return asdict(conform(estimator_class(plugin, "check"), plugin, parameters, scenario))


def _report(found: Any) -> Report:
    """What a process of its own found out, or that it did not come back."""
    if not isinstance(found, Ended):
        try:
            return TypeAdapter(Report).validate_python(found)
        except ValidationError:
            found = Ended(Status.crashed, "the process running it answered nonsense")
    return Report({}, {}, [Finding("runs", "some case", "design, start, predict, update and estimate come back",
                                   found.reason, "see what it does to its process, or for how long it may go on")])


def _print(plugin: str, report: Report) -> None:
    for case, kept in report.kept.items():
        print(f"{plugin} on {case}: {len(kept)} rules kept: {', '.join(kept)}")
    for case, reason in report.left_out.items():
        print(f"{plugin} on {case}: left out: {reason}")
    for found in report.findings:
        print(f"\nBROKEN {found.rule} ({plugin} on {found.case})\n  expected: {found.expected}\n"
              f"  happened: {found.happened}\n  mend:     {found.mend}")
    count = len(report.findings)
    print(f"{plugin}: {'all rules kept' if not count else f'{count} broken'}")
