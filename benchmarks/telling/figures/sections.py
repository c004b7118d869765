"""Errors over the sections of a trip with stops on the way, one line an estimator."""

from __future__ import annotations

import numpy as np

from ..tables import windows
from ..wording import bracket
from .axes import Panel, legend, legend_height, spanning
from .canvas import Canvas
from .data import CellResults
from .errors import LEFT, RIGHT


def errors_by_section(cell: CellResults) -> Canvas | None:
    """Pooled RMSE of each quantity on each section, per estimator."""
    names = list(dict.fromkeys(f"{line['metric']}:{line['quantity']}:{line['unit']}" for line in cell.lines("value")))
    found = windows(names, cell.about["quantities"])
    if not found:
        return None
    each, labels = 96.0, cell.labels
    room = legend_height(labels, cell.width - 8)
    canvas = Canvas(len(found) * (each + 18) + 24 + room, f"Errors by section, {cell.key}", cell.width)
    for row, (quantity, columns) in enumerate(found.items()):
        last, sections = row == len(found) - 1, np.arange(1, len(columns) + 1)
        lines = {(line["quantity"], line["estimator"]): line for line in cell.lines("value", "rmse")}
        unit = next(line["shown_unit"] for key, line in lines.items() if key[0] == columns[0][1])
        errors = {label: np.array([lines[name, label]["value"] * lines[name, label]["factor"]
                                   if (name, label) in lines else np.nan for _, name in columns]) for label in labels}
        panel = Panel(canvas, LEFT, 14 + row * (each + 18), cell.width - LEFT - RIGHT, each,
                      spanning(sections, log=False, margin=0.02), spanning(*errors.values(), zero=True), whole=True,
                      title=bracket(f"RMSE of {quantity}", unit), x_ticks=last, x_label="section" if last else "")
        for label in labels:
            panel.line(sections, errors[label], cell.styles[label], title=label)
    legend(canvas, room, [(label, cell.styles[label]) for label in labels])
    return canvas
