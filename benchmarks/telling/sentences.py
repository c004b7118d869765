"""Findings in words, by templates without adjectives; every number in them is one of the verdict table.

A: counts over a folder. B: a scenario, over its variants. C: a quantity of one variant, in full and short."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from ..judging.comparison import Comparison
from ..judging.floors import UNDER_NOTE
from .marks import Line, drawn
from .rankings import Cell, Ranking
from .wording import (
    bracket,
    capital,
    change,
    change_interval,
    counted,
    deciding,
    metric_name,
    number,
    percent,
    plus_minus,
    ratio,
    ratio_interval,
    some,
    value_of,
)


def names(lines: Sequence[Line]) -> list[str]:
    return [str(line["estimator"]) for line in lines]


def counts(cells: Sequence[Cell]) -> dict[str, int]:
    """Over all cells: comparisons with the best by verdict, runs, lost runs, covariance claims by verdict."""
    out: Counter[str] = Counter()
    for cell in cells:
        for ranking in cell.rankings:
            out.update(drawn(line) for line in ranking.ranked if drawn(line) != "best")
        out.update(f"claim {line['verdict']}" for line in cell.of("consistency", "nees"))
        for line in cell.of("reliability", "lost"):
            out["rows"] += int(line["runs"])
            out["lost runs"] += int(line["lost"])
    return out


def over_all(cells: Sequence[Cell], runs: int) -> list[str]:
    """Template A."""
    n = counts(cells)
    compared = sum(n[word] for word in ("worse", "tie", "undecided", "lost", "better"))
    first = (f"At {counted(runs, 'run')}, of {counted(compared, 'comparison')} with the best of their setting "
             f"{n['worse']} {'is' if n['worse'] == 1 else 'are'} worse, {n['tie']} "
             f"{'ties' if n['tie'] == 1 else 'tie'} within 1 % and {n['undecided']} "
             f"{'is' if n['undecided'] == 1 else 'are'} undecided"
             + (f"; {n['lost']} lost runs" if n["lost"] else "") + ".")
    second = f"Lost runs: {n['lost runs']:,} of {n['rows']:,}."
    claims = {word: n[f"claim {word}"] for word in ("too sure", "too cautious", "consistent", "undecided",
                                                    "not certified")}
    if sum(claims.values()):
        second += (f" Of {counted(sum(claims.values()), 'covariance claim')} {claims['too sure']} "
                   f"{'is' if claims['too sure'] == 1 else 'are'} too sure, "
                   f"{claims['too cautious']} too unsure, {claims['consistent']} consistent, {claims['undecided']} "
                   f"undecided{f', {loose} not certified' if (loose := claims['not certified']) else ''}.")
    return [first, second]


def over_variants(cells: Sequence[Cell]) -> list[str]:
    """Template B, a line a quantity; nothing of a scenario with one variant."""
    out = []
    quantities = dict.fromkeys(ranking.quantity for cell in cells for ranking in cell.rankings)
    for quantity in quantities if len(cells) > 1 else ():
        found = [ranking for cell in cells for ranking in cell.rankings if ranking.quantity == quantity]
        tops = Counter(name for ranking in found for name in names([*ranking.drawn("best"), *ranking.drawn("tie")]))
        by_count: dict[int, list[str]] = {}
        for name, times in tops.items():
            by_count.setdefault(times, []).append(name)
        parts = [f"in {times}: {some(by_count[times])}" for times in sorted(by_count, reverse=True)]
        always = [name for name in dict.fromkeys(name for ranking in found for name in names(ranking.ranked))
                  if all(name in names(ranking.drawn("worse")) for ranking in found)]
        out.append(f"{capital(quantity)}, {counted(len(found), 'variant')}. Best or tied {'; '.join(parts[:3])}. "
                   f"Worse in every variant: {some(always) or 'none'}.")
    return out


def finding(cell: Cell, ranking: Ranking) -> str:
    """Template C: who has the least error and how far the others are, of one quantity of a variant."""
    best = ranking.best
    head = capital(ranking.quantity)
    if best is None or not best["runs"]:
        return f"{head}: no entry finished a run."
    parts = [f"{head}: least {metric_name(ranking.metric)} {_with_unit(plus_minus(best), ranking.unit)} "
             f"({best['estimator']}, {counted(int(best['runs']), 'run')})."]
    ties, open_, worse, lost = (ranking.drawn(word) for word in ("tie", "undecided", "worse", "lost"))
    if ties:
        parts.append(f"Tied, within 1 %: {some(names(ties))}.")
    if open_:
        shown = [f"{line['estimator']} ({change_interval(line)}" + (f"; about {found} would decide)" if (
            found := deciding(line)) else ")") for line in open_[:2]]
        rest = names(open_[2:])
        parts.append(f"Undecided: {', '.join(shown)}{', ' + some(rest) if rest else ''}.")
    if worse and best["value"] == 0:
        parts.append(f"Worse: {len(worse)} of {len(ranking.ranked)}, than no error at all: {some(names(worse))}.")
    elif worse:
        ends = [f"{line['estimator']} ({change_interval(line)})" for line in (worse[0], worse[-1])]
        parts.append(f"Worse: {len(worse)} of {len(ranking.ranked)}, "
                     + (f"from {ends[0]} to {ends[1]}." if len(worse) > 1 else f"{ends[0]}."))
    if lost:
        parts.append(f"Lost runs: {_lost(cell, lost)}; ranked after every entry that finished.")
    return " ".join([*parts, *_floor(ranking), *_smoothed(ranking)])


def short_finding(cell: Cell, ranking: Ranking) -> str:
    """Template C for the terminal."""
    best = ranking.best
    head = capital(ranking.quantity)
    if best is None or not best["runs"]:
        return f"{head}: no entry finished a run."
    ties, open_, worse, lost = (ranking.drawn(word) for word in ("tie", "undecided", "worse", "lost"))
    parts = [f"best {best['estimator']}"]
    if ties:
        parts.append(f"tie {some(names(ties))}")
    if open_:
        first = f"{open_[0]['estimator']} ({', '.join(filter(None, [change(open_[0]), deciding(open_[0])]))})"
        parts.append("undecided " + ", ".join([first, *filter(None, [some(names(open_[1:]))])]))
    if worse and best["value"] == 0:
        parts.append(f"worse {len(worse)} of {len(ranking.ranked)}, than no error at all: {some(names(worse))}")
    elif worse:
        ends = [f"{line['estimator']} {change(line)}" for line in (worse[0], worse[-1])]
        parts.append(f"worse {len(worse)} of {len(ranking.ranked)}, " + " to ".join(ends if len(worse) > 1
                                                                                    else ends[:1]))
    if lost:
        parts.append(f"lost {_lost(cell, lost)}")
    if kind := floor_name(best):
        parts.append(f"{kind} {_with_unit(number(best['floor'] * best['factor']), ranking.unit)}, best at "
                     f"{percent(best['efficiency'])} of it")
    if ranking.smoothed:
        parts.append(f"of the smoothers {ranking.smoothed['estimator']}")
    return f"{head}: {'; '.join(parts)}."


def claims_of(cell: Cell) -> str:
    """What became of the covariances, sets and bounds that a variant's entries claim."""
    nees = cell.of("consistency", "nees")
    sure = sorted((line for line in nees if line["verdict"] == "too sure"), key=lambda line: -line["value"])
    parts = []
    if sure:
        parts.append(f"Claims: too sure {len(sure)} of {len(nees)}, most {sure[0]['estimator']} "
                     f"(ANEES {number(sure[0]['value'])}; 1 is right).")
    unsure = names([line for line in nees if line["verdict"] == "too cautious"])
    if unsure:
        parts.append(f"Too unsure: {some(unsure)}.")
    loose = [line for line in (*nees, *cell.of("claim")) if line["verdict"] == "not certified"]
    if loose:
        parts.append(f"Claims are not certified here: {loose[0]['note'].partition(';')[0]}; beside them stands the "
                     "measured mean square over the claim.")
    for line in cell.of("claim", "coverage"):
        if line["verdict"] == "broken":
            parts.append(f"{line['estimator']} {line['note'].replace('left in', 'left its set in')}.")
    for line in cell.of("claim", "bound"):
        if line["verdict"] == "broken":
            parts.append(f"{line['estimator']} exceeds its certified bound: {ratio(line['ratio'], True)} times "
                         f"{ratio_interval(line)}.")
    return " ".join(parts)


