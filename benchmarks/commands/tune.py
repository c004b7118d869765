"""`railstate tune`: the best numbers for one estimator of a scenario, searched on runs that are none of the table's."""

from __future__ import annotations

import json
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer

from ...scenarios.errors import InputError
from ..planning.catalogue import Catalogue
from ..planning.naming import find_one
from ..running.machinery import machinery
from ..store.provenance import environment
from ..studies.entries import toml
from ..studies.search import parse_axis, parse_constraint
from ..studies.tune import CONSTRAINTS, GREATER, Task, Tuned, tune
from ..telling.console import print_table
from . import options as use


def tune_(
    scenario: Annotated[str, typer.Argument(help="Built-in name, NAME/VARIANT, or a TOML file.")],
    estimator: Annotated[str, typer.Option(metavar="LABEL", help="The estimator of the scenario that is tuned, or the "
                                           "name of an installed or loose one.")],
    over: Annotated[str, typer.Option(metavar="KEY=LOW..HIGH:log,..", help="What of its entry is searched, and between "
                                      "which limits: linear, :log, :log1m (the logarithm of 1 - x), :int, or KEY=A|B; "
                                      "KEY+KEY ties two; knowledge.sigma_v.1 is one element of a list.")],
    objective: Annotated[str, typer.Option(metavar="METRIC:QUANTITY,..", help="What is made least, of several their "
                                           "geometric mean; log-likelihood:innovation, made greatest, needs no "
                                           "truth.")],
    subject_to: Annotated[list[str], typer.Option(metavar="METRIC:QUANTITY=LOW..HIGH", help=(
        "What every tuned entry must keep, on the mean of the training runs: nees:state=0.8..1.25 (1 is right), "
        "coverage:ellipsoid=0.999.."))] = [],  # noqa: B006
    budget: Annotated[int, typer.Option(help="Evaluations at the most (0: 30 for each number, 100 in all).")] = 0,
    limit: Annotated[float, typer.Option(metavar="SECONDS", min=0.0, help="An evaluation that takes longer counts as "
                                         "lost (0: 20 times as long as the untuned entry, 10 s at the least).")] = 0.0,
    beside: Annotated[str, typer.Option(metavar="A,B", help="Other entries that the table shows on both sets.")] = "",
    runs: use.Runs = 100,
    seed: use.Seed = 1,
    jobs: use.Jobs = 0,
    out: Annotated[str, typer.Option(help="Write the tuned entry to this TOML file, and beside it, as .json, how it "
                                     "came about.")] = "",
    plugin: use.Plugins = [],  # noqa: B006
    set_: use.Sets = [],  # noqa: B006
    batch: use.Batch = 0,
    backend: use.Backend = "local",
    scheduler: use.Scheduler = "",
    timeout: use.Timeout = 900.0,
    memory: use.Memory = 0.0,
) -> None:
    """Tune an estimator on training runs, show it beside the untuned one on the table's, print its entry as TOML."""
    how = machinery(jobs, batch, backend, scheduler, timeout, memory)
    axes = [parse_axis(part) for part in use.names_in(over)]
    aims = tuple((part.partition(":")[0], part.partition(":")[2]) for part in use.names_in(objective))
    if not axes or not aims or not all(quantity for _, quantity in aims):
        raise InputError(f"--objective {objective}: expected METRIC:QUANTITY, such as rmse:speed")
    for metric, quantity in aims:
        if metric in CONSTRAINTS:
            raise InputError(f"--objective {metric}:{quantity}: is right at a value of its own, a constraint, never an "
                             "objective alone; take an error or log-likelihood:innovation, and --subject-to for this")
        if metric in GREATER and len(aims) > 1:
            raise InputError(f"--objective {objective}: {metric}:{quantity} is made greatest, and has no geometric "
                             "mean with what is made least; take it alone")
    if budget < 0 or 0 < budget < 3:
        raise InputError(f"--budget {budget}: at least 3 evaluations, or 0 for the usual number")
    allowed = budget or min(30 * len(axes), 100)
    fixed = use.overrides(set_)
    found, variant = find_one(scenario, fixed)
    name = scenario[:-len(variant) - 1] if scenario.endswith(f"/{variant}") else scenario
    begun = datetime.now(UTC)
    task = Task(found, name, variant, estimator, fixed, aims, runs, seed, how,
                Catalogue(plugin), tuple(map(parse_constraint, subject_to)), tuple(use.names_in(beside)), limit)
    tuned = tune(task, axes, allowed)
    best = ", ".join(f"{key} = {value:.6g}" if isinstance(value, float) else f"{key} = {value}"
                     for key, value in tuned.found.values.items())
    print(f"{estimator} on {found.name}/{variant}: {best}; {len(tuned.found.losses)} evaluations of at most {allowed} "
          f"on {runs} training runs")
    print("\n".join(_remarks(tuned)), end="")
    entries = ("untuned", "tuned", *(name for name in tuned.test if name not in ("untuned", "tuned")))
    print_table("Train against test", [_line(tuned, entry, aims) for entry in entries],
                ["train: the trips on which was searched; test: the others." if found.setting(variant).split(True) else
                 "train: runs of a seed of their own, on which was searched; test: the table's.",
                 *(["as told: the estimator as the scenario tells it."] if "as told" in entries else [])])
    (gap, error), (fixed_gap, _), (added, spread) = tuned.gap("tuned"), tuned.gap("untuned"), tuned.added()
    print(f"test over train: tuned {gap:+.2%} ± {1.96 * error:.2%}, untuned {fixed_gap:+.2%}; what tuning adds to it: "
          f"{added:+.2%} ± {1.96 * spread:.2%}")
    words = use.command()
    text = toml(f"{estimator}-tuned", tuned.entry, f"tuned: {words}, {begun.date()}; "
                f"{len(tuned.found.losses)} evaluations of at most {allowed}")
    print(text)
    if out:
        path = Path(out)
        manifest = {"command": words, "started": begun.isoformat(), "finished": datetime.now(UTC).isoformat(),
                    "environment": environment(), "scenario": f"{found.name}/{variant}",
                    "content": found.content_hash(variant), "estimator": estimator,
                    "axes": [asdict(axis) for axis in axes], "objective": aims,
                    "subject_to": [asdict(one) for one in task.subject_to], "runs": runs,
                    "seed": seed, "budget": allowed, "limit": tuned.limit, "evaluations": tuned.evaluations,
                    "entry": tuned.entry, "train": _told(tuned.train), "test": _told(tuned.test)}
        for place, content in ((path, text), (path.with_suffix(".json"), json.dumps(manifest, indent=1, default=str))):
            with use.written("--out", out):
                place.write_text(content, encoding="utf-8")


