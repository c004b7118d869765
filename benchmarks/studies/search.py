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
        """The value at a place in [0, 1], to six digits (of 1 - x on that axis), as it is written down."""
        place = min(max(float(place), 0.0), 1.0)
        if self.scale == "choice":
            return self.choices[min(int(place * len(self.choices)), len(self.choices) - 1)]
        if self.scale == "int":
            return round(self.low + place * (self.high - self.low))
        if self.scale == "log":
            return _digits(math.exp(math.log(self.low) + place * math.log(self.high / self.low)))
        if self.scale == "log1m":
            return 1.0 - _digits(math.exp(math.log(1 - self.low) + place * math.log((1 - self.high) / (1 - self.low))))
        return _digits(self.low + place * (self.high - self.low))


def _digits(value: float) -> float:
    return float(f"{value:.6g}")


@dataclass
class Found:
    """What a search came to. places (n, axes), losses and broken (n,): all evaluations in their order; broken: by how
    much constraints were, at most 0 where they were kept. edge: keys of axes whose optimum lies at a limit."""

    values: dict[str, Any]
    loss: float
    places: list[tuple[float, ...]] = field(default_factory=list)
    losses: list[float] = field(default_factory=list)
    broken: list[float] = field(default_factory=list)
    edge: list[str] = field(default_factory=list)

    def rank(self, i: int) -> tuple[float, float]:
        """By which evaluations are compared: the least is the best."""
        return (max(self.broken[i], 0.0) if math.isfinite(self.losses[i]) else math.inf), self.losses[i]


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
        except (tomllib.TOMLDecodeError, RecursionError):
            return Axis(keys, scale="choice", choices=tuple(span.split("|")))
    least, most, scale = _limits(span, wrong)
    scale = scale or "linear"
    if scale not in ("linear", "log", "log1m", "int") or not (least < most and math.isfinite(most - least)):
        raise InputError(wrong)
    if (scale == "log" and least <= 0) or (scale == "log1m" and most >= 1):
        raise InputError(f"--over {text}: {scale} needs " + ("LOW above 0" if scale == "log" else "HIGH below 1"))
    return Axis(keys, least, most, scale)


@dataclass(frozen=True)
class Constraint:
    """What an evaluation must keep: the mean over the runs of a metric within [low, high]."""

    metric: str
    quantity: str
    low: float
    high: float

    def broken(self, value: float) -> float:
        """By what share of its limit a value lies outside, less than 0 within. NaN lies infinitely far outside."""
        if not math.isfinite(value):
            return math.inf
        beyond = [sign * (value - limit) / (abs(limit) or 1.0)
                  for sign, limit in ((-1.0, self.low), (1.0, self.high)) if math.isfinite(limit)]
        return max(beyond, default=-1.0)


def parse_constraint(text: str) -> Constraint:
    """`METRIC:QUANTITY=LOW..HIGH`, either limit left out for none. Raises InputError."""
    name, equals, span = text.partition("=")
    metric, colon, quantity = name.strip().partition(":")
    wrong = f"--subject-to {text}: expected METRIC:QUANTITY=LOW..HIGH, such as nees:state=0.8..1.25"
    if not equals or not colon or not metric or not quantity:
        raise InputError(wrong)
    low, high, scale = _limits(span, wrong, open_=True)
    if scale or not low <= high:
        raise InputError(wrong)
    return Constraint(metric, quantity, low, high)


def _limits(span: str, wrong: str, open_: bool = False) -> tuple[float, float, str]:
    """`LOW..HIGH:scale`; open_: either may be left out. Raises InputError."""
    bounds, _, scale = span.partition(":")
    low, dots, high = bounds.partition("..")
    try:
        if not dots or not (open_ or (low and high)):
            raise ValueError
        return float(low or "-inf"), float(high or "inf"), scale
    except ValueError:
        raise InputError(wrong) from None


