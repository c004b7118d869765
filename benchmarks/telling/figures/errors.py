"""Figures of the errors themselves: over time with bands, and per run as boxes.

Both draw the quantities a scenario judges, at most `MOST` of them (the table has all); where more than `CROWD`
estimators share a figure, bands are left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ....scenarios.arrays import Array
from ...judging.statistics import finite
from ..wording import bracket, metric_name
from .axes import RIGHT, Panel, Sheet, Style, spanning
from .canvas import Canvas, text_width
from .data import CROWD, CellResults, Curve

MOST = 3
BINS = 130
FLOOR = Style("muted", (2.0, 2.0))
"""How the least possible error is drawn, of the first estimator's truths."""


def binned_rms(curve: Curve) -> tuple[Array, Array, Array, Array]:
    """Time, root mean square over the runs, and its 95 % band, in at most about `BINS` bins of equal length.

    Mean squares are averaged within a bin; the band is the mean one of its steps, because errors of neighbouring steps
    are correlated. Steps that fewer than a tenth of the runs reach are left out."""
    use = curve.active >= max(1.0, 0.1 * float(curve.active.max(initial=0.0)))
    time, n = curve.time[use], curve.active[use]
    mean = curve.squared[use] / n
    error = np.sqrt(np.maximum(curve.fourth[use] / n - mean**2, 0.0) / np.maximum(n - 1, 1))
    size = max(1, -(-len(time) // BINS))
    starts = np.arange(0, len(time), size)
    counts = np.diff(np.append(starts, len(time)))
    time, mean, error = (np.add.reduceat(v, starts) / counts for v in (time, mean, error))
    root = np.sqrt(mean)
    half = np.divide(1.96 * error, 2 * root, out=np.zeros_like(root), where=root > 0)
    return time, root, np.maximum(root - half, 0.0), root + half


def binned_floor(curve: Curve) -> tuple[Array, Array]:
    """Time and root of the least mean square possible, in the bins of `binned_rms`; empty where it is not known."""
    if not np.isfinite(curve.floor).any():
        return np.zeros(0), np.zeros(0)
    time, root, _, _ = binned_rms(replace(curve, squared=curve.floor))
    return time, root


def error_over_time(cell: CellResults) -> Canvas | None:
    """Root mean square error over the runs at each instant, per estimator and quantity; with 95 % bands for up to
    `CROWD` estimators."""
    units = cell.quantity_units()
    names = cell.chosen([quantity for _, _, quantity, _ in cell.judged
                         if quantity in units and any((label, quantity) in cell.curves for label in cell.ran)], MOST)
    labels = [label for label in cell.ran if any((label, name) in cell.curves for name in names)]
    if not names:
        return None
    sheet = Sheet(f"Error over time, {cell.key}", cell.width, [98.0] * len(names), cell.styled(labels), foot=28)
    for name in names:
        unit, factor = units[name]
        found = {label: binned_rms(cell.curves[label, name]) for label in labels if (label, name) in cell.curves}
        typical = np.array([np.median(part[1]) for part in found.values()])
        log = bool((typical > 0).all() and typical.max() > 12 * typical.min())
        y = spanning(*(np.maximum(part[1], np.quantile(part[1], 0.05)) * factor for part in found.values()), log=log,
                     zero=True)
        x = spanning(*(part[0] for part in found.values()), log=False, margin=0.0)
        panel = sheet.panel(x, y, bracket(f"RMS error of {name}", unit))
        for label, (time, _, low, high) in found.items() if len(found) <= CROWD else ():
            panel.band(time, low * factor, high * factor, cell.styles[label].colour)
        for label, (time, root, _, _) in found.items():
            panel.line(time, root * factor, cell.styles[label], title=label)
        time, root = binned_floor(cell.curves[next(iter(found)), name])
        if len(time):
            panel.line(time, root * factor, FLOOR, title="the least possible")
    return sheet.done()


def label_room(labels: list[str], width: float) -> float:
    """Left margin that holds the longest label."""
    return min(8 + max(text_width(label) for label in labels), 0.5 * width)


def errors_per_run(cell: CellResults) -> Canvas | None:
    """Each estimator's errors per run as a box (quartiles, median), whiskers (5 % to 95 %) and extremes (dots)."""
    labels = cell.ran
    shown = cell.chosen([quantity for _, _, quantity, _ in cell.judged], MOST if len(labels) <= CROWD else MOST - 1)
    columns = [column for column in cell.judged if column[2] in shown]
    if not columns:
        return None
    left, step = label_room(labels, cell.width), 11.0
    each = step * len(labels) + 4
    canvas = Canvas(len(columns) * (each + 40) + 2, f"Errors per run, {cell.key}", cell.width)
    for row, (column, metric, quantity, raw) in enumerate(columns):
        unit, factor = cell.unit(metric, quantity, raw)
        values = {label: finite(array) * factor for label, array in cell.values(column).items()}
        x = spanning(*values.values())
        top = 14 + row * (each + 40)
        panel = Panel(canvas, left, top, cell.width - left - RIGHT, each, x, spanning([0.0, 1.0], log=False),
                      y_ticks=False, x_label=bracket(f"{metric_name(metric)} of {quantity}", unit))
        for place, label in enumerate(labels):
            y = top + 2 + step * (place + 0.5)
            _box(panel, values.get(label, np.zeros(0)), y, cell.styles[label].colour, label)
            canvas.text(left - 4, y + 2.8, label, anchor="end")
    return canvas


def _box(panel: Panel, values: Array, y: float, colour: str, label: str) -> None:
    canvas = panel.canvas
    if not values.size:
        canvas.text(panel.left + 4, y + 2.8, "no finished run", colour="muted", size=7)
        return
    low, first, middle, third, high = (panel.points([v], [0])[0, 0]
                                       for v in np.quantile(values, [0.05, 0.25, 0.5, 0.75, 0.95]))
    canvas.path([(low, y), (high, y)], stroke=colour, width=0.9)
    for end in (values.min(), values.max()):
        at = panel.points([end], [0])[0, 0]
        canvas.path([(at - 0.8, y), (at, y - 0.8), (at + 0.8, y), (at, y + 0.8)], stroke=None, fill=colour)
    canvas.path([(first, y - 3), (third, y - 3), (third, y + 3), (first, y + 3)], stroke=colour, width=0.8, fill=colour,
                opacity=0.3, title=f"{label}: median {np.median(values):.3g} of {values.size} runs")
    canvas.path([(middle, y - 3.6), (middle, y + 3.6)], stroke=colour, width=1.6)
