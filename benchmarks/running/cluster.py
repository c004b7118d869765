"""Tasks on a Dask cluster: a few more under way than it has threads, results as they come.

Workers compute only with the code that is here, or not at all; what they cannot, or die of, is computed here."""

from __future__ import annotations

import logging
import warnings
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from queue import Empty, Queue
from time import monotonic
from typing import Any, NamedTuple
from urllib.parse import urlsplit

from ...estimators.registry import estimators
from ...scenarios.errors import InputError
from ...scenarios.registry import settings
from ...scenarios.source import source_hash
from ..planning.catalogue import Catalogue
from ..planning.plan import SCORING, Plan, Task
from ..planning.tasks import make_tasks
from .execute import execute
from .isolated import Loss, Losses, isolated, strange
from .machinery import Machinery
from .result import Result, joined

NUMERICAL = ("numpy", "numba", "scipy")
"""Packages of which another version may change the last bits of a row."""
ANSWER, PATIENCE = 10.0, 60.0
"""Seconds to wait for a scheduler's first word; for one that is lost to come back, or for a cluster to have workers."""
AHEAD = 2
"""Tasks under way for each thread."""


class Done(NamedTuple):
    """What a worker sends back. unlike: why it has not computed the task; losses: of its estimator here."""

    result: Result | None
    unlike: str
    losses: Mapping[tuple[str, str], Loss]


def on_cluster(plan: Plan, done: Mapping[tuple[str, str], set[int]], machinery: Machinery) -> Generator[Result]:
    """Compute all rows of the plan that are not done yet. Raises InputError for a scheduler that does not answer or is
    lost, and for workers whose code would compute other rows."""
    address = machinery.scheduler
    with _client(address) as client:
        threads, crowd = _workers(client, address)
        tasks = make_tasks(plan, done, threads, machinery.batch)
        alike = _code(tasks)
        try:
            found = client.run(differences, alike)
        except Exception as error:  # whatever a worker without the suite raises
            raise InputError(f"--scheduler {address}: a worker cannot run railstate: {error}") from None
        for worker, unlike in found.items():
            if unlike:
                raise InputError(f"--scheduler {address}: its worker {worker} has {unlike}: the same must be there")
        words, losses = replace(machinery, jobs=crowd, scheduler=""), Losses()

        def arguments(task: Task) -> tuple[Any, ...]:
            key = task.cell.key, task.labels[0]
            digest = plan.catalogue[task.cell.entries[task.labels[0]].plugin].hash if strange(task) else ""
            return task, words, alike, digest, {key: losses.found[key]} if key in losses.found else {}

        left: dict[str, list[Task]] = {}
        for task, found in _answers(client, address, tasks, threads * AHEAD, arguments):
            for key, loss in found.losses.items():
                losses.put(key, loss)
            if found.result is None:
                left.setdefault(found.unlike, []).append(task)
            else:
                yield found.result
    for unlike, some in left.items():
        count = sum(len(task.runs) * len(task.labels) for task in some)
        warnings.warn(f"--scheduler {address}: {unlike}: {count} rows are computed here", stacklevel=2)
    yield from isolated([task for some in left.values() for task in some], machinery, losses)


def _code(tasks: list[Task]) -> dict[str, str]:
    """Hashes of the suite's and settings' code that computes the tasks' rows, versions of what computes for it."""
    own = [task for task in tasks if not strange(task)]
    used = {settings()[task.cell.table["plant"]["kind"]].__module__ for task in tasks} | {
        estimators()[task.cell.entries[label].plugin].__module__ for task in own for label in task.labels}
    return {**{name: version(name) for name in NUMERICAL},
            **{name: source_hash(name) for name in sorted({SCORING, *used})}}


def differences(alike: Mapping[str, str]) -> str:
    """On a worker: the first thing that is not as where the command runs."""
    for name, there in alike.items():
        try:
            here = version(name) if name in NUMERICAL else source_hash(name)
        except PackageNotFoundError:
            here = "none"
        if here != there:
            return f"{name} {here}, not {there}" if name in NUMERICAL else f"other code of {name}"
    return ""


@cache
def _same(alike: tuple[tuple[str, str], ...]) -> str:
    return differences(dict(alike))


