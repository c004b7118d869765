"""Axes on a canvas: linear and logarithmic scales with round ticks, lines, bands, boxes, markers, legends.

Only what the suite's figures need; all of it in points on a column-wide canvas."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ....scenarios.arrays import Array
from .canvas import FONT, Canvas, text_width

DASHES: tuple[tuple[float, ...], ...] = ((), (4.0, 1.6), (1.3, 1.3), (6.0, 1.5, 1.3, 1.5), (2.5, 2.5))
LEFT, RIGHT = 36.0, 6.0
"""Room beside a panel, for its numbers and for half of the last one under it."""
MARKERS = ("circle", "square", "triangle", "diamond", "down")
_SHAPES: dict[str, Array] = {
    "circle": np.column_stack([np.cos(np.arange(8) * np.pi / 4), np.sin(np.arange(8) * np.pi / 4)]),
    "square": np.array([[-0.88, -0.88], [0.88, -0.88], [0.88, 0.88], [-0.88, 0.88]]),
    "triangle": np.array([[0.0, -1.15], [1.05, 0.8], [-1.05, 0.8]]),
    "diamond": np.array([[0.0, -1.25], [1.25, 0.0], [0.0, 1.25], [-1.25, 0.0]]),
    "down": np.array([[0.0, 1.15], [1.05, -0.8], [-1.05, -0.8]]),
}


@dataclass(frozen=True)
class Style:
    """How an estimator looks everywhere: series colour, dash of its lines, marker."""

    colour: str
    dash: tuple[float, ...] = ()
    marker: str = "circle"


@dataclass(frozen=True)
class Scale:
    """A range of values, linear or logarithmic."""

    low: float
    high: float
    log: bool = False

    def share(self, values: ArrayLike) -> Array:
        """Where values lie between low (0) and high (1), clipped to that."""
        v = np.asarray(values, dtype=np.float64)
        if self.log:
            v = np.log(np.maximum(v, self.low * 1e-6))
            low, high = np.log(self.low), np.log(self.high)
        else:
            low, high = self.low, self.high
        return np.clip((v - low) / (high - low), 0.0, 1.0)

    def ticks(self, most: int) -> list[float]:
        """Round values inside the range, at most about `most`."""
        if not self.log:
            return _linear_ticks(self.low, self.high, most)
        first, last = int(np.ceil(np.log10(self.low) - 1e-9)), int(np.floor(np.log10(self.high) + 1e-9))
        decades = last - first + 1
        if decades >= 2:
            stride = -(-decades // most)
            return [10.0**e for e in range(first, last + 1) if (e - first) % stride == 0]
        steps = [m * 10.0**e for e in range(first - 1, last + 1) for m in (1, 2, 3, 5, 7)]
        inside = [s for s in steps if self.low * (1 - 1e-9) <= s <= self.high * (1 + 1e-9)]
        return inside if len(inside) >= 2 else _linear_ticks(self.low, self.high, most)


def spanning(*values: ArrayLike, log: bool | None = None, zero: bool = False, margin: float = 0.05) -> Scale:
    """The scale that holds all finite values. log None: logarithmic where positive values span a factor over 20.

    zero: a linear scale starts at 0."""
    parts = [np.asarray(v, dtype=np.float64).ravel() for v in values]
    flat = np.concatenate([part[np.isfinite(part)] for part in parts]) if parts else np.zeros(0)
    positive = flat[flat > 0]
    if log is None:
        log = bool(len(positive)) and len(positive) == len(flat) and positive.max() > 20 * positive.min()
    if log and len(positive):
        low, high = float(positive.min()), float(positive.max())
        if high < low * 1.5:
            low, high = low / 1.5, high * 1.5
        room = (high / low) ** margin
        return Scale(low / room, high * room, True)
    if not len(flat):
        return Scale(0.0, 1.0)
    low, high = float(flat.min()), float(flat.max())
    if zero:
        low, high = min(low, 0.0), max(high, 0.0)
    if high - low < 1e-12 * max(abs(high), abs(low), 1e-300):
        low, high = low - 0.5 * (abs(low) or 1.0), high + 0.5 * (abs(high) or 1.0)
    room = margin * (high - low)
    return Scale(low if zero and low == 0 else low - room, high if zero and high == 0 else high + room)


def _linear_ticks(low: float, high: float, most: int) -> list[float]:
    """Multiples of 1, 2, 2.5 or 5 times a power of ten inside the range: as many as fit, two at least."""
    base = 10.0 ** np.floor(np.log10((high - low) / most) - 1)
    fallback: list[float] = []
    for step in (m * base * scale for scale in (1, 10, 100) for m in (1, 2, 2.5, 5)):
        first, last = int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9))
        if last - first < 1:
            break
        fallback = [float(f"{i * step:.12g}") for i in range(first, last + 1)]
        if last - first + 1 <= most:
            return fallback
    return fallback


def tick_text(value: float) -> str:
    """A tick's label: short, powers of ten as such outside 0.001 .. 99999."""
    if value == 0:
        return "0"
    if 1e-3 <= abs(value) < 1e5:
        return f"{value:.6g}".replace("-", "−")
    exponent = int(np.floor(np.log10(abs(value)) + 1e-9))
    mantissa = value / 10.0**exponent
    power = "10" + str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    head = f"{mantissa:.3g}".replace("-", "−")
    return power if head == "1" else f"{head}·{power}"


