"""The mean covariance under lost packets, between its bounds, over the share that arrives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ....estimators.random_access.losses import Losses
from .axes import Panel, Style, legend, legend_height, spanning
from .canvas import Canvas
from .errors import LEFT, RIGHT

LINES = (("upper bound V", Style("muted", (4.0, 1.6))), ("E P by renewal", Style("c0")),
         ("lower bound S", Style("muted", (1.3, 1.3))))


def covariance_under_losses(found: Sequence[Losses], threshold: float, title: str) -> Canvas:
    """Traces over p, each as far as it is finite, points where they were computed; the share under which the mean grows
    without end."""
    p = np.array([item.p for item in found])
    values = [np.array([np.nan if v is None or not np.isfinite(v) else v for v in each]) for each in (
        [item.upper for item in found], [item.mean for item in found], [item.lower for item in found])]
    shown = [(name, style, y) for (name, style), y in zip(LINES, values, strict=True) if np.isfinite(y).any()]
    width, finite = 340.0, np.concatenate([y[np.isfinite(y)] for _, _, y in shown] or [np.ones(1)])
    edge = [("threshold", Style("ink", (1.0, 2.0)))] if threshold > 0 else []
    room = legend_height([name for name, *_ in [*shown, *edge]], width - 8)
    canvas = Canvas(14 + 150 + 26 + room, title, width)
    panel = Panel(canvas, LEFT, 14, width - LEFT - RIGHT, 150, spanning(p, [threshold] if edge else [], log=False),
                  spanning(finite, log=True),
                  title="trace of the predicted covariance, mean over losses", x_label="share of packets that arrive")
    for name, style in edge:
        panel.line([threshold, threshold], [finite.min(), finite.max()], style, title=f"{name}: {threshold:.4g}")
    for name, style, y in shown:
        fine = np.isfinite(y)
        panel.line(p[fine], y[fine], style, title=name)
        for x, value in zip(p[fine], y[fine], strict=True):
            panel.mark(float(x), float(value), style, size=2.0, title=f"{name}, p = {x:g}: {value:.4g}")
    legend(canvas, room, [*((name, style) for name, style, _ in shown), *edge])
    return canvas
