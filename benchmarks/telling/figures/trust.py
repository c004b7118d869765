"""Figures of what estimators claim: NEES over time, certified bounds against measured mean squares."""

from __future__ import annotations

from collections import Counter

import numpy as np

from ...judging.statistics import chi_square_interval
from ..wording import counted
from .axes import RIGHT, Panel, Scale, Sheet, Style, draw_marker, spanning
from .canvas import Canvas
from .data import CellResults
from .errors import BINS, label_room


def nees_over_time(cell: CellResults) -> Canvas | None:
    """NEES averaged over the runs at single steps, divided by the number of states, and the chi-square interval."""
    claimed = {line["estimator"] for line in cell.of("consistency", "nees")}
    states = {str(label): int(part["nees_states"].max()) for label, part in cell.rows.groupby("estimator", sort=False)
              if label in claimed}
    runs = max((int(cell.curves[label, "nees"].active.max(initial=0.0)) for label in states
                if (label, "nees") in cell.curves), default=0)
    return _over_time(cell, "nees", states, "NEES", f"NEES / states, mean of {counted(runs, 'run')}")


def nis_over_time(cell: CellResults) -> Canvas | None:
    """NIS averaged over what all runs received at single steps, and its chi-square interval. Needs no truth."""
    return _over_time(cell, "nis", dict.fromkeys(cell.ran, 1), "NIS", "NIS / elements received, mean over the runs")


def _over_time(cell: CellResults, quantity: str, degrees: dict[str, int], name: str, title: str) -> Canvas | None:
    """A quadratic form over time, by the degrees of freedom of each estimator's, with its interval."""
    labels = cell.apart([label for label in degrees if (label, quantity) in cell.curves])
    if not labels:
        return None
    usual = Counter(degrees[label] for label in labels).most_common(1)[0][0]
    lines = {}
    for label in labels:
        curve = cell.curves[label, quantity]
        use = np.flatnonzero(curve.active >= max(1.0, 0.1 * float(curve.active.max(initial=0.0))))
        use = use[np.isfinite(curve.squared[use])]
        use = use[np.unique(np.linspace(0, len(use) - 1, min(BINS, len(use))).astype(int))] if len(use) else use
        lines[label] = (curve.time[use], curve.squared[use] / curve.active[use] / degrees[label], curve.active[use])
    time, _, active = max(lines.values(), key=lambda line: len(line[0]))
    if not len(time):
        return None
    limits = np.array([chi_square_interval(round(n), usual) for n in active])
    usually = [np.maximum(values, max(float(np.quantile(values, 0.05)), 1e-3)) for _, values, _ in lines.values()]
    y = spanning(*usually, limits, log=True)
    sheet = Sheet(f"{name} over time, {cell.key}", cell.width, [122], cell.styled(labels), foot=30)
    panel = sheet.panel(spanning(time, log=False, margin=0.0), y, title)
    panel.band(time, limits[:, 0], limits[:, 1], "muted", 0.3)
    panel.level(1.0, colour="ink")
    for label, (at, value, _) in lines.items():
        panel.line(at, value, cell.styles[label], width=0.8, title=label)
    return sheet.done()


def certified_against_measured(cell: CellResults) -> Canvas | None:
    """Mean-square bounds that estimators certify (bars) beside the mean squares measured, with 95 % intervals."""
    checks = {line["estimator"]: line for line in cell.of("claim", "bound")}
    if not checks:
        return None
    left, step = label_room(list(checks), cell.width), 16.0
    height = step * len(checks) + 4
    canvas = Canvas(height + 54, f"Certified bounds against measured mean squares, {cell.key}", cell.width)
    values = [v for line in checks.values() for v in (line["value"] / line["ratio"], line["value"])]
    panel = Panel(canvas, left, 14, cell.width - left - RIGHT - 4, height, spanning(values, log=True, margin=0.1),
                  Scale(0, 1), y_ticks=False, x_label="mean square of the performance output")
    for place, (label, bound) in enumerate(checks.items()):
        y, style = 16 + step * (place + 0.5), cell.styles[label]
        low, value, high, limit = (panel.points([v], [0])[0, 0] for v in
                                   (bound["low"], bound["value"], bound["high"], bound["value"] / bound["ratio"]))
        canvas.path([(value, y), (limit, y)], stroke=style.colour, width=0.6, dash=(1.5, 1.5))
        canvas.path([(limit, y - 6), (limit, y + 6)], stroke=style.colour, width=2.2, title=f"{label}: certified")
        canvas.path([(low, y), (high, y)], stroke=style.colour, width=2.0)
        draw_marker(canvas, value, y, Style(style.colour, marker="diamond"), 2.0, f"{label}: measured")
        canvas.text(left - 4, y + 2.8, label, anchor="end")
    legend_at = canvas.height - 6
    draw_marker(canvas, left + 4, legend_at - 2.6, Style("muted", marker="diamond"), 2.0)
    canvas.text(left + 12, legend_at, "measured", colour="muted")
    canvas.path([(left + 62, legend_at - 7), (left + 62, legend_at + 1)], stroke="muted", width=2.2)
    canvas.text(left + 67, legend_at, "certified", colour="muted")
    return canvas

