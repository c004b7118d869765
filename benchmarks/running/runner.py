"""Running a plan: tasks in parallel through joblib, parts written as they come, the dead and the hung isolated.

Rows do not depend on jobs, batch size, backend or order; killing it loses only the tasks under way. What is not the
suite's own code never runs in this process nor beside the suite's own: if it dies or hangs, that costs its rows."""

from __future__ import annotations

import multiprocessing
import os
import warnings
from collections.abc import Generator, Iterable, Iterator, Mapping
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from queue import Empty, Queue
from threading import Lock, Thread
from typing import Any

import pyarrow as pa

from ...estimators.interface import Status
from ...estimators.registry import estimators
from ...scenarios.errors import InputError
from ..isolation.process import Ended, Isolation, isolation, nursery
from ..planning.catalogue import plugin_process
from ..planning.plan import Plan, Task, own
from ..planning.tasks import make_tasks
from .execute import execute, execute_apart
from .result import Result, joined, lost, sound

LOST_RUNS, LOST_CALLS = 3, 12
"""An estimator that has cost so many single runs of a cell, or so many processes, loses the rest of its runs there."""
SHARE = 0.8
"""Share of the machine's memory that isolated processes may take together."""


@dataclass(frozen=True)
class Machinery:
    """How, not what, to run: none of it changes a row.

    jobs: processes. batch: runs per task (None: by the memory a run takes, the jobs and the number of runs). backend:
    `local`, or joblib's `dask` or `ray` with the scheduler's address. timeout: seconds a single task may take before it
    counts as hung. memory: bytes that an isolated process may take (0: an equal share of the machine's)."""

    jobs: int = 1
    batch: int | None = None
    backend: str = "local"
    scheduler: str | None = None
    timeout: float = 900.0
    memory: int = 0

    def allowed(self) -> int:
        """Bytes that an isolated process may take (0: no limit known)."""
        with suppress(OSError, ValueError, AttributeError):
            whole = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
            return self.memory or int(SHARE * whole / max(1, self.jobs))
        return self.memory


def run(plan: Plan, done: Mapping[tuple[str, str], set[int]], machinery: Machinery) -> Generator[Result]:
    """Compute all rows of the plan that are not done yet: the results of each task as they come."""
    tasks = make_tasks(plan, done, machinery.jobs, machinery.batch)
    strange = [task for task in tasks if not _own(task)]
    if strange:
        nursery.begin()
    if machinery.backend != "local":
        yield from (result for _, result in _parallel(tasks, machinery))
        return
    tasks = [task for task in tasks if _own(task)]
    left = dict.fromkeys(range(len(tasks)))
    alone = machinery.jobs == 1 or len(tasks) <= 1
    try:
        numbered = ((number, execute(task)) for number, task in enumerate(tasks))
        for number, result in numbered if alone else _parallel(tasks, machinery):
            yield result
            del left[number]
    except _Lost:
        pass
    yield from _isolated([*(tasks[number] for number in left), *strange], machinery)


def apart(tasks: list[Task], machinery: Machinery) -> pa.Table:
    """The rows of tasks, whoever's, in processes of their own."""
    return joined([result.rows for result in _isolated(tasks, machinery)])


def _own(task: Task) -> bool:
    return all(own(task.cell, label) for label in task.labels)


class _Lost(Exception):
    """A worker died or hung, which one is not known."""


def _numbered(number: int, task: Task, machinery: Machinery) -> tuple[int, Result]:
    """A task in a worker of a pool or cluster; strangers' code apart from it even there."""
    if _own(task):
        return number, execute(task)
    parts = list(_isolated([task], replace(machinery, jobs=1)))
    curves, kept = ([table for table in tables if table is not None] for tables in (
        [part.curves for part in parts], [part.kept for part in parts]))
    return number, Result(task, joined([part.rows for part in parts]), joined(curves) if curves else None,
                          joined(kept) if kept else None)


