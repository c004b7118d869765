"""Accuracy against latency: what a smaller error costs in computing time per step."""

from __future__ import annotations

import numpy as np

from ..wording import bracket, metric_name
from .axes import Sheet, spanning
from .canvas import Canvas
from .data import CellResults


def accuracy_against_latency(cell: CellResults) -> Canvas | None:
    """Error of the first judged quantities (at most two) over the latency of one step: marker at the median, line to
    the 99th percentile."""
    latency = {label: (values["latency_us_median"], values["latency_us_p99"]) for label, values in cell.timing.items()
               if np.isfinite(values["latency_us_median"])}
    columns = cell.judged[:2]
    labels = [label for label in cell.ran if label in latency]
    if not columns or not labels:
        return None
    sheet = Sheet(f"Accuracy against latency, {cell.key}", cell.width, [96.0] * len(columns), cell.styled(labels),
                  x_label="latency of a step, median to 99 % [µs]", foot=28)
    x = spanning(*(latency[label] for label in labels), log=True, margin=0.08)
    for _, metric, quantity, raw in columns:
        unit, factor = cell.unit(metric, quantity, raw)
        errors = {line["estimator"]: line["value"] * factor for line in cell.of("error", metric, quantity)}
        panel = sheet.panel(x, spanning(list(errors.values()), zero=True, margin=0.1),
                            bracket(f"{metric_name(metric)} of {quantity}", unit))
        for label in labels:
            if np.isfinite(errors.get(label, np.nan)):
                style = cell.styles[label]
                ends = panel.points(latency[label], [errors[label]] * 2)
                sheet.canvas.path(ends, stroke=style.colour, width=0.8)
                panel.mark(latency[label][0], errors[label], style, title=label)
    return sheet.done(markers=True)
