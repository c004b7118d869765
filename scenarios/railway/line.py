"""Lines (stops, limits, gradients) and trains (mass, forces, resistance), from the scenario or from TTOBench's JSON.

What a wrong file gets is one message that names the file, the entry and what is allowed."""

from __future__ import annotations

import json
import reprlib
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field, PositiveFloat, WithJsonSchema, field_validator, model_validator

from ..schema import Strict
from ..strict import key
from ..units import ACCELERATIONS, FORCES, KMH, LENGTHS, MASSES, POWERS, SHARES, SLOPES, SPEEDS
from .dynamics import GRAVITY, Forces, Slope, slope_grid

Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
Powers = Annotated[list[float], Field(min_length=5, max_length=5)]


class Line(Strict):
    """A line along its own coordinate."""

    stops: Annotated[list[float], Field(min_length=2), key("places of the stops, the first is the start", "m")]
    speed_limits: Annotated[list[Pair], Field(min_length=1), key("limit from each place on", "[m, m/s]")]
    gradients: Annotated[list[Pair], Field(min_length=1), key("rise from each place on", "[m, m/m]")]

    @field_validator("stops")
    @classmethod
    def _forwards(cls, stops: list[float]) -> list[float]:
        if any(b <= a for a, b in pairwise(stops)):
            raise ValueError("stops must lie one after another, each farther along the line")
        return stops

    @field_validator("speed_limits", "gradients")
    @classmethod
    def _ordered(cls, pairs: list[list[float]]) -> list[list[float]]:
        for (a, _), (b, _) in pairwise(pairs):
            if b < a + 0.1:
                raise ValueError(f"positions must increase by at least 0.1 m, but {b:g} m follows {a:g} m")
        return pairs

    @model_validator(mode="after")
    def _covered(self) -> Line:
        for name in ("speed_limits", "gradients"):
            pairs: list[list[float]] = getattr(self, name)
            if pairs and pairs[0][0] > self.stops[0]:
                raise ValueError(f"stops[0] = {self.stops[0]:g} m lies outside the line: {name} begin at "
                                 f"{pairs[0][0]:g} m")
        slow = [pair for pair in self.speed_limits if pair[1] <= 0]
        if slow:
            raise ValueError(f"speed limits must be positive, but from {slow[0][0]:g} m on it is {slow[0][1]:g} m/s")
        steep = [pair for pair in self.gradients if abs(pair[1]) > 0.2]
        if steep:
            raise ValueError(f"gradients are rise over length (0.018 is 18 per mille), at most 0.2, but from "
                             f"{steep[0][0]:g} m on it is {steep[0][1]:g}")
        return self

    def slope(self, rotating: float) -> Slope:
        """The gradient's deceleration for the compiled plant."""
        pairs = np.array(self.gradients)
        return slope_grid(pairs[:, 0], pairs[:, 1], rotating)

    def limit(self, s: np.ndarray) -> np.ndarray:
        """The speed limit (m/s) at positions s (m), any shape."""
        pairs = np.array(self.speed_limits)
        return pairs[np.clip(np.searchsorted(pairs[:, 0], s, side="right") - 1, 0, None), 1]

    def gradient(self, s: np.ndarray) -> np.ndarray:
        """The gradient (m/m) at positions s (m), any shape."""
        pairs = np.array(self.gradients)
        return pairs[np.clip(np.searchsorted(pairs[:, 0], s, side="right") - 1, 0, None), 1]


