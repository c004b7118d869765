"""Numbers and short phrases for tables, verdicts and the report: few digits, shown units, no false precision."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np


def number(value: float, digits: int = 3) -> str:
    """A number with `digits` significant digits; powers of ten outside 0.001 .. 99999."""
    if not np.isfinite(value):
        return "–" if np.isnan(value) else "∞" if value > 0 else "−∞"
    if value == 0:
        return "0"
    if 1e-3 <= abs(value) < 1e5:
        places = max(0, digits - 1 - int(np.floor(np.log10(abs(value)))))
        return f"{value:.{places}f}".replace("-", "−")
    mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
    return f"{mantissa}·10{_raised(int(exponent))}".replace("-", "−")


def _raised(exponent: int) -> str:
    return str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def rough(value: float) -> str:
    """A factor with two significant digits: 3400, 12, 0.85."""
    return number(float(f"{value:.2g}"), 2) if np.isfinite(value) else number(value)


def with_error(value: float, error: float) -> str:
    """`0.1234 ± 0.0021`: the error with two digits, the value to the same place; powers of ten outside 0.001 .. 99999.
    The value alone where the error is none, or rounding."""
    if not np.isfinite(error) or error <= 1e-9 * abs(value):
        return number(value)
    power = int(np.floor(np.log10(max(abs(value), error))))
    scale = 0 if -4 < power < 5 else power
    value, error = value / 10.0**scale, error / 10.0**scale
    places = int(np.clip(1 - np.floor(np.log10(error)), 0, 8))
    text = f"{value:.{places}f} ± {error:.{places}f}"
    return (f"({text})·10{_raised(scale)}" if scale else text).replace("-", "−")


def plus_minus(line: Mapping[str, Any]) -> str:
    """A line of the verdict table as `with_error` of its value and half of its 95 % interval, in its shown unit."""
    factor = line["factor"]
    return with_error(line["value"] * factor, (line["high"] - line["low"]) / 2 * factor)


def bracket(name: str, unit: str) -> str:
    """`name [unit]`, or the name alone where there is no unit."""
    return f"{name} [{unit}]" if unit else name


def ratio(value: float) -> str:
    """A ratio of errors: three decimals within 1 % of 1 (so that 1.002 is not 1), two under 10, one under 100."""
    if not np.isfinite(value):
        return number(value)
    return f"{value:.{3 if 0 < abs(value - 1) < 0.01 else 2 if value < 10 else 1 if value < 100 else 0}f}"


def percent(share: float, digits: int = 2) -> str:
    """A share in per cent: never 100 % or 0 % unless it is exactly that."""
    if not np.isfinite(share):
        return "–"
    value = 100 * share
    if value in (0.0, 100.0):
        return f"{value:.0f} %"
    places = 0 if 10 <= value < 90 else 1
    text = f"{value:.{places}f}"
    while 0 < value < 100 and text.rstrip("0").rstrip(".") in ("100", "0") and places < 4:
        places += 1
        text = f"{value:.{places}f}"
    return f"{text} %"


def change(line: Mapping[str, Any]) -> str:
    """A ratio of errors as a change: `+12 %`, or as a factor where it is large."""
    return _change(line["ratio"] - 1)


def change_range(ratios: Sequence[float]) -> str:
    """`change` of several: once where they look the same, else `+39 to +41 %` or `2.8 to 75 times`."""
    least, most = min(ratios) - 1, max(ratios) - 1
    if most >= 2 > least:
        return f"{number(least + 1, 2)} to {_change(most)}"
    ends = [_change(least), _change(most)]
    if ends[0] == ends[1]:
        return ends[0]
    common = next((unit for unit in (" %", " times") if all(end.endswith(unit) for end in ends)), "")
    return f"{ends[0].removesuffix(common)} to {ends[1]}"


def change_interval(line: Mapping[str, Any]) -> str:
    """`+12 % [10, 14]`: the change with its interval."""
    value, low, high = (line[name] for name in ("ratio", "ratio_low", "ratio_high"))
    if not np.isfinite(value) or low == high == 1:
        return change(line)
    if value >= 3:
        return f"{change(line)} [{number(low, 2)}, {number(high, 2)}]"
    return f"{change(line)} [{_bare(low - 1)}, {_bare(high - 1)}]"


def _change(relative: float) -> str:
    if not np.isfinite(relative):
        return "–" if np.isnan(relative) else "∞"
    if relative >= 2:
        return f"{number(relative + 1, 2)} times"
    sign = "+" if relative > 0 else "−" if relative < 0 else "±"
    return f"{sign}{_bare(abs(relative))} %"


def _bare(relative: float) -> str:
    """A share in per cent; never rounded to 0 where it is not."""
    value = 100 * relative
    if not np.isfinite(value):
        return "∞" if value > 0 else "–"
    places = 0 if abs(value) >= 9.95 else 1
    while value and places < 4 and not float(f"{value:.{places}f}"):
        places += 1
    text = f"{value:.{places}f}"
    return (text if float(text) else "0.0").replace("-", "−")


def numeric(values: Sequence[object]) -> bool:
    """Whether a table's column of texts holds numbers (or nothing), and so is set to the right."""
    return all(str(value)[:1] in "0123456789-−+.∞–(" for value in values)


def metric_name(metric: str) -> str:
    """A metric as tables and figures call it: abbreviations in capitals."""
    return metric.upper() if metric in ("rmse", "mae") else metric


def listing(names: Sequence[str]) -> str:
    """`a`, `a and b`, `a, b and c`."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else list(names))


def some(names: Sequence[str], most: int = 4) -> str:
    """`listing`, with `9 others` for what goes beyond `most` names."""
    if len(names) <= most:
        return listing(names)
    return listing([*names[:most - 1], f"{len(names) - most + 1} others"])


def counted(number_of: int, noun: str) -> str:
    """`1 run`, `2 runs`."""
    return f"{number_of} {noun}" + ("" if number_of == 1 else "s")


def notes_of(variant: Mapping[str, Any]) -> list[str]:
    """What a reader of a variant's table must know: its notes, and which parameters were fitted."""
    fitted = [f"Fitted, not printed by the source: {', '.join(variant['fitted'])}."] if variant["fitted"] else []
    return [*variant["notes"], *fitted]
