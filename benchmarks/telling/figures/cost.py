"""Accuracy against latency: what a smaller error costs in computing time per step."""

from __future__ import annotations

import numpy as np

from ..wording import bracket, metric_name
from .axes import Panel, legend, legend_height, spanning
from .canvas import Canvas
from .data import CellResults
from .errors import LEFT, RIGHT


def accuracy_against_latency(cell: CellResults) -> Canvas | None:
    """Error of the first judged quantities (at most two) over the latency of one step: marker at the median, line to
    the 99th percentile."""
    latency = {label: (values["latency_us_median"], values["latency_us_p99"]) for label, values in cell.timing.items()
               if np.isfinite(values["latency_us_median"])}
    columns = cell.judged[:2]
    labels = [label for label in cell.labels if label in latency]
    if not columns or not labels:
        return None
    each, room = 96.0, legend_height(labels, cell.width - 8)
    canvas = Canvas(len(columns) * (each + 18) + 24 + room, f"Accuracy against latency, {cell.key}", cell.width)
    x = spanning(*(latency[label] for label in labels), log=True, margin=0.08)
    for row, (_, metric, quantity, raw) in enumerate(columns):
        unit, factor = cell.unit(metric, quantity, raw)
        errors = {line["estimator"]: line["value"] * factor for line in cell.lines("error", metric, quantity)}
        last = row == len(columns) - 1
        panel = Panel(canvas, LEFT, 14 + row * (each + 18), cell.width - LEFT - RIGHT, each, x,
                      spanning(list(errors.values()), zero=True, margin=0.1), x_ticks=last,
                      title=bracket(f"{metric_name(metric)} of {quantity}", unit),
                      x_label="latency of a step, median to 99 % [µs]" if last else "")
        for label in labels:
            if np.isfinite(errors.get(label, np.nan)):
                style = cell.styles[label]
                ends = panel.points(latency[label], [errors[label]] * 2)
                canvas.path(ends, stroke=style.colour, width=0.8)
                panel.mark(latency[label][0], errors[label], style, title=label)
    legend(canvas, room, [(label, cell.styles[label]) for label in labels], markers=True)
    return canvas
