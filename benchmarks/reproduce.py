"""Published numbers beside ours, each with a verdict. The numbers are data: one TOML file a paper in `published/`.

A verdict is computed, compared with the expected one, and never better than the evidence: `fitted` is not
`reproduced`."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from pydantic import ValidationError

from ..scenarios.errors import InputError
from ..scenarios.files import describe
from ..scenarios.schema import Strict
from .plan import Cell as PlanCell
from .plan import Plan, make_plan
from .reproduce_values import COMPUTATIONS
from .statistics import mean_se, pooled_rmse

Verdict = Literal["reproduced", "fitted", "not reproduced", "contradicts its text", "unreachable"]
VERDICTS: tuple[Verdict, ...] = ("reproduced", "fitted", "not reproduced", "contradicts its text", "unreachable")
COLUMNS = ("paper", "item", "cell", "published", "ours", "standard_error", "unit", "verdict", "expected", "note")
FOLDER = Path(__file__).with_name("published")


class Published(Strict):
    """One published cell, and what of ours stands beside it.

    Either scenario, variant, estimator, metric, quantity (a summary of rows, times `factor`), or `compute` with its
    arguments (a function of `reproduce_values.py`), or neither: `unreachable`, and `missing` says what is missing.
    It agrees within relative * |published| + absolute + 3 standard errors, plus 2 standard deviations of single runs
    where single_run says that the paper shows one run. at_most: a claim that the number is below this.
    fitted, contradicts: what an agreement or a disagreement means here, with the reason in `note`."""

    item: str
    cell: str
    published: float | str
    unit: str
    scenario: str = ""
    variant: str = ""
    estimator: str = ""
    metric: str = ""
    quantity: str = ""
    factor: float = 1.0
    compute: str = ""
    arguments: list[str | int | float] = []
    relative: float = 0.0
    absolute: float = 0.0
    why: str
    single_run: bool = False
    at_most: float | None = None
    fitted: bool = False
    contradicts: bool = False
    missing: str = ""
    expected: Verdict
    note: str = ""


@dataclass(frozen=True)
class Found:
    """Our number: value, its standard error, and the standard deviation of single runs (0 where there are none)."""

    value: float
    error: float = 0.0
    spread: float = 0.0


@dataclass(frozen=True)
class Paper:
    """A file of `published/`."""

    name: str
    title: str
    cells: tuple[Published, ...]


class Book:
    """The rows a reproduction draws on."""

    def __init__(self, rows: pd.DataFrame) -> None:
        self.rows = rows

    def values(self, scenario: str, variant: str, estimator: str, metric: str, quantity: str) -> np.ndarray:
        """One value per run. Raises InputError if there is none."""
        part = self.rows[(self.rows["scenario"] == scenario) & (self.rows["variant"] == variant)
                         & (self.rows["estimator"] == estimator)]
        columns = [name for name in part.columns if name.startswith(f"{metric}:{quantity}:")]
        if not columns or part.empty:
            raise InputError(f"published: {scenario}/{variant}/{estimator} has no {metric}:{quantity}")
        found = part.sort_values("run")[columns[0]].to_numpy(dtype=float)
        return found[~np.isnan(found)]

    def found(self, scenario: str, variant: str, estimator: str, metric: str, quantity: str) -> Found:
        """Mean (RMSE pooled) with its standard error."""
        values = self.values(scenario, variant, estimator, metric, quantity)
        mean, error = pooled_rmse(values) if metric == "rmse" else mean_se(values)
        return Found(mean, error, float(np.std(values, ddof=1)) if len(values) > 1 else 0.0)

    def seconds(self, scenario: str, variant: str, estimator: str) -> float:
        """Estimator seconds per run."""
        part = self.rows[(self.rows["scenario"] == scenario) & (self.rows["variant"] == variant)
                         & (self.rows["estimator"] == estimator)]
        return float(part["seconds"].mean())


def papers(names: Sequence[str] = ()) -> list[Paper]:
    """The papers asked for (none: all). Raises InputError for an unknown name or a malformed file."""
    known = sorted(path.stem for path in FOLDER.glob("*.toml"))
    for name in names:
        if name not in known:
            raise InputError(f"{name}: no such paper; there are {', '.join(known)}")
    return [read(FOLDER / f"{name}.toml") for name in (names or known)]


def read(path: Path) -> Paper:
    """A published file: items share what their cells have in common; a matrix of values becomes a cell an entry."""
    table = tomllib.loads(path.read_text(encoding="utf-8"))
    cells: list[Published] = []
    mistakes: list[str] = []
    for item in table["items"]:
        common = {key: value for key, value in item.items() if key != "cells"}
        for given in item["cells"]:
            for cell in _entries({**common, **given}):
                try:
                    cells.append(Published.model_validate(cell))
                except ValidationError as error:
                    mistakes += describe(error, f"{cell.get('item')}: {cell.get('cell')}")
    if mistakes:
        raise InputError("\n".join(f"{path.name}: {line}" for line in mistakes))
    return Paper(path.stem, table["title"], tuple(cells))


def _entries(cell: dict[str, Any]) -> Iterable[dict[str, Any]]:
    if not isinstance(cell["published"], list):
        yield cell
        return
    for i, row in enumerate(cell["published"]):
        for j, value in enumerate(row):
            yield {**cell, "cell": f"{cell['cell']}[{i + 1},{j + 1}]", "published": value,
                   "arguments": [*cell.get("arguments", []), i, j]}


def plan_for(chosen: Sequence[Paper], runs: int, seed: int) -> Plan:
    """Just the rows that the cells need."""
    needed: dict[str, dict[str, None]] = {}
    for paper in chosen:
        for cell in paper.cells:
            wanted = [(cell.scenario, cell.variant, cell.estimator)] if cell.scenario else []
            if cell.compute:
                wanted += COMPUTATIONS[cell.compute].rows(*cell.arguments)
            for scenario, variant, estimator in wanted:
                needed.setdefault(f"{scenario}/{variant}", {})[estimator] = None
    cells: list[PlanCell] = []
    for name, labels in needed.items():
        cells += make_plan([name], only=list(labels), runs=runs, seed=seed).cells
    return Plan(tuple(cells), runs, seed)


def judge(cell: Published, book: Book) -> tuple[Found | None, Verdict]:
    """Our number for a cell and the verdict."""
    if cell.compute:
        found = Found(*COMPUTATIONS[cell.compute].value(book, *cell.arguments))
    elif cell.scenario:
        found = book.found(cell.scenario, cell.variant, cell.estimator, cell.metric, cell.quantity)
        found = Found(found.value * cell.factor, found.error * cell.factor, found.spread * cell.factor)
    else:
        return None, "unreachable"
    if cell.at_most is not None:
        agrees = found.value + 2 * found.error <= cell.at_most
    else:
        published = float(cell.published)
        room = cell.relative * abs(published) + cell.absolute + 3 * found.error + 2 * found.spread * cell.single_run
        agrees = math.isfinite(found.value) and abs(found.value - published) <= room
    if agrees:
        return found, "fitted" if cell.fitted else "reproduced"
    return found, "contradicts its text" if cell.contradicts else "not reproduced"


def reproduce(chosen: Sequence[Paper], rows: pd.DataFrame) -> pd.DataFrame:
    """published.csv: columns `COLUMNS`, one line a cell."""
    book = Book(rows)
    lines = []
    for paper in chosen:
        for cell in paper.cells:
            found, verdict = judge(cell, book)
            note = " ".join(part for part in (cell.note, f"missing: {cell.missing}" if cell.missing else "") if part)
            lines.append((paper.name, cell.item, cell.cell, cell.published, found.value if found else np.nan,
                          found.error if found and found.error else np.nan, cell.unit, verdict, cell.expected, note))
    return pd.DataFrame(lines, columns=list(COLUMNS))


def counts(table: pd.DataFrame) -> pd.DataFrame:
    """How many cells of each paper stand where."""
    pivot = table.groupby(["paper", "verdict"], sort=False).size().unstack(fill_value=0)
    pivot = pivot.reindex(columns=list(VERDICTS), fill_value=0)
    return pivot.assign(cells=pivot.sum(axis=1)).reset_index()
