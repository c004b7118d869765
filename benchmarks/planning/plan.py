"""What a run consists of: cells (scenario variant with its estimators), and tasks (a cell and a block of runs).

Everything here is plain data that pickles, so that a task can go to another process or another machine."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from ...estimators.registry import estimators
from ...scenarios.errors import InputError
from ...scenarios.files import DISPLAY, Scenario, file_given, load
from ...scenarios.registry import scenario_files, setting_for, setting_of, settings
from ...scenarios.schema import EstimatorEntry
from ...scenarios.setting import Setting
from ...scenarios.source import source_hash
from .catalogue import Catalogue
from .naming import find

SCORING = "railstate.benchmarks.running.execute"
"""The module from which all is imported that turns a cell and an estimator into rows."""


@dataclass(frozen=True)
class Cell:
    """One scenario variant (its resolved table) with the entries of the estimators to run, by label.

    runs: how many it has at least, where a folder holds more than the plan asks for."""

    scenario: str
    variant: str
    where: str
    table: Mapping[str, Any] = field(repr=False)
    entries: Mapping[str, EstimatorEntry]
    runs: int = 0

    @property
    def key(self) -> str:
        return f"{self.scenario}/{self.variant}"

    def setting(self) -> Setting[Any]:
        return setting_of(self.table, self.where)


@dataclass(frozen=True)
class Task:
    """A block of runs of one cell for some of its estimators. keep: trajectories of runs below this number are kept.
    plugin: the loose file that its estimator, which then is alone, comes from ("": none)."""

    cell: Cell
    labels: tuple[str, ...]
    runs: tuple[int, ...]
    seed: int
    keep: int = 0
    plugin: str = ""


@dataclass(frozen=True)
class Plan:
    """Everything that decides the rows of a run. catalogue: what is known of the estimators. changes: what the command
    line sets in the scenarios, as text."""

    cells: tuple[Cell, ...]
    runs: int
    seed: int
    keep: int = 0
    catalogue: Catalogue = field(default_factory=Catalogue, compare=False, repr=False)
    changes: str = ""

    def task(self, cell: Cell, labels: tuple[str, ...], runs: tuple[int, ...]) -> Task:
        """A task of this plan: for several of the suite's own estimators, or for one plug-in."""
        name = cell.entries[labels[0]].plugin
        file = "" if name in estimators() else self.catalogue[name].file
        return Task(cell, labels, runs, self.seed, self.keep, file)

    def configuration(self) -> dict[str, Any]:
        """What must be the same for two runs to have the same rows (display names aside): what is asked for, and the
        hashes of the code that computes it."""
        scoring, source = source_hash(SCORING), cache(self.catalogue.source)
        code = cache(lambda kind: source_hash(setting_for(kind, "plant.kind").__module__))
        return {
            "runs": max([self.runs, *(cell.runs for cell in self.cells)]),
            "seed": self.seed,
            "keep": self.keep,
            "cells": {
                cell.key: {
                    "runs": max(self.runs, cell.runs),
                    "scenario": Scenario(cell.scenario, cell.where, {cell.variant: dict(cell.table)}, cell.variant)
                    .content_hash(cell.variant),
                    "setting": code(cell.table["plant"]["kind"]),
                    "scoring": scoring,
                    "estimators": {
                        label: {"plugin": entry.plugin, "parameters": entry.parameters, "knowledge": entry.knowledge,
                                "source": source(entry.plugin),
                                **entry.model_dump(include={"late", "told_faults", "augment"}, exclude_defaults=True)}
                        for label, entry in cell.entries.items()
                    },
                }
                for cell in self.cells
            },
        }


