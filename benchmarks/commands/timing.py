"""`railstate timing`: side by side speed of our estimators and named peers, in one run, on one thread."""

from __future__ import annotations

from typing import Annotated

import pandas as pd
import typer

from ...scenarios.errors import InputError
from ..telling.console import print_table
from .options import names_in

START = "start"


def timing(
    only: Annotated[str, typer.Option(metavar="A,B", help="Comparisons to run; none: all. start: how long commands "
                                                            "take, from a first run with nothing compiled on.")] = "",
    repeats: Annotated[int, typer.Option(help="Repetitions, all sides in turn; the minimum is shown.")] = 5,
    processes: Annotated[int, typer.Option(help="Processes, one after the other, each with all repetitions.")] = 3,
) -> None:
    """Measure whole filter steps as the runner drives them, against a peer doing the same work."""
    from ..speed import COMPARISONS, race
    from ..speed.start import seconds

    chosen = names_in(only) or list(COMPARISONS)
    unknown = [name for name in chosen if name not in (*COMPARISONS, START)]
    if unknown:
        raise InputError(f"--only {','.join(unknown)}: no such comparison; allowed: "
                         f"{', '.join((*COMPARISONS, START))}")
    for option, value in (("--repeats", repeats), ("--processes", processes)):
        if value < 1:
            raise InputError(f"{option}: must be at least 1")
    for name in chosen:
        if name == START:
            print_table("start: whole commands, each in a process of its own", seconds(repeats))
            continue
        print_table(f"{name}: {COMPARISONS[name]}", pd.DataFrame(race(name, repeats, processes)))
