"""Tuning one estimator of a scenario on training runs of its own, and the tuned entry against the untuned one.

Every evaluation hears the same training runs, which are none of the table's; what is lost or infeasible ranks worst."""

from __future__ import annotations

import copy
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...scenarios.errors import InputError
from ...scenarios.files import Scenario
from ..planning.plan import make_plan
from ..running.result import joined
from ..running.runner import Machinery, run
from .search import Axis, Found, search

TRAINING = 1_000_000_007
"""How far the seed of the training runs lies from that of the table's."""
CONSTRAINTS = ("nees", "nis", "coverage", "whiteness")
"""What is right at a value of its own, so that neither its least nor its greatest is any aim."""
GREATER = ("log-likelihood", "trains-per-hour")
"""What is the better the greater it is."""


@dataclass(frozen=True)
class Scored:
    """An entry on some runs. loss: what is minimised; values: of each metric of the objective, as the tables have it;
    sd: standard error of the loss where it is a single metric, else NaN; lost: runs without a number."""

    loss: float
    values: tuple[float, ...]
    sd: float
    lost: int


@dataclass(frozen=True)
class Tuned:
    """entry: as a scenario file has it. train, test: scores by "tuned" and "untuned"."""

    entry: dict[str, Any]
    found: Found
    train: dict[str, Scored]
    test: dict[str, Scored]


@dataclass(frozen=True)
class Task:
    """What is tuned: a label of a scenario's variant. fixed: overrides of the scenario. objective: (metric, quantity)
    pairs, of which the geometric mean counts."""

    scenario: Scenario
    name: str
    variant: str
    label: str
    fixed: Mapping[str, Any]
    objective: tuple[tuple[str, str], ...]
    runs: int
    seed: int
    machinery: Machinery

    def entry(self) -> dict[str, Any]:
        """The untuned entry as the file has it. Raises InputError."""
        entries = self.scenario.variants[self.variant]["estimators"]
        if self.label not in entries:
            raise InputError(f"--estimator {self.label}: no such estimator in {self.scenario.where}; allowed: "
                             f"{', '.join(entries)}")
        return copy.deepcopy(dict(entries[self.label]))

    def score(self, entry: Mapping[str, Any], training: bool) -> Scored:
        """The entry on the training runs or the table's. Raises InputError for what the scenario does not score."""
        plan = make_plan([f"{self.name}/{self.variant}"], only=[self.label], runs=self.runs,
                         seed=self.seed + (TRAINING if training else 0),
                         overrides={**self.fixed, **self.scenario.setting(self.variant).split(training),
                                    f"estimators.{self.label}": dict(entry)})
        rows = joined([result.rows for result in run(plan, {}, self.machinery)]).to_pandas().sort_values("run")
        fine = rows[rows["status"] == "ok"]
        lost = len(rows) - len(fine)
        if fine.empty:
            return Scored(math.inf, (math.nan,) * len(self.objective), math.nan, lost)
        values, logs, sd = [], [], math.nan
        for metric, quantity in self.objective:
            column = next((name for name in rows.columns if name.startswith(f"{metric}:{quantity}:")), None)
            if column is None:
                known = sorted({name.rpartition(":")[0] for name in rows.columns if name.count(":") == 2})
                raise InputError(f"--objective {metric}:{quantity}: not among what {self.label} is scored by here; "
                                 f"allowed: {', '.join(item for item in known if aim(item))}")
            each = fine[column].to_numpy(dtype=float)
            each = each**2 if metric == "rmse" else each
            mean, error = float(each.mean()), float(each.std(ddof=1) / len(each)**0.5) if len(each) > 1 else math.nan
            value, sd = (mean**0.5, 0.5 * error / mean**0.5) if metric == "rmse" else (mean, error)
            values.append(value)
            sign = -1.0 if metric in GREATER else 1.0
            logs.append(sign * value if len(self.objective) == 1 else sign * math.log(value))
        loss = logs[0] if len(logs) == 1 else math.exp(float(np.mean(logs)))
        return Scored(math.inf if lost else loss, tuple(values), sd if len(values) == 1 else math.nan, lost)


def tune(task: Task, axes: Sequence[Axis], budget: int) -> Tuned:
    """Search on the training runs, then try the tuned and the untuned entry on both sets. Raises InputError."""
    untuned = task.entry()
    knowledge = json.loads(task.scenario.setting(task.variant).config.knowledge.model_dump_json())

    def told(values: Mapping[str, Any]) -> dict[str, Any]:
        entry = copy.deepcopy(untuned)
        for key, value in values.items():
            put(entry, key, value, {"knowledge": knowledge})
        return entry

    found = search(axes, lambda values: task.score(told(values), training=True).loss, budget)
    if not math.isfinite(found.loss):
        raise InputError(f"--over: all {len(found.losses)} evaluations of {task.label} ended infeasible or lost; other "
                         "limits may do")
    entries = {"tuned": told(found.values), "untuned": untuned}
    written = {key: value for key, value in entries["tuned"].items() if key not in ("note", "default")}
    return Tuned(written, found, {name: task.score(entry, training=True) for name, entry in entries.items()},
                 {name: task.score(entry, training=False) for name, entry in entries.items()})


def aim(column: str) -> bool:
    """Whether a metric can be an objective."""
    return column.partition(":")[0] not in CONSTRAINTS


def put(table: dict[str, Any], key: str, value: Any, base: Mapping[str, Any]) -> None:
    """Set one dotted key, `sigma_v.1` the second element of a list; base: where lists come from that the table does not
    name itself. Raises InputError."""
    head, _, rest = key.partition(".")
    if not rest:
        table[head] = value
        return
    inner, under = table.get(head), base.get(head)
    place = re.fullmatch(r"\d+", rest)
    if place and isinstance(inner if inner is not None else under, list):
        items = list(inner if inner is not None else under or [])
        if int(rest) >= len(items):
            raise InputError(f"--over {key}: there are {len(items)} elements, counted from 0")
        items[int(rest)] = value
        table[head] = items
        return
    table[head] = dict(inner or {})
    put(table[head], rest, value, under if isinstance(under, Mapping) else {})


def toml(label: str, entry: Mapping[str, Any], origin: str) -> str:
    """The entry as lines of a scenario file, its origin with it."""
    lines = ["[origin]", f"{json.dumps(f'estimators.{label}')} = {_plain(origin)}", "", f"[estimators.{label}]"]
    return "\n".join([*lines, *(f"{key} = {_plain(value)}" for key, value in entry.items()), ""])


def _plain(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key if re.fullmatch(r'[A-Za-z0-9_-]+', key) else json.dumps(key)} = {_plain(item)}"
                                for key, item in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_plain, value)) + "]"
    return json.dumps(value, ensure_ascii=False)
