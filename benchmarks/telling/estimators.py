"""A page for an estimator: what its class says of itself, and what a folder's verdict table shows of it.

Nothing here is an opinion: equations, needs and claims are its docstring and attributes, the record is counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from .marks import Line, drawn
from .rankings import Cell
from .wording import counted, ratio

NAMED = 3
"""How many settings a line names."""


class Page(NamedTuple):
    """facts: (what, words). about: paragraphs of its docstring. record: sentences."""

    name: str
    summary: str
    facts: list[tuple[str, str]]
    about: list[str]
    record: list[str]


def page(name: str, said: Mapping[str, Any], cells: Sequence[Cell] = ()) -> Page:
    """said: what the estimator says of itself, as a manifest holds it."""
    facts = [("Source", str(said["source"] or "-")),
             ("Needs", ", ".join(said["needs"]) or "nothing beyond f and h"),
             ("Claims", ", ".join(("mean", *said["claims"])))]
    about = [" ".join(part.split()) for part in str(said.get("about", "")).split("\n\n") if part.strip()]
    return Page(name, str(said["summary"]), facts, about, record(name, cells))


def record(plugin: str, cells: Sequence[Cell]) -> list[str]:
    """Where it had the least error, where it was worse, lost runs or claimed too much, in the rankings of its entries:
    one for each entry and error of a setting."""
    lines: list[tuple[str, str, Line]] = []
    claims: Counter[str] = Counter()
    lost: list[str] = []
    for cell in cells:
        labels = [label for label, entry in cell.entries.items() if entry["plugin"] == plugin]
        for ranking in cell.rankings:
            lines += [(cell.key, ranking.quantity, line) for line in ranking.lines if line["estimator"] in labels]
        for label in labels:
            claim = cell.claim(label)
            claims.update([str(claim["verdict"])] if claim and claim["verdict"] else [])
            if cell.lost(label):
                lost.append(f"{cell.key} ({label}, {cell.lost(label)} of {cell.runs})")
    if not lines:
        return []
    words = Counter(drawn(line) for _, _, line in lines)
    good = [f"{key} {quantity} ({line['estimator']})" for key, quantity, line in lines
            if drawn(line) in ("best", "tie")]
    found = [f"Least error, or tied with it, in {len(good)} of {counted(len(lines), 'ranking')}"
             f"{': ' if good else ''}{_some(good)}."]
    bad = [(float(line["ratio"]), key, quantity, line) for key, quantity, line in lines
           if drawn(line) == "worse" and line["ratio"] < float("inf")]
    if words["worse"]:
        most = ""
        if bad:
            value, key, quantity, line = max(bad, key=lambda item: item[0])
            most = f", at the most {ratio(value)} times the least error: {key} {quantity} ({line['estimator']})"
        found.append(f"Shown to be worse in {words['worse']}{most}.")
    if words["undecided"]:
        found.append(f"Undecided in {words['undecided']}.")
    if lost:
        found.append(f"Lost runs in {_some(lost)}.")
    if claims:
        told = ", ".join(f"{word} in {n}" for word, n in claims.most_common())
        found.append(f"Its claim, by entry and setting: {told}.")
    return found


def _some(names: Sequence[str]) -> str:
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more
