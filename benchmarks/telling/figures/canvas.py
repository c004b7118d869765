"""A canvas of paths and texts in points, and its three writers (SVG here, PDF and PNG through matplotlib).

Every figure is drawn on it exactly once, so that what the report shows is what `railstate plot` writes."""

from __future__ import annotations

from dataclasses import dataclass, field
from html import escape
from itertools import groupby
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ....scenarios.arrays import Array
from ..cleaning import visible

Anchor = Literal["start", "middle", "end"]

WIDTH = 252.0
"""Width of a paper's column in points (3.5 inches); on a phone it is scaled up a little."""
FONT = 8.0
NARROW, WIDE = "fijlrt -.,:()[]", "mwMW%"
"""Letters by width; the widths in `text_width` are upper estimates for the usual sans-serif fonts."""

LIGHT = {"ink": "#1b1f24", "muted": "#57606a", "grid": "#dde1e6", "paper": "#ffffff", "shade": "#cfd5dc",
         "c0": "#002daa", "c1": "#c59202", "c2": "#02b168", "c3": "#9e1b0d", "c4": "#797fff", "c5": "#5d2870",
         "c6": "#751e3a", "c7": "#a78eba"}
"""Colours by name. The eight series colours differ by at least 30 (CIE 1976) for normal sight, protanopia,
deuteranopia and tritanopia (Machado et al. 2009), and from white by a contrast of 2.8 or more."""
DARK = {"ink": "#e6e9ed", "muted": "#a3abb5", "grid": "#2d333b", "paper": "#15181c", "shade": "#3b434d",
        "c0": "#2573ff", "c1": "#ffd108", "c2": "#4df58d", "c3": "#c9801b", "c4": "#ade2d3", "c5": "#c5a7ff",
        "c6": "#c53c4a", "c7": "#6c698e"}
"""The same on a dark ground, chosen by the same rule (contrast 3.4 or more)."""
COLOURS = 8


def text_width(text: str, size: float = FONT) -> float:
    """Estimated width of a text in points, rather too much than too little."""
    return size * sum(0.41 if letter in NARROW else 0.97 if letter in WIDE else 0.63 for letter in text)


@dataclass
class _Path:
    points: Array
    stroke: str | None
    width: float
    dash: tuple[float, ...]
    fill: str | None
    opacity: float
    title: str
    dots: bool = False


@dataclass
class _Text:
    x: float
    y: float
    text: str
    size: float
    anchor: Anchor
    colour: str
    bold: bool


@dataclass
class Canvas:
    """A figure being drawn; y grows downwards. `label` is what a screen reader says. `empty` until data is drawn."""

    height: float
    label: str
    width: float = WIDTH
    items: list[_Path | _Text] = field(default_factory=list)

    def path(self, points: ArrayLike, *, stroke: str | None = "ink", width: float = 0.7,
             dash: tuple[float, ...] = (), fill: str | None = None, opacity: float = 1.0, title: str = "") -> None:
        """A polyline (closed where it is filled) through points (n, 2). title: what hovering shows."""
        array = np.asarray(points, dtype=np.float64)
        if len(array):
            self.items.append(_Path(array, stroke, width, dash, fill, opacity, title))

    def dots(self, points: ArrayLike, colour: str, size: float) -> None:
        """Round dots of a diameter at points (n, 2), as one item."""
        array = np.asarray(points, dtype=np.float64)
        if len(array):
            self.items.append(_Path(array, colour, size, (), None, 1.0, "", dots=True))

    def text(self, x: float, y: float, text: str, *, size: float = FONT, anchor: Anchor = "start",
             colour: str = "ink", bold: bool = False) -> None:
        """A text with its baseline at (x, y)."""
        self.items.append(_Text(x, y, text, size, anchor, colour, bold))

    def svg(self, *, inline: bool = False) -> str:
        """The figure as an SVG element: inline with the page's CSS colours, otherwise a file with its own.

        Coordinates are whole tenths of a point, which keeps a page with hundreds of figures small."""
        if inline:
            head = f'<svg viewBox="0 0 {self.width * 10:.0f} {self.height * 10:.0f}" role="img" ' \
                   f'aria-label="{escape(self.label)}">'
        else:
            head = (f'<svg xmlns="http://www.w3.org/2000/svg" width="{self.width:g}pt" height="{self.height:g}pt" '
                    f'viewBox="0 0 {self.width * 10:.0f} {self.height * 10:.0f}" '
                    f'font-family="Helvetica, Arial, sans-serif" fill="none" stroke-linejoin="round">'
                    f"<title>{escape(self.label)}</title>")
        colours = {name: f"var(--{name})" for name in LIGHT} if inline else LIGHT
        parts = [_svg_path(item, colours) if isinstance(item, _Path) else _svg_text(item, colours)
                 for item in self.items]
        grouped = []
        for (tag, style), same in groupby(parts, lambda part: part[:2]):
            items = [rest for _, _, rest in same]
            if tag == "path" and "fill" not in style and all(rest.endswith('"/>') for rest in items):
                items = [' d="' + "".join(rest[4:-3] for rest in items) + '"/>']  # strokes are one path
            if len(items) == 1:
                grouped.append(f"<{tag}{style}{items[0]}")
            else:  # what looks alike says so once
                grouped.append(f"<g{style}>{''.join(f'<{tag}{rest}' for rest in items)}</g>")
        return visible(head + "".join(grouped) + "</svg>")

    def save(self, path: Path) -> None:
        """Write the figure; the file's suffix (.svg, .pdf, .png) chooses the format. PNG has 300 dots per inch."""
        if path.is_symlink():  # what it leads to stays
            path.unlink()
        if path.suffix == ".svg":
            path.write_text(self.svg() + "\n", encoding="utf-8")
        else:
            _save_with_matplotlib(self, path)


