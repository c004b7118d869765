"""The search behind `tune`: axes of several scales, few evaluations, the same whatever is evaluated.

One number: nine points and a bounded scalar search; two or more: Sobol points and COBYQA from the best of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from ...scenarios.arrays import Array
from ...scenarios.errors import InputError

Scale = Literal["linear", "log", "log1m", "int", "choice"]
GRID, SOBOL = 9, 16


class _Spent(Exception):
    """The budget is spent."""


@dataclass(frozen=True)
class Axis:
    """One thing that is searched. keys: dotted keys of the estimator's entry that all get its value (tied). scale:
    linear; log; log1m, the logarithm of 1 - x; int; choice, of `choices`."""

    keys: tuple[str, ...]
    low: float = 0.0
    high: float = 1.0
    scale: Scale = "linear"
    choices: tuple[Any, ...] = ()

    def at(self, place: float) -> Any:
        """The value at a place in [0, 1]."""
        place = min(max(float(place), 0.0), 1.0)
        if self.scale == "choice":
            return self.choices[min(int(place * len(self.choices)), len(self.choices) - 1)]
        if self.scale == "int":
            return round(self.low + place * (self.high - self.low))
        if self.scale == "log":
            return float(math.exp(math.log(self.low) + place * math.log(self.high / self.low)))
        if self.scale == "log1m":
            return 1.0 - float(math.exp(math.log(1 - self.low) + place * math.log((1 - self.high) / (1 - self.low))))
        return float(self.low + place * (self.high - self.low))


@dataclass
class Found:
    """What a search came to. places (n, axes) and losses (n,): all evaluations in their order; edge: keys of axes whose
    optimum lies at a limit of the search."""

    values: dict[str, Any]
    loss: float
    places: list[tuple[float, ...]] = field(default_factory=list)
    losses: list[float] = field(default_factory=list)
    edge: list[str] = field(default_factory=list)


def parse_axis(text: str) -> Axis:
    """`KEY=LOW..HIGH[:log|log1m|int]` or `KEY=A|B|C`; several keys joined by + are tied. Raises InputError."""
    import tomllib

    key, equals, span = text.partition("=")
    keys = tuple(part.strip() for part in key.split("+"))
    wrong = f"--over {text}: expected KEY=LOW..HIGH, with :log, :log1m or :int behind it, or KEY=A|B|C"
    if not equals or not all(keys):
        raise InputError(wrong)
    for part in keys:
        if part.partition(".")[0] not in ("knowledge", "parameters", "augment") or "." not in part:
            raise InputError(f"--over {part}: only what the estimator is told can be tuned, not the truth: a key of "
                             "its entry that begins with knowledge., parameters. or augment.")
    if "|" in span:
        try:
            return Axis(keys, scale="choice", choices=tuple(tomllib.loads(f"v = [{span.replace('|', ',')}]")["v"]))
        except tomllib.TOMLDecodeError:
            return Axis(keys, scale="choice", choices=tuple(span.split("|")))
    bounds, _, scale = span.partition(":")
    low, dots, high = bounds.partition("..")
    scale = scale or "linear"
    try:
        least, most = float(low), float(high)
    except ValueError:
        raise InputError(wrong) from None
    if not dots or scale not in ("linear", "log", "log1m", "int") or not (least < most and math.isfinite(most - least)):
        raise InputError(wrong)
    if (scale == "log" and least <= 0) or (scale == "log1m" and most >= 1):
        raise InputError(f"--over {text}: {scale} needs " + ("LOW above 0" if scale == "log" else "HIGH below 1"))
    return Axis(keys, least, most, scale)


def search(axes: Sequence[Axis], loss: Callable[[Mapping[str, Any]], float], budget: int) -> Found:
    """The least loss in at most `budget` evaluations. Losses that are not finite rank behind all others."""
    found = Found({}, math.inf)
    known: dict[tuple[Any, ...], float] = {}

    def at(places: Sequence[float] | Array) -> float:
        point = tuple(float(place) for place in np.atleast_1d(places))
        values = tuple(axis.at(place) for axis, place in zip(axes, point, strict=True))
        if values in known:
            return known[values]
        if len(found.losses) >= budget:
            raise _Spent
        told = {key: value for axis, value in zip(axes, values, strict=True) for key in axis.keys}
        value = loss(told)
        value = value if math.isfinite(value) else math.inf
        known[values] = value
        found.places.append(point)
        found.losses.append(value)
        if value < found.loss or not found.values:
            found.values, found.loss = told, value
        return value

    with suppress(_Spent):
        _one(at, axes[0]) if len(axes) == 1 else _several(at, axes, budget)
    best = found.places[int(np.argmin(found.losses))]
    found.edge = ["+".join(axis.keys) for axis, place in zip(axes, best, strict=True)
                  if axis.scale in ("linear", "log", "log1m") and not 1e-3 < place < 1 - 1e-3]
    return found


def _one(at: Callable[[Sequence[float]], float], axis: Axis) -> None:
    from scipy.optimize import minimize_scalar

    if axis.scale == "choice":
        for i in range(len(axis.choices)):
            at([(i + 0.5) / len(axis.choices)])
        return
    grid = np.linspace(0.0, 1.0, GRID)
    best = int(np.argmin([at([place]) for place in grid]))
    low, high = grid[max(best - 1, 0)], grid[min(best + 1, GRID - 1)]
    minimize_scalar(lambda place: min(at([place]), 1e300), bounds=(low, high), method="bounded",
                    options={"xatol": 2e-3})


def _several(at: Callable[[Sequence[float] | Array], float], axes: Sequence[Axis], budget: int) -> None:
    from scipy.optimize import minimize
    from scipy.stats import qmc

    points = qmc.Sobol(len(axes), scramble=False).random(SOBOL)
    points = np.vstack([np.full(len(axes), 0.5), points[1:]])
    losses = [at(point) for point in points]
    best = points[int(np.argmin(losses))]
    worst = max((loss for loss in losses if math.isfinite(loss)), default=1.0)
    least = min(losses)

    def ranked(point: Array) -> float:
        """Infeasible points a good deal worse than the worst one, so that the model of the loss stays smooth."""
        value = at(point)
        return value if math.isfinite(value) else worst + abs(worst - least) + 1.0

    minimize(ranked, best, method="COBYQA", bounds=[(0.0, 1.0)] * len(axes),
             options={"initial_tr_radius": 0.12, "final_tr_radius": 1e-3, "maxfev": max(budget - SOBOL, 1)})
