"""Running a plan: tasks in parallel through joblib, parts written as they come, the dead and the hung isolated.

Rows do not depend on jobs, batch size, backend or order; killing it loses only the tasks under way. What is not the
suite's own code never runs in this process: if it dies or hangs, that costs the rows it was working on."""

from __future__ import annotations

import hashlib
import multiprocessing
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures import TimeoutError as FutureTimeout
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

from ..estimators.interface import Status
from ..estimators.registry import estimators
from ..scenarios.errors import InputError
from ..scenarios.registry import settings
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
    alone = machinery.backend == "local" and (machinery.jobs == 1 or len(tasks) <= 1)
    try:
        if alone and not _own(plan):
            raise _Lost
        for number, result in map(_numbered, range(len(tasks)), tasks) if alone else _parallel(tasks, machinery):
            keep(result)
            del left[number]
    except _Lost:
        process = _Isolation(machinery.timeout)
        try:
            for number in left:
                for result in _isolated(tasks[number], process):
                    keep(result)
        finally:
            process.close()


class _Lost(Exception):
    """A worker died or hung, which one is not known; or could, in this very process."""


def _own(plan: Plan) -> bool:
    """Whether all classes of the plan are the suite's own."""
    classes = [cls for cell in plan.cells for cls in (
        settings()[cell.table["plant"]["kind"]], *(estimators()[entry.plugin] for entry in cell.entries.values()))]
    return all(cls.__module__.startswith("railstate.") for cls in classes)


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


class _Isolation:
    """One process of its own, replaced when it dies or hangs."""

    def __init__(self, timeout: float) -> None:
        self.timeout, self._pool = timeout, None

    def execute(self, task: Task) -> Result | tuple[Status, str]:
        """The task's result, or how its process ended."""
        if self._pool is None:
            self._pool = ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"),
                                             initializer=signal.signal, initargs=(signal.SIGINT, signal.SIG_IGN))
            self._pool.submit(_ready).result()  # starting it and importing are not the task's time
        future = self._pool.submit(execute, task)
        try:
            return future.result(self.timeout)
        except BrokenProcessPool:
            ended = Status.crashed, "the process running it died"
        except FutureTimeout:
            ended = Status.timeout, f"did not finish within {self.timeout:g} s"
        self.close()
        return ended

    def close(self) -> None:
        """Kill the process, whatever it is doing."""
        if self._pool is not None:
            for process in list((getattr(self._pool, "_processes", None) or {}).values()):
                process.kill()
            self._pool.shutdown(wait=False, cancel_futures=True)
            self._pool = None


def _ready() -> None:
    """Unpickling this in a new process imports what tasks need."""


def _isolated(task: Task, process: _Isolation) -> Iterator[Result]:
    """Execute a task in a process of its own; where that dies or hangs, one estimator at a time, then halves."""
    ended = process.execute(task)
    if isinstance(ended, Result):
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
        yield from _isolated(part, process)


def _stem(task: Task) -> str:
    digest = hashlib.sha256("\0".join(task.labels).encode()).hexdigest()[:8]
    return f"{task.cell.scenario}~{task.cell.variant}~{task.runs[0]:06d}-{task.runs[-1]:06d}~{digest}"
