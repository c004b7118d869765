"""`railstate check`: the conformance test of an estimator, as a table of rules kept and the findings in full."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ...estimators.registry import estimator_class, load_file
from ..conformance import Finding, Report
from ..planning.naming import located
from ..running.isolation import Ended, isolation
from .options import overrides


def check(
    name: Annotated[str, typer.Argument(metavar="NAME|FILE", help="An installed estimator, or a Python file.")],
    scenario: Annotated[str, typer.Option(
        help="Scenario, NAME/VARIANT or TOML file; none: chosen by what it needs.")] = "",
    parameter: Annotated[list[str] | None, typer.Option(
        metavar="KEY=VALUE", help="A parameter of the estimator.")] = None,
    timeout: Annotated[float, typer.Option(min=1.0, help="Seconds after which a plug-in counts as hung.")] = 300.0,
) -> None:
    """Check that an estimator keeps the rules of the suite; exit code 1 if it does not."""
    from ..conformance import conform

    is_file = name.endswith(".py") or Path(name).is_file()
    classes = load_file(name) if is_file else {name: estimator_class(name, "check")}
    given = overrides(parameter or [], "--parameter", "gain=0.5")
    broken = 0
    with isolation(timeout) as process:
        for plugin, cls in classes.items():
            report = (conform(cls, plugin, given, scenario) if cls.__module__.startswith("railstate.") else
                      process.call(_check, str(Path(name).resolve()) if is_file else "", plugin, given,
                                   located(scenario)))
            if isinstance(report, Ended):
                report = Report({}, {}, [Finding("runs", "some case", "design, start, predict, update and estimate "
                                                 "come back", report.reason, "see what it does to its process, or "
                                                 "for how long it may go on")])
            _print(plugin, report)
            broken += len(report.findings)
    if broken:
        raise typer.Exit(1)


def _check(file: str, plugin: str, parameters: dict[str, Any], scenario: str) -> Report:
    """The check of a plug-in, in whatever process."""
    from ..conformance import conform

    if file:
        load_file(file)
    return conform(estimator_class(plugin, "check"), plugin, parameters, scenario)


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
