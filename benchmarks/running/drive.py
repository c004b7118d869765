"""Driving one estimator through one world and scoring it: a watched `Loop`, and what is left of it afterwards."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from ...estimators.interface import Estimate, Estimator, Innovation, Walk
from ...estimators.late import for_late
from ...scenarios.arrays import Array
from ...scenarios.measurement import Measurement
from ...scenarios.model import DesignModel
from ...scenarios.randomness import RunRandom
from ...scenarios.schema import Augment
from ...scenarios.setting import Setting
from ...scenarios.world import Step, Straight, World, step_times
from ..scoring.faults import FaultScores
from ..scoring.floor import Floor, Riccati, basis
from ..scoring.innovations import InnovationScore
from ..scoring.requirements import RequirementScores
from ..scoring.scorer import Scored, Scorer
from ..scoring.stretch import Stretch
from ..scoring.windows import PhaseErrors, WindowErrors
from .loop import Loop, Observer

Watch = Callable[[Stretch], None]
"""Sees the steps of a drive, some at a time; what it wants to keep it copies."""


@dataclass(frozen=True)
class Driven:
    """Outcome of a drive. seconds: time inside the estimator; scoring: time spent on scores and kept trajectories;
    steps (S,): how many steps each run was under way; floor: the least errors possible, where they are known."""

    scored: Scored
    outcomes: dict[tuple[str, str, str], Array]
    seconds: float
    scoring: float
    steps: Array
    world: World
    floor: Floor | None


class _Scoring(Observer):
    """Scores the estimates of a drive as they come. seconds: what that took."""

    def __init__(self, setting: Setting[Any], world: World, estimator: Estimator, model: DesignModel,
                 watch: Watch | None) -> None:
        score = setting.config.score
        self.skip = int(np.searchsorted(step_times(world), score.skip - 1e-9))
        self.runs, self.watch, self.seconds = world.initial_mean.shape[1], watch, 0.0
        self.walks = not setting.config.faults and not world.closed_loop
        self.stretch = Stretch(self.runs, model.own, 2 if self.walks else 1)
        self.scorer = Scorer(setting.quantities(), self.runs, world.steps, self.skip, dict(score.divergence),
                             None if model.performance is None else model.performance[:, :model.own])
        self.innovations = InnovationScore(self.runs, world.steps, self.skip)
        self.windows = WindowErrors(getattr(world, "windows", ()), setting.quantities(), self.runs)
        self.phases = PhaseErrors(setting.quantities(), self.runs)
        self.requirements = RequirementScores(setting.config.requirements, setting.quantities(), self.runs, world.steps)
        self.predicted_wanted = score.at == "prediction" and estimator.predicts
        self.updated_wanted = not self.predicted_wanted
        self.faults, self.estimator = FaultScores(setting.config.faults, setting.quantities(), self.runs), estimator
        filters = estimator.lag == 0  # a smoother knows more than any filter's least error
        found = basis(setting, self.runs) if world.closed_loop and filters else None
        self.riccati = Riccati(setting, found, world, self.predicted_wanted) if found else None
        self.k = 0
        self.waiting, self.past = dict[int, tuple[int, Step]](), dict[int, Estimate]()

    def predicted(self, step: Step, event: int, estimate: Estimate) -> None:
        if self.estimator.lag == 0:
            self._score(self.k, step, estimate)
        else:
            self.waiting[step.number] = self.k, step.kept()

    def smoothed(self, number: int, estimate: Estimate) -> None:
        """Scored in the order of the steps, as filters are."""
        self.past.setdefault(number, estimate)
        while (first := next(iter(self.waiting), None)) is not None and first in self.past:
            self._score(*self.waiting.pop(first), self.past.pop(first))

    def _score(self, k: int, step: Step, estimate: Estimate) -> None:
        begun = perf_counter()
        stretch = self.stretch
        if not stretch.take(k, estimate, step):
            self.flush()
            stretch.renew(estimate, step)
            stretch.take(k, estimate, step)
        if stretch.full:
            self.flush()
        self.faults.add(estimate, step)
        if self.riccati:
            self.riccati.take(k, step)
        self.seconds += perf_counter() - begun

    def walked(self, k: int, straight: Straight, walk: Walk) -> None:
        begun, stretch, done = perf_counter(), self.stretch, 0
        while done < len(straight.truth):
            taken = stretch.walk(k, straight, walk, done)
            if not taken:
                self.flush()
                stretch.renew(walk.at(-1), straight.last)
            if stretch.full:
                self.flush()
            done += taken
        self.innovations.walk(k, straight.active, straight.course.received, walk)
        self.k = k + len(straight.truth) - 1
        self.seconds += perf_counter() - begun

    def flush(self) -> None:
        """Score the steps that wait for it."""
        if self.stretch.count:
            self.scorer.add(self.stretch)
            self.phases.add(self.stretch, self.skip)
            self.windows.add(self.stretch, self.skip)
            self.requirements.add(self.stretch, self.skip)
            if self.watch:
                self.watch(self.stretch)
            self.stretch.count = 0

    updated = predicted

    def measured(self, step: Step, measurement: Measurement, innovation: Innovation) -> None:
        begun = perf_counter()
        if measurement.step == step.number:  # a late one tells of its own step
            self.innovations.add(self.k, step.active, measurement, innovation)
            self.faults.judged(step, measurement, self.estimator.rejected)
        self.seconds += perf_counter() - begun


def drive(setting: Setting[Any], world: World, estimator: Estimator, model: DesignModel, random: RunRandom,
          watch: Watch | None = None, floor: Floor | None = None) -> Driven:
    """Run a designed estimator through a world and score it as the scenario says. `watch` sees the scored steps; floor:
    of the same world in open loop; in a closed one it is the estimator's own."""
    scoring = _Scoring(setting, world, estimator, model, watch)
    runs = scoring.runs
    begun = perf_counter()
    estimator.start(model, runs, random)
    started = perf_counter() - begun
    loop = Loop(world, estimator, scoring, own=model.own)
    active, counts, extremes = np.zeros(runs), dict[str, Array](), dict[str, Array]()
    status = estimator.status.copy()  # as each run ended: what becomes of it later hangs on its company
    done = 0
    for step in loop.steps():
        scoring.k += 1
        active += (scoring.k - done) * step.active
        done = scoring.k
        np.copyto(status, estimator.status, where=step.active)
        for name, count in estimator.counters().items():
            np.copyto(counts.setdefault(name, np.zeros(runs)), count, where=step.active)
        for name, value in estimator.extremes().items():
            np.copyto(extremes.setdefault(name, np.zeros(runs)), value, where=step.active)
    loop.finish()
    scoring.flush()
    found = scoring.scorer.finish(status, estimator.reasons)
    bad = found.status != 0
    found.metrics.update({key: np.where(bad, np.nan, value) for key, value in scoring.innovations.finish().items()})
    found.curves["nis"], found.curves["nis-count"] = scoring.innovations.curve.T
    outcomes = {**scoring.windows.finish(), **scoring.phases.finish(), **scoring.requirements.finish(),
                **scoring.faults.finish(), **setting.outcomes(world, found.metrics)}
    floor = scoring.riccati.finish() if scoring.riccati else floor
    if floor:
        outcomes.update(floor.outcomes(found.metrics))
    outcomes.update({(name, "work", "1"): count / np.maximum(active, 1) for name, count in counts.items()})
    outcomes.update({(name, "stability", "1"): value for name, value in extremes.items()})
    outcomes = {key: np.where(bad, np.nan, value) for key, value in outcomes.items()}
    return Driven(found, outcomes, started + loop.seconds, scoring.seconds, active, world, floor)


def prepare(setting: Setting[Any], estimator_class: type[Estimator], parameters: Mapping[str, Any],
            knowledge: Mapping[str, Any], initial_mean: Array, late: str = "drop", told_faults: bool = False,
            augment: Mapping[str, Augment] | None = None) -> tuple[Estimator, DesignModel]:
    """A configured estimator and its design model, checked against each other; late, told_faults, augment: as its entry
    says. Raises Unsupported, ValidationError."""
    model = setting.told(knowledge, augment or {}, initial_mean)
    estimator_class.require(model)
    estimator = for_late(estimator_class(parameters), late, getattr(setting.config.channel, "longest", 0))
    estimator.told_faults = told_faults
    return estimator, model
