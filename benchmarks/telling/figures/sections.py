"""Errors over the sections of a trip with stops on the way, and over the phases of driving, one line an estimator."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..tables import phases, windows
from ..wording import bracket
from .axes import Panel, legend, legend_height, spanning
from .canvas import Canvas
from .data import CellResults
from .errors import LEFT, RIGHT

Parts = Callable[[Sequence[str], Sequence[str]], dict[str, list[tuple[str, str]]]]


def errors_by_section(cell: CellResults) -> Canvas | None:
    """Pooled RMSE of each quantity on each section, per estimator."""
    return _errors_by(cell, windows, "section")


def errors_by_phase(cell: CellResults) -> Canvas | None:
    """Pooled RMSE of each quantity in each phase of driving, per estimator."""
    return _errors_by(cell, phases, "phase")


def _errors_by(cell: CellResults, parts: Parts, word: str) -> Canvas | None:
    names = list(dict.fromkeys(f"{line['metric']}:{line['quantity']}:{line['unit']}" for line in cell.lines("value")))
    found = parts(names, cell.about["quantities"])
    if not found:
        return None
    each, labels, named = 96.0, cell.labels, parts is phases
    room = legend_height(labels, cell.width - 8)
    canvas = Canvas(len(found) * (each + 18) + 24 + room, f"Errors by {word}, {cell.key}", cell.width)
    for row, (quantity, columns) in enumerate(found.items()):
        last, sections = row == len(found) - 1, np.arange(1, len(columns) + 1)
        lines = {(line["quantity"], line["estimator"]): line for line in cell.lines("value", "rmse")}
        unit = next(line["shown_unit"] for key, line in lines.items() if key[0] == columns[0][1])
        errors = {label: np.array([lines[name, label]["value"] * lines[name, label]["factor"]
                                   if (name, label) in lines else np.nan for _, name in columns]) for label in labels}
        panel = Panel(canvas, LEFT, 14 + row * (each + 18), cell.width - LEFT - RIGHT, each,
                      spanning(sections, log=False, margin=0.12 if named else 0.02),
                      spanning(*errors.values()) if named else spanning(*errors.values(), zero=True), whole=True,
                      title=bracket(f"RMSE of {quantity}", unit), x_ticks=last and not named,
                      x_label="" if named or not last else word)
        for label in labels:
            panel.line(sections, errors[label], cell.styles[label], title=label)
            for place, value in zip(sections, errors[label], strict=True):
                if named and np.isfinite(value):
                    panel.mark(float(place), float(value), cell.styles[label], size=2.0, title=label)
        if named and last:
            panel.names(sections, [phase for phase, _ in columns])
    legend(canvas, room, [(label, cell.styles[label]) for label in labels], markers=named)
    return canvas