def make_plan(names: Sequence[str], *, only: Sequence[str] = (), runs: int = 100, seed: int = 1, keep: int = 0,
              overrides: Mapping[str, Any] | None = None, plugins: Sequence[str] = (),
              catalogue: Catalogue | None = None, entries: Mapping[str, Mapping[str, Any]] | None = None) -> Plan:
    """A plan from the command line's words.

    names: scenario names, NAME/VARIANT, or paths; none means every built-in scenario that needs no file of the user's.
    only: estimator labels or plug-in names; none means each scenario's default ones. entries: more of [estimators], by
    label, in every scenario. Raises InputError."""
    for flag, value in (("--runs", runs), ("--seed", seed + 1), ("--keep", keep + 1)):
        if value < 1:
            raise InputError(f"{flag}: must be at least {1 if flag == '--runs' else 0}")
    catalogue = catalogue or Catalogue(plugins)
    changes = json.dumps(overrides or {}, sort_keys=True, default=str)
    overrides = dict(overrides or {})
    overrides.update({f"estimators.{label}": dict(entry) for label, entry in (entries or {}).items()})
    cells: list[Cell] = []
    for name in names or _self_contained():
        scenario, chosen = find(name, overrides)
        for variant in chosen:
            cell = _cell(scenario, variant, only, catalogue)
            twin = next((other for other in cells if cell and other.key == cell.key), None)
            if cell and twin and _content(twin) != _content(cell):
                raise InputError(f"{cell.where} and {twin.where} are both named {cell.scenario}: a name of its own "
                                 "(name = ..) tells their results apart")
            if cell and not twin:
                cells.append(cell)
    if not cells:
        known = sorted({label for name in names or _self_contained()
                        for label in find(name, overrides)[0].variants[find(name, overrides)[1][0]]["estimators"]})
        raise InputError(f"--estimators {','.join(only)}: none of these; allowed here: {', '.join(known)}, or the name "
                         f"of an installed estimator: {', '.join(catalogue.names())}")
    return Plan(tuple(cells), runs, seed, keep, catalogue, changes)


def _content(cell: Cell) -> dict[str, Any]:
    """What a cell's rows depend on."""
    return {key: value for key, value in cell.table.items() if key not in DISPLAY} | {"estimators": cell.entries}


def _self_contained() -> list[str]:
    return [name for name in scenario_files()
            if not getattr(settings().get(str(_kind(name))), "needs_file", "")]


def _kind(name: str) -> object:
    scenario = load(name)
    return scenario.variants[scenario.default]["plant"]["kind"]


def _cell(scenario: Scenario, variant: str, only: Sequence[str], catalogue: Catalogue) -> Cell | None:
    """The cell of one variant, its estimators checked. None if none of `only` applies to it."""
    config = scenario.setting(variant).config
    entries: dict[str, EstimatorEntry] = {}
    names = catalogue.names()
    if only:
        for label in only:
            if label in config.estimators:
                entries[label] = config.estimators[label]
            elif label in names:
                entries[label] = EstimatorEntry(plugin=label)
            else:
                known = {**dict.fromkeys(config.estimators), **dict.fromkeys(names)}
                if not any(label in other["estimators"] for other in scenario.variants.values()):
                    raise InputError(f"--estimators {label}: no such estimator for {scenario.name}; allowed: "
                                     f"{', '.join(known)}")
    else:
        entries = {label: entry for label, entry in config.estimators.items() if entry.default}
        for name in catalogue.loose:
            entries.setdefault(name, EstimatorEntry(plugin=name))
    for label, entry in entries.items():
        place = f"{scenario.where}: estimators.{label}"
        if entry.plugin not in names:
            raise InputError(f"{place}.plugin: there is no estimator \"{entry.plugin}\"; installed: {', '.join(names)}")
        entries[label] = entry.model_copy(update={"parameters": catalogue.parameters(
            entry.plugin, entry.parameters, f"{place}.parameters", scenario.folder)})
    return Cell(scenario.name, variant, scenario.where, scenario.variants[variant], entries) if entries else None


def check_variants(scenario: Scenario, variants: Sequence[str], catalogue: Catalogue) -> None:
    """Raises InputError where a run of one of the variants would: its trip does not end, an estimator does not take its
    parameters. Who is not known here may come with --plugin."""
    names, seen = catalogue.names(), set[str]()
    for variant in variants:
        setting = scenario.setting(variant)
        if not setting.needs_file or file_given(setting):
            setting.batch_bytes()  # asks how long a trip is
        for label, entry in setting.config.estimators.items():
            asked = f"{label} {entry.plugin} {entry.parameters}"
            if entry.plugin in names and asked not in seen:
                seen.add(asked)
                catalogue.parameters(entry.plugin, entry.parameters,
                                     f"{scenario.where}: estimators.{label}.parameters", scenario.folder)


def own(cell: Cell, label: str) -> bool:
    """Whether an estimator of a cell, and the cell's setting, are the suite's own code."""
    setting = setting_for(cell.table["plant"]["kind"], cell.key)
    return cell.entries[label].plugin in estimators() and setting.__module__.startswith("railstate.")