class Panel:
    """A rectangle of a canvas with scales. Draws its grid and labels at once, data as asked.

    whole: x counts something, so its ticks are whole numbers."""

    def __init__(self, canvas: Canvas, left: float, top: float, width: float, height: float, x: Scale, y: Scale, *,
                 title: str = "", x_label: str = "", x_ticks: bool = True, y_ticks: bool = True,
                 whole: bool = False) -> None:
        self.canvas, self.x, self.y = canvas, x, y
        self.left, self.top, self.width, self.height = left, top, width, height
        bottom = top + height
        if title:
            canvas.text(left, top - 4, title, bold=True)
        rows = y.ticks(max(2, int(height // 18))) if y_ticks else []
        columns = [value for value in x.ticks(max(2, int(width // (16 if whole else 34))))
                   if not whole or value == round(value)]
        for value in rows:
            canvas.path([(left, self._down(value)), (left + width, self._down(value))], stroke="grid", width=0.5)
        for value in columns:
            canvas.path([(self._across(value), top), (self._across(value), bottom)], stroke="grid", width=0.5)
        for value in rows:
            canvas.text(left - 3, self._down(value) + 2.8, tick_text(value), anchor="end", colour="muted",
                        size=FONT - 0.5)
        free = 0.0  # where a tick's text may begin
        for value in columns if x_ticks else ():
            text = tick_text(value)
            half = text_width(text, FONT - 0.5) / 2
            at = min(self._across(value), canvas.width - half)
            if at - half >= free:
                canvas.text(at, bottom + 9, text, anchor="middle", colour="muted", size=FONT - 0.5)
                free = at + half + 1.5
        canvas.path([(left, bottom), (left + width, bottom)], stroke="muted", width=0.6)
        canvas.path([(left, top), (left, bottom)], stroke="muted", width=0.6)
        if x_label:
            middle = min(left + width / 2, canvas.width - text_width(x_label) / 2)
            canvas.text(middle, bottom + (19 if x_ticks else 10), x_label, anchor="middle", colour="muted")

    def _across(self, value: float) -> float:
        return self.left + float(self.x.share(value)) * self.width

    def _down(self, value: float) -> float:
        return self.top + (1 - float(self.y.share(value))) * self.height

    def points(self, xs: ArrayLike, ys: ArrayLike) -> Array:
        """Canvas points (n, 2) of data points."""
        return np.column_stack([self.left + self.x.share(xs) * self.width,
                                self.top + (1 - self.y.share(ys)) * self.height])

    def line(self, xs: ArrayLike, ys: ArrayLike, style: Style, *, width: float = 1.0, title: str = "") -> None:
        """A line, broken where y is not a number."""
        xs, ys = np.asarray(xs, dtype=np.float64), np.asarray(ys, dtype=np.float64)
        good = np.isfinite(xs) & np.isfinite(ys)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(np.int8), [0]])))
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            self.canvas.path(self.points(xs[begin:end], ys[begin:end]), stroke=style.colour, width=width,
                             dash=style.dash, title=title)
        if style.colour[1:].isdigit() and good.sum() > 12:
            begin = 7 * int(style.colour[1:]) + 3 * MARKERS.index(style.marker)  # so that they seldom lie on each other
            places = np.flatnonzero(good)
            for place in places[(begin + len(places) * np.arange(3) // 3) % len(places)]:
                draw_marker(self.canvas, self._across(float(xs[place])), self._down(float(ys[place])), style, 1.6)

    def band(self, xs: ArrayLike, low: ArrayLike, high: ArrayLike, colour: str, opacity: float = 0.18) -> None:
        """The area between two curves."""
        xs, low, high = (np.asarray(v, dtype=np.float64) for v in (xs, low, high))
        good = np.isfinite(xs) & np.isfinite(low) & np.isfinite(high)
        if good.sum() > 1:
            outline = np.concatenate([self.points(xs[good], high[good]), self.points(xs[good], low[good])[::-1]])
            self.canvas.path(outline, stroke=None, fill=colour, opacity=opacity)

    def level(self, value: float, *, colour: str = "muted", dash: tuple[float, ...] = (2, 2)) -> None:
        """A horizontal line across."""
        at = self._down(value)
        self.canvas.path([(self.left, at), (self.left + self.width, at)], stroke=colour, width=0.7, dash=dash)

    def names(self, xs: ArrayLike, texts: Sequence[str]) -> None:
        """Words under the x axis where it has no numbers."""
        for x, text in zip(np.asarray(xs, dtype=np.float64), texts, strict=True):
            self.canvas.text(self._across(float(x)), self.top + self.height + 9, text, anchor="middle", colour="muted",
                             size=FONT - 0.5)

    def mark(self, x: float, y: float, style: Style, *, size: float = 2.8, title: str = "") -> None:
        """A marker at a data point."""
        draw_marker(self.canvas, self._across(x), self._down(y), style, size, title)


class Sheet:
    """Panels one under another on a canvas of their own, with a legend at its foot. heights: of the panels; foot: room
    under the last one, which alone says what x is."""

    def __init__(self, title: str, width: float, heights: Sequence[float], entries: Sequence[tuple[str, Style]] = (), *,
                 x_label: str = "time [s]", gap: float = 18.0, foot: float = 26.0) -> None:
        self.room = legend_height([label for label, _ in entries], width - 8)
        self.canvas = Canvas(14 + sum(heights) + gap * (len(heights) - 1) + foot + self.room, title, width)
        self.entries, self.x_label, self.gap, self.top, self.left = entries, x_label, gap, 14.0, list(heights)

    def panel(self, x: Scale, y: Scale, title: str, **looks: Any) -> Panel:
        """The next one; looks: as `Panel` takes them."""
        height = self.left.pop(0)
        usual = {"x_ticks": not self.left, "x_label": "" if self.left else self.x_label}
        made = Panel(self.canvas, LEFT, self.top, self.canvas.width - LEFT - RIGHT, height, x, y, title=title,
                     **{**usual, **looks})
        self.top += height + self.gap
        return made

    def done(self, *, markers: bool = False) -> Canvas:
        """The canvas, with its legend."""
        legend(self.canvas, self.room, self.entries, markers=markers)
        return self.canvas


def draw_marker(canvas: Canvas, x: float, y: float, style: Style, size: float = 2.8, title: str = "") -> None:
    """A marker at a canvas point; dashed styles are hollow, so that shape and filling tell equal colours apart."""
    shape = _SHAPES[style.marker] * size + np.array([x, y])
    hollow = bool(style.dash)
    canvas.path(shape, stroke=style.colour, width=1.0, fill="paper" if hollow else style.colour, title=title)


def legend_height(labels: Sequence[str], width: float) -> float:
    """How much room `legend` takes for these labels."""
    return 11.0 * len(_rows(labels, width)) + 2.0 if labels else 0.0


def legend(canvas: Canvas, room: float, entries: Sequence[tuple[str, Style]], *, markers: bool = False) -> None:
    """Entries in rows at the foot of a figure, in a room that `legend_height` told: a piece of line (or the marker) and
    the label."""
    left, top, width = 4.0, canvas.height - room, canvas.width - 8
    styles = dict(entries)
    for number, row in enumerate(_rows([label for label, _ in entries], width)):
        x, y = left, top + 11.0 * number + 7
        for label in row:
            style = styles[label]
            if markers:
                draw_marker(canvas, x + 7, y - 2.6, style)
            else:
                canvas.path([(x, y - 2.6), (x + 15, y - 2.6)], stroke=style.colour, width=1.4, dash=style.dash)
                if style.colour[1:].isdigit():
                    draw_marker(canvas, x + 7.5, y - 2.6, style, 1.8)
            canvas.text(x + 18, y, label)
            x += 26 + text_width(label)


def _rows(labels: Sequence[str], width: float) -> list[list[str]]:
    rows: list[list[str]] = [[]]
    used = 0.0
    for label in labels:
        need = 26 + text_width(label)
        if rows[-1] and used + need - 8 > width:
            rows.append([])
            used = 0.0
        rows[-1].append(label)
        used += need
    return rows
