"""Executing a task in whatever process it lands in: simulate once, drive every estimator, turn all into tables.

An estimator or a world that raises costs only the runs that make it raise: the block is halved until they are found."""

from __future__ import annotations

import traceback
from collections.abc import Sequence
from contextlib import suppress
from functools import cached_property
from time import perf_counter
from typing import Any

import numpy as np
import pyarrow as pa

from ...estimators.interface import Status
from ...estimators.registry import estimator_class, estimators
from ...scenarios.errors import Infeasible, InputError
from ...scenarios.randomness import Streams
from ...scenarios.setting import Setting
from ...scenarios.world import Step, World, step_times
from ..isolation.process import clean
from ..planning.plan import Task, own
from ..planning.tasks import ROOM
from ..scoring.floor import Floor, floor_of
from ..scoring.stretch import Stretch
from .drive import Driven, drive, prepare
from .result import Result, arrow_table, failed, identity, joined

Columns = dict[str, Any]
TRACE = 20_000
"""Characters of a traceback that are kept."""
WARM_STEPS, WARM_SECONDS = 10, 0.1
_warm: set[tuple[str, str, int]] = set()


def execute(task: Task) -> Result:
    """Run a task on one thread. Raises nothing for what an estimator does wrong: that becomes rows."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1), np.errstate(all="ignore"):
        setting = task.cell.setting()
        worlds = _Worlds(setting, task)
        rows: list[pa.Table] = []
        curves: list[pa.Table] = []
        kept: list[pa.Table] = []
        for label in task.labels:
            block = _Block(setting, task, label, worlds)
            block.run(tuple(range(len(task.runs))))
            rows += block.rows
            curves += block.curves
            kept += block.kept
        if kept:
            kept += worlds.extras()
    return Result(task, joined(rows), joined(curves) if curves else None, joined(kept) if kept else None)


def execute_apart(task: Task) -> dict[str, pa.Table | None]:
    """The same in a process of its own: tables only."""
    found = execute(task)
    return {"rows": found.rows, "curves": found.curves, "kept": found.kept}


class _Worlds:
    """The truth of a task's runs: simulated once for all estimators when open loop, anew for each when closed."""

    def __init__(self, setting: Setting[Any], task: Task) -> None:
        self.setting, self.task, self.floors = setting, task, dict[bool, Floor | None]()

    @cached_property
    def shared(self) -> World:
        """That of all runs."""
        return self._make(self.task.runs)

    def _make(self, runs: Sequence[int]) -> World:
        cell = self.task.cell
        return self.setting.world(Streams(self.task.seed, cell.scenario, cell.variant, runs))

    def for_runs(self, runs: tuple[int, ...]) -> World:
        if runs == self.task.runs and not self.shared.closed_loop:
            return self.shared
        return self._make(runs)

    def floor(self, world: World, positions: Sequence[int], predicted: bool) -> Floor | None:
        """The least errors possible of some of the task's runs, in open loop; predicted: before the measurements."""
        if world.closed_loop:
            return None
        if predicted not in self.floors:
            self.floors[predicted] = floor_of(self.setting, self.shared, predicted)
        found = self.floors[predicted]
        return found if found is None or len(positions) == len(self.task.runs) else found.of(list(positions))

    def extras(self) -> list[pa.Table]:
        """What the figures of an open-loop setting want of the truth, for the kept runs."""
        out = []
        if self.shared.closed_loop:
            return out  # those belong to each estimator
        extra: dict[str, np.ndarray] = getattr(self.shared, "extra", {})
        times = step_times(self.shared)
        for position, run in enumerate(self.task.runs):
            if run < self.task.keep:
                for name, values in extra.items():
                    out.append(_trajectory(self.task, "", run, times, np.arange(len(values)), name,
                                           values[:, position].astype(float)))
        return out


class _TooMany(Exception):
    """An estimator would keep too much of so many runs."""


