"""A plan cut into tasks, what is done already left out; strangers' code apart from all else."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from ...estimators.registry import estimators
from ...scenarios import machine_code
from .plan import Plan, Task, own

BLOCK = 2000
"""Most runs of a block: from here on what Python does per step is small beside the arithmetic."""
ROOM = 400e6
"""Bytes that the trajectories of a block of runs, or what an estimator keeps of them, may take."""


def make_tasks(plan: Plan, done: Mapping[tuple[str, str], set[int]], jobs: int, batch: int | None) -> list[Task]:
    """The tasks that are left. done: (cell key, label) -> runs that have rows. Heavy tasks come first. Every
    second has its estimators the other way round: two processes compile different things until they meet."""
    tasks: list[tuple[float, Task]] = []
    for cell in plan.cells:
        setting = cell.setting()
        room = max(1, int(ROOM / max(setting.batch_bytes(), 1)))
        count = max(plan.runs, cell.runs)
        share = count if len(plan.cells) >= 2 * jobs else -(-count // jobs)
        size = batch or -(-share // -(-share // min(BLOCK, room)))  # alike, so that no process waits for another
        there = {label: done.get((cell.key, label), set[int]()) for label in cell.entries}
        ours = [label for label in cell.entries if own(cell, label)]
        missing: dict[tuple[str, ...], list[int]] = {}
        for run in range(count):
            together = tuple([label for label in ours if run not in there[label]])
            if together:
                missing.setdefault(together, []).append(run)
        for label in [label for label in cell.entries if label not in ours]:
            missing[label,] = [run for run in range(count) if run not in there[label]]
        for labels, runs in missing.items():
            for first in range(0, len(runs), size):
                block = tuple(runs[first:first + size])
                weight = setting.batch_bytes() * len(block) * len(labels)
                tasks.append((weight, plan.task(cell, labels, block)))
    heavy = [task for _, task in sorted(tasks, key=lambda item: -item[0])]
    return heavy if jobs == 1 else [_by_code(task, backwards=place % 2 == 0) for place, task in enumerate(heavy)]


def _by_code(task: Task, backwards: bool) -> Task:
    """The task with those estimators last that share most code with the first one; backwards: first."""
    if not own(task.cell, task.labels[0]) or len(task.labels) < 3:
        return task
    modules = [sys.modules[estimators()[task.cell.entries[label].plugin].__module__] for label in task.labels]
    code = [set(machine_code.closure(Path(str(module.__file__)))) for module in modules]
    shared = {label: len(of & code[0]) for label, of in zip(task.labels, code, strict=True)}
    labels = sorted(task.labels, key=shared.__getitem__)
    return replace(task, labels=tuple(reversed(labels) if backwards else labels))


def task_name(task: Task) -> str:
    """The name of a task's part in a folder: no other task has it, so none is written over."""
    digest = hashlib.sha256("\0".join([*task.labels, *map(str, task.runs)]).encode()).hexdigest()[:8]
    return f"{task.cell.scenario}~{task.cell.variant}~{task.runs[0]:06d}-{task.runs[-1]:06d}~{digest}"
