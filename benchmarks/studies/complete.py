"""From a plan to a finished results folder: rows, timing, summary and tables. The heart of `railstate run`."""

from __future__ import annotations

import hashlib
import json
from itertools import groupby
from pathlib import Path

import pandas as pd

from .console import print_table, progress
from .describe import description
from .latency import timing_table
from .plan import Plan, own
from .runner import Machinery, run
from .store import Store
from .summary import cell_tables, outage_tables, summarise, to_latex, to_markdown, window_tables
from .verdicts import headlines, short_verdicts
from .wording import notes_of


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
        with progress(total - sum(len(runs) for runs in store.done().values()), "rows") as advance:
            run(plan, store, machinery, lambda task: advance(len(task.runs) * len(task.labels), task.cell.key))
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


def print_results(store: Store) -> None:
    """The tables on standard output, failures with their replay lines, and the closing count."""
    rows, manifest = store.rows(), store.manifest()
    summary = summarise(rows)
    tables = cell_tables(summary, manifest, store.timing(), short_verdicts(rows, manifest))
    windows: dict[str, list[tuple[str, pd.DataFrame]]] = {}
    for title, parts in window_tables(rows, manifest):
        windows.setdefault(title.partition(": ")[0], []).append((title, parts))
    for scenario, variants in groupby(tables, lambda item: item[0].split("/")[0]):
        told: set[str] = set()
        for key, frame in variants:
            notes = notes_of(manifest["scenarios"][scenario]["variants"][key.split("/")[1]])
            print_table(key, frame, [note for note in notes if note not in told])
            told.update(notes)
            for title, parts in windows.pop(key, []) if len(told) == len(notes) else []:
                print_table(title, parts)
        for line in headlines(rows, manifest, scenario):
            print(f"{scenario}: {line}")
        print()
    bad = rows[rows["status"] != "ok"]
    groups = bad.groupby(["scenario", "variant", "estimator", "status", "reason"], sort=False)
    for (scenario, variant, estimator, status, reason), part in groups:
        first = int(part["run"].iloc[0])
        print(f"{status}: {scenario}/{variant}/{estimator}, {len(part)} of {manifest['configuration']['runs']} runs: "
              f"{str(reason).splitlines()[0] if reason else 'no reason given'}\n"
              f"  replay: railstate replay {scenario}/{variant}/{estimator}/{first} --out {store.folder}")
    counts = rows["status"].value_counts()
    print(f"{len(rows)} rows: " + ", ".join(f"{n} {status}" for status, n in counts.items()) + f"; in {store.folder}")