class _Block:
    """One estimator on a task's runs, halved where it raises, or where it would keep too much of them."""

    def __init__(self, setting: Setting[Any], task: Task, label: str, worlds: _Worlds) -> None:
        self.setting, self.task, self.label, self.worlds = setting, task, label, worlds
        self.rows: list[pa.Table] = []
        self.curves: list[pa.Table] = []
        self.kept: list[pa.Table] = []

    def run(self, positions: tuple[int, ...]) -> None:
        runs = tuple(self.task.runs[p] for p in positions)
        watch = _Keeper(self.setting, self.task, self.label, runs)
        world = self.worlds.for_runs(runs)  # what is wrong with it is nobody's row
        caught = _caught(self.task, self.label)
        try:
            driven = self._drive(runs, world, watch)
            rows, curves = self._table(runs, driven), self._curves(runs, driven)
            kept = watch.tables(step_times(driven.world))
            if driven.world.closed_loop:
                kept += watch.extras(driven.world)
        except Infeasible as error:
            self.rows.append(failed(self.task, self.label, runs, Status.infeasible, clean(error)))
        except _TooMany:
            self._halve(positions)
        except caught as error:
            if isinstance(error, InputError) and self.task.cell.entries[self.label].plugin in estimators():
                raise
            if len(runs) > 1:
                self._halve(positions)
            else:
                text = clean("".join(traceback.format_exception_only(error)).strip())
                self.rows.append(failed(self.task, self.label, runs, Status.failed, text,
                                        clean(traceback.format_exc()[-TRACE:], TRACE)))
        else:
            self.rows.append(rows)
            self.curves += curves
            self.kept += kept

    def _halve(self, positions: tuple[int, ...]) -> None:
        half = len(positions) // 2
        self.run(positions[:half])
        self.run(positions[half:])

    def _drive(self, runs: tuple[int, ...], world: World, watch: _Keeper) -> Driven:
        cell = self.task.cell
        entry = cell.entries[self.label]
        estimator, model = prepare(self.setting, estimator_class(entry.plugin, self.label), entry.parameters,
                                   entry.knowledge, world.initial_mean, entry.late, entry.told_faults, entry.augment)
        if len(runs) > 1 and len(runs) * estimator.memory(model.nx, world.steps) > ROOM:
            raise _TooMany
        estimator.design(model)
        random = Streams(self.task.seed, cell.scenario, cell.variant, runs)("estimator", self.label)
        self._warm_up(runs, world)
        predicted = self.setting.config.score.at == "prediction" and estimator.predicts
        places = range(len(runs)) if runs == self.task.runs else tuple(map(self.task.runs.index, runs))
        floor = None if estimator.lag != 0 else self.worlds.floor(world, places, predicted)
        return drive(self.setting, world, estimator, model, random, watch if watch.wanted else None, floor)

    def _warm_up(self, runs: tuple[int, ...], world: World) -> None:
        """Compile (or load) what this estimator needs on this plant and on so many runs before anything is timed: the
        block's own first steps, until two passes take as long, so that nobody's time tells who came before. A run that
        makes it raise, die or hang costs no other so."""
        task, entry = self.task, self.task.cell.entries[self.label]
        key = (self.setting.kind, repr((entry.plugin, entry.parameters, entry.knowledge, entry.late, entry.augment)),
               len(runs))
        if key in _warm:
            return
        _warm.add(key)
        begun, before = perf_counter(), np.inf
        with suppress(*_caught(task, self.label)):  # what goes wrong here goes wrong again where it counts
            while perf_counter() - begun < WARM_SECONDS:
                short = FirstSteps(self.worlds.for_runs(runs) if world.closed_loop else world, WARM_STEPS)
                estimator, model = prepare(self.setting, estimator_class(entry.plugin, self.label), entry.parameters,
                                           entry.knowledge, world.initial_mean, entry.late, entry.told_faults,
                                           entry.augment)
                estimator.design(model)
                random = Streams(task.seed, task.cell.scenario, task.cell.variant, runs)("estimator", self.label)
                seconds = drive(self.setting, short, estimator, model, random).seconds
                if abs(seconds - before) <= 0.1 * seconds:
                    break
                before = seconds

    def _curves(self, runs: tuple[int, ...], driven: Driven) -> list[pa.Table]:
        """Sums over the runs that finished, as rows are judged: where some were lost, the others are driven again."""
        finished = tuple(np.array(runs)[driven.scored.status == Status.ok].tolist())
        if not finished:
            return []
        if len(finished) < len(runs):
            watch = _Keeper(self.setting, self.task, self.label, ())
            driven = self._drive(finished, self.worlds.for_runs(finished), watch)
        return _curves(self.task, self.label, self.setting, driven)

    def _table(self, runs: tuple[int, ...], driven: Driven) -> pa.Table:
        units = {item.name: item.unit for item in self.setting.quantities()}
        scored = driven.scored
        statuses, n = scored.status.tolist(), len(runs)
        names, dimension = {status: Status(status).name for status in set(statuses)}, scored.nees_states
        columns = {**identity(self.task, self.label, runs), "status": [names[status] for status in statuses],
                   "reason": [clean(text) if text else "" for text in scored.reasons], "exception": [""] * n,
                   "seconds": np.full(n, driven.seconds / n), "steps": driven.steps.astype(np.int32),
                   "nees_states": pa.nulls(n, pa.int32()) if dimension is None else np.full(n, dimension, np.int32)}
        for (metric, quantity), values in scored.metrics.items():
            unit = units.get(quantity, "1")
            columns[f"{metric}:{quantity}:{f'{unit}^2' if metric == 'sum-squared' else unit}"] = values
        for (metric, quantity, unit), values in driven.outcomes.items():
            columns[f"{metric}:{quantity}:{unit}"] = np.asarray(values, dtype=float)
        return arrow_table(columns)


