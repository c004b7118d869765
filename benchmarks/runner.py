"""Running a plan: tasks in parallel through joblib, parts written as they come, the dead and the hung isolated.

Rows do not depend on jobs, batch size, backend or order; killing it loses only the tasks under way."""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures import TimeoutError as FutureTimeout
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

from ..estimators.interface import Status
from ..scenarios.errors import InputError
from .execute import Result, execute, failed_rows
from .plan import Plan, Task, make_tasks
from .store import Store


@dataclass(frozen=True)
class Machinery:
    """How, not what, to run: none of it changes a row.

    jobs: processes. batch: runs per task (None: chosen from memory and jobs). backend: `local`, or joblib's `dask` or
    `ray` with the scheduler's address. timeout: seconds a single task may take before it counts as hung."""

    jobs: int = 1
    batch: int | None = None
    backend: str = "local"
    scheduler: str | None = None
    timeout: float = 900.0


def run(plan: Plan, store: Store, machinery: Machinery, report: Callable[[Task], None] = lambda task: None) -> None:
    """Compute all rows of the plan that the store does not have yet. `report` is told of each finished task."""
    tasks = make_tasks(plan, store.done(), machinery.jobs, machinery.batch)

    def keep(result: Result) -> None:
        store.write_part(_stem(result.task), rows=result.rows, curves=result.curves, trajectories=result.kept)
        report(result.task)

    left = dict.fromkeys(range(len(tasks)))
    try:
        for number, result in _parallel(tasks, machinery):
            keep(result)
            del left[number]
    except _Lost:
        for number in left:
            for result in _isolated(tasks[number], machinery.timeout):
                keep(result)


class _Lost(Exception):
    """A worker died or hung; which one is not known."""


def _numbered(number: int, task: Task) -> tuple[int, Result]:
    return number, execute(task)


def _parallel(tasks: list[Task], machinery: Machinery) -> Iterator[tuple[int, Result]]:
    if machinery.backend == "local" and (machinery.jobs == 1 or len(tasks) <= 1):
        for number, task in enumerate(tasks):
            yield number, execute(task)
        return
    import joblib
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    with _backend(machinery) as options:
        parallel = joblib.Parallel(return_as="generator_unordered", batch_size=1, pre_dispatch="2*n_jobs", **options)
        try:
            results: Iterable[Any] = parallel(joblib.delayed(_numbered)(n, task) for n, task in enumerate(tasks))
            yield from results
        except (TerminatedWorkerError, BrokenProcessPool, TimeoutError, FutureTimeout) as error:
            if machinery.backend == "local":
                joblib.externals.loky.get_reusable_executor().shutdown(wait=False, kill_workers=True)
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


def _isolated(task: Task, timeout: float) -> Iterator[Result]:
    """Execute a task in a process of its own; where that dies or hangs, one estimator at a time, then halves."""
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(1, mp_context=context)
    future = pool.submit(execute, task)
    try:
        yield future.result(timeout)
        return
    except BrokenProcessPool:
        status, reason = Status.crashed, "the process running it died"
    except FutureTimeout:
        status, reason = Status.timeout, f"did not finish within {timeout:g} s"
    finally:
        for process in list((getattr(pool, "_processes", None) or {}).values()):
            if process.is_alive() and not future.done():
                os.kill(process.pid, signal.SIGKILL)
        pool.shutdown(wait=False, cancel_futures=True)
    if len(task.labels) > 1:
        parts = [replace(task, labels=(label,)) for label in task.labels]
    elif len(task.runs) > 1:
        half = len(task.runs) // 2
        parts = [replace(task, runs=task.runs[:half]), replace(task, runs=task.runs[half:])]
    else:
        print(f"{task.cell.key}/{task.labels[0]}/{task.runs[0]}: {status.name}: {reason}", file=sys.stderr)
        yield failed_rows(task, status, reason)
        return
    for part in parts:
        yield from _isolated(part, timeout)


def _stem(task: Task) -> str:
    digest = hashlib.sha256("\0".join(task.labels).encode()).hexdigest()[:8]
    return f"{task.cell.scenario}~{task.cell.variant}~{task.runs[0]:06d}-{task.runs[-1]:06d}~{digest}"
