"""From a plan to a finished results folder: rows, timing, summary and tables. The heart of `railstate run`."""

from __future__ import annotations

import contextlib
import hashlib
import json
import warnings
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from ...scenarios.errors import InputError, Interrupted
from ...scenarios.inheritance import written
from ...scenarios.source import source_hash
from ..judging.table import summary, verdicts
from ..planning.plan import Plan, own
from ..planning.tasks import task_name
from ..running.latency import timing_table
from ..running.machinery import Machinery
from ..running.runner import run
from ..scoring.columns import TIMING
from ..store.folder import Store
from ..store.growth import OVERWRITTEN, Growth, grown
from ..store.provenance import other_versions
from ..telling.cleaning import csv
from ..telling.console import progress
from ..telling.markup import to_latex, to_markdown
from ..telling.rankings import cells_of
from ..telling.sentences import caption
from ..telling.tables import cell_table, outage_tables, phase_tables, window_tables
from ..telling.wording import notes_of


def default_folder(plan: Plan) -> Path:
    """results/NAME-HASH, the same for all that may grow together: other runs, estimators and variants of the scenarios
    as they are, under the plan's seed and number of kept trajectories."""
    names = list(dict.fromkeys(cell.scenario for cell in plan.cells))
    parts = [json.dumps([plan.seed, plan.keep, sorted(names)]), plan.changes]
    parts += [text for where in sorted({cell.where for cell in plan.cells}) for text in written(where)]
    digest = hashlib.sha256("\0".join(parts).encode()).hexdigest()[:8]
    return Path("results") / f"{'+'.join(names) if len(names) < 3 else 'run'}-{digest}"


def complete(plan: Plan, folder: Path, machinery: Machinery, command: str, *, timing: bool = True,
             retry: Collection[str] = (), overwrite: bool = False) -> Store:
    """Compute what is missing in `folder` and write the files that are made from the rows. Raises InputError,
    Interrupted.

    retry: statuses whose rows are computed anew. overwrite: what is there of the plan is. A folder that cannot be
    written is read, if it holds all that is asked for."""
    store = Store(folder)
    if not store.writable:
        return _as_it_is(store, plan)
    try:
        with store.writing(command):
            _fill(store, grown(store, plan, overwrite), machinery, command, timing, retry)
    except KeyboardInterrupt:
        have = sum(len(runs) for runs in store.done().values())
        raise Interrupted(f"interrupted: {have} rows are in {folder}; the same command continues "
                          f"(add --out {folder})") from None
    return store


def _fill(store: Store, growth: Growth, machinery: Machinery, command: str, timing: bool, retry: Collection[str]
          ) -> None:
    plan = growth.plan
    before = store.manifest() if store.exists else None
    if before:
        _drop(store, growth, retry)
        if all((key, label) in growth.stale and growth.stale[key, label] == OVERWRITTEN
               for key, cell in before["configuration"]["cells"].items() for label in cell["estimators"]):
            before = None
    wanted = {(cell.key, label): max(plan.runs, cell.runs) for cell in plan.cells for label in cell.entries}
    done = store.done() if before else {}
    left = sum(wanted.values()) - sum(len(runs) for key, runs in done.items() if key in wanted)
    if before and done and left:
        for changed in other_versions(before["environment"]):
            warnings.warn(f"{store.folder}: was begun with another version: {changed}; the last bits of its rows may "
                          "differ from the new ones", stacklevel=2)
    if not before or left or before["configuration"] != json.loads(json.dumps(growth.configuration)):
        store.open(growth.configuration, growth.description, command, afresh=not before)
    touched: set[tuple[str, str]] = set()
    with progress(left, "rows") as advance, contextlib.closing(run(plan, done, machinery)) as results:
        for found in results:
            task = found.task
            store.write_part(task_name(task), rows=found.rows, curves=found.curves, trajectories=found.kept)
            touched.update((task.cell.key, label) for label in task.labels)
            advance(len(task.runs) * len(task.labels), task.cell.key)
    rows = store.rows()
    measured = store.timing()
    known = set() if measured is None else {(f"{scenario}/{variant}", label) for scenario, variant, label in
                                            zip(*(measured[name] for name in TIMING[:3]), strict=True)}
    untimed = [pair for pair in wanted if timing and (pair in touched or pair not in known)]
    makers = source_hash(__name__)
    if not left and not untimed and before and before["finished"] and before.get("tables") == makers:
        return  # all is as it was
    if untimed:
        some = [replace(cell, entries=entries) for cell in plan.cells if (entries := {
            label: entry for label, entry in cell.entries.items() if (cell.key, label) in untimed})]
        if not all(own(cell, label) for cell in some for label in cell.entries):
            write_tables(store, rows)  # first: a plug-in may take its time
        new = timing_table(replace(plan, cells=tuple(some)), rows, machinery)
        store.write_timing(new)
    write_tables(store, rows)
    store.finish(rows=len(rows), statuses=rows["status"].value_counts().to_dict(), tables=makers)