def required(cells: Sequence[Cell]) -> str:
    """Over all cells: how many entries meet what is required of them."""
    found = Counter(line["verdict"] for cell in cells for line in cell.of("requirement"))
    names = dict.fromkeys(name for cell in cells for name in cell.requirements)
    return (f"Requirements ({some(list(names))}), each of an entry in a setting: {found['met']} met, "
            f"{found['not met']} not met, {found['undecided']} undecided.")


def requirements_of(cell: Cell) -> list[str]:
    """Which requirement who keeps, a sentence each."""
    out = []
    for name, lines in cell.requirements.items():
        what = f"in {100 * float(lines[0]['against']):g} % of the {'runs' if lines[0]['metric'] == 'kept' else 'time'}"
        parts = [f"{word}{' for' if word == 'undecided' else ' by'} {some(found)}" for word in (
            "met", "not met", "undecided")
                 if (found := names([line for line in lines if line["verdict"] == word]))]
        out.append(f"Requirement {name}, {what}: {'; '.join(parts)}.")
    return out


def caption(cell: Cell) -> str:
    """What the signs of a table mean, of which family and over which runs."""
    family = max((int(line["family"]) for line in cell.of("error")), default=0)
    parts = ["± and [ ] are 95 %: ± of the entry alone, [ ] of the ratio to the best over the same runs, simultaneous "
             f"over all pairs of the {family} entries; the verdict follows [ ]. {counted(cell.runs, 'run')}."
             if family > 1 else f"± is half of the 95 % interval. {counted(cell.runs, 'run')}."]
    notes = " ".join(line["note"] for line in cell.of("error"))
    if any(line["lost"] for line in cell.of("error")):
        parts.append("Values are over finished runs; in verdicts a lost run has the largest error of its cell.")
    parts += [f"{note[0].upper()}{note[1:]}." for note in (
        "under 20 runs there is no verdict", "events rarer than 3/n of the runs may not have been seen")
        if note in notes]
    return " ".join(parts)


