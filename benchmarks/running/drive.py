"""Driving one estimator through one world: the only loop in the suite that feeds measurements, one step at a time.

Causality holds by construction, closed loops work, and estimators' time is measured apart from everything else."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from ...estimators.interface import Estimate, Estimator, misshapen
from ...scenarios.arrays import Array
from ...scenarios.model import DesignModel
from ...scenarios.randomness import RunRandom
from ...scenarios.setting import Setting
from ...scenarios.world import Step, World, step_times
from ..scoring.scorer import Scored, Scorer
from ..scoring.windows import WindowErrors

Watch = Callable[[int, Estimate, Step], None]


@dataclass(frozen=True)
class Driven:
    """Outcome of a drive. seconds: time inside the estimator; scoring: time spent on scores and kept trajectories;
    steps: how many steps were driven (all runs together)."""

    scored: Scored
    outcomes: dict[tuple[str, str, str], Array]
    seconds: float
    scoring: float
    steps: int
    world: World


def drive(setting: Setting[Any], world: World, estimator: Estimator, model: DesignModel, random: RunRandom,
          watch: Watch | None = None) -> Driven:
    """Run a designed estimator through a world and score it as the scenario says. `watch` sees each scored step."""
    score = setting.config.score
    skip = int(np.searchsorted(step_times(world, setting.config.time.period), score.skip - 1e-9))
    runs = world.initial_mean.shape[1]
    scorer = Scorer(setting.quantities(), runs, world.steps, skip, dict(score.divergence), model.performance)
    windows = WindowErrors(getattr(world, "windows", ()), setting.quantities(), runs)
    before_update = score.at == "prediction" and estimator.predicts
    seconds = scoring = 0.0

    def scored(k: int, estimate: Estimate, step: Step) -> float:
        """Score an estimate; the seconds it took."""
        begun = perf_counter()
        scorer.add(k, checked(estimate, step), step)
        if k >= skip:
            windows.add(estimate, step)
        if watch:
            watch(k, estimate, step)
        return perf_counter() - begun

    good: tuple[Any, ...] | None = None

    def checked(estimate: Estimate, step: Step) -> Estimate:
        """The same, after a look at its arrays where any has another shape than before. Raises TypeError."""
        nonlocal good
        shapes = tuple(getattr(value, "shape", None) for value in (
            estimate.mean, estimate.covariance, estimate.parameter, estimate.ellipsoid, estimate.bound))
        if shapes != good:
            wrong = misshapen(estimate, model.nx, runs, len(step.truth) - model.nx)
            if wrong:
                raise TypeError(f"estimate(): {wrong}")
            good = shapes
        return estimate

    begun = perf_counter()
    estimator.start(model, runs, random)
    estimate = estimator.estimate()
    seconds += perf_counter() - begun
    mean = estimate.mean
    driven, active, counts, extremes = 0, np.zeros(runs), dict[str, Array](), dict[str, Array]()
    for k in range(world.steps):
        step = world.step(k, mean)
        if not step.active.any():
            break
        last = len(step.events) - 1
        if estimator.oracle:
            estimator.reveal(step.truth)
        begun = perf_counter()
        for number, event in enumerate(step.events):
            if not (isinstance(event.portion, float) and event.portion == 0.0):
                estimator.predict(step.u, event.portion)
            if before_update and number == last:
                estimate = estimator.estimate()
                seconds += perf_counter() - begun
                scoring += scored(k, estimate, step)
                begun = perf_counter()
            estimator.update(event.y, event.received)
        if not before_update or world.closed_loop:
            estimate = estimator.estimate()
            mean = estimate.mean
        seconds += perf_counter() - begun
        if not before_update:
            scoring += scored(k, estimate, step)
        driven += 1
        active += step.active
        for name, count in estimator.counters().items():
            np.copyto(counts.setdefault(name, np.zeros(runs)), count, where=step.active)
        for name, value in estimator.extremes().items():
            np.copyto(extremes.setdefault(name, np.zeros(runs)), value, where=step.active)
    found = scorer.finish(estimator.status, estimator.reasons)
    bad = found.status != 0
    outcomes = {**windows.finish(), **setting.outcomes(world, found.metrics)}
    outcomes.update({(name, "work", "1"): count / np.maximum(active, 1) for name, count in counts.items()})
    outcomes.update({(name, "stability", "1"): value for name, value in extremes.items()})
    outcomes = {key: np.where(bad, np.nan, value) for key, value in outcomes.items()}
    return Driven(found, outcomes, seconds, scoring, driven, world)


def prepare(setting: Setting[Any], estimator_class: type[Estimator], parameters: Mapping[str, Any],
            knowledge: Mapping[str, Any], initial_mean: Array) -> tuple[Estimator, DesignModel]:
    """A configured estimator and its design model, checked against each other. Raises Unsupported, ValidationError."""
    model = setting.design_model(knowledge, initial_mean)
    estimator_class.require(model)
    return estimator_class(parameters), model
