"""`railstate reproduce`: every published number the suite can reach, beside ours, with a verdict."""

from __future__ import annotations

import os
import shlex
import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import typer

from ...scenarios.errors import InputError
from ..planning.plan import Plan
from ..running.runner import Machinery
from ..store.folder import Store
from ..studies.complete import complete
from ..telling.console import print_table
from ..telling.markup import to_latex, to_markdown
from .options import Jobs, Seed

RUNS, SEED = 400, 1
"""Those of the committed tables."""
SHORT = ("item", "cell", "published", "ours", "standard_error", "unit", "verdict")


def reproduce(
    papers: Annotated[list[str] | None, typer.Argument(metavar="[PAPER ...]", help="Papers; none: all.")] = None,
    runs: Annotated[int, typer.Option("--runs", "-n", help="Monte Carlo runs.")] = RUNS,
    seed: Seed = SEED,
    jobs: Jobs = 0,
    out: Annotated[str, typer.Option(
        help="Folder for published.csv, .md and .tex (results/published for the whole of it).")] = "",
    rows: Annotated[str, typer.Option(help="Folder for the rows behind it; continued if unfinished.")] = "",
) -> None:
    """Set our numbers beside the published ones. Exits with 1 when a verdict is not the expected one."""
    from ..published.reproduce import UNDECIDED, counts, plan_for, reproduce
    from ..published.reproduce import papers as read_papers

    if runs < 2:
        raise InputError("--runs: must be at least 2, or no number has an error to be judged by")
    whole = not papers and (runs, seed) == (RUNS, SEED)
    out = out or f"results/{'published' if whole else 'reproduction'}"
    chosen = read_papers(papers or [])
    plan: Plan = plan_for(chosen, runs, seed)
    machinery = Machinery(jobs or os.cpu_count() or 1)
    frame = pd.DataFrame()
    if plan.cells:
        from ..studies.complete import default_folder

        folder = Path(rows) if rows else default_folder(plan)
        frame = complete(plan, folder, machinery, shlex.join(["railstate", *sys.argv[1:]]), timing=False).rows()
    table = reproduce(chosen, frame)
    store, summary = Store(out), counts(table)
    Path(out).mkdir(parents=True, exist_ok=True)
    store.write_text("published.csv", _rounded(table).to_csv(index=False))
    shown = _shown(table)
    documents = [(f"{paper.name}: {paper.title}", shown[table["paper"] == paper.name][list(SHORT)],
                  [f"{cell}: {note}" for cell, note in zip(part["cell"], part["note"], strict=True) if note])
                 for paper in chosen if len(part := table[table["paper"] == paper.name])]
    store.write_text("published.md", "\n".join(to_markdown(*one) for one in
                                               [("Published numbers, reproduced", summary, []), *documents]))
    store.write_text("published.tex", "\n".join(to_latex(*one) for one in documents))
    for title, part, _ in documents:
        print_table(title, part)
    print_table("Cells by verdict", summary)
    undecided = table["note"].str.endswith(UNDECIDED)
    wrong = table[(table["verdict"] != table["expected"]) & ~undecided]
    for _, line in wrong.iterrows():
        print(f"{line['paper']}: {line['item']}: {line['cell']}: {line['verdict']}, expected {line['expected']} "
              f"(published {line['published']}, ours {line['ours']:.6g})")
    print(f"{len(table)} cells, {len(wrong)} verdicts other than expected"
          + (f", {undecided.sum()} undecided with {runs} runs" if undecided.any() else "") + f"; in {out}")
    if len(wrong):
        raise typer.Exit(1)


def _rounded(table: pd.DataFrame) -> pd.DataFrame:
    """Six significant digits: what the solver's last digits do not change."""
    return table.assign(**{name: [np.nan if np.isnan(v) else float(f"{v:.6g}") for v in table[name]]
                           for name in ("ours", "standard_error")})


def _shown(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(ours=["" if np.isnan(v) else f"{v:.5g}" for v in table["ours"]],
                        standard_error=["" if np.isnan(v) else f"{v:.2g}" for v in table["standard_error"]],
                        published=[str(v) for v in table["published"]])
