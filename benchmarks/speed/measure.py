"""What the speed comparisons share: our steps as the runner drives them, a peer's own loop, a line of the table."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from ...estimators.registry import estimators
from ...scenarios.arrays import Array
from ...scenarios.randomness import Streams
from ...scenarios.world import Trajectory
from ..planning.plan import Cell, make_plan
from ..running.drive import drive, prepare
from ..running.execute import FirstSteps
from ..running.latency import measure

Row = dict[str, str]


def cell_of(name: str, label: str, overrides: dict[str, Any] | None = None) -> Cell:
    """One scenario variant with one estimator."""
    return make_plan([name], only=[label], overrides=overrides).cells[0]


class Ours(NamedTuple):
    """Medians over some drives, in ns per run-step: inside the estimator, scoring it, and the runner's own. means: the
    estimates at the end (nx, runs)."""

    estimator: float
    scoring: float
    runner: float
    means: Array


def ours(cell: Cell, label: str, runs: int, steps: int, repeats: int) -> Ours:
    """Measure `repeats` drives after a warm-up. The truth is simulated beforehand and not counted."""
    setting, entry = cell.setting(), cell.entries[label]
    world = setting.world(Streams(1, cell.scenario, cell.variant, range(runs)))
    short = FirstSteps(world, steps)
    parts, last = [], np.empty((0, runs))
    for repeat in range(repeats + 1):
        estimator, model = prepare(setting, estimators()[entry.plugin], entry.parameters, entry.knowledge,
                                   world.initial_mean, augment=entry.augment)
        estimator.design(model)
        random = Streams(1, cell.scenario, cell.variant, range(runs))("estimator", label)
        begun = perf_counter()
        driven = drive(setting, short, estimator, model, random)
        total = perf_counter() - begun
        if repeat:
            parts.append(1e9 / driven.steps.sum() * np.array(
                [driven.seconds, driven.scoring, total - driven.seconds - driven.scoring]))
        last = estimator.estimate().mean.copy()
    estimator, scoring, runner = (float(value) for value in np.median(parts, axis=0))
    return Ours(estimator, scoring, runner, last)


def peer(loop: Callable[[], tuple[int, Array]], repeats: int) -> tuple[float, Array]:
    """(ns per run-step, final means) of a peer's loop, which returns its number of run-steps; median after a
    warm-up."""
    seconds, last = [], np.empty(0)
    for repeat in range(repeats + 1):
        begun = perf_counter()
        count, last = loop()
        if repeat:
            seconds.append(1e9 * (perf_counter() - begun) / count)
    return float(np.median(seconds)), last


def line(what: str, runs: int, mine: float, name: str, theirs: float, apart: float, **more: str) -> Row:
    """A line of a comparison. apart: greatest difference between the two estimates: the same work was done."""
    return {"estimator": what, "runs": str(runs), "ns/run-step": f"{mine:.0f}", "peer": name,
            "peer ns/run-step": f"{theirs:.0f}", "times faster": f"{theirs / mine:.0f}" if theirs >= 10 * mine
            else f"{theirs / mine:.1f}", "estimates differ by": f"{apart:.1e}", **more}


def recorded(cell: Cell, runs: int) -> Trajectory:
    """The open-loop truth of a cell."""
    world = cell.setting().world(Streams(1, cell.scenario, cell.variant, range(runs)))
    assert isinstance(world, Trajectory)
    return world


def latency(cell: Cell, label: str) -> float:
    """Median microseconds of one step of one run."""
    return 1e6 * float(np.median(measure(cell, label, 1)[1]))
