"""`railstate reproduce`: every published number the suite can reach, beside ours, with a verdict."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import pandas as pd
import typer

from ...scenarios.errors import InputError
from ..planning.plan import Plan
from ..running.machinery import machinery
from ..store.folder import Store
from ..studies.complete import complete, default_folder
from ..telling.cleaning import csv
from ..telling.console import hush, print_json, print_table
from ..telling.markup import to_latex, to_markdown
from .options import Backend, Batch, Jobs, Json, Memory, Scheduler, Seed, Timeout, command

RUNS, SEED = 400, 1
"""Those of the committed tables."""


def reproduce(
    papers: Annotated[list[str] | None, typer.Argument(metavar="[PAPER ...]", help="Papers; none: all.")] = None,
    runs: Annotated[int, typer.Option("--runs", "-n", help="Monte Carlo runs.")] = RUNS,
    seed: Seed = SEED,
    jobs: Jobs = 0,
    out: Annotated[str, typer.Option(
        help="Folder for published.csv, .json, .md and .tex (results/published for the whole of it).")] = "",
    rows: Annotated[str, typer.Option(help="Folder for the rows behind it; continued if unfinished.")] = "",
    as_json: Json = False,
    batch: Batch = 0,
    backend: Backend = "local",
    scheduler: Scheduler = "",
    timeout: Timeout = 900.0,
    memory: Memory = 0.0,
) -> None:
    """Set our numbers beside the published ones. Exits with 1 when a verdict is not the expected one."""
    from ..published import tables
    from ..published.files import papers as read_papers
    from ..published.reproduce import plan_for
    from ..published.reproduce import reproduce as reproduced

    how = machinery(jobs, batch, backend, scheduler, timeout, memory)
    hush(as_json)
    if runs < 2:
        raise InputError("--runs: must be at least 2, or no number has an error to be judged by")
    whole = not papers and (runs, seed) == (RUNS, SEED)
    out = out or f"results/{'published' if whole else 'reproduction'}"
    chosen = read_papers(papers or [])
    plan: Plan = plan_for(chosen, runs, seed)
    frame = pd.DataFrame()
    if plan.cells:
        folder = Path(rows) if rows else default_folder(plan)
        frame = complete(plan, folder, how, command(), timing=False).rows()
    done = reproduced(chosen, frame)
    store, summary, document = Store(out), tables.counts(done), tables.document(done, runs, seed)
    Path(out).mkdir(parents=True, exist_ok=True)
    store.write_text("published.csv", csv(tables.table(done)))
    store.write_text("published.json", json.dumps(document, indent=1, ensure_ascii=False) + "\n")
    printed = [one for each in done for one in tables.printed(each)]
    store.write_text("published.md", "\n".join(to_markdown(*one) for one in
                                               [("Published numbers, reproduced", summary, []), *printed]))
    store.write_text("published.tex", "\n".join(to_latex(*one) for one in printed))
    wrong = [(each.paper.name, line) for each in done for line in each.lines if line.unexpected]
    if as_json:  # what published.json holds
        print_json(document)
    else:
        for title, part, notes in printed:
            print_table(title, part, notes)
        print_table("Cells by verdict", summary)
        for name, line in wrong:
            print(f"{name}: {line.group}: {line.cell}: {line.stands.verdict}, expected {line.expected} "
                  f"(published {line.published}, ours {line.stands.value:.6g})")
        lines = [line for each in done for line in each.lines]
        undecided = sum(line.stands.verdict == "undecided" for line in lines)
        print(f"{len(lines)} cells, {len(wrong)} verdicts other than expected"
              + (f", {undecided} undecided with {runs} runs" if undecided else "") + f"; in {out}")
    if wrong:
        raise typer.Exit(1)
