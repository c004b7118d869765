"""Tasks in processes of their own: the dead and the hung are found, and cost only their estimator's rows."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from queue import Empty, Queue
from threading import Lock, Thread
from typing import NamedTuple

from ...estimators.interface import Status
from ...estimators.registry import estimators
from ...scenarios.errors import InputError
from ..isolation.process import Ended, Isolation, isolation
from ..planning.catalogue import plugin_process
from ..planning.plan import Task, own
from .execute import execute_apart
from .machinery import Machinery
from .result import Result, lost, sound

LOST_RUNS, LOST_CALLS = 3, 12
"""An estimator that has cost so many single runs of a cell, or so many processes, loses the rest of its runs there."""


class Loss(NamedTuple):
    """Single runs and processes that an estimator has cost, and how the last of these ended."""

    runs: int
    calls: int
    ended: Ended


def strange(task: Task) -> bool:
    """Whether a task runs what is not the suite's own code."""
    return not all(own(task.cell, label) for label in task.labels)


def isolated(tasks: list[Task], machinery: Machinery, losses: Losses) -> Iterator[Result]:
    """Execute tasks in processes of their own, as many at a time as there are jobs."""
    found: Queue[Result | BaseException | None] = Queue()
    waiting = Queue[Task]()
    for task in tasks:
        waiting.put(task)
    stopped: list[Isolation] = []
    lock = Lock()

    def work() -> None:
        try:
            while True:
                task = waiting.get_nowait()
                with _process_for(task, machinery) as process:
                    with lock:
                        if process not in stopped:
                            stopped.append(process)
                    for result in _narrowed(task, process, losses):
                        found.put(result)
        except Empty:
            found.put(None)
        except BaseException as error:
            found.put(error)

    busy = min(max(1, machinery.jobs), len(tasks))
    for _ in range(busy):
        Thread(target=work, daemon=True).start()
    try:
        while busy:
            result = found.get()
            if isinstance(result, BaseException):
                raise result
            if result is None:
                busy -= 1
            else:
                yield result
    except BaseException:
        with lock, suppress(Empty):
            while True:
                waiting.get_nowait()
        for process in stopped:
            process.end()
        raise


@contextmanager
def _process_for(task: Task, machinery: Machinery) -> Iterator[Isolation]:
    """A process for a task: that of its plug-in, or one for the suite's own."""
    if not strange(task):
        with isolation("the suite", machinery.timeout, machinery.allowed()) as process:
            yield process
    else:
        name = task.cell.entries[task.labels[0]].plugin
        with plugin_process(name, task.plugin, machinery.timeout, machinery.allowed()) as process:
            yield process


class Losses:
    """How often estimators of a cell have cost a single run and a process, and how the last one ended; said once where
    that is the end of them. quiet: not said."""

    def __init__(self, found: Mapping[tuple[str, str], Loss] | None = None, quiet: bool = False) -> None:
        self._lock, self._quiet = Lock(), quiet
        self.found = dict(found or {})

    def add(self, task: Task, ended: Ended) -> None:
        """One more."""
        self.put((task.cell.key, task.labels[0]), Loss(int(len(task.runs) == 1), 1, ended))

    def put(self, key: tuple[str, str], more: Loss) -> None:
        """Some more of one estimator, (cell key, label)."""
        with self._lock:
            runs, calls, ended = self.found.get(key, Loss(0, 0, more.ended))
            over = _over(runs, calls)
            runs, calls, ended = self.found[key] = Loss(runs + more.runs, calls + more.calls, more.ended)
            if _over(runs, calls) and not over and not self._quiet:
                warnings.warn(f"{key[0]}/{key[1]}: lost {calls} processes ({ended.reason}): the rest of its runs are "
                              "lost too", stacklevel=2)

    def over(self, task: Task) -> Ended | None:
        """How the rest of an estimator's runs are lost, if they are."""
        runs, calls, ended = self.found.get((task.cell.key, task.labels[0]), Loss(0, 0, Ended(Status.crashed, "")))
        if len(task.labels) > 1 or not _over(runs, calls):
            return None
        return Ended(ended.status, f"not run after {calls} lost processes: {ended.reason}")


def _over(runs: int, calls: int) -> bool:
    return runs >= LOST_RUNS or calls >= LOST_CALLS


def _narrowed(task: Task, process: Isolation, losses: Losses) -> Iterator[Result]:
    """Execute a task in a process of its own; where that dies or hangs, one estimator at a time, then its first run,
    then halves of the others."""
    ended = losses.over(task)
    if ended is not None:
        yield lost(task, *ended)
        return
    try:
        ended = process.call(execute_apart, task)
    except InputError as error:
        if task.cell.entries[task.labels[0]].plugin in estimators():
            raise
        ended = Ended(Status.failed, str(error))
    if not isinstance(ended, Ended):
        result = sound(task, ended)
        if result is not None:
            yield result
            return
        ended = Ended(Status.crashed, "the process running it answered nonsense")
        process.close()
    if len(task.labels) > 1:
        parts = [replace(task, labels=(label,)) for label in task.labels]
    else:
        losses.add(task, ended)
        first, rest = task.runs[:1], task.runs[1:]
        if not rest:
            yield lost(task, *ended)
            return
        half = len(rest) // 2
        parts = [replace(task, runs=runs) for runs in (first, rest[:half], rest[half:]) if runs]
    for part in parts:
        yield from _narrowed(part, process, losses)