def search(axes: Sequence[Axis], loss: Callable[[Mapping[str, Any]], float | tuple[float, float]],
           budget: int) -> Found:
    """The least loss in at most `budget` evaluations. loss: a number, or with it by how much constraints are broken:
    above 0 it ranks behind all that keep them. Losses that are not finite rank behind all others."""
    found = Found({}, math.inf)
    known: dict[tuple[Any, ...], int] = {}

    def at(places: Sequence[float] | Array) -> int:
        """The number of the evaluation at a point."""
        point = tuple(float(place) for place in np.atleast_1d(places))
        values = tuple(axis.at(place) for axis, place in zip(axes, point, strict=True))
        if values in known:
            return known[values]
        if len(found.losses) >= budget:
            raise _Spent
        told = {key: value for axis, value in zip(axes, values, strict=True) for key in axis.keys}
        given = loss(told)
        value, broken = given if isinstance(given, tuple) else (given, -1.0)
        known[values] = number = len(found.losses)
        found.places.append(point)
        found.losses.append(value if math.isfinite(value) else math.inf)
        found.broken.append(broken)
        return number

    with suppress(_Spent):
        _one(at, axes[0], found, budget) if len(axes) == 1 else _several(at, axes, found, budget)
    best = min(range(len(found.losses)), key=found.rank)
    found.loss = found.losses[best]
    found.values = {key: axis.at(place) for axis, place in zip(axes, found.places[best], strict=True)
                    for key in axis.keys}
    found.edge = ["+".join(axis.keys) for axis, place in zip(axes, found.places[best], strict=True)
                  if axis.scale != "choice" and (axis.at(place) in (axis.low, axis.high)
                                                 or not 1e-3 < place < 1 - 1e-3)]
    return found


def _height(found: Found, number: int, constraints: bool) -> float:
    """The loss of an evaluation for an optimiser that knows numbers alone: what is infeasible, or (`constraints`)
    breaks them, is worse than the worst of the others by about their spread: its picture of the loss stays smooth."""
    value, broken = found.losses[number], found.broken[number] if constraints else -1.0
    if math.isfinite(value) and broken <= 0:
        return value
    fine = [one for one, off in zip(found.losses, found.broken, strict=True)
            if math.isfinite(one) and (off <= 0 or not constraints)]
    worst, spread = max(fine, default=1.0), max(fine, default=1.0) - min(fine, default=0.0)
    return worst + (spread or 1.0) * (1 + min(broken, 1.0) if math.isfinite(value) else 1.0 + constraints)


def _one(at: Callable[[Sequence[float]], int], axis: Axis, found: Found, budget: int) -> None:
    from scipy.optimize import minimize_scalar

    if axis.scale == "choice":
        for i in range(len(axis.choices)):
            at([(i + 0.5) / len(axis.choices)])
        return
    grid = np.linspace(0.0, 1.0, min(GRID, budget))
    best = int(min(range(len(grid)), key=lambda i: found.rank(at([grid[i]]))))
    low, high = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    minimize_scalar(lambda place: _height(found, at([place]), True), bounds=(low, high), method="bounded",
                    options={"xatol": 2e-3})


def _several(at: Callable[[Array], int], axes: Sequence[Axis], found: Found, budget: int) -> None:
    from scipy.optimize import NonlinearConstraint, minimize
    from scipy.stats import qmc

    points = qmc.Sobol(len(axes), scramble=False).random(SOBOL)
    points = np.vstack([np.full(len(axes), 0.5), points[1:]])
    best = min(points, key=lambda point: found.rank(at(point)))
    kept: Any = NonlinearConstraint(lambda point: np.array([min(found.broken[at(point)], 1.0)]), -np.inf, 0.0)
    minimize(lambda point: _height(found, at(point), False), best, method="COBYQA", bounds=[(0.0, 1.0)] * len(axes),
             constraints=[kept] if any(broken != -1.0 for broken in found.broken) else [],
             options={"initial_tr_radius": 0.12, "final_tr_radius": 1e-3, "maxfev": max(budget - SOBOL, 1)})