def _remarks(tuned: Tuned) -> list[str]:
    """What a user must know of the search, a line each."""
    lines = [f"the optimum of {key} lies at a limit of the search: it may be better beyond" for key in tuned.found.edge]
    if tuned.kept:
        lines.append("none is better than the untuned entry, which stays")
    over = sum(bool(one.get("over")) for one in tuned.evaluations)
    bad = sum(one["loss"] is None for one in tuned.evaluations) - over
    off = sum(one.get("broken") is None or one["broken"] > 0 for one in tuned.evaluations if one["loss"] is not None)
    if over:
        lines.append(f"{over} evaluations took more than {tuned.limit:.3g} s and were given up")
    if bad:
        lines.append(f"{bad} evaluations ended infeasible or with lost runs")
    if off:
        lines.append(f"{off} evaluations broke --subject-to")
    return [*lines, ""] if lines else lines


def _line(tuned: Tuned, entry: str, aims: tuple[tuple[str, str], ...]) -> dict[str, str]:
    """A line of the table: each metric on both sets, SI units."""
    out = {"entry": entry}
    for i, (metric, quantity) in enumerate(aims):
        for where, scored in (("train", tuned.train[entry]), ("test", tuned.test[entry])):
            sd = scored.sds[i]
            spread = f" ± {1.96 * sd:.2g}" if sd == sd else ""
            lost = f", {scored.lost} lost" if scored.lost else ""
            out[f"{where}: {metric} {quantity}"] = f"{scored.values[i]:.5g}{spread}{lost}"
    return out


def _told(scores: dict[str, Any]) -> dict[str, Any]:
    return {name: {"objective": scored.values, "standard_errors": scored.sds, "loss": scored.loss, "lost": scored.lost}
            for name, scored in scores.items()}
