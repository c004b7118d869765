"""A scenario in plain sentences, from rows alone: the report's first paragraph of each setting.

Who wins, by how much, where it is a tie, who is an oracle, who breaks a promise, which runs failed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from ..judging.verdicts import Breach, Judged, broken_promises, by_run, cells, judge, judged_columns, oracle_labels
from ..scoring.columns import shown_unit
from .wording import change_range, listing, number, percent, plus_minus, some


def paragraph(rows: pd.DataFrame, manifest: Mapping[str, Any], scenario: str) -> list[str]:
    """A scenario in plain sentences: who is best in the default variant and by how much, in how many of the others,
    who is an oracle, who broke a promise, which runs failed."""
    mine = rows[rows["scenario"] == scenario]
    about = manifest["scenarios"][scenario]
    sentences: list[str] = []
    tops: dict[str, list[set[str]]] = {}
    breaches: dict[str, dict[str, list[Breach]]] = {}
    oracles: set[str] = set()
    total = 0
    for _, variant, part in cells(mine):
        known = oracle_labels(manifest, scenario, variant)
        judged = {quantity: (unit, metric, judge(by_run(part, column), metric, known))
                  for column, metric, quantity, unit in judged_columns(part, about)}
        for quantity, (_, _, found) in judged.items():
            if any(j.verdict == "best" and j.value.value == 0 for j in found.values()):
                continue
            tops.setdefault(quantity, []).append({j.estimator for j in found.values() if j.verdict in ("best", "tie")})
        if not total:
            sentences += _default_variant(variant, judged, about)
        for label, estimator_rows in part.groupby("estimator", sort=False):
            for breach in broken_promises(estimator_rows):
                breaches.setdefault(breach.kind, {}).setdefault(str(label), []).append(breach)
        oracles |= known
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


def _breach_words(kind: str, found: Mapping[str, list[Breach]], total: int) -> str:
    """`Too sure of its own errors: a and b in 5 of 8 variants (ANEES up to 10, 1 is right); c in ..`"""
    title, template = _BREACHES[kind]
    alike: dict[int, list[str]] = {}
    for label, items in sorted(found.items(), key=lambda item: -len(item[1])):
        alike.setdefault(len(items), []).append(label)
    parts = []
    for place, (times, labels) in enumerate(alike.items()):
        worst = max(breach.size for label in labels for breach in found[label])
        size = number(worst, 2) if kind in ("nees", "bound") else percent(worst)
        where = f" in {_share(times, total)}" if total > 1 else ""
        parts.append(f"{some(labels)}{where} ({template.format(size=size) if place == 0 else f'up to {size}'})")
    return f"{title}: {'; '.join(parts)}."


def _default_variant(variant: str, judged: Mapping[str, tuple[str, str, dict[str, Judged]]],
                     about: Mapping[str, Any]) -> list[str]:
    """`Variant white: a is best (position 0.11 m); the next, b, has 5 to 6 % more error, ..`, `a and b tie as best ..`;
    quantities with the same winners together."""
    groups: dict[tuple[str, ...], list[tuple[str, str, list[Judged]]]] = {}
    for quantity, (unit, metric, found) in judged.items():
        best = next((j for j in found.values() if j.verdict == "best"), None)
        if best is None or best.value.value == 0:
            continue
        winners = tuple(j.estimator for j in found.values() if j.verdict in ("best", "tie"))
        worse = sorted((j for j in found.values() if j.verdict == "worse" and j.against),
                       key=lambda j: j.against.relative if j.against else 0.0)
        shown, factor = shown_unit(about, metric, quantity, unit)
        value = f"{quantity} {plus_minus(best.value, factor)} {shown}".rstrip()
        groups.setdefault(winners, []).append((quantity, value, worse))
    out: list[str] = []
    for winners, members in groups.items():
        text = (f"{some(winners)} {'tie as' if len(winners) > 1 else 'is'} best "
                f"({', '.join(value for _, value, _ in members)})")
        unsure = {j.estimator for quantity, _, _ in members for j in judged[quantity][2].values()
                  if j.verdict == "incomplete"}
        text += f"; {some(sorted(unsure))}: too few runs to tell" if unsure else ""
        text += _follower("; the next", [(quantity, worse[0]) for quantity, _, worse in members if worse])
        text += _follower(", the last", [(quantity, worse[-1]) for quantity, _, worse in members if len(worse) > 1])
        out.append(text)
    return [f"Variant {variant}: {'. '.join(out)}." if out else f"Variant {variant}: no estimator gave a value."]


def _follower(opening: str, found: list[tuple[str, Judged]]) -> str:
    """`; the next, c (d for speed), has 5 to 6 % more error`, nothing where there is none."""
    pairs = [judged.against for _, judged in found if judged.against]
    if not pairs:
        return ""
    first = found[0][1].estimator
    others: dict[str, list[str]] = {}
    for quantity, judged in found:
        if judged.estimator != first:
            others.setdefault(judged.estimator, []).append(quantity)
    aside = "; ".join(f"{label} for {listing(quantities)}" for label, quantities in others.items())
    return f"{opening}, {first}{f' ({aside})' if aside else ''}, has {_times(change_range(pairs))} error"


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