def _caught(task: Task, label: str) -> tuple[type[BaseException], ...]:
    """What becomes a row: in a process of a plug-in's own, where nobody presses Ctrl-C, all that it raises."""
    return (Exception, SystemExit) if own(task.cell, label) else (BaseException,)


class FirstSteps:
    """A world cut short."""

    def __init__(self, world: World, steps: int) -> None:
        self._world, self.steps = world, min(steps, world.steps)
        self.initial_mean, self.closed_loop = world.initial_mean, world.closed_loop
        self.lengths = world.lengths[:self.steps]
        if hasattr(world, "straight"):
            self.straight: Any = lambda k, most: getattr(world, "straight")(k, min(most, self.steps - k))  # noqa: B009

    def step(self, k: int, mean: Any) -> Step:
        return self._world.step(k, mean)


def _curves(task: Task, label: str, setting: Setting[Any], driven: Driven) -> list[pa.Table]:
    """Sums over the runs per step, a table a quantity; NEES under the quantity name `nees`, NIS under `nis`."""
    curves, times = driven.scored.curves, step_times(driven.world)
    steps = np.flatnonzero(curves["active"] > 0)
    none, zero = np.full(len(steps), np.nan), np.zeros(len(steps))
    tables = []
    for q, item in enumerate(setting.quantities()):
        if np.isnan(curves["squared"][steps, q]).all():
            continue  # a parameter that is not estimated
        least = none if driven.floor is None else np.nansum(driven.floor.squares[steps, q], axis=1)
        tables.append((item.name, curves["active"][steps], curves["squared"][steps, q], curves["fourth"][steps, q],
                       curves["error"][steps, q], least))
    for name in ("nees", "nis"):
        if curves[f"{name}-count"].any():
            tables.append((name, curves[f"{name}-count"][steps], curves[name][steps], zero, zero, none))
    n = len(steps)
    return [arrow_table({
        "scenario": [task.cell.scenario] * n, "variant": [task.cell.variant] * n, "estimator": [label] * n,
        "step": steps.astype(np.int32), "time": times[steps], "quantity": [name] * n,
        "active": active, "squared": squared, "fourth": fourth, "error": error, "floor": floor,
    }) for name, active, squared, fourth, error, floor in tables]