def comparison(found: Comparison, a: str, b: str) -> str:
    """B against A in one line."""
    where = f"{found.cell}{'/' + found.label if found.label else ''}"
    line = found.b
    if found.lost:
        chance = ", which may be chance" if found.verdict == "tie" else ""
        return (f"{where}: {b} ends well in {percent(1 - line['value'])} of the runs, {a} in "
                f"{percent(1 - found.a['value'])}{chance} ({counted(int(line['runs']), 'run')})")
    subject = f"{where}: {line['quantity']} {line['metric']}"
    note = f"; {line['note']}" if line["note"] else ""
    if found.verdict in ("better", "worse"):
        return (f"{subject}: {b} is {found.verdict} than {a}, {change_interval(line)}, with the lower error in "
                f"{percent(line['won'])} of the runs{note}")
    if found.verdict == "tie":
        return f"{subject}: a tie within 1 %, {b} {change_interval(line)} against {a}{note}"
    runs = f"; about {found_runs} would decide" if (found_runs := deciding(line)) else ""
    return f"{subject}: undecided, {b} {change_interval(line)} against {a}{runs}{note}"


def _with_unit(text: str, unit: str) -> str:
    return f"{text} {unit}".rstrip()


def _lost(cell: Cell, lines: Sequence[Line]) -> str:
    said = [f"{line['estimator']} {cell.lost(line['estimator'])} of {cell.runs}" for line in lines]
    return some(said)


def floor_name(line: Line) -> str:
    """What the floor of a line is: `floor`, `linear optimum`; empty where there is none."""
    value = line.get("floor", float("nan"))
    return str(line.get("floor_kind") or "floor") if value == value else ""


def _floor(ranking: Ranking) -> list[str]:
    """How near the best comes to the floor of the setting, where there is one."""
    best = ranking.best
    kind = floor_name(best) if best else ""
    if best is None or not kind:
        return []
    above = best["efficiency"] > 1 and kind.startswith("floor")
    aside = (": under it, to be explained" if UNDER_NOTE in best["note"] else " (over 100 % by chance)" if above else
             " (its interval covers it)" if best["low"] <= best["floor"] <= best["high"] else "")
    return [f"{capital(kind)} {_with_unit(number(best['floor'] * best['factor']), ranking.unit)}: {best['estimator']} "
            f"reaches {percent(best['efficiency'])}{aside}."]


def _smoothed(ranking: Ranking) -> list[str]:
    """The least error of the smoothers, who answer another question."""
    line = ranking.smoothed
    return [] if line is None else [f"Smoothers, ranked among themselves: least "
                                    f"{_with_unit(plus_minus(line), ranking.unit)} ({line['estimator']})."]


def title_of(ranking: Ranking) -> str:
    """`RMSE position [m]`."""
    return bracket(ranking.name, ranking.unit)


def least(ranking: Ranking) -> str:
    """`RMSE of position: ekf has the least, 0.112 m`, what a figure shows."""
    best = ranking.best
    if best is None or not best["runs"]:
        return f"{metric_name(ranking.metric)} of {ranking.quantity}: no entry finished a run."
    return (f"{metric_name(ranking.metric)} of {ranking.quantity}: {best['estimator']} has the least, "
            f"{_with_unit(value_of(best), ranking.unit)}.")
