"""Running a plan: tasks in parallel, on this machine's cores or on a cluster, results as they come.

Rows do not depend on jobs, batch size, cluster or order; killing it loses only the tasks under way. What is not the
suite's own code never runs in this process nor beside the suite's own: if it dies or hangs, that costs its rows."""

from __future__ import annotations

import atexit
import gc
import multiprocessing
from collections.abc import Generator, Iterator, Mapping
from concurrent.futures.process import BrokenProcessPool

import pyarrow as pa

from ..isolation.process import nursery
from ..planning.plan import Plan, Task
from ..planning.tasks import make_tasks
from .execute import execute
from .isolated import Losses, isolated, strange
from .machinery import Machinery
from .result import Result, joined


def run(plan: Plan, done: Mapping[tuple[str, str], set[int]], machinery: Machinery) -> Generator[Result]:
    """Compute all rows of the plan that are not done yet: the results of each task as they come. Raises InputError for
    a cluster that is not there, computes otherwise, or is lost."""
    if machinery.scheduler:
        from .cluster import on_cluster

        yield from on_cluster(plan, done, machinery)
        return
    tasks = make_tasks(plan, done, machinery.jobs, machinery.batch)
    others = [task for task in tasks if strange(task)]
    if others:
        nursery.begin()
    tasks = [task for task in tasks if not strange(task)]
    left = dict.fromkeys(range(len(tasks)))
    alone = machinery.jobs == 1 or len(tasks) <= 1
    try:
        numbered = ((number, execute(task)) for number, task in enumerate(tasks))
        for number, result in numbered if alone else _parallel(tasks, machinery):
            yield result
            del left[number]
    except _Lost:
        pass
    yield from isolated([*(tasks[number] for number in left), *others], machinery, Losses())


def apart(tasks: list[Task], machinery: Machinery) -> pa.Table:
    """The rows of tasks, whoever's, in processes of their own."""
    return joined([result.rows for result in isolated(tasks, machinery, Losses())])


class _Lost(Exception):
    """A worker died or hung, which one is not known."""


def _numbered(number: int, task: Task) -> tuple[int, Result]:
    if not gc.get_freeze_count():
        gc.freeze()  # what was imported is no garbage: loky looks for that once a second
        atexit.register(gc.freeze)  # who ends need not look for it either
    return number, execute(task)


def _parallel(tasks: list[Task], machinery: Machinery) -> Iterator[tuple[int, Result]]:
    import joblib
    from joblib.externals.loky import get_reusable_executor  # pyright: ignore[reportMissingImports]
    from joblib.externals.loky.process_executor import TerminatedWorkerError  # pyright: ignore[reportMissingImports]

    parallel = joblib.Parallel(n_jobs=machinery.jobs, backend="loky", timeout=machinery.timeout, batch_size=1,
                               return_as="generator_unordered", pre_dispatch="2*n_jobs")
    try:
        yield from parallel(joblib.delayed(_numbered)(n, task) for n, task in enumerate(tasks))
    except (TerminatedWorkerError, BrokenProcessPool, TimeoutError, multiprocessing.TimeoutError) as error:
        get_reusable_executor().shutdown(wait=False, kill_workers=True)
        raise _Lost from error
