"""`railstate run`: scenarios x variants x estimators x runs, into a results folder and tables."""

from __future__ import annotations

from typing import Annotated

import typer

from ...estimators.interface import Status
from ...scenarios.errors import InputError
from ..api import runs as api
from ..telling.results import print_results, print_results_json
from . import options as use


def run(
    scenarios: Annotated[list[str] | None, typer.Argument(
        metavar="[SCENARIO ...]", help="Built-in name, NAME/VARIANT, or a TOML file; none: all built-in.")] = None,
    estimators: use.Estimators = "",
    runs: use.Runs = 100,
    seed: use.Seed = 1,
    jobs: use.Jobs = 0,
    batch: use.Batch = 0,
    out: Annotated[str, typer.Option(help="Results folder; what it lacks is added.")] = "",
    set_: use.Sets = [],  # noqa: B006
    plugin: use.Plugins = [],  # noqa: B006
    keep: Annotated[int, typer.Option(help="Keep the trajectories of the first N runs for figures.")] = 1,
    line: use.Line = "",
    train: use.Train = "",
    recording: use.Recording = [],  # noqa: B006
    map_: use.Map = "",
    quality: use.Quality = "",
    missing: use.Missing = "",
    track: use.Track = "",
    balises: use.Balises = "",
    from_: use.From = None,
    to: use.To = None,
    without: use.Without = [],  # noqa: B006
    backend: use.Backend = "local",
    scheduler: use.Scheduler = "",
    timeout: use.Timeout = 900.0,
    memory: use.Memory = 0.0,
    retry: Annotated[str, typer.Option(metavar="STATUS,..", help="Statuses to compute anew: crashed,timeout,..")] = "",
    overwrite: Annotated[bool, typer.Option(
        "--overwrite", help="Compute anew what the folder holds of this; replace another configuration.")] = False,
    until: Annotated[str, typer.Option(metavar="WHAT", help=(
        "Add runs, at most --runs, until a half interval is so small, as rmse:position=1%, or until verdicts are "
        "decided."))] = "",
    json: use.Json = False,
    quiet: use.Quiet = False,
) -> None:
    """Run estimators on scenarios and print the tables."""
    changes = {**use.overrides(set_), **use.files(line, train, recording),
               **use.meaning(map_, quality, missing, track, balises, from_, to, without)}
    again = use.names_in(retry)
    allowed = [status.name for status in Status if status is not Status.ok]
    if not set(again) <= set(allowed) or (retry and not again):
        raise InputError(f"--retry {retry}: expected statuses of lost rows; allowed: {', '.join(allowed)}")
    found = api.run(scenarios or (), use.labels(estimators) or None, runs=runs, seed=seed, jobs=jobs, folder=out,
                    overrides=changes, plugins=plugin, keep=keep, until=until, retry=again, overwrite=overwrite,
                    batch=batch, backend=backend, scheduler=scheduler, timeout=timeout, memory=memory,
                    quiet=quiet or json, command=use.command())
    if json:
        print_results_json(found.store)
    elif not quiet:
        print_results(found.store)
