"""Running a plan: tasks in parallel through joblib, parts written as they come, the dead and the hung isolated.

Rows do not depend on jobs, batch size, backend or order; killing it loses only the tasks under way. What is not the
suite's own code never runs in this process: if it dies or hangs, that costs the rows it was working on."""

from __future__ import annotations

import multiprocessing
from collections.abc import Generator, Iterable, Iterator, Mapping
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from queue import Empty, Queue
from threading import Thread
from typing import Any

from ...scenarios.errors import InputError
from ..planning.plan import Plan, Task, own
from ..planning.tasks import make_tasks
from .execute import Result, execute, failed_rows
from .isolation import Ended, Isolation, isolation


@dataclass(frozen=True)
class Machinery:
    """How, not what, to run: none of it changes a row.

    jobs: processes. batch: runs per task (None: by the memory a run takes, the jobs and the number of runs). backend:
    `local`, or joblib's `dask` or `ray` with the scheduler's address. timeout: seconds a single task may take before it
    counts as hung."""

    jobs: int = 1
    batch: int | None = None
    backend: str = "local"
    scheduler: str | None = None
    timeout: float = 900.0


def run(plan: Plan, done: Mapping[tuple[str, str], set[int]], machinery: Machinery) -> Generator[Result]:
    """Compute all rows of the plan that are not done yet: the results of each task as they come."""
    tasks = make_tasks(plan, done, machinery.jobs, machinery.batch)

    left = dict.fromkeys(range(len(tasks)))
    alone = machinery.backend == "local" and (machinery.jobs == 1 or len(tasks) <= 1)
    try:
        if alone and not all(own(cell, label) for cell in plan.cells for label in cell.entries):
            raise _Lost
        for number, result in map(_numbered, range(len(tasks)), tasks) if alone else _parallel(tasks, machinery):
            yield result
            del left[number]
    except _Lost:
        yield from _isolated([tasks[number] for number in left], machinery)


class _Lost(Exception):
    """A worker died or hung, which one is not known; or could, in this very process."""


def _numbered(number: int, task: Task) -> tuple[int, Result]:
    return number, execute(task)


def _parallel(tasks: list[Task], machinery: Machinery) -> Iterator[tuple[int, Result]]:
    import joblib
    from joblib.externals.loky import get_reusable_executor  # pyright: ignore[reportMissingImports]
    from joblib.externals.loky.process_executor import TerminatedWorkerError  # pyright: ignore[reportMissingImports]

    with _backend(machinery) as options:
        parallel = joblib.Parallel(return_as="generator_unordered", batch_size=1, pre_dispatch="2*n_jobs", **options)
        try:
            results: Iterable[Any] = parallel(joblib.delayed(_numbered)(n, task) for n, task in enumerate(tasks))
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


def _isolated(tasks: Iterable[Task], machinery: Machinery) -> Iterator[Result]:
    """Execute tasks in processes of their own, as many at a time as there are jobs."""
    found: Queue[Result | BaseException | None] = Queue()
    waiting = Queue[Task]()
    for task in tasks:
        waiting.put(task)

    def work(process: Isolation) -> None:
        try:
            while True:
                for result in _narrowed(waiting.get_nowait(), process):
                    found.put(result)
        except Empty:
            found.put(None)
        except BaseException as error:
            found.put(error)

    with ExitStack() as stack:
        busy = max(1, min(machinery.jobs, waiting.qsize()))
        for _ in range(busy):
            Thread(target=work, args=(stack.enter_context(isolation(machinery.timeout)),), daemon=True).start()
        while busy:
            result = found.get()
            if isinstance(result, BaseException):
                raise result
            if result is None:
                busy -= 1
            else:
                yield result


def _narrowed(task: Task, process: Isolation) -> Iterator[Result]:
    """Execute a task in a process of its own; where that dies or hangs, one estimator at a time, then halves."""
    ended = process.call(execute, task)
    if not isinstance(ended, Ended):
        yield ended
        return
    if len(task.labels) > 1:
        parts = [replace(task, labels=(label,)) for label in task.labels]
    elif len(task.runs) > 1:
        half = len(task.runs) // 2
        parts = [replace(task, runs=task.runs[:half]), replace(task, runs=task.runs[half:])]
    else:
        yield failed_rows(task, *ended)
        return
    for part in parts:
        yield from _narrowed(part, process)
