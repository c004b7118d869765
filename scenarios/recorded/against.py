"""Columns of a recording against each other: the integral of speed and the ways of position and odometer.

A unit that lies shows as a factor (3.6, 1000, .3048), two columns that changed places as a fit after changing back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from ..arrays import Array
from .findings import Finding

FACTORS = {3.6: "km/h and m/s", 1000.0: "km and m, or ms and s", 0.3048: "feet and m", 1.609344: "miles and km",
           0.44704: "mph and m/s", 0.514444: "knots and m/s", 60.0: "min and s", 100.0: "cm and m",
           9.80665: "g and m/s^2"}
"""Factors by which units are mistaken for each other."""
NEAR, WIDE = 0.05, 0.25
"""Within this share of a factor it is that factor; a ratio farther than this from 1 is odd."""
PARTS, LEAST = 24, 20.0
"""The trip is cut into so many parts; ways below this, m, tell nothing."""
PAIRS = (("speed", "position"), ("speed", "odometer"), ("speed", "reference_position"), ("odometer", "position"),
         ("odometer", "reference_position"), ("position", "reference_position"), ("speed", "reference_speed"),
         ("wheel-a", "wheel-b"), *((wheel, other) for wheel in ("wheel-a", "wheel-b")
                                   for other in ("position", "reference_position", "balise")),
         ("speed", "wheel-a"), ("odometer", "balise"))


def against(time: Array, columns: Mapping[str, Array]) -> Iterator[Finding]:
    """What the columns (N,) in SI by role say of each other."""
    for one, other in PAIRS:
        if one not in columns or other not in columns:
            continue
        both = way(time, columns, one), way(time, columns, other)
        ratio, together = compared(time, *both)
        if np.isnan(ratio):
            continue
        text = f"the way by {one} is {abs(ratio):.4g} times the way by {other}"
        named = _factor(abs(ratio))
        if ratio < 0 and together < -0.5:
            yield Finding("impossible", one, f"{one} and {other} go in opposite directions: a minus turns one "
                          f"(--map {one}=-COLUMN)")
        elif named:
            yield Finding("impossible", one, f"{text}: the factor between {named}: the unit of one of them is another")
        elif together < 0.5:
            swapped = _swapped(time, columns, one, other)
            yield Finding("impossible" if swapped else "odd", one,
                          f"{one} and {other} do not go together" + (": the two columns have changed places" if swapped
                                                                     else f" (correlation {together:.2f})"))
        elif abs(ratio - 1) > WIDE:
            yield Finding("odd", one, text)
    if "acceleration" in columns and {"speed", "reference_speed"} & set(columns):
        name = "speed" if "speed" in columns else "reference_speed"
        ratio, together = compared(time, _integral(time, columns["acceleration"]), columns[name], least=2.0)
        named = _factor(abs(ratio)) if together > 0.6 else ""
        if together < -0.6 and ratio < 0:
            yield Finding("odd", "acceleration", f"acceleration has the opposite sign of the change of {name}")
        elif named:
            yield Finding("impossible", "acceleration", f"the integral of acceleration is {ratio:.4g} times the change "
                          f"of {name}: the factor between {named}")


def way(time: Array, columns: Mapping[str, Array], role: str) -> Array:
    """The way (N,) in m by a column: itself, or the integral of a speed; NaN where it has no value."""
    return _integral(time, columns[role]) if "speed" in role else columns[role]


def compared(time: Array, one: Array, other: Array, least: float = LEAST) -> tuple[float, float]:
    """Ratio of one way to the other and the correlation of their increments over parts of the trip; NaN where they move
    too little to tell."""
    there = np.flatnonzero(np.isfinite(one) & np.isfinite(other))
    if len(there) < 4:
        return np.nan, np.nan
    cuts = np.unique(there[np.searchsorted(time[there], np.linspace(time[there[0]], time[there[-1]], PARTS + 1))])
    a, b = np.diff(one[cuts]), np.diff(other[cuts])
    moved = np.maximum(np.abs(a), np.abs(b))
    use = moved > 0.02 * moved.max()
    if use.sum() < 3 or np.abs(a).sum() < 1e-3 * least or np.abs(b).sum() < 1e-3 * least or moved.sum() < least:
        return np.nan, np.nan
    a, b = a[use], b[use]
    by = np.where(np.abs(b) > 0, b, np.nan)
    order = np.argsort(a / by)  # the weighted median of a / b: a place that jumps is one part of many
    weight = np.cumsum(np.abs(b)[order])
    ratio = float((a / by)[order][np.searchsorted(weight, weight[-1] / 2)])
    scaled = np.abs(ratio) * b
    total = np.sqrt((a**2).sum() * (scaled**2).sum())
    return ratio, float((a * scaled).sum() / total) if total > 0 else 0.0


def _integral(time: Array, values: Array) -> Array:
    """Integral (N,) of a column by the trapezoid rule between its values; NaN where it has none."""
    out, there = np.full(len(time), np.nan), np.isfinite(values)
    steps = 0.5 * (values[there][1:] + values[there][:-1]) * np.diff(time[there])
    out[there] = np.concatenate([[0.0], np.cumsum(steps)])
    return out


def _factor(ratio: float) -> str:
    """The units that are this factor apart, "" for none."""
    for factor, units in FACTORS.items():
        for value in (factor, 1 / factor):
            if abs(ratio / value - 1) < NEAR:
                return f"{units} ({factor:g})"
    return ""


def _swapped(time: Array, columns: Mapping[str, Array], one: str, other: str) -> bool:
    """Whether they fit after changing places."""
    changed = {one: columns[other], other: columns[one]}
    ratio, together = compared(time, way(time, changed, one), way(time, changed, other))
    return together > 0.9 and (abs(ratio - 1) < WIDE or bool(_factor(abs(ratio))))
