"""The mean covariance under lost packets, between its bounds, over the share that arrives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ....estimators.random_access.losses import Losses
from .axes import Sheet, Style, spanning
from .canvas import Canvas

LINES = (("upper bound V", Style("muted", (4.0, 1.6))), ("E P by renewal", Style("c0")),
         ("lower bound S", Style("muted", (1.3, 1.3))))


def covariance_under_losses(found: Sequence[Losses], threshold: float, title: str) -> Canvas:
    """Traces over p, each as far as it is finite, points where they were computed; the share under which the mean grows
    without end."""
    p = np.array([item.p for item in found])
    values = [np.array([np.nan if v is None or not np.isfinite(v) else v for v in each]) for each in (
        [item.upper for item in found], [item.mean for item in found], [item.lower for item in found])]
    shown = [(name, style, y) for (name, style), y in zip(LINES, values, strict=True) if np.isfinite(y).any()]
    finite = np.concatenate([y[np.isfinite(y)] for _, _, y in shown] or [[1.0]])
    edge = [("threshold", Style("ink", (1.0, 2.0)))] if threshold > 0 else []
    sheet = Sheet(title, 340.0, [150], [*((name, style) for name, style, _ in shown), *edge],
                  x_label="share of packets that arrive")
    panel = sheet.panel(spanning(p, [threshold] if edge else [], log=False), spanning(finite, log=True),
                        "trace of the predicted covariance, mean over losses")
    for name, style in edge:
        panel.line([threshold, threshold], [finite.min(), finite.max()], style, title=f"{name}: {threshold:.4g}")
    for name, style, y in shown:
        fine = np.isfinite(y)
        panel.line(p[fine], y[fine], style, title=name)
        for x, value in zip(p[fine], y[fine], strict=True):
            panel.mark(float(x), float(value), style, size=2.0, title=f"{name}, p = {x:g}: {value:.4g}")
    return sheet.done()
