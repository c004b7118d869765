"""The lossy-channel setting's own figures: what came through, and the headway that the errors allow."""

from __future__ import annotations

import numpy as np

from .axes import Scale, Sheet, Style, spanning
from .canvas import Canvas
from .data import CellResults

WINDOWS = 60


def receptions(cell: CellResults) -> Canvas | None:
    """Share of packets that arrived in each window of the first kept run, and the longest wait in it."""
    track = cell.kept.get(("", "received"))
    if track is None:
        return None
    received = track.truth > 0.5
    size = max(1, -(-len(received) // WINDOWS))
    starts = np.arange(0, len(received), size)
    share = np.add.reduceat(received.astype(float), starts) / np.diff(np.append(starts, len(received)))
    index = np.arange(len(received))
    since = index - np.maximum.accumulate(np.where(received, index, -1))
    wait = np.maximum.reduceat(since, starts) * cell.period
    time = track.time[starts]
    sheet, x = Sheet(f"Receptions, {cell.key}", cell.width, [64, 64]), spanning(track.time, log=False, margin=0.0)
    panel = sheet.panel(x, Scale(0.0, 1.0), f"share received (mean {received.mean():.2f})")
    panel.line(time, share, Style("c0"))
    panel.level(float(received.mean()))
    sheet.panel(x, spanning(wait, log=False, zero=True), "longest wait for a packet [s]").line(time, wait, Style("c3"))
    return sheet.done()


def headway(cell: CellResults) -> Canvas | None:
    """Headway time over speed, from each estimator's own largest position error, with 95 % intervals."""
    lines = [(float(line["quantity"].rpartition("-")[2]), line) for line in cell.of("value", "headway")
             if line["quantity"].rpartition("-")[2].isdecimal()]
    speeds = np.unique([speed for speed, _ in lines])
    found = {label: [line for _, line in sorted(lines, key=lambda item: item[0]) if line["estimator"] == label]
             for label in cell.ran}
    found = {label: values for label, values in found.items() if len(values) == len(speeds)}
    if len(speeds) < 2 or not found:
        return None
    sheet = Sheet(f"Headway, {cell.key}", cell.width, [130], cell.styled([*found]), x_label="speed [km/h]")
    panel = sheet.panel(spanning(speeds, log=False), spanning(
        *([v["value"] for v in values] for values in found.values()), log=False), "headway [s]")
    for label, values in found.items():
        panel.band(speeds, [v["low"] for v in values], [v["high"] for v in values], cell.styles[label].colour)
        panel.line(speeds, [v["value"] for v in values], cell.styles[label], title=label)
        for speed, value in zip(speeds, values, strict=True):
            panel.mark(float(speed), value["value"], cell.styles[label], size=2.2)
    return sheet.done(markers=True)
