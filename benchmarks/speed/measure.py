"""What the speed comparisons share: sides that do the same work, measured in turn, and lines over several processes.

Minimums: other work on the machine only ever adds. Ratios are of one process each, whose memory both sides share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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

Row = dict[str, str]
BY_HAND = "written by hand"
"""What the compiled loops of `by_hand` are called: the limit, no peer."""


def cell_of(name: str, label: str, overrides: dict[str, Any] | None = None, plugin: str = "") -> Cell:
    """One scenario variant with one estimator; plugin: another one than the entry has, with its defaults."""
    cell = make_plan([name], only=[label], overrides=overrides).cells[0]
    if not plugin:
        return cell
    entry = cell.entries[label].model_copy(update={"plugin": plugin, "parameters": {}})
    return Cell(cell.scenario, cell.variant, cell.where, cell.table, {label: entry})


class Side(NamedTuple):
    """One side of a comparison. run() returns seconds, the number of run-steps, and the final means (nx, runs)."""

    name: str
    run: Callable[[], tuple[float, int, Array]]


class Line(NamedTuple):
    """An estimator of ours against a peer, in ns per run-step. apart: greatest difference between the two estimates:
    the same work was done. faster: how many times."""

    estimator: str
    states: int
    runs: int
    peer: str
    mine: float
    theirs: float
    faster: float
    apart: float

    @property
    def row(self) -> Row:
        """As it is shown."""
        return {"estimator": self.estimator, "states": str(self.states), "runs": str(self.runs),
                "ns/run-step": _digits(self.mine), "peer": self.peer, "peer ns/run-step": _digits(self.theirs),
                "times faster": _digits(self.faster), "estimates differ by": f"{self.apart:.1e}"}

    @staticmethod
    def least(lines: Sequence[Line]) -> Line:
        """That of several processes: least times, the median of the paired ratios, the greatest difference."""
        return lines[0]._replace(
            mine=min(line.mine for line in lines), theirs=min(line.theirs for line in lines),
            faster=float(np.median([line.faster for line in lines])), apart=max(line.apart for line in lines))


def _digits(value: float) -> str:
    return f"{value:.0f}" if value >= 100 else f"{value:.1f}" if value >= 10 else f"{value:.2f}"


def ours(cell: Cell, label: str, runs: int, steps: int) -> Side:
    """Whole steps as the runner drives them, the time inside the estimator. The truth is simulated beforehand."""
    setting, entry = cell.setting(), cell.entries[label]
    world = setting.world(Streams(1, cell.scenario, cell.variant, range(runs)))
    short = FirstSteps(world, steps)

    def run() -> tuple[float, int, Array]:
        estimator, model = prepare(setting, estimators()[entry.plugin], entry.parameters, entry.knowledge,
                                   world.initial_mean, augment=entry.augment)
        estimator.design(model)
        random = Streams(1, cell.scenario, cell.variant, range(runs))("estimator", label)
        driven = drive(setting, short, estimator, model, random)
        return driven.seconds, int(driven.steps.sum()), estimator.estimate().mean.copy()

    return Side(label, run)


def peer(name: str, loop: Callable[[], tuple[int, Array]]) -> Side:
    """A peer's own loop, which returns its number of run-steps and its final means."""

    def run() -> tuple[float, int, Array]:
        begun = perf_counter()
        count, last = loop()
        return perf_counter() - begun, count, last

    return Side(name, run)


def contest(mine: Side, states: int, runs: int, peers: list[Side], repeats: int) -> list[Line]:
    """A line per peer: minimums of so many repetitions, all sides in turn, after a warm-up of each."""
    best, last = _minimums([mine, *peers], repeats)
    return [Line(mine.name, states, runs, side.name, best[0], best[i], best[i] / best[0], _apart(last[0], last[i]))
            for i, side in enumerate(peers, 1)]


def contest_of_parts(mine: Side, short: Side, slow: Side, states: int, runs: int, repeats: int) -> list[Line]:
    """A line against a peer too slow for all of it: timed once over a part, in which the estimates are compared."""
    (best,), _ = _minimums([mine], repeats)
    (_, theirs), last = _minimums([short, slow], 1)
    return [Line(mine.name, states, runs, slow.name, best, theirs, theirs / best, _apart(*last))]


def _minimums(sides: list[Side], repeats: int) -> tuple[list[float], list[Array]]:
    """ns per run-step of each side, and its final means."""
    best, last = [np.inf] * len(sides), [np.empty(0)] * len(sides)
    for repeat in range(repeats + 1):
        for i, side in enumerate(sides):
            seconds, count, last[i] = side.run()
            if repeat:
                best[i] = min(best[i], 1e9 * seconds / count)
    return best, last


def _apart(a: Array, b: Array) -> float:
    """Of the runs that both have; (n,) is of one run."""
    a, b = (part.reshape(len(part), -1) for part in (a, b))
    runs = min(a.shape[1], b.shape[1])
    return float(np.abs(a[:, :runs] - b[:, :runs]).max())


def recorded(cell: Cell, runs: int) -> Trajectory:
    """The open-loop truth of a cell."""
    world = cell.setting().world(Streams(1, cell.scenario, cell.variant, range(runs)))
    assert isinstance(world, Trajectory)
    return world
