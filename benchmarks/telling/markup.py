"""Tables as Markdown and LaTeX."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from .cleaning import latex, markdown
from .wording import numeric


def to_markdown(title: str, frame: pd.DataFrame, notes: Sequence[str]) -> str:
    """A Markdown table with a heading and its notes."""
    head = "| " + " | ".join(map(markdown, frame.columns)) + " |"
    rule = "|" + "|".join(" ---: " if numeric(frame[c].tolist()) else " --- " for c in frame.columns) + "|"
    body = ["| " + " | ".join(map(markdown, row)) + " |" for row in frame.to_numpy()]
    below = [f"- {markdown(note)}" for note in notes]
    return "\n".join([f"## {markdown(title)}", "", head, rule, *body, "", *below]) + "\n"


def to_latex(title: str, frame: pd.DataFrame, notes: Sequence[str]) -> str:
    """A LaTeX table with booktabs rules, in plain ASCII."""
    spec = "".join("r" if numeric(frame[c].tolist()) else "l" for c in frame.columns)
    lines = [r"\begin{table}", r"\centering", rf"\caption{{{latex(title)}}}", rf"\begin{{tabular}}{{{spec}}}",
             r"\toprule", " & ".join(latex(c) for c in frame.columns) + r" \\", r"\midrule"]
    lines += [" & ".join(latex(value) for value in row) + r" \\" for row in frame.to_numpy()]
    lines += [r"\bottomrule", r"\end{tabular}", *(rf"\par\footnotesize {latex(note)}" for note in notes)]
    lines += [r"\end{table}"]
    return "\n".join(lines) + "\n"
