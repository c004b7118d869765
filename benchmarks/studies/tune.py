"""Tuning one estimator of a scenario on training runs of its own, and the tuned entry against the untuned one.

Every evaluation hears the same training runs, which are none of the table's; what is lost or infeasible ranks worst."""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np
import pandas as pd

from ...scenarios.arrays import Array
from ...scenarios.errors import InputError
from ...scenarios.files import Scenario
from ..planning.catalogue import Catalogue
from ..planning.plan import make_plan
from ..running.machinery import Machinery
from ..running.result import joined
from ..running.runner import run
from .deadline import Overdue, within
from .entries import put
from .search import Axis, Constraint, Found, search

TRAINING = 1_000_000_007
"""How far the seed of the training runs lies from that of the table's."""
CONSTRAINTS = ("nees", "nis", "coverage", "whiteness")
"""What is right at a value of its own, so that neither its least nor its greatest is any aim."""
GREATER = ("log-likelihood", "trains-per-hour")
"""What is the better the greater it is."""
PATIENCE, SHORTEST = 20.0, 10.0
"""Where no limit is given, an evaluation may take so many times as long as the untuned entry, and at least so many
seconds."""


@dataclass(frozen=True)
class Scored:
    """An entry on some runs. loss: what is minimised; values, sds: of each metric of the objective, as the tables have
    it, with its standard error; pulls (runs,): of each run on the logarithm of the loss, whose mean is 0; lost: runs
    without a number; broken: by how much constraints are."""

    loss: float
    values: tuple[float, ...]
    sds: tuple[float, ...]
    pulls: Array = field(repr=False)
    lost: int = 0
    broken: float = -1.0


@dataclass(frozen=True)
class Tuned:
    """entry: as a scenario file has it. train, test: scores by "tuned", "untuned" and what stands beside.
    evaluations: of the search, in their order, for the manifest. kept: the untuned entry was no worse than any of
    them, and stays."""

    entry: dict[str, Any]
    found: Found
    train: dict[str, Scored]
    test: dict[str, Scored]
    evaluations: list[dict[str, Any]]
    limit: float
    kept: bool

    def gap(self, name: str) -> tuple[float, float]:
        """Test loss over training loss, less 1, with its standard error: the runs of both are independent."""
        return self._gap(self.test[name].pulls, self.train[name].pulls, name)

    def added(self) -> tuple[float, float]:
        """What tuning adds to the gap: that of the tuned entry less that of the fixed, untuned one on the same runs."""
        (tuned, _), (fixed, _) = self.gap("tuned"), self.gap("untuned")
        test, train = (_difference(scores["tuned"].pulls, scores["untuned"].pulls)
                       for scores in (self.test, self.train))
        error = self._gap(test, train, "tuned")[1]
        return tuned - fixed, error

    def _gap(self, test: Array, train: Array, name: str) -> tuple[float, float]:
        scores = self.test[name].loss, self.train[name].loss
        size = abs(scores[0] / scores[1]) if scores[1] else math.nan
        return scores[0] / scores[1] - 1 if scores[1] else math.nan, size * math.hypot(_error(test), _error(train))


def _error(pulls: Array) -> float:
    return float(pulls.std(ddof=1) / len(pulls)**0.5) if len(pulls) > 1 else math.nan


def _difference(a: Array, b: Array) -> Array:
    return a - b if len(a) == len(b) else np.array([math.nan])


