"""manifest.json: what a results folder knows of its plan, its estimators and the machine; read once, as a stranger's.

No name in it is taken that could not have been written: files are named after variants and estimators."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, NonNegativeInt, PositiveInt, model_validator

from ...estimators.registry import GIVEN
from ...scenarios.schema import Label, Name
from ...scenarios.setting import Setting
from ..planning.catalogue import Catalogue
from ..planning.plan import Cell, EstimatorEntry, Plan
from ..scoring.faults import fault_table
from ..scoring.floor import floor_kind

SCHEMA = 2
"""Version of the folder's layout and of this file's keys."""


def _moment(text: str) -> str:
    if datetime.fromisoformat(text).tzinfo is None:
        raise ValueError("needs its offset from UTC")
    return text


Moment = Annotated[str, AfterValidator(_moment)]
CellKey = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9-]*/[A-Za-z0-9][A-Za-z0-9._-]*$")]
Text = Annotated[str, Field(max_length=20_000)]


class _Part(BaseModel):
    """A table of the manifest. Keys that it does not name are kept as they are and decide nothing."""

    model_config = ConfigDict(extra="allow", allow_inf_nan=False)


class EstimatorKey(_Part):
    """What an estimator's rows depend on besides their cell."""

    plugin: str
    parameters: dict[str, Any]
    knowledge: dict[str, Any]
    source: str


class KeyOfCell(_Part):
    """What the rows of a cell depend on, and how many runs it has."""

    runs: PositiveInt
    scenario: str
    setting: str
    scoring: str
    estimators: Annotated[dict[Label, EstimatorKey], Field(min_length=1)]


class Configuration(_Part):
    """The keys of all rows. runs: the most that a cell has."""

    runs: PositiveInt
    seed: NonNegativeInt
    keep: NonNegativeInt
    cells: Annotated[dict[CellKey, KeyOfCell], Field(min_length=1)]


class AboutVariant(_Part):
    """What is told of a variant. period: s; floor: what the least error possible is called, empty: none is known;
    uncertified: why claims do not hold over its channel, see `Setting.uncertified`;
    until: why its runs were stopped, where that hung on them; level: of its verdicts."""

    notes: list[Text]
    fitted: list[Text]
    requirements: list[dict[str, Any]] = []
    floor: str = ""
    uncertified: dict[str, str] = {}
    until: Text = ""
    level: Annotated[float, Field(gt=0, lt=1)] = 0.05
    title: Text
    period: Annotated[float, Field(gt=0)]


class AboutScenario(_Part):
    """What is told of a scenario."""

    title: Text
    source: Text
    kind: str
    scored: str
    shown: dict[str, tuple[str, float]]
    quantities: list[str]
    table: list[tuple[str, str]]
    variants: dict[Label, AboutVariant]


class AboutEstimator(_Part):
    """What is told of an estimator. about: its docstring. given: in Python, by value: only who gave it can compute its
    rows again."""

    summary: Text
    family: Annotated[str, Field(max_length=60)] = "Other"
    source: Text
    claims: list[str]
    needs: list[str] = []
    oracle: bool
    smoother: bool = False
    given: bool = False
    about: Text = ""


class StoredCell(_Part):
    """A cell as it can be computed again."""

    where: str
    table: dict[str, Any]
    entries: dict[Label, EstimatorEntry]


class Replay(_Part):
    """The plan. plugins: the loose files it was made with, of which nothing is run unless it is named again."""

    plugins: list[str]
    cells: dict[CellKey, StoredCell]


class Environment(_Part):
    """Where the rows were begun."""

    python: str
    platform: str
    processor: str
    cores: int | None
    packages: dict[str, str]
    git_commit: str | None
    git_dirty: bool | None


class Manifest(_Part):
    """manifest.json."""

    schema_version: int
    railstate: str
    command: str
    configuration: Configuration
    scenarios: dict[Name, AboutScenario]
    estimators: dict[str, AboutEstimator]
    replay: Replay
    environment: Environment
    started: Moment
    finished: Moment | None = None
    rows: NonNegativeInt | None = None
    statuses: dict[str, NonNegativeInt] = {}

    @model_validator(mode="after")
    def _whole(self) -> Manifest:
        for key, cell in self.configuration.cells.items():
            scenario, variant = key.split("/")
            if scenario not in self.scenarios or variant not in self.scenarios[scenario].variants:
                raise ValueError(f"scenarios: nothing is told of {key}")
            if key not in self.replay.cells:
                raise ValueError(f"replay.cells: {key} is missing")
            for label, entry in cell.estimators.items():
                if entry.plugin not in self.estimators:
                    raise ValueError(f"estimators: nothing is told of {entry.plugin}")
                if label not in self.replay.cells[key].entries:
                    raise ValueError(f"replay.cells.{key}.entries: {label} is missing")
        return self


def stored_cell(manifest: Mapping[str, Any], key: str, labels: Mapping[str, Any] | None = None) -> Cell:
    """A cell of a folder as it can be computed again, with the entries of some of its labels (None: all)."""
    scenario, variant = key.split("/")
    saved = manifest["replay"]["cells"][key]
    wanted = manifest["configuration"]["cells"][key]["estimators"] if labels is None else labels
    return Cell(scenario, variant, saved["where"], saved["table"],
                {label: EstimatorEntry.model_validate(saved["entries"][label]) for label in wanted})


def stored_plan(manifest: Mapping[str, Any], catalogue: Catalogue) -> Plan:
    """The plan a results folder was made from. Nothing that the folder names is run: its estimators are those of the
    catalogue. Raises InputError."""
    configuration = manifest["configuration"]
    return Plan(tuple(stored_cell(manifest, key) for key in configuration["cells"]), configuration["runs"],
                configuration["seed"], configuration["keep"], catalogue)


def description(plan: Plan) -> dict[str, Any]:
    """The manifest's `scenarios`, `estimators` and `replay` entries."""
    scenarios: dict[str, Any] = {}
    for cell in plan.cells:
        setting = cell.setting()
        config = setting.config
        about = scenarios.setdefault(cell.scenario, {
            "title": config.title, "source": config.source, "kind": setting.kind,
            "scored": config.score.at,
            "shown": {**setting.shown, **{item.name: item.shown for item in setting.quantities() if item.shown}},
            "quantities": [item.name for item in setting.quantities()], "table": _table(setting), "variants": {}})
        about["variants"][cell.variant] = {"notes": setting.notes, "fitted": config.fitted, "title": config.title,
                                           "period": setting.sampling_period, "floor": floor_kind(setting),
                                           "uncertified": setting.uncertified,
                                           "requirements": [asked.model_dump() for asked in config.requirements]}
    plugins = {entry.plugin: plan.catalogue[entry.plugin] for cell in plan.cells for entry in cell.entries.values()}
    return {
        "scenarios": scenarios,
        "estimators": {name: {field: getattr(one, field) for field in AboutEstimator.model_fields}
                       for name, one in plugins.items()},
        "replay": {"plugins": [path for path in plan.catalogue.files if not path.endswith(GIVEN)], "cells": {
            cell.key: {"where": cell.where, "table": dict(cell.table),
                       "entries": {label: entry.model_dump() for label, entry in cell.entries.items()}}
            for cell in plan.cells}},
    }


def _table(setting: Setting[Any]) -> tuple[tuple[str, str], ...]:
    """(metric, quantity) pairs that tables show: the setting's own, and what became of runs with faults."""
    return *setting.table(), *fault_table(setting.config.faults, setting.quantities())
