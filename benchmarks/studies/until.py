"""`railstate run --until`: a folder that grows look by look until a cell's intervals are narrow or its verdicts said.

Each cell stops for itself; its rows are those of a run of that length, its reason stands in the manifest."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

from ..judging.stopping import Rule, first_runs
from ..planning.plan import Plan
from ..running.machinery import Machinery
from ..store.folder import Store
from .complete import complete, write_tables


def complete_until(plan: Plan, rule: Rule, folder: Path, machinery: Machinery, command: str, *,
                   retry: Collection[str] = (), overwrite: bool = False) -> Store:
    """Add runs to the plan's cells until the rule says stop. Raises InputError, Interrupted."""
    left = list(plan.cells)
    reasons: dict[str, str] = {}
    store = Store(folder)
    for look in rule.looks:
        first = look == rule.looks[0]
        store = complete(replace(plan, cells=tuple(left), runs=look), folder, machinery, command, timing=first,
                         retry=retry if first else (), overwrite=overwrite and first)
        rows, manifest = store.rows(), store.manifest()
        waiting = []
        for cell in left:
            labels = list(manifest["configuration"]["cells"][cell.key]["estimators"])
            missing = rule.missing(first_runs(rows, cell.key, labels, look), manifest)
            if not missing:
                reasons[cell.key] = f"Stopped after {look} runs: {rule.reached()} ({rule.about()})."
            elif look == rule.most:
                reasons[cell.key] = f"Stopped after {look} runs, the most allowed: {missing} ({rule.about()})."
            else:
                waiting.append(cell)
        left = waiting
        if not left:
            break
    if store.writable and any(store.told(key, "until") != reason for key, reason in reasons.items()):
        with store.writing(command):
            store.tell({key: {"until": reason, "level": rule.level} for key, reason in reasons.items()})
            write_tables(store, store.rows())
    return store
