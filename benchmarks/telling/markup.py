"""Tables as Markdown and LaTeX."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from .wording import numeric


def to_markdown(title: str, frame: pd.DataFrame, notes: Sequence[str]) -> str:
    """A Markdown table with a heading and its notes."""
    head = "| " + " | ".join(frame.columns) + " |"
    rule = "|" + "|".join(" ---: " if numeric(frame[c].tolist()) else " --- " for c in frame.columns) + "|"
    body = ["| " + " | ".join(str(value) for value in row) + " |" for row in frame.to_numpy()]
    return "\n".join([f"## {title}", "", head, rule, *body, "", *(f"- {note}" for note in notes)]) + "\n"
_LATEX = str.maketrans({
    **{letter: f"\\{letter}" for letter in "&%_#${}"}, "\\": r"\textbackslash{}", "^": r"\^{}", "~": r"\~{}",
    "<": "$<$", ">": "$>$", "±": r"$\pm$", "−": "$-$", "–": "--", "·": r"$\cdot$", "×": r"$\times$",
    "∞": r"$\infty$", "µ": r"$\mu$", "σ": r"$\sigma$", "χ": r"$\chi$", "‰": r"\textperthousand{}",
    **{raised: f"$^{{{plain}}}$" for raised, plain in zip("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789", strict=True)}})


def latex(text: object) -> str:
    """Text for LaTeX; letters it has no word for become question marks."""
    return str(text).translate(_LATEX).replace("}$$^{", "").encode("ascii", "replace").decode()


def to_latex(title: str, frame: pd.DataFrame, notes: Sequence[str]) -> str:
    """A LaTeX table with booktabs rules, in plain ASCII."""
    spec = "".join("r" if numeric(frame[c].tolist()) else "l" for c in frame.columns)
    lines = [r"\begin{table}", r"\centering", rf"\caption{{{latex(title)}}}", rf"\begin{{tabular}}{{{spec}}}",
             r"\toprule", " & ".join(latex(c) for c in frame.columns) + r" \\", r"\midrule"]
    lines += [" & ".join(latex(value) for value in row) + r" \\" for row in frame.to_numpy()]
    lines += [r"\bottomrule", r"\end{tabular}", *(rf"\par\footnotesize {latex(note)}" for note in notes)]
    lines += [r"\end{table}"]
    return "\n".join(lines) + "\n"
