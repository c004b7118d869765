"""Published numbers beside ours: which rows they need, and each cell under each reading of its paper with a verdict.

What is printed is data (a TOML a paper), what is computed lies in `computed/`, what judges in `verdicts`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from ..planning.plan import Cell as PlanCell
from ..planning.plan import Plan, make_plan
from .computed import COMPUTATIONS
from .files import Paper, Published, Word
from .rows import Book, Found
from .verdicts import NOTHING, Judged, judge, together

TOGETHER = "Numbers of one run together"


@dataclass(frozen=True)
class Line:
    """A printed number and what became of it under each reading; the first is the one that stands for the paper ("":
    the number hangs on no reading). printed: of one run, of a mean; why: the reason of the tolerance."""

    group: str
    cell: str
    published: float | str
    unit: str
    printed: str
    why: str
    expected: Word
    entries: dict[str, Judged]

    @property
    def stands(self) -> Judged:
        return next(iter(self.entries.values()))

    @property
    def unexpected(self) -> bool:
        """Another verdict than the file expects, and no want of runs."""
        return self.stands.verdict not in (self.expected, "undecided")


@dataclass(frozen=True)
class Reproduced:
    """A paper and its numbers, in the order of its file."""

    paper: Paper
    lines: tuple[Line, ...]


def plan_for(chosen: Sequence[Paper], runs: int, seed: int) -> Plan:
    """Just the rows that the cells need."""
    needed: dict[str, dict[str, None]] = {}
    for paper in chosen:
        for cell in paper.cells:
            for reading in paper.readings_of(cell):
                for scenario, variant, estimator in _rows(paper.under(cell, reading)):
                    needed.setdefault(f"{scenario}/{variant}", {})[estimator] = None
    cells: list[PlanCell] = []
    for name, labels in needed.items():
        cells += make_plan([name], only=list(labels), runs=runs, seed=seed).cells
    return Plan(tuple(cells), runs, seed)


def _rows(cell: Published) -> list[tuple[str, str, str]]:
    if cell.compute:
        return COMPUTATIONS[cell.compute].rows(*cell.arguments)
    return [(cell.scenario, cell.variant, cell.estimator)] if cell.scenario else []


def find(cell: Published, book: Book) -> Found | None:
    """Our number for a cell whose names are filled in; None where it is unreachable."""
    if cell.compute:
        return COMPUTATIONS[cell.compute].value(book, *cell.arguments)
    if cell.scenario:
        return book.found(cell.scenario, cell.variant, cell.estimator, cell.metric, cell.quantity).times(cell.factor)
    return None


def reproduce(chosen: Sequence[Paper], rows: pd.DataFrame) -> list[Reproduced]:
    """Every cell of the papers under every reading that it is tried under."""
    book = Book(rows)
    return [_paper(paper, book) for paper in chosen]


def _paper(paper: Paper, book: Book) -> Reproduced:
    lines: list[Line] = []
    trials: dict[str, list[tuple[Published, dict[str, Found | None]]]] = {name: [] for name in paper.trials}
    for cell in paper.cells:
        found = {name: find(paper.under(cell, name), book) for name in paper.readings_of(cell)}
        printed = "one run" if cell.trials == 1 else f"mean of {cell.trials}" if cell.trials else ""
        entries = {name: judge(paper.under(cell, name), one) if one else NOTHING for name, one in found.items()}
        lines.append(Line(cell.group, cell.cell, cell.published, cell.unit, printed, cell.why, cell.expected, entries))
        if cell.trial:
            trials[cell.trial].append((cell, found))
    for name, members in trials.items():
        trial = paper.trials[name]
        judged: dict[str, Judged] = {}
        for reading in dict.fromkeys(one for _, found in members for one in found):
            cells = [paper.under(cell, reading) for cell, _ in members]
            one = together(trial, cells, [found.get(reading, next(iter(found.values()))) for _, found in members])
            if one:
                judged[reading] = one
        lines.append(Line(TOGETHER, name, "p ≥ 0.05", "1", "one run",
                          "share of our runs, rounded as printed, that lie as far out", trial.expected,
                          judged or {paper.stands: NOTHING}))
    return Reproduced(paper, tuple(lines))
