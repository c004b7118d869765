"""Critical-difference diagrams over a scenario's variants (Friedman ranks, Nemenyi cliques; Demsar 2006)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from ...judging.ranks import over_settings
from ..wording import number
from .axes import Panel, Scale, draw_marker
from .canvas import Canvas
from .data import CellResults
from .errors import MOST, label_room


def critical_difference(cells: Sequence[CellResults]) -> Canvas | None:
    """Mean ranks over the variants, one rank each; bars join estimators that are not told apart."""
    names = list(dict.fromkeys(quantity for cell in cells for _, _, quantity, _ in cell.judged))[:MOST]
    table = pd.DataFrame([line for cell in cells for line in cell.lines])
    found = {name: ranks for name in names if (ranks := over_settings(table, name))}
    if not found:
        return None
    step, width = 11.0, cells[0].width
    left = label_room([label for labels, _ in found.values() for label in labels], width)
    canvas = Canvas(sum(step * len(labels) + 50 for labels, _ in found.values()), f"Ranks, {cells[0].scenario}", width)
    top = 14.0
    for name, (labels, ranks) in found.items():
        order = np.argsort(ranks.mean, kind="stable")
        height = step * len(labels) + 4
        bars = 5.0 * len(ranks.cliques) + 4
        panel = Panel(canvas, left, top, width - left - bars - 4, height, Scale(0.8, len(labels) + 0.2), Scale(0, 1),
                      y_ticks=False, whole=True, x_label=f"mean rank over {ranks.n} variants, {name} (Friedman p "
                      f"{number(ranks.p, 2)})")
        for place, index in enumerate(order):
            y, label = top + 2 + step * (place + 0.5), labels[index]
            x = panel.points([ranks.mean[index]], [0])[0, 0]
            canvas.path([(left, y), (x, y)], stroke="grid", width=0.7)
            draw_marker(canvas, x, y, cells[0].styles[label], title=f"{label}: {ranks.mean[index]:.2f}")
            canvas.text(left - 4, y + 2.8, label, anchor="end")
        places = {int(index): place for place, index in enumerate(order)}
        for place, clique in enumerate(ranks.cliques):
            rows = [places[member] for member in clique]
            x = width - bars + 5 * place + 2
            ends = [top + 2 + step * (end + 0.5) for end in (min(rows), max(rows))]
            canvas.path([(x, ends[0] - 3), (x, ends[1] + 3)], stroke="ink", width=2.4,
                        title="not told apart: " + ", ".join(labels[member] for member in clique))
        top += height + 46
    return canvas