@cache
def _known(name: str, file: str, digest: str) -> str:
    """On a worker: why a plug-in cannot run there."""
    try:
        return "" if Catalogue([file] if file else [])[name].hash == digest else f"a worker has another plug-in {name}"
    except InputError:
        return f"a worker has no plug-in {name}"


def compute(task: Task, machinery: Machinery, alike: Mapping[str, str], digest: str,
            losses: Mapping[tuple[str, str], Loss]) -> Done:
    """On a worker: a task, strangers' code apart from all else even there. digest: the hash of a stranger's code;
    losses: what it has cost before."""
    name = task.cell.entries[task.labels[0]].plugin
    unlike = _same(tuple(alike.items())) or (_known(name, task.plugin, digest) if strange(task) else "")
    if unlike:
        return Done(None, unlike, {})
    if not strange(task):
        return Done(execute(task), "", {})
    here = Losses(losses, quiet=True)
    parts = list(isolated([task], machinery, here))
    tables = [[table for table in found if table is not None] for found in (
        [part.curves for part in parts], [part.kept for part in parts])]
    curves, kept = (joined(found) if found else None for found in tables)
    more = {key: Loss(found.runs - before.runs, found.calls - before.calls, found.ended) for key, found in
            here.found.items() if (before := losses.get(key, Loss(0, 0, found.ended))).calls < found.calls}
    return Done(Result(task, joined([part.rows for part in parts]), curves, kept), "", more)


@contextmanager
def _client(address: str) -> Iterator[Any]:
    """A client of the cluster, whose own words are kept from the terminal: what matters is said here."""
    try:
        from distributed import Client
    except ImportError:
        raise InputError("--backend dask: dask is not installed; pip install 'railstate[cluster]'") from None
    for name in [name for name in logging.root.manager.loggerDict if name.startswith(("distributed", "tornado"))]:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    logging.getLogger("asyncio").setLevel(logging.CRITICAL + 1)
    try:
        client = Client(address, timeout=ANSWER, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(f"--scheduler {address}: no Dask scheduler answers there ({error})") from None
    try:
        yield client
    finally:
        with suppress(Exception):  # whoever has gone has gone
            client.close(timeout=2)


def _workers(client: Any, address: str) -> tuple[int, int]:
    """Threads of a cluster, and the most that a machine of it has."""
    try:
        client.wait_for_workers(1, timeout=PATIENCE)
    except TimeoutError:
        raise InputError(f"--scheduler {address}: has no workers") from None
    hosts = Counter[str | None]()
    for worker, threads in client.nthreads().items():
        hosts[urlsplit(worker).hostname] += threads
    return hosts.total(), max(hosts.values())


def _answers(client: Any, address: str, tasks: list[Task], ahead: int,
             arguments: Callable[[Task], tuple[Any, ...]]) -> Iterator[tuple[Task, Done]]:
    """What workers say of tasks, in whatever order. Raises InputError where the cluster is lost, and what a task
    raises."""
    from distributed import KilledWorker

    ended: Queue[Any] = Queue()
    waiting, under_way = deque(tasks), dict[str, tuple[Any, Task]]()
    alive = monotonic()
    while waiting or under_way:
        while waiting and len(under_way) < ahead:
            task = waiting.popleft()
            future = client.submit(compute, *arguments(task), pure=False)
            under_way[future.key] = future, task
            future.add_done_callback(ended.put)
        try:
            future = ended.get(timeout=1.0)
        except Empty:
            with suppress(OSError, TimeoutError, CancelledError):
                alive = monotonic() if client.status == "running" and client.nthreads() else alive
            if client.status in ("closed", "closing") or monotonic() > alive + PATIENCE:
                raise _gone(address) from None
            continue
        alive = monotonic()
        _, task = under_way.pop(future.key)
        if future.status in ("cancelled", "lost"):
            raise _gone(address)
        try:
            yield task, future.result()
        except KilledWorker:
            yield task, Done(None, "several workers died of a task", {})
        except (OSError, TimeoutError, CancelledError):
            raise _gone(address) from None
        future.release()


def _gone(address: str) -> InputError:
    return InputError(f"--scheduler {address}: is lost, or all its workers are; what is done is kept, the same command "
                      "continues")
