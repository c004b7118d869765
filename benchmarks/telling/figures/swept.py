"""A metric over the values of a swept key, a line an estimator: beside the tables of a sweep and in its page."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from .axes import Panel, Scale, Sheet, Style, spanning
from .canvas import Canvas


def over_key(part: pd.DataFrame, key: str, label: str, styles: Mapping[str, Style]) -> Canvas:
    """Lines of the verdict table of one metric, each estimator's value with its 95 % interval against the swept key;
    values that are no numbers stand side by side in the order of the sweep."""
    numbers = pd.to_numeric(part[key], errors="coerce")
    values = part[key].drop_duplicates().tolist()
    x = numbers if numbers.notna().all() else part[key].map({value: float(i) for i, value in enumerate(values)})
    value, low, high = (part[name] * part["factor"] for name in ("value", "low", "high"))
    y_scale = spanning(value[np.isfinite(value)], margin=0.08)
    if not y_scale.log:
        y_scale = spanning(low, high, margin=0.04)
    names = [name for name in styles if name in {*part["estimator"]}]
    sheet = Sheet(f"{label} over {key}", 340.0, [150.0], [(name, styles[name]) for name in names], x_label=key)
    x_scale = spanning(x, log=bool(numbers.notna().all() and (x > 0).all() and x.max() > 20 * x.min()))
    panel = sheet.panel(x_scale, y_scale, label, x_ticks=bool(numbers.notna().all()))
    if numbers.isna().any():
        _words(sheet.canvas, panel, x_scale, [str(value) for value in values])
    for name in names:
        mine = part["estimator"] == name
        panel.band(x[mine], low[mine], high[mine], styles[name].colour)
        panel.line(x[mine], value[mine], styles[name], width=1.2, title=name)
        for at, here in zip(x[mine], value[mine], strict=True):
            if np.isfinite(here):
                panel.mark(float(at), float(here), styles[name], size=1.8, title=f"{name}, {key} = {at:g}: {here:.4g}")
    return sheet.done()


def _words(canvas: Canvas, panel: Panel, scale: Scale, words: list[str]) -> None:
    """Values in words under their places."""
    for place, word in enumerate(words):
        at = panel.left + float(scale.share(place)) * panel.width
        canvas.text(min(at, canvas.width - 3 * len(word)), panel.top + panel.height + 9, word, anchor="middle",
                    colour="muted")