def _parallel(tasks: list[Task], machinery: Machinery) -> Iterator[tuple[int, Result]]:
    import joblib
    from joblib.externals.loky import get_reusable_executor  # pyright: ignore[reportMissingImports]
    from joblib.externals.loky.process_executor import TerminatedWorkerError  # pyright: ignore[reportMissingImports]

    with _backend(machinery) as options:
        parallel = joblib.Parallel(return_as="generator_unordered", batch_size=1, pre_dispatch="2*n_jobs", **options)
        try:
            results: Iterable[Any] = parallel(joblib.delayed(_numbered)(n, task, machinery)
                                              for n, task in enumerate(tasks))
            yield from results
        except (TerminatedWorkerError, BrokenProcessPool, TimeoutError, multiprocessing.TimeoutError) as error:
            if machinery.backend == "local":
                get_reusable_executor().shutdown(wait=False, kill_workers=True)
            raise _Lost from error


@contextmanager
def _backend(machinery: Machinery) -> Iterator[dict[str, Any]]:
    """joblib options for the backend; a cluster's client lives as long as the run."""
    import joblib

    if machinery.backend == "local":
        yield {"n_jobs": machinery.jobs, "backend": "loky", "timeout": machinery.timeout}
        return
    if machinery.backend == "dask":
        try:
            from dask.distributed import Client
        except ImportError:
            raise InputError("--backend dask: dask is not installed; pip install 'railstate[cluster]'") from None
        if not machinery.scheduler:
            raise InputError("--backend dask: needs --scheduler ADDRESS, such as tcp://host:8786")
        try:
            client = Client(machinery.scheduler, timeout="10s")
        except (OSError, ValueError) as error:
            raise InputError(f"--scheduler {machinery.scheduler}: no Dask scheduler answers there ({error})") from None
        with client, joblib.parallel_config(backend="dask"):
            yield {"n_jobs": -1}
        return
    if machinery.backend == "ray":
        try:
            import ray  # pyright: ignore[reportMissingImports]
            from ray.util.joblib import register_ray  # pyright: ignore[reportMissingImports]
        except ImportError:
            raise InputError("--backend ray: ray is not installed; pip install ray") from None
        ray.init(address=machinery.scheduler or "auto", ignore_reinit_error=True)
        register_ray()
        with joblib.parallel_config(backend="ray"):
            yield {"n_jobs": -1}
        return
    raise InputError(f"--backend {machinery.backend}: unknown; allowed: local, dask, ray")


def _isolated(tasks: list[Task], machinery: Machinery) -> Iterator[Result]:
    """Execute tasks in processes of their own, as many at a time as there are jobs."""
    found: Queue[Result | BaseException | None] = Queue()
    waiting, losses = Queue[Task](), _Losses()
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
    if _own(task):
        with isolation("the suite", machinery.timeout, machinery.allowed()) as process:
            yield process
    else:
        name = task.cell.entries[task.labels[0]].plugin
        with plugin_process(name, task.plugin, machinery.timeout, machinery.allowed()) as process:
            yield process


class _Losses:
    """How often estimators of a cell have cost a process, and how the last one ended."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._found: dict[tuple[str, str], tuple[int, int, Ended]] = {}

    def add(self, task: Task, ended: Ended) -> None:
        with self._lock:
            key = task.cell.key, task.labels[0]
            runs, calls, _ = self._found.get(key, (0, 0, ended))
            over = self._over(runs, calls)
            runs, calls = runs + (len(task.runs) == 1), calls + 1
            self._found[key] = runs, calls, ended
            if self._over(runs, calls) and not over:
                warnings.warn(f"{key[0]}/{key[1]}: lost {calls} processes ({ended.reason}): the rest of its runs are "
                              "lost too", stacklevel=2)

    def over(self, task: Task) -> Ended | None:
        """How the rest of an estimator's runs are lost, if they are."""
        runs, calls, ended = self._found.get((task.cell.key, task.labels[0]), (0, 0, Ended(Status.crashed, "")))
        if len(task.labels) > 1 or not self._over(runs, calls):
            return None
        return Ended(ended.status, f"not run after {calls} lost processes: {ended.reason}")

    @staticmethod
    def _over(runs: int, calls: int) -> bool:
        return runs >= LOST_RUNS or calls >= LOST_CALLS


def _narrowed(task: Task, process: Isolation, losses: _Losses) -> Iterator[Result]:
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
