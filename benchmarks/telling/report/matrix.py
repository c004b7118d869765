"""The overview: settings by families. A cell stands for one entry of the family, its ratio to the best (or yardstick,
or floor) with the verdict's sign.

Which entry: of the tuned ones the one with the least error, where the family has any (the least of many entries is a
choice made on the test's own rows); else of all."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from ..estimators import Page, page
from ..marks import MARKS, Line, drawn, shade
from ..rankings import Cell, Ranking
from ..sentences import floor_name
from ..wording import ratio, ratio_of, value_of

AGAINST = ("the best", "the yardstick", "the floor")
QUANTITIES = ("first of the setting", "second")
NO_FLOOR = 1e-12


class View(NamedTuple):
    """What a cell shows in one view: classes, sign and ratio, entry, the number it sorts by (None: after all that have
    one)."""

    css: str
    text: str
    entry: str
    sort: float | None
    word: str


class Row(NamedTuple):
    """A setting: scenario, variant, its least errors by quantity (value with unit, entry), cells by family and view."""

    scenario: str
    variant: str
    id: str
    least: list[tuple[str, str]]
    cells: dict[str, list[View | None]]


class Matrix(NamedTuple):
    """Rows, families (in the order of the columns), tallies by family and view: (words, shares of the bar), what each
    of the views is against, and the yardsticks by name."""

    rows: list[Row]
    families: list[str]
    tallies: dict[str, list[tuple[str, list[tuple[str, float]]]]]
    views: list[str]
    against: list[str]


def anchor(*names: str) -> str:
    """The id of a section: lower case, other signs become `-`."""
    return "-".join("".join(letter if letter.isalnum() else "-" for letter in name.lower()) for name in names)


def matrix(cells: Sequence[Cell]) -> Matrix:
    """The overview of a folder's cells."""
    floors = any(floor_name(line) for cell in cells for line in cell.of("error"))
    against: list[str] = [*AGAINST] if floors else [*AGAINST[:2]]
    seconds = any(len(cell.rankings) > 1 for cell in cells)
    found = Counter(family for cell in cells for family in dict.fromkeys(
        cell.families.get(label, "Other") for label in _ranked(cell)))  # in the order of entries: of equals the first
    families = sorted(found, key=lambda name: -found[name])
    rows = [_row(cell, families, len(against), 2 if seconds else 1) for cell in cells if cell.rankings]
    tallies = {family: [_tally([row.cells[family][view] for row in rows]) for view in
                        range(len(against) * (2 if seconds else 1))] for family in families}
    return Matrix(rows, families, tallies, list(QUANTITIES[:2 if seconds else 1]), against)


def _ranked(cell: Cell) -> list[str]:
    return [str(line["estimator"]) for ranking in cell.rankings[:2] for line in ranking.ranked]


def _row(cell: Cell, families: Sequence[str], kinds: int, quantities: int) -> Row:
    rankings = [cell.rankings[min(i, len(cell.rankings) - 1)] for i in range(quantities)]
    least = [(f"{value_of(r.best)} {r.unit}".strip(), str(r.best["estimator"])) if r.best and r.best["runs"]
             else ("", "") for r in rankings]
    made: dict[str, list[View | None]] = {}
    for family in families:
        views: list[View | None] = []
        for kind in range(kinds):
            for i, ranking in enumerate(rankings):
                entry = chosen(cell, ranking, family) if i < len(cell.rankings) else None
                views.append(_view(cell, ranking, entry, family, kind) if entry else None)
        made[family] = views
    return Row(cell.scenario, cell.variant, anchor(cell.scenario, cell.variant), least, made)


def chosen(cell: Cell, ranking: Ranking, family: str) -> Line | None:
    """The line that stands for a family."""
    mine = [line for line in ranking.ranked if cell.families.get(line["estimator"], "Other") == family]
    tuned = [line for line in mine if cell.tuned(line["estimator"])]
    return next(iter(tuned or mine), None)


def _view(cell: Cell, ranking: Ranking, line: Line, family: str, kind: int) -> View | None:
    label = str(line["estimator"])
    others = any(drawn(other) == "lost" and other["estimator"] != label and
                 cell.families.get(other["estimator"], "Other") == family for other in ranking.ranked)
    after = " ✕" if others else ""
    if drawn(line) == "lost":
        return View("lost", f"✕ {line['lost']} of {cell.runs} lost", label, None, "lost")
    if kind == 0:
        return View(shade(line), f"{MARKS[drawn(line)].sign} {ratio_of(line)}{after}", label, float(line["ratio"]),
                    drawn(line))
    if kind == 1:
        duels = cell.of("yardstick", ranking.metric, ranking.quantity)
        reference = next((duel["against"] for duel in duels), "")
        if label == reference:
            return View("outline", f"◇ 1{after}", label, 1.0, "reference")
        duel = next((duel for duel in duels if (duel["estimator"], duel["against"]) == (label, reference)), None)
        return None if duel is None else View(shade(duel), f"{MARKS[drawn(duel)].sign} {ratio_of(duel)}{after}", label,
                             float(duel["ratio"]), drawn(duel))
    if not floor_name(line) or not line["efficiency"] > NO_FLOOR:
        return None
    over = 1 / float(line["efficiency"])
    return View(shade(line), f"{MARKS[drawn(line)].sign} {ratio(over)}{after}", label, over, drawn(line))


BARS = (("★=", "best", ("best", "tie")), ("▼", "tie", ("better",)), ("◇", "outline", ("reference",)),
        ("?", "open", ("undecided",)), ("▲", "w2", ("worse",)), ("✕", "lost", ("lost",)))


def _tally(views: Sequence[View | None]) -> tuple[str, list[tuple[str, float]]]:
    """`★= 17 ? 10`, and the shares of its bar."""
    counts = Counter(view.word for view in views if view)
    total = sum(counts.values())
    parts = [(sign, css, n) for sign, css, words in BARS if (n := sum(counts[word] for word in words))]
    return " ".join(f"{sign} {n}" for sign, _, n in parts), [(css, 100 * n / total) for _, css, n in parts]


def families_in_words(cells: Sequence[Cell], estimators: Mapping[str, Any], families: Sequence[str]) -> list[
        tuple[str, list[Page]]]:
    """Of each family a page for each plug-in."""
    plugins = {family: dict.fromkeys(entry["plugin"] for cell in cells for label, entry in cell.entries.items()
                                     if cell.families.get(label, "Other") == family) for family in families}
    return [(family, [page(name, estimators[name], cells) for name in names]) for family, names in plugins.items()]
