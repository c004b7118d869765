"""Random access's own figure: the trace of the filters' covariances between the theorems' bounds."""

from __future__ import annotations

import numpy as np

from ....estimators.random_access.bounds import CovarianceBounds
from ....scenarios.arrays import Array
from .axes import Sheet, Style, spanning
from .canvas import Canvas
from .data import CellResults
from .example import thinned


def covariance_bounds(cell: CellResults) -> CovarianceBounds | None:
    """Theorems 2 to 4 for a variant, None where its channel is not random access."""
    config = cell.setting.config
    model = cell.setting.design_model({}, np.array(config.plant.x0, dtype=float)[:, None])
    if model.linear is None or model.reception is None or not model.reception.nodes:
        return None
    return CovarianceBounds(model.linear, model.reception, model.initial_covariance[:, :, 0], config.time.steps)


BOUNDED = "random-access"
"""The plug-in whose covariance the theorems bound."""


def trace_and_bounds(cell: CellResults) -> Canvas | None:
    """Trace of P over time in a kept run, and nx times the bounds of its eigenvalues: (21) from below; from above
    mu_k of (26), as far as it is of the others' size, the sigma that the paper claims, and the least one for which
    (30), (31) hold. Other filters' covariances are bounded by none of them and are left out."""
    entries = cell.table["estimators"]
    labels = [label for label in cell.ran if (label, "trace-covariance") in cell.kept
              and entries.get(label, {}).get("plugin", label) == BOUNDED]
    bounds = covariance_bounds(cell) if labels else None
    if bounds is None:
        return None
    tracks = {label: cell.kept[label, "trace-covariance"] for label in labels}
    nx = bounds.A.shape[1]
    shown = cell.styled(labels)
    levels: list[tuple[str, float, Style]] = []
    if bounds.lower > 0:
        levels.append(("lower bound (21)", nx * bounds.lower, Style("ink", (4.0, 1.6))))
    claimed = entries[labels[0]].get("parameters", {}).get("sigma")
    if claimed:
        levels.append((f"claimed, σ = {claimed:g}", nx * float(claimed), Style("ink", (1.3, 1.3))))
    found = bounds.search()
    if found:
        levels.append((f"(30), (31) hold, σ = {found[0]:g}", nx * found[0], Style("muted", (1.3, 1.3))))
    time: Array = next(iter(tracks.values())).time
    top = 1.5 * max([value for _, value, _ in levels], default=max(float(t.estimate.max()) for t in tracks.values()))
    mu = nx * bounds.mu[1:len(time) + 1]
    rising = int(np.argmax(mu > top)) if (mu > top).any() else len(mu)
    upper = Style("muted", (4.0, 1.6))
    shown += [("upper bound μ_k (26)", upper), *((name, style) for name, _, style in levels)]
    sheet = Sheet(f"Trace of P, {cell.key}", cell.width, [130], shown)
    panel = sheet.panel(spanning(time, log=False, margin=0.0), spanning(
        *(track.estimate for track in tracks.values()), [value for _, value, _ in levels], mu[:rising + 1]),
        "trace of P and its bounds")
    for label, track in tracks.items():
        use = thinned(len(track.time))
        panel.line(track.time[use], track.estimate[use], cell.styles[label], width=0.8, title=label)
    panel.line(time[:rising + 1], mu[:rising + 1], upper, title="upper bound μ_k (26)")
    for name, value, style in levels:
        panel.line(time[[0, -1]], np.array([value, value]), style, title=name)
    return sheet.done()
