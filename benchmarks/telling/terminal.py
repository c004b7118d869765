"""The verdict table of a cell on a terminal: entries by rows, per quantity sign, value, half interval and ratio.

At 80 columns two quantities a table, more beneath it; wider outputs add the interval of the ratio, the step, and how
near an entry comes to the floor."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from .console import WIDE, Column, Piece, columns, plain, print_columns, say, wrapped
from .marks import MARKS, Line, drawn, mark
from .rankings import Cell, Ranking
from .sentences import claims_of, requirements_of, short_finding, title_of
from .wording import bracket, counted, halves, metric_name, number, percent, ratio_interval, ratio_of

INTERVALS_FROM = 100
"""Columns from which the ratio's interval and the time of a step are shown."""
ANSWERS = {"too sure": "sure", "too cautious": "unsure", "consistent": "ok", "undecided": "?", "kept": "ok",
           "broken": "broken", "not certified": "uncert.", "": ""}


def print_cell(cell: Cell, about: str) -> None:
    """A cell: heading, table, findings. about: what is said after its name."""
    say((plain(f"{cell.key}  {counted(cell.runs, 'run')}{about}"), "bold"))
    if cell.title:
        wrapped(cell.title, "")
    print()
    labels = cell.labels
    gone = {label for label in labels if cell.lost(label) == cell.runs}
    wide = columns() >= INTERVALS_FROM
    first = Column(["entry"], [[(label, MARKS["lost"].style if label in gone else "")] for label in labels])
    claims = _column(["claim", _claim_head(cell)], labels, lambda label: claim_words(cell.claim(label)))
    made: list[Column] = []
    for place, ranking in enumerate(cell.rankings):
        made.append(error_column(ranking, labels, wide))
        near = _column(["eff.", ranking.quantity], labels, lambda label, of=ranking: _near(of.line(label)))
        made += [near] if near and columns() >= WIDE else []
        if claims and place == min(1, len(cell.rankings) - 1):
            made.append(claims)  # beside the first two quantities
    if claims and not cell.rankings:
        made.append(claims)
    made += [column for name, lines in cell.requirements.items() if (column := _column(
        ["keeps", name], labels, lambda label, lines=lines: _required(_of(lines, label))))]
    if wide and cell.timing:
        made.append(Column(["step", "[µs]"], [[(_step(cell, label) if label not in gone else "", "")]
                                              for label in labels], True))
    for lines in cell.outcomes:
        metric, quantity = lines[0]["metric"], lines[0]["quantity"]
        name = quantity if metric in quantity else f"{metric_name(metric)} {quantity}"
        made.append(Column([*bracket(name, lines[0]["shown_unit"]).rsplit(" ", 1)], _aligned(
            [_outcome(_of(lines, label)) for label in labels]), True))
    print_columns(first, made)
    print()
    for ranking in cell.rankings:
        wrapped(short_finding(cell, ranking))
    for text in (claims_of(cell), *requirements_of(cell)):
        if text:
            wrapped(text)


def print_key() -> None:
    """What the signs mean."""
    signs = [(f"{MARKS[word].sign} {said}", MARKS[word].style) for word, said in (
        ("best", "best"), ("tie", "tie, within 1 %"), ("undecided", "undecided"), ("worse", "worse"),
        ("lost", "lost runs"), ("oracle", "oracle"))]
    say(*[piece for text, style in signs for piece in ((plain(text), style), ("  ", ""))][:-1])
    for text in ("±: half of the 95 % interval.  /best: ratio over the same runs (the verdict).",
                 "ANEES: 1 is right; sure: too sure, unsure: too unsure, ?: undecided."):
        wrapped(text)


