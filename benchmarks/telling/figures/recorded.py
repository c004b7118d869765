"""The recorded setting's own figures: the trip with every estimator's error and claimed band, and errors by outage."""

from __future__ import annotations

import numpy as np

from ....scenarios.arrays import Array
from ..wording import bracket
from .axes import Panel, Sheet, Style, spanning
from .canvas import Canvas
from .data import CellResults
from .example import thinned

BANDS = 2.0
"""Half the width of a band in claimed standard deviations."""


def recorded_trip(cell: CellResults) -> Canvas | None:
    """Reference speed and estimates above; below, a panel an estimator, the position error of the first kept run with
    its claimed band. Grey: where readings are out."""
    units = cell.quantity_units()
    labels = [label for label in cell.ran if {(label, "position"), (label, "speed")} <= set(cell.kept)]
    if not labels or not {"position", "speed"} <= set(units):
        return None
    (length, to_length), (pace, to_pace) = units["position"], units["speed"]
    sheet = Sheet(f"Recorded trip, {cell.key}", cell.width, [84.0, *(40.0 for _ in labels)],
                  [("reference", Style("ink")), *cell.styled(labels)], gap=16, foot=28)
    first = cell.kept[labels[0], "speed"]
    x, out = spanning(first.time, log=False, margin=0.0), _outages(cell)
    panel = sheet.panel(x, spanning(*(cell.kept[label, "speed"].estimate * to_pace for label in labels), log=False),
                        bracket("speed", pace))
    _shade(panel, out)
    for label in labels:
        track = cell.kept[label, "speed"]
        use = thinned(len(track.time))
        panel.line(track.time[use], track.estimate[use] * to_pace, cell.styles[label], width=0.8, title=label)
    panel.line(first.time, first.truth * to_pace, Style("ink"), width=1.2, title="reference")
    for label in labels:
        track = cell.kept[label, "position"]
        error, band = (track.estimate - track.truth) * to_length, BANDS * track.sd * to_length
        shown = [error, band, -band] if np.isfinite(band).any() else [error]
        under = sheet.panel(x, spanning(*shown, log=False), bracket(f"position error of {label}", length))
        _shade(under, out)
        under.band(track.time, -band, band, cell.styles[label].colour)
        use = thinned(len(track.time))
        under.line(track.time[use], error[use], Style(cell.styles[label].colour), width=0.9, title=label)
    return sheet.done()


def errors_by_outage(cell: CellResults) -> Canvas | None:
    """Position error at the end of the outage over where it begins, all runs."""
    begin, error = "begin:outage:s", "rmse:position-outage-end:m"
    if begin not in cell.rows or error not in cell.rows or cell.rows[begin].nunique() < 3:
        return None
    name, factor = cell.unit("rmse", "position-outage-end", "m")
    places, errors = cell.values(begin), cell.values(error)
    labels = [label for label in cell.ran if np.isfinite(errors[label]).any()]
    sheet = Sheet(f"Errors by outage, {cell.key}", cell.width, [130], cell.styled(labels),
                  x_label="the outage begins at [s]")
    usual = [np.maximum(errors[label], np.nanquantile(errors[label], 0.1)) * factor for label in labels]
    panel = sheet.panel(spanning(*places.values(), log=False, margin=0.02), spanning(*usual, zero=True),
                        bracket("position error at the outage's end", name))
    for label in labels:
        order = np.argsort(places[label], kind="stable")
        panel.line(places[label][order], errors[label][order] * factor, cell.styles[label], width=0.9, title=label)
    return sheet.done()


def _outages(cell: CellResults) -> list[tuple[float, float]]:
    """(from, to) of the first kept run's outages, s."""
    track = cell.kept.get(("", "outage"))
    if track is None:
        return []
    edges = np.flatnonzero(np.diff(np.concatenate([[0], track.truth > 0, [0]]).astype(int)))
    return [(float(track.time[a]), float(track.time[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _shade(panel: Panel, spans: list[tuple[float, float]]) -> None:
    for begin, end in spans:
        ends: Array = np.array([begin, end])
        panel.band(ends, np.full(2, panel.y.low), np.full(2, panel.y.high), "muted", 0.15)