class Train(Strict):
    """A train by its mass, forces and resistance."""

    mass: Annotated[PositiveFloat, key("mass without the rotating parts' share", "kg")]
    rotating: Annotated[float, Field(ge=0, le=1), key("mass of its rotating parts as a share", "1")] = 0.0
    max_speed: Annotated[PositiveFloat, key("greatest speed", "m/s")]
    max_traction: Annotated[PositiveFloat, key("greatest tractive force", "N")]
    max_braking: Annotated[PositiveFloat, key("greatest braking force", "N")]
    traction: Annotated[Powers, key(
        "share of the force left at V, min(1, c0/V + c1 + c2 V + c3 V^2 + c4 V^3): the five coefficients, as "
        "sources print them (constant power is c0 alone)", "V in km/h")]
    braking: Annotated[Powers, key("the same of the braking force", "V in km/h")]
    resistance: Annotated[list[float], Field(min_length=3, max_length=3), key(
        "r0 + r1 V + r2 V^2, N per kN of weight", "N/kN, V in km/h")]

    @property
    def forces(self) -> Forces:
        """The acceleration law's constants."""
        inertia = self.mass * (1 + self.rotating)
        t0, t1, t2, t3, t4 = self.traction
        b0, b1, b2, b3, b4 = self.braking
        r0, r1, r2 = (1e-3 * GRAVITY * r / (1 + self.rotating) for r in self.resistance)
        return Forces(self.max_traction / inertia, t0, t1, t2, t3, t4, self.max_braking / inertia, b0, b1, b2, b3, b4,
                      r0, r1, r2)


def read_line(path: str) -> Line:
    """A line from a TTOBench track file. Raises ValueError with the file's name."""
    table = _json(path)
    stops = _entry(table, "stops", path)
    scale = _unit(stops.get("unit"), LENGTHS, "stops", path)
    line = {"stops": [scale * s for s in _numbers(stops.get("values"), "stops", path)],
            "speed_limits": _pairs(table, "speed limits", "velocity", SPEEDS, path)}
    line["gradients"] = _pairs(table, "gradients", "slope", SLOPES, path) if "gradients" in table else [[0.0, 0.0]]
    return _checked(Line, line, path)


def read_train(path: str) -> Train:
    """A train from a TTOBench train file. Raises ValueError with the file's name.

    Forces are limited by force, power and, where given, by the greatest acceleration and deceleration; pneumatic
    brakes are taken to hold their force at any speed."""
    table = _json(path)
    mass = _value(table, "mass", MASSES, path)
    if mass <= 0:
        raise ValueError(f"{path}: \"mass\" must be more than 0")
    rotating = _value(table, "rho", SHARES, path, 0.0)
    inertia = mass * (1 + rotating)
    traction = _value(table, "max traction force", FORCES, path)
    regenerative = _value(table, "max reg braking force", FORCES, path, 0.0)
    pneumatic = _value(table, "max pn braking force", FORCES, path, 0.0)
    pull = min(traction, inertia * _value(table, "max acceleration", ACCELERATIONS, path, np.inf))
    hold = min(regenerative + pneumatic, inertia * _value(table, "max deceleration", ACCELERATIONS, path, np.inf))
    weight = 1e-3 * mass * GRAVITY
    resistance = [_value(table, f"rolling resistance r{k}", _resistances(k), path, 0.0) / weight for k in range(3)]
    train = {
        "mass": mass, "rotating": rotating, "max_speed": _value(table, "max speed", SPEEDS, path),
        "max_traction": pull, "max_braking": hold, "resistance": resistance,
        "traction": _limited(pull, 0.0, _value(table, "max traction power", POWERS, path, np.inf)),
        "braking": _limited(hold, pneumatic, _value(table, "max reg braking power", POWERS, path, np.inf)),
    }
    return _checked(Train, train, path)


def _file_or_table(read: Callable[[str], Any]) -> Any:
    """What a scenario may hold in place of a table: the path of a file."""
    return BeforeValidator(lambda given: read(given) if isinstance(given, str) else given)


_EITHER = WithJsonSchema({"anyOf": [{"type": "string"}, {"type": "object"}]})
LineOrFile = Annotated[Line, _file_or_table(read_line), _EITHER]
TrainOrFile = Annotated[Train, _file_or_table(read_train), _EITHER]


def _limited(force: float, constant: float, power: float) -> list[float]:
    """Share of `force` that constant + power / v leaves, as coefficients in km/h."""
    if not np.isfinite(power) or force <= 0:
        return [0.0, 1.0, 0.0, 0.0, 0.0]
    return [KMH * power / force, constant / force, 0.0, 0.0, 0.0]


