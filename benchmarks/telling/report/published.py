"""Published numbers on the page: counts by paper, and cells by readings, a table a paper, notes numbered once under it.

Drawn from published.json as `railstate reproduce` writes it; verdicts are its own."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any, NamedTuple

from markupsafe import Markup

from ....scenarios.errors import InputError
from ..marks import MARKS
from ..wording import number, split_error
from .sections import Entry, Table, chip

Z = 1.96
WORDS = {"reproduced": "reproduced", "corrected": "corrected",
         "follows from its own table": "following from their own tables", "fitted": "fitted",
         "undecided": "undecided", "not reproduced": "not reproduced",
         "contradicts its text": "contradicting their text", "unreachable": "unreachable"}
"""Verdicts in the order of the key, and what many of them are called."""


class Paper(NamedTuple):
    """A paper: its name, what it is, its verdicts counted in the order of the key, its table."""

    name: str
    title: str
    counts: list[tuple[str, int]]
    table: Table


def papers(document: Mapping[str, Any]) -> list[Paper]:
    """The papers of a published.json. Raises InputError where it is none."""
    try:
        return [_paper(paper) for paper in document["papers"]]
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise InputError(f"published numbers: not as railstate reproduce writes them into published.json: "
                         f"{type(error).__name__}: {error}") from None


def sentence(found: list[Paper]) -> str:
    """`Of 106 published numbers 24 are reproduced, 45 fitted, ..`, under the reading that stands for each paper."""
    total: Counter[str] = Counter()
    for paper in found:
        total.update(dict(paper.counts))
    parts = [f"{total[said]} {said}" for said in WORDS.values() if total[said]]
    return f"Of {sum(total.values())} published numbers: {', '.join(parts)}." if parts else ""


def _paper(paper: Mapping[str, Any]) -> Paper:
    cells = [(group, cell) for group in paper["groups"] for cell in group["cells"]]
    counts = Counter(cell["verdict"] for _, cell in cells)
    readings = list(dict.fromkeys(entry["reading"] for _, cell in cells for entry in cell["entries"]
                                  if not entry["stands"]))
    notes: dict[str, int] = {}
    lines = []
    for group, cell in cells:
        stands = next((entry for entry in cell["entries"] if entry["stands"]), None)
        others = {entry["reading"]: entry for entry in cell["entries"] if not entry["stands"]}
        if group["note"]:
            notes.setdefault(group["note"], len(notes) + 1)
        word = cell["verdict"]
        lines.append((f"{group['group']}: {cell['cell']}", [
            Entry(str(cell["published"]), str(cell["published"]), True), _value(stands), Entry(str(cell["unit"])),
            Entry(chip(word, word) if word in MARKS else word, word),
            Entry(Markup("<sup>{}</sup>").format(notes[group["note"]]) if group["note"] else ""),
            *(_other(others.get(reading)) for reading in readings)]))
    titles = [f"{name}: {paper['readings'][name]}." for name in [paper["stands"], *readings]
              if name in paper["readings"]]
    table = Table(
        [("published", "published", True), ("here", "here|low|high", True), ("unit", "unit", False),
         ("verdict", "verdict", False), ("note", "note", False), *((name, name, True) for name in readings)], lines,
        "Here: under the reading that stands for the paper, ± half of the 95 % interval"
        + ("; further readings to the right." if readings else "."),
        [*titles, *(f"{place}: {note}" for note, place in notes.items())])
    return Paper(paper["name"], f"{paper['authors']} ({paper['year']}): {paper['title']}. {paper['reference']}.",
                 [(said, counts[word]) for word, said in WORDS.items() if counts[word]], table)


def _value(entry: Mapping[str, Any] | None) -> Entry:
    if entry is None or entry["ours"] is None:
        return Entry("", "", True)
    half = Z * entry["standard_error"] if entry["standard_error"] is not None else float("nan")
    value, text = split_error(entry["ours"], half)
    limits = "|".join("" if half != half else f"{entry['ours'] + sign * half:.6g}" for sign in (-1, 1))
    return Entry(f"{value} ± {text}" if text else number(entry["ours"], 4), f"{entry['ours']:.6g}|{limits}", True)


def _other(entry: Mapping[str, Any] | None) -> Entry:
    """A further reading: its number with the verdict's sign."""
    if entry is None or entry["ours"] is None:
        return Entry("", "", True)
    word, said = entry["verdict"], number(entry["ours"], 4)
    return Entry(chip(word, said) if word in MARKS and word else said, f"{entry['ours']:.6g}", True)
