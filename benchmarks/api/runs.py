"""Runs as Python and the command line ask for them: what the folder lacks is computed, no more."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..judging.stopping import rule
from ..planning.catalogue import Catalogue
from ..planning.plan import make_plan
from ..running.machinery import machinery
from ..studies.complete import complete, default_folder
from ..studies.until import complete_until
from ..telling.console import hush
from .given import Given, taken
from .results import Results


def run(scenario: str | Path | Sequence[str | Path] = (), estimators: Any = None, *,
        runs: int = 100, seed: int = 1, jobs: int = 0, folder: str | Path | None = None,
        overrides: Mapping[str, Any] | None = None, plugins: Sequence[str] = (), keep: int = 1, until: str = "",
        retry: Collection[str] = (), overwrite: bool = False, batch: int = 0, backend: str = "local",
        scheduler: str = "", timeout: float = 900.0, memory: float = 0.0, quiet: bool = False, command: str = ""
        ) -> Results:
    """Run estimators on scenarios; compute what the folder lacks of it, and no more.

    scenario: a built-in name, NAME/VARIANT, NAME/PATTERN*, a TOML file, or several; none: all built-in. estimators: a
    label of the scenario, the name of an installed one, a class over `railstate.Estimator`, an object of one, a
    function `make(model)` that returns `step(y, u)`, or several; a mapping gives labels: {"mine": Mine(..), "wide":
    {"plugin": "ekf", "knowledge": {"sigma_w": 1.0}}}. Classes, objects and functions that are not the suite's own go by
    value into processes of their own. Their rows count in this session: in another they are computed anew, and neither
    `railstate replay` nor `verify` can compute them.

    jobs: processes (0: all cores). folder: where rows are kept and found again (None: results/NAME-HASH). overrides:
    {"channel.p": 0.3}, as `--set`. plugins: loose files with estimators. keep: trajectories of the first runs that are
    kept for figures. until: "rmse:position=1%" or "decided". retry: statuses whose rows are computed anew. timeout:
    seconds; memory: GB, of a plug-in's process. command: as the folder is to tell it. The rest is as in `railstate run
    --help`. Raises InputError."""
    names = [scenario] if isinstance(scenario, str | os.PathLike) else list(scenario)
    given = taken(estimators)
    command = command or _call(names, given, runs, seed, folder, overrides)
    hush(quiet)
    how = machinery(jobs, batch, backend, scheduler, timeout, memory)
    plan = make_plan([str(name) for name in names], only=given.only, runs=runs, seed=seed, keep=keep,
                     overrides=overrides, catalogue=Catalogue([*plugins, *given.files]), entries=given.entries)
    place = Path(folder) if folder else default_folder(plan)
    if until:
        return Results(complete_until(plan, rule(until, runs), place, how, command, retry=retry,
                                      overwrite=overwrite))
    return Results(complete(plan, place, how, command, retry=retry, overwrite=overwrite))


def _call(names: Sequence[Any], given: Given, runs: int, seed: int, folder: Any, overrides: Any) -> str:
    """The call in words, for the folder."""
    words = [", ".join(repr(str(name)) for name in names)]
    words = [f"[{words[0]}]"] if len(names) != 1 else words
    words += [repr(list(given.only))] if given.only else []
    words += [f"{key}={value!r}" for key, value, usual in (("runs", runs, 100), ("seed", seed, 1), (
        "overrides", dict(overrides or {}), {})) if value != usual]
    words += [f"folder={str(folder)!r}"] if folder else []
    return f"railstate.run({', '.join(words)})"