def _resistances(power: int) -> dict[str, float]:
    """Units of the coefficient of V^power and their factor to N per (km/h)^power."""
    below = {0: "", 1: "/({})", 2: "/({})^2"}[power]
    return {unit + below.format(speed): force * (KMH * scale) ** -power
            for unit, force in FORCES.items() for speed, scale in SPEEDS.items()}


def _checked(kind: Any, table: dict[str, Any], path: str) -> Any:
    try:
        return kind.model_validate(table)
    except ValueError as error:
        details = getattr(error, "errors", list)()
        text = "; ".join(f"{'.'.join(str(p) for p in item['loc'])}: {item['msg'].removeprefix('Value error, ')}"
                         .removeprefix(": ") for item in details) or str(error)
        raise ValueError(f"{path}: {text}") from None


def _json(path: str) -> dict[str, Any]:
    try:
        table = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise ValueError(f"{path}: not a JSON file: {error}") from None
    if not isinstance(table, dict):
        raise ValueError(f"{path}: not a track or train file: it must hold a JSON object")
    return table


def _entry(table: dict[str, Any], key: str, path: str) -> dict[str, Any]:
    form = _FORMS.get(key, '{"value": 1.0, "unit": ..}')
    if key not in table:
        raise ValueError(f"{path}: \"{key}\" is missing; the file has {', '.join(map(json.dumps, table)) or 'nothing'}"
                         f"; allowed: {form}")
    if not isinstance(table[key], dict):
        raise ValueError(f"{path}: \"{key}\" is {reprlib.repr(table[key])}; allowed: {form}")
    return table[key]


_FORMS = {
    "stops": '{"unit": "m", "values": [0, 1300, ..]}',
    "speed limits": '{"units": {"position": "m", "velocity": "km/h"}, "values": [[0, 80], ..]}',
    "gradients": '{"units": {"position": "m", "slope": "permil"}, "values": [[0, 2], ..]}'}
"""How entries of a track are written; those of a train are a value with its unit."""


def _unit(unit: Any, allowed: dict[str, float], key: str, path: str) -> float:
    if not isinstance(unit, str) or unit not in allowed:
        what = f"\"{key}\" needs a unit" if unit is None else f"unit {unit!r} of \"{key}\" is unknown"
        raise ValueError(f"{path}: {what}; allowed: {', '.join(allowed)}")
    return allowed[unit]


def _numbers(values: Any, key: str, path: str) -> list[float]:
    if not isinstance(values, list) or not values:
        raise ValueError(f"{path}: \"{key}\" needs a list of values")
    bad = [v for v in values if not isinstance(v, int | float) or isinstance(v, bool) or abs(v) > 1e15]
    if bad:
        raise ValueError(f"{path}: \"{key}\" must be numbers (got {reprlib.repr(bad[0])})")
    return [float(v) for v in values]


def _pairs(table: dict[str, Any], key: str, second: str, units: dict[str, float], path: str) -> list[list[float]]:
    entry = _entry(table, key, path)
    named = entry.get("units")
    if not isinstance(named, dict):
        raise ValueError(f"{path}: \"{key}\" needs units of position and {second}; allowed: {_FORMS[key]}")
    scales = (_unit(named.get("position"), LENGTHS, key, path), _unit(named.get(second), units, key, path))
    rows = entry.get("values")
    if not isinstance(rows, list) or not rows or any(not isinstance(row, list) or len(row) != 2 for row in rows):
        raise ValueError(f"{path}: \"{key}\" needs rows [position, {second}]; allowed: {_FORMS[key]}")
    return [[scale * v for scale, v in zip(scales, _numbers(row, key, path), strict=True)] for row in rows]


def _value(table: dict[str, Any], key: str, units: dict[str, float], path: str, default: float | None = None) -> float:
    if key not in table and default is not None:
        return default
    entry = _entry(table, key, path)
    return _unit(entry.get("unit"), units, key, path) * _numbers([entry.get("value")], key, path)[0]
