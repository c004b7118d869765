"""Figures of what a scenario requires: error and allowance, width of claims against misses, claim against error.

They follow from [[requirements]], whatever the plant."""

from __future__ import annotations

from typing import Any

import numpy as np

from ....scenarios.arrays import Array
from .axes import Scale, Sheet, Style, spanning
from .canvas import Canvas
from .data import CellResults, Kept
from .example import thinned

ROUNDING = 1e-6


def _asked(cell: CellResults, form: str) -> list[dict[str, Any]]:
    """The cell's requirements of a form."""
    return [item for item in cell.table.get("requirements", ()) if item["form"] == form]


def _tracks(cell: CellResults, quantity: str, claimed: bool = False) -> dict[str, Kept]:
    """The first kept run's trajectory of a quantity by estimator (those that claim a width only)."""
    found = {label: cell.kept[label, quantity] for label in cell.ran if (label, quantity) in cell.kept}
    return {label: track for label, track in found.items() if not claimed or np.isfinite(track.sd).any()}


def error_under_allowance(cell: CellResults) -> Canvas | None:
    """Error of the distance since the last reference over the position, with the allowance and the references."""
    asked = _asked(cell, "allowance")
    since, off = cell.kept.get(("", "since-reference")), cell.kept.get(("", "reference-error"))
    tracks = _tracks(cell, asked[0].get("quantity", "position")) if asked else {}
    if not tracks or since is None or off is None:
        return None
    first = next(iter(tracks.values()))
    away, shift = (np.interp(first.time, part.time, np.nan_to_num(part.truth, nan=0.0)) for part in (since, off))
    known = np.interp(first.time, since.time, np.isfinite(since.truth).astype(float)) > 0.5
    at, use = first.truth / 1000.0, thinned(len(first.time))
    allowed = np.where(known, asked[0]["constant"] + asked[0]["share"] * away, np.nan)
    errors = {label: np.where(known, track.estimate - track.truth - shift, np.nan) for label, track in tracks.items()}
    limit = Style("ink", (4.0, 1.6))
    sheet = Sheet(f"Error under the allowance, {cell.key}", cell.width, [150],
                  [*cell.styled([*errors]), ("allowed", limit)], x_label="position [km]")
    largest = np.abs(np.nan_to_num([*errors.values()])).max()
    highest = float(np.clip(largest, 1.2 * np.nanmax(allowed), 2.5 * np.nanmax(allowed)))
    panel = sheet.panel(spanning(at, log=False, margin=0.0), Scale(-highest, highest),
                        "error of the distance since the last balise [m]")
    panel.band(at[use], -allowed[use], allowed[use], "muted", 0.18)
    for place in np.flatnonzero(np.diff(away) < -1.0):
        panel.line([at[place + 1]] * 2, [-highest, -0.92 * highest], Style("ink"), width=1.2, title="balise")
    for label, error in errors.items():
        panel.line(at[use], error[use], cell.styles[label], width=0.8, title=label)
    for sign in (1, -1):
        panel.line(at[use], sign * allowed[use], limit, width=0.8, title="allowed")
    return sheet.done()


def width_against_misses(cell: CellResults) -> Canvas | None:
    """Median half-width of what is claimed over the share of time in which it misses the truth, an estimator a mark."""
    asked = _asked(cell, "confidence")
    name = asked[0]["name"] if asked else ""
    columns = [column for column in cell.rows.columns if column.startswith(f"half-width:{name}:")] if asked else []
    if not columns:
        return None
    inside, width = cell.values(f"inside:{name}:1"), cell.values(columns[0])
    found = {label: (1 - float(np.nanmean(inside[label])), float(np.nanmedian(width[label])),
                     float(np.isfinite(inside[label]).sum())) for label in cell.ran
             if np.isfinite(inside[label]).any()}
    if not found:
        return None
    floor = 1e-4
    sheet = Sheet(f"Width against misses, {cell.key}", cell.width, [130], cell.styled([*found]),
                  x_label=f"share of time missed (left edge: under {floor:g})", foot=28)
    panel = sheet.panel(Scale(floor / 2, 1.0, True), spanning(*([w] for _, w, _ in found.values()), margin=0.2),
                        "half-width claimed [m], median")
    target = 1 - asked[0].get("accept", 0.99)
    panel.line([target, target], [panel.y.low, panel.y.high], Style("ink", (4.0, 1.6)), width=0.7, title="asked")
    for label, (miss, half, _) in found.items():
        panel.mark(max(miss, floor / 2), half, cell.styles[label], title=f"{label}: {miss:.4g}, {half:.3g} m")
    return sheet.done(markers=True)


def claim_against_error(cell: CellResults) -> Canvas | None:
    """Stanford plot of the first kept run: the half-width claimed over the error; under the diagonal it misses."""
    asked = _asked(cell, "confidence")
    tracks = _tracks(cell, asked[0].get("quantity", "position"), claimed=True) if asked else {}
    if not tracks:
        return None
    k = float(asked[0]["k"])
    column = "coverage:ellipsoid:1"
    held = cell.values(column) if column in cell.rows else {}
    sets = {label for label, values in held.items() if np.isfinite(values).any()}  # these claim the whole of it
    pairs: dict[str, tuple[Array, Array]] = {}
    for label, track in tracks.items():
        use = thinned(len(track.time), 400)
        factor = 1.0 if label in sets else k
        pairs[label] = np.abs(track.estimate - track.truth)[use], factor * track.sd[use]
    everything = np.concatenate([np.concatenate(pair) for pair in pairs.values()])
    everything = everything[np.isfinite(everything) & (everything > ROUNDING)]
    scale = spanning(np.maximum(everything, 0.02), log=True)
    sheet = Sheet(f"Claim against error, {cell.key}", cell.width, [170], cell.styled([*pairs]),
                  x_label="|error| [m]; grey: the claim misses the truth", foot=28)
    panel = sheet.panel(scale, scale, "half-width claimed [m]")
    ends = np.array([scale.low, scale.high])
    panel.band(ends, np.full(2, scale.low), ends, "muted", 0.25)
    panel.line(ends, ends, Style("ink"), width=0.8, title="claim = error")
    for label, (error, claim) in pairs.items():
        use = np.isfinite(error + claim)
        sheet.canvas.dots(panel.points(np.maximum(error[use], scale.low), np.maximum(claim[use], scale.low)),
                          cell.styles[label].colour, 1.8)
    return sheet.done(markers=True)
