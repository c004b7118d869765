"""The braking setting's own figure: the parameter f as it drifts, as it is estimated, and how many values survive."""

from __future__ import annotations

import numpy as np

from .axes import Panel, Style, legend, legend_height, spanning
from .canvas import Canvas
from .data import CROWD, CellResults
from .errors import LEFT, RIGHT
from .example import thinned


def parameter_and_diversity(cell: CellResults) -> Canvas | None:
    """Above: f and its estimates, averaged over all runs, for up to `CROWD` estimators with one standard deviation of
    single runs to either side. Below: distinct values of f among the particles, one kept run."""
    labels = cell.apart([label for label in cell.labels if (label, "f") in cell.curves and (label, "f") in cell.kept])
    if not labels:
        return None
    truth = cell.kept[labels[0], "f"]
    means, spreads = {}, {}
    for label in labels:
        curve = cell.curves[label, "f"]
        runs = np.maximum(curve.active, 1)
        bias = curve.error / runs
        means[label] = (curve.time, np.interp(curve.time, truth.time, truth.truth) + bias)
        spreads[label] = np.sqrt(np.maximum(curve.squared / runs - bias**2, 0.0))
    diverse = {label: cell.kept[label, "diversity"] for label in labels if (label, "diversity") in cell.kept}
    names = ["true f", *labels]
    room = legend_height(names, cell.width - 8)
    canvas = Canvas(14 + 120 + (92 if diverse else 0) + 26 + room, f"Parameter f, {cell.key}", cell.width)
    x = spanning(truth.time, log=False, margin=0.0)
    panel = Panel(canvas, LEFT, 14, cell.width - LEFT - RIGHT, 120, x,
                  spanning(truth.truth, *(mean for _, mean in means.values()), log=False, margin=0.1),
                  title="f, mean estimates and their spread", x_ticks=not diverse,
                  x_label="" if diverse else "time [s]")
    for label, (time, mean) in means.items():
        use = thinned(len(time))
        if len(means) <= CROWD:
            low, high = mean - spreads[label], mean + spreads[label]
            panel.band(time[use], low[use], high[use], cell.styles[label].colour)
        panel.line(time[use], mean[use], cell.styles[label], title=label)
    panel.line(truth.time, truth.truth, Style("ink"), width=1.8, title="true f")
    if diverse:
        under = Panel(canvas, LEFT, 14 + 120 + 18, cell.width - LEFT - RIGHT, 74, x,
                      spanning(*(track.estimate for track in diverse.values()), [0.0], log=False),
                      title="distinct values of f among the particles", x_label="time [s]")
        for label, track in diverse.items():
            use = thinned(len(track.time))
            under.line(track.time[use], track.estimate[use], cell.styles[label], width=0.8, title=label)
    legend(canvas, room, [("true f", Style("ink")), *((label, cell.styles[label]) for label in labels)])
    return canvas
