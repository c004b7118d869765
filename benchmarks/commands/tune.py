"""`railstate tune`: the best numbers for one estimator of a scenario, searched on runs that are none of the table's."""

from __future__ import annotations

import os
import shlex
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import pandas as pd
import typer

from ...scenarios.errors import InputError
from ..planning.naming import find_one
from ..running.runner import Machinery
from ..studies.search import parse_axis
from ..studies.tune import CONSTRAINTS, Scored, Task, toml, tune
from ..telling.console import print_table
from .options import Jobs, Runs, Seed, Sets, names_in, overrides


def tune_(
    scenario: Annotated[str, typer.Argument(help="Built-in name, NAME/VARIANT, or a TOML file.")],
    estimator: Annotated[str, typer.Option(metavar="LABEL", help="The estimator of the scenario that is tuned.")],
    over: Annotated[str, typer.Option(metavar="KEY=LOW..HIGH:log,..", help="What of its entry is searched, and between "
                                      "which limits: linear, :log, :log1m (the logarithm of 1 - x), :int, or KEY=A|B; "
                                      "KEY+KEY ties two; knowledge.sigma_v.1 is one element of a list.")],
    objective: Annotated[str, typer.Option(metavar="METRIC:QUANTITY,..", help="What is made least, of several their "
                                           "geometric mean; log-likelihood:innovation, made greatest, needs no "
                                           "truth.")],
    budget: Annotated[int, typer.Option(help="Evaluations at the most (0: 30 for each number, 100 in all).")] = 0,
    runs: Runs = 100,
    seed: Seed = 1,
    jobs: Jobs = 0,
    out: Annotated[str, typer.Option(help="Write the tuned entry to this TOML file.")] = "",
    set_: Sets = [],  # noqa: B006
) -> None:
    """Tune an estimator on training runs, show it beside the untuned one on the table's, print its entry as TOML."""
    axes = [parse_axis(part) for part in names_in(over)]
    aims = tuple((metric, quantity) for metric, _, quantity in (part.partition(":") for part in names_in(objective)))
    if not axes or not aims or not all(quantity for _, quantity in aims):
        raise InputError(f"--objective {objective}: expected METRIC:QUANTITY, such as rmse:speed")
    for metric, quantity in aims:
        if metric in CONSTRAINTS:
            raise InputError(f"--objective {metric}:{quantity}: is right at a value of its own, a constraint, never an "
                             "objective alone; take an error or log-likelihood:innovation")
    if budget < 0 or 0 < budget < 3:
        raise InputError(f"--budget {budget}: at least 3 evaluations, or 0 for the usual number")
    allowed = budget or min(30 * len(axes), 100)
    fixed = overrides(set_)
    found, variant = find_one(scenario, fixed)
    name = scenario[:-len(variant) - 1] if scenario.endswith(f"/{variant}") else scenario
    task = Task(found, name, variant, estimator, fixed, aims, runs, seed, Machinery(jobs or os.cpu_count() or 1))
    tuned = tune(task, axes, allowed)
    best = ", ".join(f"{key} = {value:.6g}" if isinstance(value, float) else f"{key} = {value}"
                     for key, value in tuned.found.values.items())
    print(f"{estimator} on {found.name}/{variant}: {best}; {len(tuned.found.losses)} evaluations of at most {allowed} "
          f"on {runs} training runs")
    for key in tuned.found.edge:
        print(f"the optimum of {key} lies at a limit of the search: it may be better beyond")
    print_table("Train against test", pd.DataFrame([_line(entry, tuned.train[entry], tuned.test[entry], aims)
                                                    for entry in ("untuned", "tuned")]),
                ["train: the trips on which was searched; test: the others." if found.setting(variant).split(True) else
                 "train: runs of a seed of their own, on which was searched; test: the table's."])
    gaps = {entry: tuned.test[entry].loss / tuned.train[entry].loss - 1 for entry in ("untuned", "tuned")}
    print(f"test over train: tuned {gaps['tuned']:+.2%}, untuned {gaps['untuned']:+.2%}; what tuning adds to it: "
          f"{gaps['tuned'] - gaps['untuned']:+.2%}")
    words = shlex.join(["railstate", *sys.argv[1:]])
    text = toml(f"{estimator}-tuned", tuned.entry, f"tuned: {words}, {datetime.now(UTC).date()}; "
                f"{len(tuned.found.losses)} evaluations of at most {allowed}")
    print(text)
    if out:
        try:
            Path(out).write_text(text, encoding="utf-8")
        except OSError as error:
            raise InputError(f"--out {out}: cannot be written: {error.strerror}") from None


def _line(entry: str, train: Scored, test: Scored, aims: tuple[tuple[str, str], ...]) -> dict[str, str]:
    """A line of the table: each metric on both sets, SI units."""
    out = {"entry": entry}
    for i, (metric, quantity) in enumerate(aims):
        for where, scored in (("train", train), ("test", test)):
            spread = f" ± {1.96 * scored.sd:.2g}" if scored.sd == scored.sd else ""
            lost = f", {scored.lost} lost" if scored.lost else ""
            out[f"{where}: {metric} {quantity}"] = f"{scored.values[i]:.5g}{spread}{lost}"
    return out
