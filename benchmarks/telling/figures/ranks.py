"""Critical-difference diagrams over a scenario's variants (Friedman ranks, Wilcoxon-Holm cliques; Demsar 2006)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...judging.ranks import Ranks, friedman
from ...judging.verdicts import COMPLETE
from .axes import Panel, Scale, draw_marker
from .canvas import WIDTH, Canvas
from .data import CellResults
from .errors import MOST, label_room


def rank_over_variants(cells: Sequence[CellResults], quantity: str) -> tuple[list[str], Ranks] | None:
    """Estimators that all variants share and that finished nearly all runs, with their ranks over blocks (one block is
    one run of one variant; runs of different variants are independent). None where fewer than two are left."""
    blocks: list[dict[str, np.ndarray]] = []
    oracles: set[str] = set()
    for cell in cells:
        column = next((found for found in cell.judged if found[2] == quantity), None)
        if column:
            blocks.append(cell.values(column[0]))
            oracles |= cell.oracles
    if not blocks:
        return None
    labels = [label for label in blocks[0] if label not in oracles and all(label in block for block in blocks)]
    stacked = {label: np.concatenate([block[label] for block in blocks]) for label in labels}
    labels = [label for label in labels if np.isfinite(stacked[label]).mean() >= COMPLETE]
    if len(labels) < 2:
        return None
    return labels, friedman(np.column_stack([stacked[label] for label in labels]))


def critical_difference(cells: Sequence[CellResults]) -> Canvas | None:
    """Mean ranks over all runs of all variants; bars join estimators that are not told apart."""
    names = list(dict.fromkeys(quantity for cell in cells for _, _, quantity, _ in cell.judged))[:MOST]
    found = {name: ranks for name in names if (ranks := rank_over_variants(cells, name)) and ranks[1].n > 1}
    if not found:
        return None
    step = 11.0
    left = label_room([label for labels, _ in found.values() for label in labels])
    canvas = Canvas(sum(step * len(labels) + 50 for labels, _ in found.values()), f"Ranks, {cells[0].scenario}")
    top = 14.0
    for name, (labels, ranks) in found.items():
        order = np.argsort(ranks.mean, kind="stable")
        height = step * len(labels) + 4
        bars = 5.0 * len(ranks.cliques) + 4
        panel = Panel(canvas, left, top, WIDTH - left - bars - 4, height, Scale(0.8, len(labels) + 0.2), Scale(0, 1),
                      y_ticks=False, whole=True, x_label=f"mean rank, {name} (1 is best)")
        for place, index in enumerate(order):
            y, label = top + 2 + step * (place + 0.5), labels[index]
            x = panel.points([ranks.mean[index]], [0])[0, 0]
            canvas.path([(left, y), (x, y)], stroke="grid", width=0.7)
            draw_marker(canvas, x, y, cells[0].styles[label], title=f"{label}: {ranks.mean[index]:.2f}")
            canvas.text(left - 4, y + 2.8, label, anchor="end")
        places = {int(index): place for place, index in enumerate(order)}
        for number, clique in enumerate(ranks.cliques):
            rows = [places[member] for member in clique]
            x = WIDTH - bars + 5 * number + 2
            ends = [top + 2 + step * (end + 0.5) for end in (min(rows), max(rows))]
            canvas.path([(x, ends[0] - 3), (x, ends[1] + 3)], stroke="ink", width=2.4,
                        title="not told apart: " + ", ".join(labels[member] for member in clique))
        top += height + 46
    return canvas