def _svg_path(item: _Path, colours: dict[str, str]) -> tuple[str, str, str]:
    """The element's tag, the attributes that it may share with its neighbours, and what is its own."""
    tenths = np.rint(item.points * 10).astype(np.int64)
    if item.dots:
        moves = "".join(f"M{x} {y}h0" for x, y in np.unique(tenths, axis=0).tolist())
        return "path", (f' stroke="{colours[item.stroke or "ink"]}" stroke-width="{item.width * 10:g}" '
                        'stroke-linecap="round"'), f' d="{moves}"/>'
    if len(tenths) > 2 and item.fill is None:
        keep = np.concatenate([[True], (np.diff(tenths, axis=0) != 0).any(axis=1)])
        tenths = tenths[keep]
    steps = np.diff(tenths, axis=0)
    moves = " ".join(f"{x} {y}" for x, y in steps.tolist()).replace(" -", "-")
    data = f"M{tenths[0, 0]} {tenths[0, 1]}" + (f"l{moves}" if moves else "h0") + ("z" if item.fill else "")
    style = ""
    if item.fill:
        style += f' fill="{colours[item.fill]}"'
        if item.opacity < 1:
            style += f' fill-opacity="{item.opacity:g}"'
    if item.stroke:
        style += f' stroke="{colours[item.stroke]}" stroke-width="{item.width * 10:g}"'
        if item.dash:
            style += f' stroke-dasharray="{" ".join(f"{part * 10:g}" for part in item.dash)}"'
    return "path", style, f' d="{data}"' + (
        f"><title>{escape(item.title)}</title></path>" if item.title else "/>")


def _svg_text(item: _Text, colours: dict[str, str]) -> tuple[str, str, str]:
    """As `_svg_path`."""
    x, y = round(item.x * 10), round(item.y * 10)
    style = f' font-size="{item.size * 10:g}" fill="{colours[item.colour]}"'
    if item.anchor != "start":
        style += f' text-anchor="{item.anchor}"'
    if item.bold:
        style += ' font-weight="600"'
    return "text", style, f' x="{x}" y="{y}">{escape(item.text)}</text>'


def _save_with_matplotlib(canvas: Canvas, path: Path) -> None:
    from matplotlib import rc_context
    from matplotlib.figure import Figure
    from matplotlib.patches import Polygon

    with rc_context({"font.family": "sans-serif", "pdf.fonttype": 42}):
        figure = Figure(figsize=(canvas.width / 72, canvas.height / 72))
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set_axis_off()
        axes.set_xlim(0, canvas.width)
        axes.set_ylim(canvas.height, 0)
        for order, item in enumerate(canvas.items):
            if isinstance(item, _Text):
                align: dict[Anchor, Literal["left", "center", "right"]] = {
                    "start": "left", "middle": "center", "end": "right"}
                across = align[item.anchor]
                axes.text(item.x, item.y, item.text.replace("$", r"\$"), fontsize=item.size * 0.95,
                          color=LIGHT[item.colour], va="baseline", ha=across,
                          fontweight="bold" if item.bold else "normal", zorder=order)
                continue
            dash = (0, tuple(part / item.width for part in item.dash)) if item.dash else "solid"
            if item.dots:
                axes.plot(item.points[:, 0], item.points[:, 1], ".", color=LIGHT[item.stroke or "ink"],
                          markersize=item.width, markeredgewidth=0, zorder=order)
                continue
            if item.fill:
                axes.add_patch(Polygon(item.points, closed=True, facecolor=LIGHT[item.fill], edgecolor="none",
                                       alpha=item.opacity, zorder=order))
            if item.stroke:
                outline = np.vstack([item.points, item.points[:1]]) if item.fill else item.points
                axes.plot(outline[:, 0], outline[:, 1], color=LIGHT[item.stroke], linewidth=item.width, linestyle=dash,
                          solid_capstyle="butt", solid_joinstyle="round", zorder=order)
        figure.savefig(path, dpi=300, facecolor="white")
