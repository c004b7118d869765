"""One kept run as an example: the truth of each quantity, and every estimator's error on it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .axes import Panel, Style, legend, legend_height, spanning
from .canvas import WIDTH, Canvas
from .data import Cell
from .errors import LEFT, MOST, RIGHT, bracket

POINTS = 260


def thinned(length: int, most: int = POINTS) -> NDArray[np.intp]:
    """Indices of at most `most` evenly spread steps."""
    return np.unique(np.linspace(0, length - 1, min(most, length)).astype(np.intp)) if length else np.zeros(0, np.intp)


def example_run(cell: Cell) -> Canvas | None:
    """Truth above, errors (estimate minus truth) below, for at most three quantities of the first kept run."""
    units = cell.quantity_units()
    names = [name for name in units if any(np.isfinite(track.truth).any() for (label, key), track in cell.kept.items()
                                           if key == name and label)][:MOST]
    labels = [label for label in cell.labels if any((label, name) in cell.kept for name in names)]
    if not names:
        return None
    above, below, gap = 46.0, 74.0, 18.0
    room = legend_height(labels, WIDTH - 8)
    canvas = Canvas(len(names) * (above + below + 2 * gap) + 24 + room, f"An example run, {cell.key}")
    top = 14.0
    for name in names:
        unit, factor = units[name]
        tracks = {label: cell.kept[label, name] for label in labels if (label, name) in cell.kept}
        longest = max(tracks.values(), key=lambda track: len(track.time))
        x = spanning(longest.time, log=False, margin=0.0)
        use = thinned(len(longest.time))
        truth = Panel(canvas, LEFT, top, WIDTH - LEFT - RIGHT, above, x, spanning(longest.truth * factor, log=False),
                      title=bracket(f"{name}, truth", unit), x_ticks=False)
        truth.line(longest.time[use], longest.truth[use] * factor, Style("ink"))
        errors = {label: (track.time, (track.estimate - track.truth) * factor) for label, track in tracks.items()}
        panel = Panel(canvas, LEFT, top + above + gap, WIDTH - LEFT - RIGHT, below, x,
                      spanning(*(error for _, error in errors.values()), log=False), x_ticks=name == names[-1],
                      title=bracket(f"{name}, estimate − truth", unit), x_label="time [s]" if name == names[-1] else "")
        for label, (time, error) in errors.items():
            use = thinned(len(time))
            panel.line(time[use], error[use], cell.styles[label], width=0.8, title=label)
        top += above + below + 2 * gap
    legend(canvas, 4, canvas.height - room, WIDTH - 8, [(label, cell.styles[label]) for label in labels])
    return canvas
