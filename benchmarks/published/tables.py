"""What `reproduce` writes: a line a cell and reading for published.csv, printed tables, and one nested document.

`document` is the structure that published.json holds and others draw from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd

from ..telling.wording import number
from .files import WORDS
from .reproduce import Line, Reproduced
from .verdicts import Judged

PUBLISHED_COLUMNS = ("paper", "group", "cell", "reading", "stands", "published", "printed", "ours", "standard_error",
                     "low", "high", "unit", "verdict", "expected", "why")
SHOWN = ("group", "cell", "published", "printed", "ours", "s.e.", "accepted", "unit", "verdict")


def table(done: Sequence[Reproduced]) -> pd.DataFrame:
    """published.csv: columns `PUBLISHED_COLUMNS`, a line a cell and reading; `expected` where the reading stands for
    the paper."""
    return pd.DataFrame([
        (one.paper.name, line.group, line.cell, reading, judged is line.stands, line.published, line.printed,
         *(_rounded(value) for value in judged[:4]), line.unit, _verdict(one, reading, judged),
         line.expected if judged is line.stands else "", line.why)
        for one in done for line in one.lines for reading, judged in line.entries.items()],
        columns=list(PUBLISHED_COLUMNS))


def counts(done: Sequence[Reproduced]) -> pd.DataFrame:
    """How many cells of each paper stand where, under the reading that stands for it."""
    lines = []
    for one in done:
        words = [line.stands.verdict for line in one.lines]
        lines.append({"paper": one.paper.name, **{word: words.count(word) for word in WORDS}, "cells": len(words)})
    return pd.DataFrame(lines)


def printed(one: Reproduced) -> Iterator[tuple[str, pd.DataFrame, list[str]]]:
    """(title, table, notes) of a paper: its cells under the reading that stands for it, then the matrix of readings."""
    paper = one.paper
    groups = dict.fromkeys(line.group for line in one.lines)
    notes = [f"{name}: {text}" for name, text in _notes(one).items()]
    reasons = {group: "; ".join(dict.fromkeys(
        line.why for line in one.lines if line.group == group and line.why != "-")) for group in groups}
    notes += [f"{group}, accepted: {why}." for group, why in reasons.items() if why]
    if paper.stands:
        notes.insert(0, f"Reading: {paper.readings[paper.stands].title}. {paper.why}")
    frame = pd.DataFrame([(line.group, line.cell, str(line.published), line.printed, *_words(line.stands), line.unit,
                           line.stands.verdict) for line in one.lines], columns=list(SHOWN))
    yield f"{paper.name}: {paper.authors} ({paper.year}), {paper.title}", frame, notes
    tried = [line for line in one.lines if len(line.entries) > 1]
    if tried:
        names = [name for name in paper.readings if any(name in line.entries for line in tried)]
        names.sort(key=lambda name: name != paper.stands)
        matrix = pd.DataFrame([
            {"group": line.group, "cell": line.cell, "published": str(line.published),
             **{name: _mark(line, name, paper.readings[name].counts) for name in names}} for line in tried])
        yield (f"{paper.name}: readings", matrix,
               [f"{name}{' (stands for the paper)' if name == paper.stands else ''}: {paper.readings[name].title}."
                for name in names] + ["= comes out, ~ fitted, x does not, ? undecided."])


def document(done: Sequence[Reproduced], runs: int, seed: int) -> dict[str, Any]:
    """published.json: {runs, seed, verdicts: {word: meaning}, papers: [{name, title, authors, year, reference, stands,
    why, readings: {name: title}, groups: [{group, note, cells: [{cell, published, unit, printed, why, expected,
    verdict, entries: [{reading, stands, ours, standard_error, low, high, verdict}]}]}]}]}. The first entry is the
    reading that stands for the paper; the verdict is "" under one that is not the paper's own method. Numbers that are
    none are null: an exact number's standard error, an open end of what is accepted."""
    return {"runs": runs, "seed": seed, "verdicts": dict(WORDS), "papers": [_document(one) for one in done]}


def _document(one: Reproduced) -> dict[str, Any]:
    paper, notes = one.paper, _notes(one)
    groups: dict[str, list[dict[str, Any]]] = {}
    for line in one.lines:
        groups.setdefault(line.group, []).append({
            "cell": line.cell, "published": line.published, "unit": line.unit, "printed": line.printed,
            "why": line.why, "expected": line.expected, "verdict": line.stands.verdict,
            "entries": [{"reading": name, "stands": judged is line.stands,
                         **dict(zip(("ours", "standard_error", "low", "high"), map(_plain, judged[:4]), strict=True)),
                         "verdict": _verdict(one, name, judged)} for name, judged in line.entries.items()]})
    return {"name": paper.name, "title": paper.title, "authors": paper.authors, "year": paper.year,
            "reference": paper.reference, "stands": paper.stands, "why": paper.why,
            "readings": {name: reading.title for name, reading in paper.readings.items()},
            "groups": [{"group": group, "note": notes.get(group, ""), "cells": cells}
                       for group, cells in groups.items()]}


def _verdict(one: Reproduced, reading: str, judged: Judged) -> str:
    """Nothing for a method that is not the paper's own."""
    return judged.verdict if not reading or one.paper.readings[reading].counts else ""


def _notes(one: Reproduced) -> dict[str, str]:
    """Said once per group; a trial's with the trial's name."""
    missing: dict[str, list[str]] = {}
    for cell in one.paper.cells:
        if cell.missing:
            missing.setdefault(cell.group, []).append(cell.missing)
    found: dict[str, str] = {}
    for group in dict.fromkeys(line.group for line in one.lines):
        trials = [f"{name}: {trial.note}" for name, trial in one.paper.trials.items() if trial.note]
        parts = [one.paper.notes.get(group, "") or ("" if group in one.paper.notes else " ".join(trials)),
                 *(f"Missing: {text}." for text in dict.fromkeys(missing.get(group, [])))]
        if text := " ".join(filter(None, parts)):
            found[group] = text
    return found


def _words(judged: Judged) -> tuple[str, str, str]:
    """Ours, its standard error, and the range in which a print is accepted."""
    if np.isnan(judged.value):
        return "", "", ""
    accepted = (f"≤ {number(judged.high, 4)}" if np.isneginf(judged.low) else
                f"≥ {number(judged.low, 4)}" if np.isposinf(judged.high) else
                f"{number(judged.low, 4)} .. {number(judged.high, 4)}")
    return number(judged.value, 5), "" if np.isnan(judged.error) else number(judged.error, 2), accepted


def _mark(line: Line, reading: str, counts: bool) -> str:
    judged = line.entries.get(reading)
    if judged is None:
        return ""
    sign = {"fitted": "~", "undecided": "?", "not reproduced": "x", "contradicts its text": "x", "unreachable": ""}
    value = "" if np.isnan(judged.value) else number(judged.value, 4)
    return f"{value} {sign.get(judged.verdict, '=') if counts else ''}".strip()


def _plain(value: float) -> float | None:
    return _rounded(value) if np.isfinite(value) else None


def _rounded(value: float) -> float:
    """Six significant digits: what a solver's last digits do not change."""
    return float(f"{value:.6g}")
