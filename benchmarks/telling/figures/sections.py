"""Errors over the sections of a trip with stops on the way, one line an estimator."""

from __future__ import annotations

import numpy as np

from ...judging.statistics import pooled_rmse
from ...scoring.columns import window_columns
from .axes import Panel, legend, legend_height, spanning
from .canvas import WIDTH, Canvas
from .data import CellResults
from .errors import LEFT, RIGHT, bracket


def errors_by_section(cell: CellResults) -> Canvas | None:
    """Pooled RMSE of each quantity on each section, per estimator."""
    found = window_columns(cell.rows.columns, cell.about["quantities"])
    found = {name: columns for name, columns in found.items() if len(columns) > 1}
    if not found:
        return None
    each, labels = 96.0, cell.labels
    room = legend_height(labels, WIDTH - 8)
    canvas = Canvas(len(found) * (each + 18) + 24 + room, f"Errors by section, {cell.key}")
    for row, (quantity, columns) in enumerate(found.items()):
        last, sections = row == len(found) - 1, np.arange(1, len(columns) + 1)
        unit, factor = cell.unit("rmse", quantity, columns[0][1].rpartition(":")[2])
        errors = {label: np.array([pooled_rmse(cell.values(column)[label])[0] * factor for _, column in columns])
                  for label in labels}
        panel = Panel(canvas, LEFT, 14 + row * (each + 18), WIDTH - LEFT - RIGHT, each,
                      spanning(sections, log=False, margin=0.02), spanning(*errors.values(), zero=True), whole=True,
                      title=bracket(f"RMSE of {quantity}", unit), x_ticks=last, x_label="section" if last else "")
        for label in labels:
            panel.line(sections, errors[label], cell.styles[label], title=label)
    legend(canvas, 4, canvas.height - room, WIDTH - 8, [(label, cell.styles[label]) for label in labels])
    return canvas
