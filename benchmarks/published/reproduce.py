"""Published numbers beside ours, each with a verdict. The numbers are data: one TOML file a paper.

A verdict is computed, compared with the expected one, and never better than the evidence: `fitted` is not
`reproduced`."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pandas as pd
from pydantic import ValidationError, field_validator

from ...scenarios.errors import InputError, describe
from ...scenarios.schema import Strict
from ..planning.plan import Cell as PlanCell
from ..planning.plan import Plan, make_plan
from .rows import Book, Found
from .values import COMPUTATIONS

Reproduction = Literal["reproduced", "fitted", "not reproduced", "contradicts its text", "unreachable"]
VERDICTS: tuple[Reproduction, ...] = ("reproduced", "fitted", "not reproduced", "contradicts its text", "unreachable")
PUBLISHED_COLUMNS = ("paper", "item", "cell", "published", "ours", "standard_error", "unit", "verdict", "expected",
                     "note")
UNDECIDED = "Too few runs to decide."
FOLDER = Path(__file__).parent


class Published(Strict):
    """One published cell, and what of ours stands beside it.

    Either scenario, variant, estimator, metric, quantity (a summary of rows, times `factor`), or `compute` with its
    arguments (a function of `values.py`), or neither: `unreachable`, and `missing` says what is missing.
    It agrees within relative * |published| + absolute + 3 standard errors, plus 2 standard deviations of a mean of as
    many runs as the paper has `trials` (0: no allowance). at_most: a claim that the number is below this, by 2 standard
    errors.
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
    trials: int = 0
    at_most: float | None = None
    fitted: bool = False
    contradicts: bool = False
    missing: str = ""
    expected: Reproduction
    note: str = ""


class _File(Strict):
    """The file itself: items, each with `cells` that take over what the item says of all of them."""

    title: str
    items: list[dict[str, Any]]

    @field_validator("items")
    @classmethod
    def _have_cells(cls, items: list[dict[str, Any]]) -> list[dict[str, Any]]:
        for item in items:
            cells = item.get("cells")
            if not isinstance(cells, list) or not all(isinstance(cell, dict) for cell in cells):
                raise ValueError(f"item \"{item.get('item')}\" needs cells = [{{ cell = .. }}, ..]")
        return items


@dataclass(frozen=True)
class Paper:
    """A file of `published/`."""

    name: str
    title: str
    cells: tuple[Published, ...]


def papers(names: Sequence[str] = ()) -> list[Paper]:
    """The papers asked for (none: all). Raises InputError for an unknown name or a malformed file."""
    known = sorted(path.stem for path in FOLDER.glob("*.toml"))
    for name in names:
        if name not in known:
            raise InputError(f"{name}: no such paper; there are {', '.join(known)}")
    return [read(FOLDER / f"{name}.toml") for name in (names or known)]


def read(path: Path) -> Paper:
    """A published file: items share what their cells have in common; a matrix of values becomes a cell an entry."""
    try:
        book = _File.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path.name}: not valid TOML: {error}") from None
    except ValidationError as error:
        raise InputError("\n".join(f"{path.name}: {line}" for line in describe(error, _File))) from None
    cells: list[Published] = []
    mistakes: list[str] = []
    for item in book.items:
        common = {key: value for key, value in item.items() if key != "cells"}
        for given in item["cells"]:
            for cell in _entries({**common, **given}):
                try:
                    cells.append(Published.model_validate(cell))
                except ValidationError as error:
                    mistakes += describe(error, Published, f"{cell.get('item')}: {cell.get('cell')}")
    if mistakes:
        raise InputError("\n".join(f"{path.name}: {line}" for line in mistakes))
    return Paper(path.stem, book.title, tuple(cells))


def _entries(cell: dict[str, Any]) -> Iterable[dict[str, Any]]:
    if not isinstance(cell.get("published"), list):
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


class Reproduced(NamedTuple):
    """Our number for a cell, the verdict, and whether the runs were enough to tell it from the other one."""

    found: Found | None
    verdict: Reproduction
    decided: bool


def reproduce_cell(cell: Published, book: Book) -> Reproduced:
    """Our number for a cell and the verdict; too few runs leave it undecided."""
    if cell.compute:
        found = COMPUTATIONS[cell.compute].value(book, *cell.arguments)
    elif cell.scenario:
        found = book.found(cell.scenario, cell.variant, cell.estimator, cell.metric, cell.quantity)
        found = Found(found.value * cell.factor, found.error * cell.factor, found.spread * cell.factor)
    else:
        return Reproduced(None, "unreachable", True)
    if cell.at_most is not None:
        distance, room, error = found.value, cell.at_most, 2 * found.error
        agrees = distance + error <= room
    else:
        published = float(cell.published)
        distance, error = abs(found.value - published), 3 * found.error
        room = (cell.relative * abs(published) + cell.absolute
                + (2 * found.spread / cell.trials**0.5 if cell.trials else 0.0))
        agrees = distance <= room + error
    decided = not abs(distance - room) < error
    if agrees:
        return Reproduced(found, "fitted" if cell.fitted else "reproduced", decided)
    return Reproduced(found, "contradicts its text" if cell.contradicts else "not reproduced", decided)


def reproduce(chosen: Sequence[Paper], rows: pd.DataFrame) -> pd.DataFrame:
    """published.csv: columns `COLUMNS`, one line a cell; a verdict that the runs do not decide says so in the note."""
    book = Book(rows)
    lines = []
    for paper in chosen:
        for cell in paper.cells:
            found, verdict, decided = reproduce_cell(cell, book)
            note = " ".join(part for part in (cell.note, f"missing: {cell.missing}" if cell.missing else "",
                                              "" if decided else UNDECIDED) if part)
            lines.append((paper.name, cell.item, cell.cell, cell.published, found.value if found else np.nan,
                          found.error if found and found.error else np.nan, cell.unit, verdict, cell.expected, note))
    return pd.DataFrame(lines, columns=list(PUBLISHED_COLUMNS))


def counts(table: pd.DataFrame) -> pd.DataFrame:
    """How many cells of each paper stand where."""
    pivot = table.groupby(["paper", "verdict"], sort=False).size().unstack(fill_value=0)
    pivot = pivot.reindex(columns=list(VERDICTS), fill_value=0)
    return pivot.assign(cells=pivot.sum(axis=1)).reset_index()
