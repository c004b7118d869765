"""Errors over the sections of a trip with stops on the way, and over the phases of driving, one line an estimator."""

from __future__ import annotations

import numpy as np

from ..tables import Parts, phases, windows
from ..wording import bracket
from .axes import Sheet, spanning
from .canvas import Canvas
from .data import CellResults


def errors_by_section(cell: CellResults) -> Canvas | None:
    """Pooled RMSE of each quantity on each section, per estimator."""
    return _errors_by(cell, windows, "section")


def errors_by_phase(cell: CellResults) -> Canvas | None:
    """Pooled RMSE of each quantity in each phase of driving, per estimator."""
    return _errors_by(cell, phases, "phase")


def _errors_by(cell: CellResults, parts: Parts, word: str) -> Canvas | None:
    names = list(dict.fromkeys(f"{line['metric']}:{line['quantity']}:{line['unit']}" for line in cell.of("value")))
    found = parts(names, cell.about["quantities"])
    if not found:
        return None
    labels, named = cell.ran, parts is phases
    sheet = Sheet(f"Errors by {word}, {cell.key}", cell.width, [96.0] * len(found), cell.styled(labels),
                  x_label="" if named else word, foot=28)
    for quantity, columns in found.items():
        sections = np.arange(1, len(columns) + 1)
        lines = {(line["quantity"], line["estimator"]): line for line in cell.of("value", "rmse")}
        unit = next(line["shown_unit"] for key, line in lines.items() if key[0] == columns[0][1])
        errors = {label: np.array([lines[name, label]["value"] * lines[name, label]["factor"]
                                   if (name, label) in lines else np.nan for _, name in columns]) for label in labels}
        panel = sheet.panel(spanning(sections, log=False, margin=0.12 if named else 0.02),
                            spanning(*errors.values(), zero=not named), bracket(f"RMSE of {quantity}", unit),
                            whole=True, **({"x_ticks": False} if named else {}))
        for label in labels:
            panel.line(sections, errors[label], cell.styles[label], title=label)
            for place, value in zip(sections, errors[label], strict=True):
                if named and np.isfinite(value):
                    panel.mark(float(place), float(value), cell.styles[label], size=2.0, title=label)
        if named and not sheet.left:
            panel.names(sections, [phase for phase, _ in columns])
    return sheet.done(markers=named)
