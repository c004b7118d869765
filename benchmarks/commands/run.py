"""`railstate run`: scenarios x variants x estimators x runs, into a results folder and tables."""

from __future__ import annotations

import shlex
import sys
from typing import Annotated

import typer

from ...estimators.interface import Status
from ...scenarios.errors import InputError
from ..api import runs as api
from ..telling.results import print_results, print_results_json
from .options import (
    Backend,
    Balises,
    Batch,
    Estimators,
    From,
    Jobs,
    Json,
    Line,
    Map,
    Memory,
    Missing,
    Plugins,
    Quality,
    Quiet,
    Recording,
    Runs,
    Scheduler,
    Seed,
    Sets,
    Timeout,
    To,
    Track,
    Train,
    Without,
    files,
    labels,
    meaning,
    names_in,
    overrides,
)


def run(
    scenarios: Annotated[list[str] | None, typer.Argument(
        metavar="[SCENARIO ...]", help="Built-in name, NAME/VARIANT, or a TOML file; none: all built-in.")] = None,
    estimators: Estimators = "",
    runs: Runs = 100,
    seed: Seed = 1,
    jobs: Jobs = 0,
    batch: Batch = 0,
    out: Annotated[str, typer.Option(help="Results folder; what it lacks is added.")] = "",
    set_: Sets = [],  # noqa: B006
    plugin: Plugins = [],  # noqa: B006
    keep: Annotated[int, typer.Option(help="Keep the trajectories of the first N runs for figures.")] = 1,
    line: Line = "",
    train: Train = "",
    recording: Recording = [],  # noqa: B006
    map_: Map = "",
    quality: Quality = "",
    missing: Missing = "",
    track: Track = "",
    balises: Balises = "",
    from_: From = None,
    to: To = None,
    without: Without = [],  # noqa: B006
    backend: Backend = "local",
    scheduler: Scheduler = "",
    timeout: Timeout = 900.0,
    memory: Memory = 0.0,
    retry: Annotated[str, typer.Option(metavar="STATUS,..", help="Statuses to compute anew: crashed,timeout,..")] = "",
    overwrite: Annotated[bool, typer.Option(
        "--overwrite", help="Compute anew what the folder holds of this; replace another configuration.")] = False,
    until: Annotated[str, typer.Option(metavar="WHAT", help=(
        "Add runs, at most --runs, until a half interval is so small, as rmse:position=1%, or until verdicts are "
        "decided."))] = "",
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run estimators on scenarios and print the tables."""
    changes = {**overrides(set_), **files(line, train, recording),
               **meaning(map_, quality, missing, track, balises, from_, to, without)}
    again = names_in(retry)
    allowed = [status.name for status in Status if status is not Status.ok]
    if not set(again) <= set(allowed) or (retry and not again):
        raise InputError(f"--retry {retry}: expected statuses of lost rows; allowed: {', '.join(allowed)}")
    found = api.run(scenarios or (), labels(estimators) or None, runs=runs, seed=seed, jobs=jobs, folder=out,
                    overrides=changes, plugins=plugin, keep=keep, until=until, retry=again, overwrite=overwrite,
                    batch=batch, backend=backend, scheduler=scheduler, timeout=timeout, memory=memory,
                    quiet=quiet or json, command=shlex.join(["railstate", *sys.argv[1:]]))
    if json:
        print_results_json(found.store)
    elif not quiet:
        print_results(found.store)
