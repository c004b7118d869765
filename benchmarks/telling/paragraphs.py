"""A scenario in plain sentences, from its verdicts alone: the report's first paragraph of each setting.

Who wins, by how much, where it is a tie, who is an oracle, who breaks a promise, which runs failed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import pandas as pd

from .sayings import Line, drawn, records
from .wording import change_range, listing, number, percent, plus_minus, some


def paragraph(table: pd.DataFrame, scenario: str) -> list[str]:
    """A scenario in plain sentences: who is best in the default variant and by how much, in how many of the others,
    who is an oracle, who broke a promise, which runs failed. table: the verdict table."""
    sentences: list[str] = []
    tops: dict[str, list[set[str]]] = {}
    breaches: dict[str, dict[str, list[float]]] = {}
    oracles: set[str] = set()
    total = 0
    for variant, part in table[table["scenario"] == scenario].groupby("variant", sort=False):
        judged: dict[str, list[dict[str, Any]]] = {}
        for line in records(part, "error"):
            judged.setdefault(line["quantity"], []).append(line)
        for quantity, lines in judged.items():
            if not any(line["verdict"] == "best" and line["value"] == 0 for line in lines):
                tops.setdefault(quantity, []).append({line["estimator"] for line in lines
                                                      if drawn(line) in ("best", "tie")})
            oracles |= {line["estimator"] for line in lines if line["verdict"] == "oracle"}
        if not total:
            sentences += _default_variant(str(variant), judged)
        for line in records(part, "consistency", "claim", "reliability"):
            for kind, size in _breaches(line):
                breaches.setdefault(kind, {}).setdefault(line["estimator"], []).append(size)
        total += 1
    if total > 1:
        sentences += _over_variants(tops)
    if oracles:
        sentences.append(f"{listing(sorted(oracles))}: not ranked, since told what the others must estimate.")
    sentences += [_breach_words(kind, found, total) for kind in _BREACHES if (found := breaches.get(kind))]
    if not breaches:
        sentences.append("Nobody broke a promise, and no run failed.")
    return sentences


_BREACHES = {
    "nees": ("Too sure of its own errors", "ANEES up to {size}, 1 is right"),
    "set": ("Promises a set that always holds the truth, and leaves it", "in up to {size} of the runs"),
    "bound": ("Exceeds its certified bound", "by up to {size} times"),
    "status": ("Has runs that diverged, failed or could not be designed", "up to {size} of the runs"),
}


def _breaches(line: Line) -> Iterator[tuple[str, float]]:
    """(kind, how bad it is) of a line that says that something was not kept."""
    if line["kind"] == "reliability":
        if line["metric"] == "lost" and line["lost"]:
            yield "status", line["value"]
    elif line["verdict"] == "too sure" and line["metric"] == "nees":
        yield "nees", line["value"]
    elif line["verdict"] == "broken":
        if line["metric"] == "bound":
            yield "bound", line["ratio"]
        else:
            yield "set", int(line["note"].split()[2]) / line["runs"]


def _breach_words(kind: str, found: Mapping[str, list[float]], total: int) -> str:
    """`Too sure of its own errors: a and b in 5 of 8 variants (ANEES up to 10, 1 is right); c in ..`"""
    title, template = _BREACHES[kind]
    alike: dict[int, list[str]] = {}
    for label, items in sorted(found.items(), key=lambda item: -len(item[1])):
        alike.setdefault(len(items), []).append(label)
    parts = []
    for place, (times, labels) in enumerate(alike.items()):
        worst = max(size for label in labels for size in found[label])
        size = number(worst, 2) if kind in ("nees", "bound") else percent(worst)
        where = f" in {_share(times, total)}" if total > 1 else ""
        parts.append(f"{some(labels)}{where} ({template.format(size=size) if place == 0 else f'up to {size}'})")
    return f"{title}: {'; '.join(parts)}."


def _default_variant(variant: str, judged: Mapping[str, list[dict[str, Any]]]) -> list[str]:
    """`Variant white: a is best (position 0.11 m); undecided: c; the least worse, b, has 5 to 6 % more error, ..`,
    `a and b tie as best ..`; quantities with the same winners together."""
    groups: dict[tuple[str, ...], list[tuple[str, Line, list[Line]]]] = {}
    for quantity, lines in judged.items():
        best = next((line for line in lines if line["verdict"] == "best"), None)
        if best is None or best["value"] == 0:
            continue
        winners = tuple(line["estimator"] for line in lines if drawn(line) in ("best", "tie"))
        worse = sorted((line for line in lines if drawn(line) == "worse"), key=lambda line: line["ratio"])
        groups.setdefault(winners, []).append((quantity, best, list(worse)))
    out: list[str] = []
    for winners, members in groups.items():
        values = [f"{quantity} {plus_minus(line)} {line['shown_unit']}".rstrip() for quantity, line, _ in members]
        text = f"{some(winners)} {'tie as' if len(winners) > 1 else 'is'} best ({', '.join(values)})"
        for word, said in (("undecided", "undecided"), ("lost", "lost more runs than equals would")):
            names = {line["estimator"] for quantity, _, _ in members for line in judged[quantity]
                     if drawn(line) == word}
            text += f"; {said}: {some(sorted(names))}" if names else ""
        text += _follower("; the least worse", [(quantity, worse[0]) for quantity, _, worse in members if worse])
        text += _follower(", the last", [(quantity, worse[-1]) for quantity, _, worse in members if len(worse) > 1])
        out.append(text)
    return [f"Variant {variant}: {'. '.join(out)}." if out else f"Variant {variant}: no estimator gave a value."]


def _follower(opening: str, found: list[tuple[str, Line]]) -> str:
    """`; the least worse, c (d for speed), has 5 to 6 % more error`, nothing where there is none."""
    if not found:
        return ""
    first = found[0][1]["estimator"]
    others: dict[str, list[str]] = {}
    for quantity, line in found:
        if line["estimator"] != first:
            others.setdefault(line["estimator"], []).append(quantity)
    aside = "; ".join(f"{label} for {listing(quantities)}" for label, quantities in others.items())
    size = _times(change_range([line["ratio"] for _, line in found]))
    return f"{opening}, {first}{f' ({aside})' if aside else ''}, has {size} error"


def _share(times: int, total: int) -> str:
    if times < total:
        return f"{times} of {total} variants"
    return "both variants" if total == 2 else f"all {total} variants"


def _times(words: str) -> str:
    return f"{words} the" if words.endswith("times") else words.replace("+", "") + " more"


def _over_variants(tops: Mapping[str, list[set[str]]]) -> list[str]:
    """In how many variants the most frequent winners are best or tied, quantities with the same answer together."""
    answers: dict[tuple[tuple[str, ...], int, int], list[str]] = {}
    for quantity, lists in tops.items():
        names = [name for winners in lists for name in winners]
        if names:
            most = max(names.count(name) for name in names)
            leaders = tuple(sorted({name for name in names if names.count(name) == most}))
            answers.setdefault((leaders, most, len(lists)), []).append(quantity)
    return [f"{some(leaders)} {'are' if len(leaders) > 1 else 'is'} best or tied for {listing(quantities)} in "
            + _share(most, total) + ("." if most == total else ", more often than any other.")
            for (leaders, most, total), quantities in answers.items()]
