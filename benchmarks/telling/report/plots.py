"""The page's own drawings: a ranked plot of a quantity, with the ratio to the best beside it, and errors over time.

Inline SVG in the page's classes; every number drawn is one of the verdict table, or of the curves."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from html import escape

import numpy as np

from ....scenarios.arrays import Array
from ...judging.family import MARGIN
from ..figures.axes import Scale, tick_text
from ..figures.data import CellResults
from ..figures.errors import binned_rms
from ..marks import Line, drawn, mark
from ..rankings import Ranking
from ..sentences import floor_name, least, title_of
from ..wording import change, number, value_of

ROW, TOP, BOTTOM = 20, 24, 20
LEFT_WIDTH, RIGHT_WIDTH = 356, 236
LETTER, VALUE_ROOM, WORD_ROOM = 6.5, 62, 66
FAR = 8.0
"""Ratios beyond this are drawn as an arrow."""
SHAPES = {"best": "m-5 0l5-5 5 5-5 5z", "worse": "m-5 4l5-9 5 9z"}
CIRCLE = "m-4 0a4 4 0 1 0 8 0 4 4 0 1 0-8 0z"
"""Markers: circles but for those."""
CURVE_POINTS = 65


def ranked(ranking: Ranking) -> str:
    """Both panels: entries with value and interval of their own; ratios to the best with their simultaneous ones."""
    lines = [line for line in ranking.lines if drawn(line)]
    height = TOP + ROW * len(lines) + BOTTOM
    said = escape(least(ranking))
    return (f'<svg viewBox="0 0 {LEFT_WIDTH} {height}" width="{LEFT_WIDTH}" height="{height}" role="img" '
            f'aria-label="{said}">{_values(ranking, lines, height)}</svg>'
            f'<svg class="ratio" viewBox="0 0 {RIGHT_WIDTH} {height}" width="{RIGHT_WIDTH}" height="{height}" '
            f'aria-hidden="true">{_ratios(ranking, lines, height)}</svg>')


def _scale(values: Sequence[float], log_from: float, floor: float = 0.0) -> Scale:
    good = [v for v in values if np.isfinite(v) and v > floor]
    if not good:
        return Scale(0.0, 1.0)
    low, high = min(good), max(good)
    if high / low >= log_from:
        return Scale(low / (high / low) ** 0.04, high * (high / low) ** 0.04, True)
    room = 0.06 * (high - low) or 0.1 * high
    return Scale(max(low - room, 0.0), high + room)


def _values(ranking: Ranking, lines: Sequence[Line], height: int) -> str:
    left = 18 + LETTER * max(len(str(line["estimator"])) for line in lines) + 6
    right = LEFT_WIDTH - VALUE_ROOM
    shown = [line[name] * line["factor"] for line in lines if line["runs"] for name in ("value", "low", "high")]
    floors = [line["floor"] * line["factor"] for line in lines[:1] if floor_name(line)]
    scale = _scale([*shown, *floors], 4.0)
    title = title_of(ranking)
    out = [f'<text class="h" y="10">{escape(title)}{", log" if scale.log else ""}</text>',
           _grid(scale, left, right, height)]
    for value in floors:
        x = left + float(scale.share(value)) * (right - left)
        out.append(f'<path class="floor" d="M{x:.1f} {TOP - 4}V{height - BOTTOM}"/><text class="f" x="{x:.1f}" '
                   f'y="{TOP - 6}" text-anchor="middle">{floor_name(lines[0])} {number(value)}</text>')
    values, placed = [], []
    for i, line in enumerate(lines):
        y, sign = TOP + ROW * i + ROW / 2, mark(line)
        out.append(f'<text y="{y + 4:g}">{sign.sign}<tspan x="16">{escape(str(line["estimator"]))}</tspan></text>')
        if not line["runs"]:
            continue
        text = value_of(line) + (f" of {line['runs']}" if line["lost"] else "")
        values.append(f'<text y="{y + 4:g}">{text}</text>')
        if drawn(line) != "lost" and (line["value"] > 0 or not scale.log):
            at = [left + float(scale.share(line[name] * line["factor"])) * (right - left - 6) for name in
                  ("value", "low", "high")]
            placed.append((line, at[0], at[1], at[2], y))
    return f'{"".join(out)}<g class="e" transform="translate({LEFT_WIDTH})">{"".join(values)}</g>{_markers(placed)}'


def _ratios(ranking: Ranking, lines: Sequence[Line], height: int) -> str:
    ranked = [line for line in lines if line in ranking.ranked and drawn(line) != "lost" and np.isfinite(line["ratio"])]
    if ranking.best is None or not ranked:
        return ""
    right = RIGHT_WIDTH - WORD_ROOM
    ends = [min(line[name], FAR) for line in ranked for name in ("ratio", "ratio_low", "ratio_high")]
    scale = _scale([*ends, 1 - MARGIN, 1 + MARGIN], 4.0, 1e-3)

    def x(value: float) -> float:
        return 4 + float(scale.share(value)) * (right - 8)

    out = [f'<text class="h" y="10">ratio to {escape(str(ranking.best["estimator"]))}'
           f'{", log" if scale.log else ""}</text>',
           f'<path class="band" d="M{x(1 - MARGIN):.1f} {TOP}H{x(1 + MARGIN):.1f}V{height - BOTTOM}'
           f'H{x(1 - MARGIN):.1f}z"/>',
           _grid(scale, 4, right - 4, height), f'<path class="one" d="M{x(1):.1f} {TOP}V{height - BOTTOM}"/>']
    words, placed = [], []
    for i, line in enumerate(lines):
        y, word = TOP + ROW * i + ROW / 2, ""
        if line in ranked:
            word = "" if drawn(line) == "best" else "tie" if drawn(line) == "tie" else change(line)
            if line["ratio"] > FAR:
                out.append(f'<path class="m worse" d="M{right - 10:.1f} {y - 4:g}l8 4-8 4z"/>')
            else:
                placed.append((line, x(line["ratio"]), x(line["ratio_low"]), x(min(line["ratio_high"], FAR)), y))
        elif drawn(line) == "lost":
            word = f"{line['lost']} lost"
        if word:
            words.append(f'<text y="{y + 4:g}">{word}</text>')
    return f'{"".join(out)}<g class="w" transform="translate({right + 4})">{"".join(words)}</g>{_markers(placed)}'


def _grid(scale: Scale, left: float, right: float, height: int) -> str:
    lines, texts, free = "", "", -1e9
    for value in _ticks(scale):
        at = left + float(scale.share(value)) * (right - left)
        lines += f"M{_short(at)} {TOP}V{height - BOTTOM}"
        text = tick_text(value)
        half = 3.2 * len(text)
        if at - half > free:
            texts += f'<text x="{_short(at)}" y="{height - 6}">{text}</text>'
            free = at + half + 4
    return f'<path class="g" d="{lines}"/><g class="t">{texts}</g>'


def _ticks(scale: Scale) -> list[float]:
    """Three to five ticks of 1, 2 and 5 where a logarithmic scale has them; else the scale's own."""
    if scale.log:
        powers = range(int(np.floor(np.log10(scale.low))), int(np.ceil(np.log10(scale.high))) + 1)
        for mantissas in ((1,), (1, 3), (1, 2, 5)):
            found = [m * 10.0**power for power in powers for m in mantissas
                     if scale.low <= m * 10.0**power <= scale.high]
            if len(found) >= 3:
                return found[::-(-len(found) // 5)]
    return scale.ticks(4)


def _markers(placed: Sequence[tuple[Line, float, float, float, float]]) -> str:
    """Lines with where value, low and high end and their row are: bars under markers, a path a verdict."""
    bars, shapes = defaultdict[str, str](str), defaultdict[str, str](str)
    for line, at, low, high, y in placed:
        word = drawn(line)
        if np.isfinite(low + high):
            bars[word] += f"M{_short(low)} {y:g}H{_short(high)}"
        shapes[word] += f"M{_short(at)} {y:g}{SHAPES.get(word, CIRCLE)}"
    return "".join(f'<path class="{kind} {word}" d="{path}"/>' for kind, found in (("i", bars), ("m", shapes))
                   for word, path in found.items())


def _short(value: float) -> str:
    return f"{round(value, 1):g}"


def curves(cell: CellResults, ranking: Ranking) -> tuple[str, int]:
    """Root mean square error over time, a panel an entry in the order of the table, shared axes, behind each the
    best's; and how many panels. Empty without curves of the quantity."""
    found: dict[str, tuple[Array, Array]] = {}
    for line in ranking.lines:
        curve = cell.curves.get((line["estimator"], ranking.quantity))
        if curve is not None and curve.active.max(initial=0.0) > 0:
            time, root, _, _ = binned_rms(curve)
            if np.isfinite(root).any():
                stride = -(-len(time) // CURVE_POINTS)
                found[str(line["estimator"])] = time[::stride], root[::stride] * line["factor"]
    if not found:
        return "", 0
    sizes = np.concatenate([root for _, root in found.values()])
    sizes = sizes[np.isfinite(sizes) & (sizes > 0)]
    if not len(sizes):
        return "", 0
    low, high = max(float(sizes.min()), float(sizes.max()) / 1e4), float(sizes.max())
    scale = Scale(low, high, True) if high / low > 8 else Scale(0.0, high)
    begin, end = min(t[0] for t, _ in found.values()), max(t[-1] for t, _ in found.values())
    wide, tall = 150.0, 66.0
    best = str(ranking.best["estimator"]) if ranking.best else ""
    name = f"c-{cell.scenario}-{cell.variant}"

    def path(label: str) -> str:
        time, root = found[label]
        x = np.rint(wide * (time - begin) / max(end - begin, 1e-12)).astype(int)
        y = np.rint(tall * (1 - scale.share(root))).astype(int)
        good = np.isfinite(root)
        points = np.column_stack([x[good], y[good]])
        steps = " ".join(f"{a} {b}" for a, b in np.diff(points, axis=0).tolist()).replace(" -", "-")
        return f"M{points[0, 0]} {points[0, 1]}l{steps or '0 0'}"

    behind = f'<path class="b" d="{path(best)}"/>' if best in found else ""
    ground = (f'<g id="{name}"><path class="g" d="M0 0V{tall:g}H{wide:g}"/>'
              f'<text class="t" x="-3" y="7" text-anchor="end">{tick_text(float(f"{scale.high:.2g}"))}</text>'
              f'<text class="t" x="-3" y="{tall:g}" text-anchor="end">{tick_text(float(f"{scale.low:.2g}"))}</text>'
              f'<text class="t" x="{wide:g}" y="{tall + 12:g}" text-anchor="end">'
              f'{tick_text(float(f"{end:.3g}"))} s</text>{behind}</g>')
    panels: list[str] = []
    for line in ranking.lines:
        label = str(line["estimator"])
        if label in found:
            size = f"{max(wide, LETTER * (len(label) + 2)) + 40:.0f}", f"{tall + 32:.0f}"
            panels.append(
                f'<svg viewBox="-34 -16 {size[0]} {size[1]}" width="{size[0]}" height="{size[1]}" role="img" '
                f'aria-label="{escape(label)}"><text y="-5">{mark(line).sign} {escape(label)}</text>'
                f'{f"""<use href="#{name}"/>""" if panels else ground}'
                f'<path class="o {drawn(line)}" d="{path(label)}"/></svg>')
    axes = (f'data-x0="{begin:.6g}" data-x1="{end:.6g}" data-y0="{scale.low:.6g}" data-y1="{scale.high:.6g}" '
            f'data-log="{int(scale.log)}"')
    return f'<div class="panels" role="group" aria-label="error over time" {axes}>{"".join(panels)}</div>', len(panels)