def _drop(store: Store, growth: Growth, retry: Collection[str]) -> None:
    """Take out what is to be computed anew, and say so."""
    gone: dict[tuple[str, str], Collection[int] | None] = dict.fromkeys(growth.stale)
    asked = {(cell.key, label) for cell in growth.plan.cells for label in cell.entries}
    if retry:
        gone = {**{pair: runs for pair, runs in store.lost(retry).items() if pair in asked}, **gone}
    for reason in dict.fromkeys(growth.stale.values()):
        pairs = ["/".join(pair) for pair, why in growth.stale.items() if why == reason]
        if reason != OVERWRITTEN:
            warnings.warn(f"{store.folder}: {reason}, computed anew: {', '.join(pairs[:5])}"
                          + (f" and {len(pairs) - 5} more" if len(pairs) > 5 else ""), stacklevel=2)
    store.drop(gone)


def _as_it_is(store: Store, plan: Plan) -> Store:
    """A folder that cannot be written. Raises InputError where it does not hold all of the plan."""
    if not store.exists:
        raise InputError(f"{store.folder}: cannot be written; choose another --out")
    growth, done = grown(store, plan), store.done()
    missing = sum(max(growth.plan.runs, cell.runs) - len(done.get((cell.key, label), ()))
                  for cell in growth.plan.cells for label in cell.entries)
    if missing or growth.stale:
        raise InputError(f"{store.folder}: cannot be written, and not all rows are in it that are asked for; choose "
                         "another --out")
    return store


def write_tables(store: Store, rows: pd.DataFrame) -> None:
    """verdicts.parquet and what `texts` gives, from the store's rows and timing alone."""
    table = verdicts(rows, store.manifest())
    store.write_verdicts(table)
    for name, text in texts(table, rows, store.manifest(), store.timing()):
        store.write_text(name, text)


def texts(table: pd.DataFrame, rows: pd.DataFrame, manifest: Mapping[str, Any], timing: pd.DataFrame | None
          ) -> Iterator[tuple[str, str]]:
    """(name, text) of the files that are made from rows and their verdicts: verdicts.csv, summary.csv, tables/*."""
    yield "verdicts.csv", csv(table)
    yield "summary.csv", csv(summary(table))
    for cell in cells_of(table, manifest, timing):
        notes = [caption(cell), *notes_of(cell.about["variants"][cell.variant])]
        yield from _both(f"{cell.scenario}~{cell.variant}", cell.key, cell_table(cell), notes)
    for key, frame in outage_tables(rows):
        yield f"tables/{key.replace('/', '~')}~outages.csv", csv(frame)
    for kind, tables in (("", window_tables), ("-phases", phase_tables)):
        for title, frame in tables(table, manifest):
            cell, _, what = title.partition(": ")
            yield from _both(f"{cell.replace('/', '~')}~{what.split()[2]}{kind}", title, frame, [])


def _both(stem: str, title: str, frame: pd.DataFrame, notes: Sequence[str]) -> Iterator[tuple[str, str]]:
    yield f"tables/{stem}.md", to_markdown(title, frame, notes)
    yield f"tables/{stem}.tex", to_latex(title, frame, notes)