def error_column(ranking: Ranking, labels: Sequence[str], intervals: bool) -> Column:
    """Sign, value, half of its interval, ratio to the best (with its interval), or what was lost."""
    lines = [ranking.line(label) for label in labels]
    parts = [[plain(part) for part in _parts(line, intervals)] for line in lines]
    sizes = [max((len(part[i]) for part in parts if len(part) == 4), default=0) for i in range(4)]
    spare = max((len(part[0]) for part in parts if len(part) == 1), default=0) - sum(sizes) - 3
    sizes[3] += max(spare, 0)
    cells: list[list[Piece]] = []
    for line, part in zip(lines, parts, strict=True):
        sign = mark(line) if line else MARKS[""]
        if len(part) == 1:
            cells.append([(f"{sign.sign} {part[0]}".ljust(sum(sizes) + 5), sign.style)])
            continue
        value, half, ratio, interval = part
        cells.append([(f"{sign.sign} ", sign.style), (value.rjust(sizes[0]), sign.style if value and not ratio else ""),
                      (f" {half.ljust(sizes[1])}", ""), (f" {ratio.rjust(sizes[2])}", sign.style),
                      (f" {interval.ljust(sizes[3])}", "")])
    under = f"{'value':>{sizes[0] + 2}} {'±95 %'.ljust(sizes[1])} {'/best':>{sizes[2]}}"
    return Column([title_of(ranking), under], cells)


def _parts(line: Line | None, intervals: bool) -> list[str]:
    """Value, half, ratio, interval; of who is lost one text: `0.123 of 9, 11 lost`, `20 of 20 lost`."""
    if line is None or drawn(line) == "":
        return [""] * 4
    if drawn(line) == "lost":
        return [f"{halves(line)[0]} of {line['runs']}, {line['lost']} lost" if line["runs"]
                else f"{line['lost']} of {line['lost']} lost"]
    value, half = halves(line)
    beside = f"of {line['runs']}" if line["lost"] else f"±{half}" if half else ""
    if drawn(line) in ("best", "oracle"):
        return [value, beside, "", ""]
    return [value, beside, ratio_of(line), ratio_interval(line) if intervals else ""]


def _near(line: Line | None) -> str:
    """`98 %`: the floor over the value."""
    return percent(line["efficiency"]) if line is not None and line["efficiency"] > 0 else ""


def claim_words(line: Line | None) -> str:
    """`sure 5.51`, `unsure 0.4`, `? 0.88`, `ok 1.02`, `set kept`, `bound broken`."""
    if line is None:
        return ""
    word = ANSWERS.get(line["verdict"], line["verdict"])
    if line["kind"] == "consistency":
        return f"{word} {number(line['value'])}"
    return f"{'set' if line['metric'] == 'coverage' else 'bound'} {word}"


def _claim_head(cell: Cell) -> str:
    metrics = {line["metric"] for label in cell.labels if (line := cell.claim(label)) and line["kind"] == "consistency"}
    return f"({', '.join(sorted(map(metric_name, metrics)))})" if metrics else ""


def _required(line: Line | None) -> str:
    """`✓ 20/20`, `? 96 %`."""
    if line is None:
        return ""
    kept = (f"{round(line['value'] * line['runs'])}/{line['runs']}" if line["metric"] == "kept"
            else percent(line["value"]))
    return f"{mark(line).sign} {kept}"


def _outcome(line: Line | None) -> tuple[str, str]:
    if line is None:
        return "", ""
    if line["kind"] == "share":
        return f"{round(line['value'] * line['runs'])} of {line['runs']}", ""
    value, half = halves(line)
    return value, f" ±{half}" if half else ""


def _aligned(parts: Sequence[tuple[str, str]]) -> list[list[Piece]]:
    """Values and halves each set under another."""
    size = max((len(plain(half)) for _, half in parts), default=0)
    return [[(value, ""), (half.ljust(size), "")] for value, half in parts]


def _column(head: list[str], labels: Sequence[str], words: Callable[[str], str]) -> Column | None:
    texts = [words(label) for label in labels]
    return Column([line for line in head if line], [[(text, "")] for text in texts]) if any(texts) else None


def _step(cell: Cell, label: str) -> str:
    value = cell.timing.get(label, {}).get("latency_us_median", float("nan"))
    return number(value) if value == value else ""


def _of(lines: Sequence[Line], label: str) -> Any:
    return next((line for line in lines if line["estimator"] == label), None)