@dataclass(frozen=True)
class Task:
    """What is tuned: a label of a scenario's variant. fixed: overrides of the scenario. objective: (metric, quantity)
    pairs, of which the geometric mean counts. subject_to: what an evaluation must keep. beside: labels that are shown
    with it. limit: seconds that an evaluation may take; 0: PATIENCE times the untuned entry's."""

    scenario: Scenario
    name: str
    variant: str
    label: str
    fixed: Mapping[str, Any]
    objective: tuple[tuple[str, str], ...]
    runs: int
    seed: int
    machinery: Machinery
    catalogue: Catalogue
    subject_to: tuple[Constraint, ...] = ()
    beside: tuple[str, ...] = ()
    limit: float = 0.0

    def entry(self, label: str) -> dict[str, Any]:
        """An entry as the file has it, or of an installed or loose estimator by its name. Raises InputError."""
        entries = self.scenario.variants[self.variant]["estimators"]
        if label in entries:
            return {key: copy.deepcopy(value) for key, value in entries[label].items() if key != "tuned"}
        if label in self.catalogue.names():
            return {"plugin": label}
        raise InputError(f"--estimator {label}: no such estimator in {self.scenario.where}; allowed: "
                         f"{', '.join(entries)}, or the name of an installed estimator")

    def score(self, entry: Mapping[str, Any], training: bool, label: str = "") -> Scored:
        """The entry on the training runs or the table's. Raises InputError for what the scenario does not score."""
        label = label or self.label
        plan = make_plan([f"{self.name}/{self.variant}"], only=[label], runs=self.runs,
                         seed=self.seed + (TRAINING if training else 0),
                         overrides={**self.fixed, **self.scenario.setting(self.variant).split(training),
                                    f"estimators.{label}": dict(entry)}, catalogue=self.catalogue)
        rows = joined([result.rows for result in run(plan, {}, self.machinery)]).to_pandas().sort_values("run")
        fine = rows[rows["status"] == "ok"]
        lost = len(rows) - len(fine)
        if fine.empty:
            nothing = (math.nan,) * len(self.objective)
            return Scored(math.inf, nothing, nothing, np.array([math.nan]), lost)
        values, sds, logs, pulls = [], [], [], np.zeros(len(fine))
        for metric, quantity in self.objective:
            each = self._column(fine, metric, quantity, "--objective")
            each = each**2 if metric == "rmse" else each
            mean = float(each.mean())
            value, power = (mean**0.5, 0.5) if metric == "rmse" else (mean, 1.0)
            pull = power * (each - mean) / mean if mean else np.full(len(each), math.nan)
            values.append(value)
            sds.append(abs(value) * _error(pull))
            pulls += pull / len(self.objective)
            logs.append((-value if metric in GREATER else value) if len(self.objective) == 1 else
                        math.log(value) if value > 0 else -math.inf)
        loss = logs[0] if len(logs) == 1 else math.exp(float(np.mean(logs)))
        broken = max((one.broken(self._kept(fine, one)) for one in self.subject_to), default=-1.0)
        return Scored(math.inf if lost else loss, tuple(values), tuple(sds), pulls, lost, broken)

    def _column(self, rows: pd.DataFrame, metric: str, quantity: str, flag: str) -> Array:
        column = next((name for name in rows.columns if name.startswith(f"{metric}:{quantity}:")), None)
        if column is None:
            known = sorted({name.rpartition(":")[0] for name in rows.columns if name.count(":") == 2})
            raise InputError(f"{flag} {metric}:{quantity}: not among what {self.label} is scored by here; allowed: "
                             f"{', '.join(item for item in known if flag != '--objective' or aim(item))}")
        return rows[column].to_numpy(dtype=float)

    def _kept(self, rows: pd.DataFrame, one: Constraint) -> float:
        """What a constraint is about: a mean over the runs; NEES over its dimension, as tables have it."""
        each = self._column(rows, one.metric, one.quantity, "--subject-to")
        if one.metric == "nees":
            each = each / rows["nees_states"].to_numpy(dtype=float)
        return float(each.mean())


def tune(task: Task, axes: Sequence[Axis], budget: int) -> Tuned:
    """Search on the training runs, then try the tuned and the untuned entry on both sets. Raises InputError."""
    untuned = task.entry(task.label)
    knowledge = json.loads(task.scenario.setting(task.variant).resolve_knowledge({}).model_dump_json())
    log: list[dict[str, Any]] = []

    def told(values: Mapping[str, Any]) -> dict[str, Any]:
        entry = copy.deepcopy(untuned)
        for key, value in values.items():
            put(entry, key, value, {"knowledge": knowledge})
        return entry

    begun = perf_counter()
    train = {"untuned": task.score(untuned, training=True)}
    limit = task.limit or max(SHORTEST, PATIENCE * (perf_counter() - begun))

    def evaluated(values: Mapping[str, Any]) -> tuple[float, float]:
        begun = perf_counter()
        try:
            with within(limit):
                scored = task.score(told(values), training=True)
        except Overdue:
            log.append({"values": dict(values), "loss": None, "seconds": perf_counter() - begun, "over": True})
            return math.inf, -1.0
        log.append({"values": dict(values), "loss": _finite(scored.loss), "lost": scored.lost,
                    "broken": _finite(scored.broken), "objective": [_finite(value) for value in scored.values],
                    "seconds": perf_counter() - begun})
        return scored.loss, scored.broken

    found = search(axes, evaluated, budget)
    if not math.isfinite(found.loss):
        raise InputError(f"--over: all {len(found.losses)} evaluations of {task.label} ended infeasible, lost or over "
                         f"{limit:.3g} s; other limits may do")
    if min(found.broken) > 0:
        raise InputError(f"--subject-to: none of {len(found.losses)} evaluations of {task.label} keeps it; other "
                         "limits of the search may do")
    kept = train["untuned"].broken <= 0 and train["untuned"].loss <= found.loss
    tuned = untuned if kept else told(found.values)
    entries = {"tuned": (task.label, tuned), **{label: (label, task.entry(label)) for label in task.beside}}
    train |= {name: task.score(entry, True, label) for name, (label, entry) in entries.items()}
    bare = {"plugin": untuned["plugin"]}
    if not set(untuned) <= {"plugin", "note", "default"}:
        with suppress(InputError):  # of another model, it may not be scored by the objective
            train["as told"], entries["as told"] = task.score(bare, True), (task.label, bare)
    test = {name: task.score(entry, False, label)
            for name, (label, entry) in {"untuned": (task.label, untuned), **entries}.items()}
    written = {key: value for key, value in tuned.items() if key not in ("note", "default")}
    written["tuned"] = {"variant": task.variant, "untuned": task.label, "runs": task.runs, "train": {
        f"{metric}:{quantity}": [_short(train[name].values[i]) for name in ("tuned", "untuned")]
        for i, (metric, quantity) in enumerate(task.objective)}}
    return Tuned(written, found, train, test, log, limit, kept)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _short(value: float) -> float:
    return float(f"{value:.5g}")


def aim(column: str) -> bool:
    """Whether a metric can be an objective."""
    return column.partition(":")[0] not in CONSTRAINTS
