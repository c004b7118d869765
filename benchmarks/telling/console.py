"""Printing: result tables, progress on a terminal, and nothing of it anywhere else."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import pandas as pd
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from .wording import numeric

WIDE = 400
"""Columns assumed where the output is a file or a pipe, so that no table is cut."""


def console() -> Console:
    """Standard output: as wide as the terminal, or wide enough for any table."""
    return Console(soft_wrap=False) if sys.stdout.isatty() else Console(width=WIDE, no_color=True, highlight=False)


def print_table(title: str, frame: pd.DataFrame, notes: Sequence[str] = (), to: Console | None = None) -> None:
    """Print a table; text columns to the left, numbers to the right."""
    out = to or console()
    if title:
        out.print(title, style="bold", highlight=False, markup=False)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for column in frame.columns:
        values = [str(value) for value in frame[column]]
        right = numeric(values)
        head = escape(str(column)).replace(" ", "\n") if right else escape(str(column))
        table.add_column(head, justify="right" if right else "left", overflow="fold", no_wrap=right,
                         min_width=None if right else min(24, max(map(len, [*values, str(column)]), default=0)))
    for row in frame.itertuples(index=False):
        table.add_row(*("" if pd.isna(value) else escape(str(value)) for value in row))
    out.print(table)
    for note in notes:
        out.print(f"  {note}", style="dim", highlight=False, markup=False)
    if notes:
        out.print()


@contextmanager
def progress(total: int, unit: str) -> Iterator[Callable[[int, str], None]]:
    """Yield `advance(count, what)`. A bar with rate and time left on a terminal's standard error; else silent."""
    if not sys.stderr.isatty() or total == 0:
        yield lambda count, what: None
        return
    columns = (TextColumn("{task.description:32.32}"), BarColumn(), TextColumn("{task.completed:.0f}/{task.total:.0f} "
               + unit), TextColumn("{task.fields[rate]}"), TimeElapsedColumn(), TextColumn("left"),
               TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        job = bar.add_task("starting", total=total, rate="")

        def advance(count: int, what: str) -> None:
            elapsed = bar.tasks[0].elapsed or 0.0
            done = bar.tasks[0].completed + count
            bar.update(job, advance=count, description=what, rate=f"{done / elapsed:.0f}/s" if elapsed else "")

        yield advance
