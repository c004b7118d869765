"""One kept run as an example: the truth of each quantity, and estimators' errors on it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..wording import bracket, some
from .axes import Sheet, Style, spanning
from .canvas import Canvas
from .data import CellResults
from .errors import MOST

POINTS = 90
CROWDED_OUT = 12.0
"""Errors this many times those of the best estimator leave the panel, which would show nothing else."""


def thinned(length: int, most: int = POINTS) -> NDArray[np.intp]:
    """Indices of at most `most` evenly spread steps."""
    return np.unique(np.linspace(0, length - 1, min(most, length)).astype(np.intp)) if length else np.zeros(0, np.intp)


def example_run(cell: CellResults) -> Canvas | None:
    """Truth above, errors (estimate minus truth) below, for at most three quantities (or those asked for) of a
    kept run."""
    units = cell.quantity_units()
    names = cell.chosen([name for name in units if any(
        np.isfinite(track.truth).any() for (label, key), track in cell.kept.items() if key == name and label)], MOST)
    labels = cell.apart([label for label in cell.ran if any((label, name) in cell.kept for name in names)])
    if not names:
        return None
    sheet = Sheet(f"An example run, {cell.key}", cell.width, [46.0, 74.0] * len(names), cell.styled(labels), foot=28)
    for name in names:
        unit, factor = units[name]
        tracks = {label: cell.kept[label, name] for label in labels if (label, name) in cell.kept}
        longest = max(tracks.values(), key=lambda track: len(track.time))
        x = spanning(longest.time, log=False, margin=0.0)
        use = thinned(len(longest.time))
        truth = sheet.panel(x, spanning(longest.truth * factor, log=False), bracket(f"{name}, truth", unit))
        truth.line(longest.time[use], longest.truth[use] * factor, Style("ink"))
        errors = {label: (track.time, (track.estimate - track.truth) * factor) for label, track in tracks.items()}
        largest = {label: float(np.abs(np.nan_to_num(error)).max()) for label, (_, error) in errors.items()}
        most = CROWDED_OUT * min((size for size in largest.values() if size > 0), default=0.0)
        off = [label for label, size in largest.items() if size > most]
        y = spanning(*(error for label, (_, error) in errors.items() if label not in off), log=False)
        panel = sheet.panel(x, y, bracket(f"{name}, estimate − truth", unit) + (f"; off: {some(off)}" if off else ""))
        for label, (time, error) in errors.items():
            use = thinned(len(time))
            inside = np.where((error >= y.low) & (error <= y.high), error, np.nan)
            panel.line(time[use], inside[use], cell.styles[label], width=0.8, title=label)
    return sheet.done()
