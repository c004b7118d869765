"""The metro setting's own figure: the trip along the line, with speed limits, gradients and the disturbance."""

from __future__ import annotations

import numpy as np

from ....scenarios.arrays import Array
from .axes import Sheet, Style, spanning
from .canvas import Canvas
from .data import CellResults, Kept
from .example import thinned

ROWS = (("gradient", "gradient [‰]", 1000.0), ("disturbance", "disturbance [m/s²]", 1.0))
"""Extras drawn under the speed: name, title, factor."""
FOUR = ("robust-bounded", "ekf", "ukf", "ckf")
"""Those of the paper's Figure 3."""


def speed_profile(cell: CellResults) -> Canvas | None:
    """Speed over position in a kept run, with the estimates of the paper's four estimators (where they are not all
    there, of the best and the worst), the speed that was to be kept and the limit; below it those estimators' errors,
    the line's gradients and the disturbance that the estimators do not know."""
    labels = [label for label in cell.ran if (label, "position") in cell.kept and (label, "speed") in cell.kept]
    if not labels:
        return None
    place, speed = cell.kept[labels[0], "position"], cell.kept[labels[0], "speed"]
    at = place.truth / 1000.0

    def extra(name: str) -> Array | None:
        track: Kept | None = cell.kept.get(("", name))
        return None if track is None else np.interp(place.time, track.time, track.truth)

    ends = _compared(cell, labels)
    lines: list[tuple[str, Array, Style]] = [("true speed", speed.truth * 3.6, Style("ink"))]
    lines += [(label, _at(cell, label, place) * 3.6, cell.styles[label]) for label in ends]
    for name, label, style in (("reference-speed", "reference", Style("muted", (4.0, 1.6))),
                               ("speed-limit", "limit", Style("muted", (1.3, 1.3)))):
        values = extra(name)
        if values is not None:
            lines.append((label, values * 3.6, style))
    below = [(title, values * factor) for name, title, factor in ROWS if (values := extra(name)) is not None]
    sheet = Sheet(f"Trip, {cell.key}", cell.width, [90, 42, *(42 for _ in below)],
                  [(label, style) for label, _, style in lines], x_label="position [km]")
    x, use = spanning(at, log=False, margin=0.0), thinned(len(at))
    panel = sheet.panel(x, spanning(*(values for _, values, _ in lines), log=False, zero=True), "speed [km/h]")
    for label, values, style in lines:
        panel.line(at[use], values[use], style, width=0.8, title=label)
    errors = {label: (_at(cell, label, place) - speed.truth) * 3.6 for label in ends}
    off = sheet.panel(x, spanning(*errors.values(), log=False), "estimate − true speed [km/h]")
    for label, error in errors.items():
        off.line(at[use], error[use], cell.styles[label], width=0.8, title=label)
    for title, values in below:
        under = sheet.panel(x, spanning(values, log=False, zero=True), title)
        under.line(at[use], values[use], Style("ink"), width=0.8)
    return sheet.done()


def _compared(cell: CellResults, labels: list[str]) -> list[str]:
    """The paper's four; else of the estimators with a kept run those of least and greatest judged speed error (one
    where it is the same)."""
    if set(FOUR) <= set(labels):
        return list(FOUR)
    found = {line["estimator"]: line["value"] for line in cell.of("error", quantity="speed")}
    known = [label for label in labels if np.isfinite(found.get(label, np.nan))] or labels[:1]
    error = {label: found.get(label, 0.0) for label in known}
    return list(dict.fromkeys((min(known, key=error.__getitem__), max(known, key=error.__getitem__))))


def _at(cell: CellResults, label: str, place: Kept) -> Array:
    """An estimator's speed at the instants of the trip."""
    track = cell.kept[label, "speed"]
    return np.interp(place.time, track.time, track.estimate)
