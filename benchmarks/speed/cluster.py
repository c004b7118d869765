"""What a Dask cluster costs: tasks on local clusters of one and of two workers against the same work in this process.

A line a number of workers and a block size; in `benchmarks/README.md` stands what follows for many machines."""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter
from typing import Any, NamedTuple

from ..planning.plan import make_plan
from ..running.machinery import Machinery
from ..running.runner import run
from .measure import Row

SCENARIO, ESTIMATOR = "ningbo-metro/white", "ekf"
BLOCKS, TASKS = (1, 100), 16
"""Runs a task, and tasks a measurement."""


class Line(NamedTuple):
    """seconds of all tasks: in this process, and on workers (each with one thread) that have done them before."""

    workers: int
    block: int
    alone: float
    there: float

    @property
    def row(self) -> Row:
        """As it is shown. The cost of a task is what its worker's time has beyond the work."""
        cost = (self.there * self.workers - self.alone) / TASKS
        return {"workers": str(self.workers), "runs a task": str(self.block),
                "work a task [ms]": f"{1e3 * self.alone / TASKS:.1f}", "cost of a task [ms]": f"{1e3 * cost:.1f}",
                "efficiency": f"{self.alone / self.workers / self.there:.2f}"}

    @staticmethod
    def least(lines: Sequence[Line]) -> Line:
        """That of several processes."""
        return lines[0]._replace(alone=min(line.alone for line in lines), there=min(line.there for line in lines))


def race(repeats: int) -> list[Line]:
    """Minimums of so many repetitions, with and without the cluster in turn."""
    from distributed import LocalCluster

    lines = []
    for workers in (1, 2):
        local: Any = LocalCluster
        with local(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster:
            for block in BLOCKS:
                plan = make_plan([SCENARIO], only=[ESTIMATOR], runs=block * TASKS)
                machines = (Machinery(1, block), Machinery(1, block, cluster.scheduler_address))
                best = [float("inf")] * 2
                for repeat in range(repeats + 1):
                    for side, machinery in enumerate(machines):
                        begun = None
                        for _ in run(plan, {}, machinery):
                            begun = begun or perf_counter()  # from the first result on: a client has to connect
                        if repeat and begun is not None:
                            best[side] = min(best[side], (perf_counter() - begun) * TASKS / (TASKS - 1))
                lines.append(Line(workers, block, *best))
    return lines
