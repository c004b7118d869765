"""timing.csv: what a design, one step of one run, and a run-step of a batch cost.

Latency is measured after the rows, on one thread each, by as many processes as computed these, plug-ins in one of their
own; throughput comes from the rows."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from ...estimators.registry import estimator_class
from ...scenarios.randomness import Streams
from ...scenarios.world import World
from ..planning.plan import Cell, Plan, own
from ..scoring.columns import TIMING
from .drive import prepare
from .loop import Loop, Observer
from .machinery import Machinery

if TYPE_CHECKING:  # workers import this
    import pandas as pd

WARM_UP, STEPS, SAMPLES, SECONDS = 5, 100, 200, 0.05
FEW = 8
"""So many are measured in this process: others would have to start, or load their machine code, first."""
AGREED = 1.1
"""Two passes agree where their medians are this near."""


def timing_table(plan: Plan, rows: pd.DataFrame, machinery: Machinery) -> pd.DataFrame:
    """One line per cell and estimator, columns `TIMING`; NaN for estimators that cannot be designed, and for plug-ins
    that die or take longer than the machinery's timeout."""
    import pandas as pd

    return pd.DataFrame(list(_lines(plan, rows, machinery)), columns=list(TIMING))


def _lines(plan: Plan, rows: pd.DataFrame, machinery: Machinery) -> Iterator[dict[str, Any]]:
    throughput = _throughput(rows)
    ours = _ours([(cell, label) for cell in plan.cells for label in cell.entries if own(cell, label)], plan.seed,
                 machinery.jobs)
    for cell in plan.cells:
        for label in cell.entries:
            design, latencies = next(ours) if own(cell, label) else _measured(plan, cell, label, rows, machinery)
            yield {"scenario": cell.scenario, "variant": cell.variant, "estimator": label, "design_s": design,
                   "latency_us_median": 1e6 * float(np.median(latencies)) if len(latencies) else np.nan,
                   "latency_us_p99": 1e6 * float(np.quantile(latencies, 0.99)) if len(latencies) else np.nan,
                   "samples": len(latencies),
                   "throughput_ns": throughput.get((cell.scenario, cell.variant, label), np.nan),
                   "sampling_period_s": cell.setting().sampling_period}


def _ours(pairs: list[tuple[Cell, str]], seed: int, jobs: int) -> Iterator[tuple[float, list[float]]]:
    """Design seconds and latencies of the suite's own estimators, in the order of the pairs."""
    if jobs == 1 or len(pairs) <= FEW:
        return (measure(cell, label, seed) for cell, label in pairs)
    import joblib

    parallel = joblib.Parallel(n_jobs=jobs, backend="loky", return_as="generator", pre_dispatch="2*n_jobs")
    return parallel(joblib.delayed(measure)(cell, label, seed) for cell, label in pairs)  # pyright: ignore


def _measured(plan: Plan, cell: Cell, label: str, rows: pd.DataFrame,
              machinery: Machinery) -> tuple[float, list[float]]:
    """Design seconds and latencies of a plug-in; none of one that never finished a run."""
    mine = (rows["scenario"] == cell.scenario) & (rows["variant"] == cell.variant) & (rows["estimator"] == label)
    if set(rows.loc[mine, "status"]) & {"ok", "diverged"}:
        with plan.catalogue.process(cell.entries[label].plugin, machinery.timeout, machinery.allowed()) as process:
            found = process.call(measure, cell, label, plan.seed)
        with suppress(TypeError, ValueError):
            return float(found[0]), [float(value) for value in found[1]]
    return np.nan, []


def _throughput(rows: pd.DataFrame) -> dict[Any, float]:
    """Nanoseconds per run and step inside the estimator, at the batch size of the run."""
    if "steps" not in rows:
        return {}
    timed = rows[rows["steps"].notna() & (rows["steps"] > 0)]
    grouped = timed.groupby(["scenario", "variant", "estimator"], sort=False)
    return {key: 1e9 * float(part["seconds"].sum() / part["steps"].sum()) for key, part in grouped}


def measure(cell: Cell, label: str, seed: int) -> tuple[float, list[float]]:
    """Design seconds and the seconds of each of some `SAMPLES` steps of one run (prediction, update, estimate), in
    passes over its first `STEPS`, on one thread. A pass is warm-up, and left out, until the next agrees with it, and so
    are each one's first steps; slow estimators are cut off by time."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1), np.errstate(all="ignore"):
        return _timed(cell, label, seed)


def _timed(cell: Cell, label: str, seed: int) -> tuple[float, list[float]]:
    setting, entry = cell.setting(), cell.entries[label]
    streams = Streams(seed, cell.scenario, cell.variant, (0,))
    try:
        world = _world(cell, seed)
        estimator, model = prepare(setting, estimator_class(entry.plugin, label), entry.parameters, entry.knowledge,
                                   world.initial_mean, entry.late, entry.told_faults, entry.augment)
        begun = perf_counter()
        info = estimator.design(model)
        design = float(info.get("design_s", perf_counter() - begun))
        passes: list[list[float]] = []
        spent = 0.0
        while spent <= SECONDS and sum(map(len, passes)) < SAMPLES:
            estimator.start(model, 1, streams("estimator", label))
            if world.closed_loop and passes:
                world = setting.world(streams)
            passes.append(_pass(Loop(world, estimator, Observer(), own=model.own), SECONDS - spent))
            spent += sum(passes[-1])
            if not passes[-1]:
                break
            if len(passes) == 2 and np.median(passes[0]) > AGREED * np.median(passes[1]):
                del passes[0]  # that was the warm-up
    except (Exception, SystemExit):  # the rows already tell what it raised
        return np.nan, []
    return design, [value for each in passes for value in each]


_latest: list[tuple[Cell, int, World]] = []


def _world(cell: Cell, seed: int) -> World:
    """The world of a setting's first run, which its estimators share in open loop."""
    if _latest and _latest[0][1] == seed and (_latest[0][0].key, _latest[0][0].table) == (cell.key, cell.table):
        return _latest[0][2]
    world = cell.setting().world(Streams(seed, cell.scenario, cell.variant, (0,)))
    _latest[:] = [] if world.closed_loop else [(cell, seed, world)]
    return world


def _pass(loop: Loop, limit: float) -> list[float]:
    """Seconds of each of the first steps but for `WARM_UP`, as far as the limit (s) lasts."""
    seconds, begun = list[float](), 0.0
    for k in range(min(loop.world.steps, WARM_UP + STEPS)):
        before = loop.seconds
        begun = before if k == WARM_UP else begun
        if (seconds and before - begun > limit) or loop.step(k) is None:
            break
        if k >= WARM_UP:
            seconds.append(loop.seconds - before)
    return seconds
