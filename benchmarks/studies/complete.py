"""From a plan to a finished results folder: rows, timing, summary and tables. The heart of `railstate run`."""

from __future__ import annotations

import contextlib
import hashlib
import json
from pathlib import Path

import pandas as pd

from ..judging.summary import summarise
from ..planning.plan import Plan, own
from ..planning.tasks import task_name
from ..running.latency import timing_table
from ..running.runner import Machinery, run
from ..store.folder import Store
from ..store.manifest import description
from ..telling.console import progress
from ..telling.markup import to_latex, to_markdown
from ..telling.sayings import short_verdicts
from ..telling.tables import cell_tables, outage_tables, window_tables
from ..telling.wording import notes_of


class Interrupted(Exception):
    """Ctrl-C during a run: what was finished is in the folder and the same command goes on."""


def default_folder(plan: Plan) -> Path:
    """results/run-HASH of the plan's configuration: the same command continues its own folder."""
    text = json.dumps(plan.configuration(), sort_keys=True, default=str)
    return Path("results") / f"run-{hashlib.sha256(text.encode()).hexdigest()[:10]}"


def complete(plan: Plan, folder: Path, machinery: Machinery, command: str, *, timing: bool = True) -> Store:
    """Compute what is missing in `folder` and write the files that are made from the rows. Raises InputError,
    Interrupted."""
    store = Store(folder)
    try:
        store.open(plan.configuration(), description(plan), command)
        total = sum(len(cell.entries) for cell in plan.cells) * plan.runs
        done = store.done()
        with (progress(total - sum(len(runs) for runs in done.values()), "rows") as advance,
              contextlib.closing(run(plan, done, machinery)) as results):
            for found in results:
                task = found.task
                store.write_part(task_name(task), rows=found.rows, curves=found.curves, trajectories=found.kept)
                advance(len(task.runs) * len(task.labels), task.cell.key)
        rows = store.rows()
        if timing and not (folder / "timing.csv").exists():
            if not all(own(cell, label) for cell in plan.cells for label in cell.entries):
                write_tables(store, rows)  # first: a plug-in may take its time
            store.write_text("timing.csv", timing_table(plan, rows, machinery.timeout).to_csv(index=False))
        write_tables(store, rows)
        store.finish(rows=len(rows), statuses=rows["status"].value_counts().to_dict())
    except KeyboardInterrupt:
        have = sum(len(runs) for runs in store.done().values())
        raise Interrupted(f"interrupted: {have} rows are in {folder}; the same command continues "
                          f"(add --out {folder})") from None
    return store


def write_tables(store: Store, rows: pd.DataFrame) -> None:
    """summary.csv, tables/*.md and tables/*.tex, from the store's rows and timing alone."""
    manifest = store.manifest()
    summary = summarise(rows)
    store.write_text("summary.csv", summary.to_csv(index=False))
    for key, frame in cell_tables(summary, manifest, store.timing(), short_verdicts(rows, manifest)):
        scenario, variant = key.split("/")
        notes = notes_of(manifest["scenarios"][scenario]["variants"][variant])
        stem = f"tables/{scenario}~{variant}"
        store.write_text(f"{stem}.md", to_markdown(key, frame, notes))
        store.write_text(f"{stem}.tex", to_latex(key, frame, notes))
    for key, frame in outage_tables(rows):
        store.write_text(f"tables/{key.replace('/', '~')}~outages.csv", frame.to_csv(index=False))
    for title, frame in window_tables(rows, manifest):
        cell, _, what = title.partition(": ")
        stem = f"tables/{cell.replace('/', '~')}~{what.split()[2]}"
        store.write_text(f"{stem}.md", to_markdown(title, frame, []))
        store.write_text(f"{stem}.tex", to_latex(title, frame, []))
