"""The braking setting's own figure: the parameter f as it drifts, as it is estimated, and how many values survive."""

from __future__ import annotations

import numpy as np

from .axes import Sheet, Style, spanning
from .canvas import Canvas
from .data import CROWD, CellResults
from .example import thinned


def parameter_and_diversity(cell: CellResults) -> Canvas | None:
    """Above: f and its estimates, averaged over all runs, for up to `CROWD` estimators with one standard deviation of
    single runs to either side. Below: distinct values of f among the particles, one kept run."""
    labels = cell.apart([label for label in cell.ran if (label, "f") in cell.curves and (label, "f") in cell.kept])
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
    sheet = Sheet(f"Parameter f, {cell.key}", cell.width, [120, 74] if diverse else [120],
                  [("true f", Style("ink")), *cell.styled(labels)])
    x = spanning(truth.time, log=False, margin=0.0)
    panel = sheet.panel(x, spanning(truth.truth, *(mean for _, mean in means.values()), log=False, margin=0.1),
                        "f, mean estimates and their spread")
    for label, (time, mean) in means.items():
        use = thinned(len(time))
        if len(means) <= CROWD:
            low, high = mean - spreads[label], mean + spreads[label]
            panel.band(time[use], low[use], high[use], cell.styles[label].colour)
        panel.line(time[use], mean[use], cell.styles[label], title=label)
    panel.line(truth.time, truth.truth, Style("ink"), width=1.8, title="true f")
    if diverse:
        under = sheet.panel(x, spanning(*(track.estimate for track in diverse.values()), [0.0], log=False),
                            "distinct values of f among the particles")
        for label, track in diverse.items():
            use = thinned(len(track.time))
            under.line(track.time[use], track.estimate[use], cell.styles[label], width=0.8, title=label)
    return sheet.done()
