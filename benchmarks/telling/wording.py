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


def split_error(value: float, error: float) -> tuple[str, str]:
    """(`0.1234`, `0.0021`): the error with two digits, the value to the same place; powers of ten outside 0.001 ..
    99999. No error where it is none, or rounding."""
    if not np.isfinite(error) or error <= 1e-9 * abs(value):
        return number(value), ""
    power = int(np.floor(np.log10(max(abs(value), error))))
    scale = 0 if -4 < power < 5 else power
    value, error = value / 10.0**scale, error / 10.0**scale
    places = int(np.clip(1 - np.floor(np.log10(error)), 0, 8))
    tail = f"·10{_raised(scale)}" if scale else ""
    return f"{value:.{places}f}{tail}".replace("-", "−"), f"{error:.{places}f}{tail}"


def halves(line: Mapping[str, Any]) -> tuple[str, str]:
    """Value and half of the 95 % interval of a line of the verdict table, in its shown unit, as `split_error`."""
    factor = line["factor"]
    return split_error(line["value"] * factor, (line["high"] - line["low"]) / 2 * factor)


def plus_minus(line: Mapping[str, Any]) -> str:
    """A line of the verdict table as `0.1234 ± 0.0021`, in its shown unit; the value alone where there is no error."""
    value, half = halves(line)
    return f"{value} ± {half}" if half else value


def value_of(line: Mapping[str, Any]) -> str:
    """A line's value in its shown unit with three digits."""
    return number(line["value"] * line["factor"])


def value_words(line: Mapping[str, Any]) -> str:
    """`0.112 ± 0.003`, shares as `95 % [84, 99]`; with the runs behind it where some are lost; nothing where there is
    no value."""
    if not line["runs"]:
        return ""
    if line["kind"] in ("share", "requirement") or line["metric"] == "coverage":
        return f"{percent(line['value'])} [{number(100 * line['low'])}, {number(100 * line['high'])}]"
    text = plus_minus(line)
    return f"{text} of {line['runs']}" if line["lost"] and line["kind"] == "error" else text


def bracket(name: str, unit: str) -> str:
    """`name [unit]`, or the name alone where there is no unit."""
    return f"{name} [{unit}]" if unit else name


def ratio(value: float, fine: bool = False) -> str:
    """A ratio of errors: two decimals under 10, one under 100. fine: three within 1 % of 1, for bounds and for what is
    called worse, so that 1.002 is not 1."""
    if not np.isfinite(value):
        return number(value)
    if value >= 1e6:  # of two runs: nobody reads so many digits
        return "over 1e6"
    return f"{value:.{3 if fine and 0 < abs(value - 1) < 0.01 else 2 if value < 9.995 else 1 if value < 99.95 else 0}f}"


def ratio_of(line: Mapping[str, Any]) -> str:
    """The ratio of a line; the best's is 1."""
    return "1" if line["verdict"] == "best" else ratio(line["ratio"], line["verdict"] in ("worse", "better"))


def ratio_interval(line: Mapping[str, Any]) -> str:
    """`[1.002, 1.29]`; nothing for the best."""
    if line["verdict"] == "best" or not np.isfinite(line["ratio_low"]):
        return ""
    return f"[{ratio(line['ratio_low'], True)}, {ratio(line['ratio_high'], True)}]"


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


def change_interval(line: Mapping[str, Any]) -> str:
    """`+12 % [+10, +14]`, `3.0 times [2.6, 3.4]`: the change with its interval."""
    value, low, high = (line[name] for name in ("ratio", "ratio_low", "ratio_high"))
    if not np.isfinite(value) or low == high:
        return change(line)
    if value >= 2:
        return f"{change(line)} [{number(low, 2)}, {number(high, 2)}]"
    return f"{change(line)} [{_signed(low - 1)}, {_signed(high - 1)}]"


def _change(relative: float) -> str:
    if not np.isfinite(relative):
        return "–" if np.isnan(relative) else "∞"
    return f"{number(relative + 1, 2)} times" if relative >= 1 else f"{_signed(relative)} %"


def _signed(relative: float) -> str:
    sign = "+" if relative > 0 else "−" if relative < 0 else "±"
    return sign + _bare(abs(relative))


def _bare(relative: float) -> str:
    """A share in per cent; never rounded to 0 where it is not."""
    value = 100 * relative
    if not np.isfinite(value):
        return "∞" if value > 0 else "–"
    if value >= 1e8:
        return "over 1e8"
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
    return {"rmse": "RMSE", "mae": "MAE", "nees": "ANEES", "nis": "NIS"}.get(metric, metric.replace("-", " "))


def capital(quantity: str) -> str:
    """A quantity at the head of a sentence; names of one letter, or of a letter and figures, keep their case."""
    return quantity if len(quantity) < 3 or not quantity[0].isalpha() else quantity[0].upper() + quantity[1:]


def some(names: Sequence[str]) -> str:
    """Names in a row; of more than five, four `and 9 others`."""
    return ", ".join(names) if len(names) <= 5 else f"{', '.join(names[:4])} and {len(names) - 4} others"


def counted(number_of: int, noun: str) -> str:
    """`1 run`, `2 runs`, `12,000 runs`."""
    return f"{number_of:,} {noun}" + ("" if number_of == 1 else "s")


def deciding(line: Mapping[str, Any]) -> str:
    """`40 runs`: about how many would decide, in tens under 1,000, then two figures; nothing where it is not known."""
    runs = line["deciding"]
    if not 0 < runs < float("inf"):
        return ""
    if runs > 1e5:
        return "more than 100,000 runs"
    return f"{-(-int(runs) // 10) * 10 if runs < 1000 else int(float(f'{runs:.2g}')):,} runs"


def notes_of(variant: Mapping[str, Any]) -> list[str]:
    """What a reader of a variant's table must know: its notes, which parameters were fitted, why its runs stopped."""
    fitted = [f"Fitted, not printed by the source: {', '.join(variant['fitted'])}."] if variant["fitted"] else []
    return [*variant["notes"], *fitted, *filter(None, [variant.get("until")])]
