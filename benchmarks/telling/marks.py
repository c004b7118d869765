"""Signs of verdicts: a text sign and a word each, so that colour never speaks alone; ASCII where nothing else is known.

How lines of the verdict table are drawn, everywhere: terminal, page, figures, LaTeX."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

Line = Mapping[str, Any]
"""A line of the verdict table."""


class Mark(NamedTuple):
    """sign, its ASCII form, the word beside it, the page's class, the terminal's style."""

    sign: str
    plain: str
    word: str
    css: str
    style: str = ""


MARKS = {
    "best": Mark("★", "*", "best", "best", "bold blue"),
    "tie": Mark("=", "=", "tie", "best", "blue"),
    "undecided": Mark("?", "?", "undecided", "open", "dim"),
    "better": Mark("▼", "<", "better", "tie", "blue"),
    "worse": Mark("▲", ">", "worse", "w2", "yellow"),
    "lost": Mark("✕", "x", "lost", "lost", "bold magenta"),
    "oracle": Mark("○", "o", "oracle", "none"),
    "reference": Mark("◇", "-", "reference", "none"),
    "": Mark(" ", " ", "", "none"),
    # claims and requirements
    "consistent": Mark("✓", "ok", "consistent", "tie"),
    "too sure": Mark("✗", "x", "too sure", "w2", "yellow"),
    "too cautious": Mark("✗", "x", "too unsure", "w1"),
    "kept": Mark("✓", "ok", "kept", "tie"),
    "broken": Mark("✗", "x", "broken", "w2", "yellow"),
    "met": Mark("✓", "ok", "met", "tie"),
    "not met": Mark("✗", "x", "not met", "w2", "yellow"),
    "white": Mark("✓", "ok", "white", "tie"),
    "not certified": Mark("–", "-", "not certified", "outline"),
    "coloured": Mark("✗", "x", "coloured", "w1"),
    # published numbers
    "reproduced": Mark("✓", "ok", "reproduced", "tie"),
    "corrected": Mark("✎", "c", "corrected", "tie"),
    "follows from its own table": Mark("∴", "t", "follows from its own table", "tie"),
    "fitted": Mark("~", "~", "fitted", "outline"),
    "not reproduced": Mark("✗", "x", "not reproduced", "w2"),
    "contradicts its text": Mark("≠", "#", "contradicts its text", "w3"),
    "unreachable": Mark("–", "-", "unreachable", "none"),
}
ASCII = {**{mark.sign: mark.plain for mark in MARKS.values() if len(mark.sign.encode()) > 1},
         "±": "+-", "−": "-", "–": "-", "·10": "e", "·": "*", "×": "x", "∞": "inf", "µ": "u", "σ": "sigma", "≤": "<=",
         "≥": ">=", "→": "->", "─": "-", "†": "+", "\u202f": " ", "\u00a0": " ", "²": "^2",
         **dict(zip("⁻⁰¹³⁴⁵⁶⁷⁸⁹", "-013456789", strict=True))}
"""What stands for a sign where an output cannot encode it."""


def drawn(line: Line) -> str:
    """The verdict as it is drawn: who lost more runs than equals would is lost, whatever the errors say."""
    word = line["verdict"]
    return "lost" if not line["eligible"] and word != "none" else "" if word == "none" else word


def mark(line: Line) -> Mark:
    """The sign of a line of the verdict table."""
    return MARKS.get(drawn(line), MARKS[""])


def shade(line: Line) -> str:
    """The page's class of an error's verdict: worse in three steps, under 1.1, to 2, from 2."""
    if drawn(line) != "worse":
        return mark(line).css
    return "w1" if line["ratio"] < 1.1 else "w2" if line["ratio"] < 2 else "w3"