def _trajectory(task: Task, label: str, run: int, times: np.ndarray, steps: np.ndarray, name: str,
                truth: np.ndarray, estimate: np.ndarray | None = None, sd: np.ndarray | None = None) -> pa.Table:
    n = len(steps)
    nothing = np.full(n, np.nan)
    return arrow_table({
        "scenario": [task.cell.scenario] * n, "variant": [task.cell.variant] * n, "estimator": [label] * n,
        "run": np.full(n, run, np.int32), "step": steps.astype(np.int32),
        "time": times[steps], "name": [name] * n, "truth": truth,
        "estimate": nothing if estimate is None else estimate, "sd": nothing if sd is None else sd,
    })


class _Keeper:
    """Watches a drive and keeps whole trajectories of the first runs: each scored quantity of the truth, its estimate
    and claimed standard deviation, the trace of the covariance, and particle diversity."""

    def __init__(self, setting: Setting[Any], task: Task, label: str, runs: tuple[int, ...]) -> None:
        self.setting, self.task, self.label, self.runs = setting, task, label, runs
        self.positions = [p for p, run in enumerate(runs) if run < task.keep]  # the first ones: runs ascend
        self.wanted = bool(self.positions)
        self.seen: dict[str, list[np.ndarray]] = {}

    def __call__(self, stretch: Stretch) -> None:
        n, active = len(self.positions), stretch.active[:, None, :len(self.positions)]
        rows = {"truth": stretch.truth, "mean": np.where(active, stretch.vector[:, :stretch.estimated, :n], np.nan)}
        for name, claims in (("covariance", stretch.covariance), ("ellipsoid", stretch.ellipsoid)):
            if claims is not None:
                rows[name] = claims.diagonal
        if stretch.diversity is not None:
            rows["diversity"] = stretch.diversity
        for name, values in {**rows, "step": stretch.places}.items():
            own = values if values.ndim == 1 else values[..., :n]
            self.seen.setdefault(name, []).append(own[:stretch.count].copy())

    def tables(self, times: np.ndarray) -> list[pa.Table]:
        """One table per kept run and name; all parts (K, kept runs). times (K,) of all steps, s."""
        if not self.seen:
            return []
        seen = {name: np.concatenate(values) for name, values in self.seen.items()}
        mean, truth = seen["mean"], seen["truth"]
        claimed = seen.get("covariance", seen.get("ellipsoid", np.empty((0, 0, 0))))
        columns: dict[str, tuple[np.ndarray, ...]] = {}
        for item in self.setting.quantities():
            if any(i >= mean.shape[1] for i, _ in item.components):
                continue  # a parameter that is not estimated
            if len(item.components) == 1:
                i, weight = item.components[0]
                sd = [weight * np.sqrt(np.maximum(claimed[:, i], 0))] if i < claimed.shape[1] else []
                columns[item.name] = (weight * truth[:, i], weight * mean[:, i], *sd)
            else:
                which, weights = (np.array(part) for part in zip(*item.components, strict=True))
                squared = (weights[:, None] * (mean[:, which] - truth[:, which])) ** 2
                error = np.sqrt(squared.mean(axis=1) if item.mean else squared.sum(axis=1))
                columns[item.name] = (np.full_like(error, np.nan), error)
        for name, values in (("trace-covariance", seen.get("covariance", np.empty((0, 0, 0))).sum(axis=1)),
                             ("diversity", seen.get("diversity", np.empty((0, 0))))):
            if len(values):
                columns[name] = (np.full_like(values, np.nan), values)
        return [_trajectory(self.task, self.label, self.runs[position], times, seen["step"], name,
                            *(part[:, n] for part in parts))
                for name, parts in columns.items() for n, position in enumerate(self.positions)]

    def extras(self, world: World) -> list[pa.Table]:
        """A closed-loop world's own figures data, which belong to this estimator."""
        extra: dict[str, np.ndarray] = getattr(world, "extra", {})
        times = step_times(world)
        return [_trajectory(self.task, self.label, self.runs[p], times, np.arange(len(values)), name,
                            np.asarray(values)[:, p].astype(float))
                for p in self.positions for name, values in extra.items()]
