"""Adhesion of wheel and rail: friction along the line, sliding with hysteresis, and the slip speed that follows.

Micro-slip beside a first-order slide is what truth uses; friction by Polach's curve of the slip speed is an option."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field, NonNegativeFloat, PositiveFloat, field_validator, model_validator

from ..arrays import Array
from ..machine_code import njit
from ..randomness import RunRandom
from ..schema import Strict
from ..strict import key

Range = Annotated[list[float], Field(min_length=2, max_length=2)]
Span = Annotated[list[float], Field(min_length=2, max_length=2)]
Friction = Annotated[float, Field(gt=0, le=1)]
LOW_BEFORE, LOW_AFTER = (-410.0, -170.0), (30.0, 220.0)
"""Low stretches by rule, m from a stop: where trains brake for it, and where they leave it."""


class Adhesion(Strict):
    """Friction of the rail and what slip does."""

    curve: Annotated[Literal["first-order", "polach"], key(
        "how the transmitted force follows from slip")] = "first-order"
    open: Annotated[Friction, key("friction in the open air", "1")] = 0.3
    tunnel: Annotated[Friction, key("friction in tunnels", "1")] = 0.3
    low: Annotated[list[Span] | Literal["stops"], key(
        "stretches of low friction: [[from, to], ..], or stops: before and after the line's stops in turn", "m")] = []
    cell: Annotated[PositiveFloat, key(
        "there friction and strength are drawn anew per run for each stretch of this length", "m")] = 40.0
    friction: Annotated[Range, key("least and greatest friction there", "1")] = [0.03, 0.09]
    strength: Annotated[Range, key(
        "least and greatest strength of a slide there: slip speed as a share of the speed, per axle", "1")] = [
            0.08, 0.3]
    cleaned: Annotated[PositiveFloat, key("the second car's friction over the first's", "1")] = 1.2
    release: Annotated[Friction, key(
        "an axle slides until the force asked falls to this share of what the rail bears", "1")] = 0.9
    sliding: Annotated[Friction, key("share of it that a sliding axle transmits", "1")] = 0.9
    traction: Annotated[PositiveFloat, key("slip speed of a slide in traction, over strength x speed", "1")] = 1.5
    least_traction: Annotated[NonNegativeFloat, key("its least", "m/s")] = 1.0
    braking: Annotated[PositiveFloat, key("slip speed of a slide in braking, over strength x speed", "1")] = 1.0
    least_braking: Annotated[NonNegativeFloat, key("its least", "m/s")] = 0.3
    swing: Annotated[float, Field(ge=0, le=1), key("share by which it swings", "1")] = 0.6
    swing_period: Annotated[PositiveFloat, key("of that", "s")] = 1.6
    phase: Annotated[Range, key("least and greatest phase of that", "rad")] = [0.0, 2 * np.pi]
    slide_time: Annotated[PositiveFloat, key("with which a slide is reached", "s")] = 0.4
    micro: Annotated[list[NonNegativeFloat], Field(min_length=2, max_length=2), key(
        "slip as a share of the speed at full use of the friction, on rails of friction 0.30 and more and on "
        "others", "1")] = [0.006, 0.015]
    micro_time: Annotated[PositiveFloat, key("with which that is reached", "s")] = 0.3

    @field_validator("friction", "strength", "phase")
    @classmethod
    def _ordered(cls, pair: list[float]) -> list[float]:
        if pair[0] > pair[1] or pair[0] < 0:
            raise ValueError("[least, most] needs 0 <= least <= most")
        return pair

    @model_validator(mode="after")
    def _consistent(self) -> Adhesion:
        if self.friction[0] <= 0:
            raise ValueError("friction must be more than 0")
        if self.low != "stops":
            spans(self.low, "low")
        return self

    def stretches(self, stops: list[float]) -> list[Span]:
        """The low stretches on a line with these stops, in order."""
        if self.low != "stops":
            return self.low
        out = []
        for i, stop in enumerate(stops):
            before, after = (stop + LOW_BEFORE[0], stop + LOW_BEFORE[1]), (stop + LOW_AFTER[0], stop + LOW_AFTER[1])
            if i and i % 2 == len(stops[1:]) % 2 and before[0] > stops[i - 1]:
                out.append(list(before))
            elif i < len(stops) - 1 and after[1] < stops[i + 1]:
                out.append(list(after))
        return out

    def rail(self, stops: list[float], tunnels: list[Span], random: RunRandom) -> Rail:
        """The rail of S runs: friction pieces along the line and what is drawn for each cell."""
        low = self.stretches(stops)
        edges = sorted({stops[0] - 1e6, *(e for pair in [*tunnels, *low] for e in pair)})
        inside = [any(a <= edge < b for a, b in low) for edge in edges]
        base = [self.tunnel if any(a <= edge < b for a, b in tunnels) else self.open for edge in edges]
        cells = int((stops[-1] - stops[0] + 200.0) / self.cell) + 2
        phase = random.uniform(self.phase[0], self.phase[1], 2)
        strength = random.uniform(self.strength[0], self.strength[1], 2, cells)
        friction = random.uniform(self.friction[0], self.friction[1], cells)
        return Rail(np.array(edges), np.array(base), np.array(inside), stops[0], self.cell, friction, strength, phase)

    @property
    def law(self) -> Law:
        """The constants for compiled code."""
        return Law(self.cleaned, self.release, self.sliding, self.traction, self.least_traction, self.braking,
                   self.least_braking, self.swing, 2 * np.pi / self.swing_period, self.slide_time, self.micro[0],
                   self.micro[1], self.micro_time, self.curve == "polach")


def spans(pairs: list[Span], name: str) -> None:
    """Raise ValueError where stretches [[from, to], ..] are not in order."""
    flat = [edge for pair in pairs for edge in pair]
    if any(b <= a for a, b in pairwise(flat)):
        raise ValueError(f"{name} = [[from, to], ..] needs stretches in order, each with from < to")


@dataclass(frozen=True)
class Rail:
    """edge, base (n,): friction from each edge (m) on; low (n,): where cells count instead. begin, cell m: cell c of a
    position is (s - begin) / cell; friction (cells, S), strength (2, cells, S), phase (2, S) rad."""

    edge: Array
    base: Array
    low: np.ndarray
    begin: float
    cell: float
    friction: Array
    strength: Array
    phase: Array


class Law(NamedTuple):
    """Constants of `Adhesion` (swing_rate rad/s)."""

    cleaned: float
    release: float
    sliding: float
    traction: float
    least_traction: float
    braking: float
    least_braking: float
    swing: float
    swing_rate: float
    slide_time: float
    micro_dry: float
    micro_wet: float
    micro_time: float
    polach: bool


@njit(cache=True, error_model="numpy", inner=True)
def held(force, most, slides, law):  # pyright: ignore
    """(transmitted N, slides): an axle asked for `force` (N) where the rail bears `most` (N)."""
    use = abs(force) / most
    slides = use > law.release if slides else use > 1.0
    if slides:
        return np.sign(force) * law.sliding * most, True
    return force, False


@njit(cache=True, error_model="numpy", inner=True)
def slip(w, slides, force, most, v, friction, strength, phase, t, h, law):  # pyright: ignore
    """The slip speed w (m/s, wheel less train) h seconds later."""
    if slides:
        if force > 0.0:
            target = max(law.traction * strength * v, law.least_traction)
        else:
            target = -max(law.braking * strength * v, law.least_braking)
        target *= 1.0 + law.swing * np.sin(law.swing_rate * t + phase)
        return w + (target - w) * (1.0 - np.exp(-h / law.slide_time))
    use = min(abs(force) / most, 1.0)
    if law.polach:
        target = np.sign(force) * polach_slip(use, friction, v)
    else:
        target = np.sign(force) * (law.micro_dry if friction >= 0.3 else law.micro_wet) * use * v
    if abs(w - target) >= 0.02 * v + 0.02:
        w += (target - w) * (1.0 - np.exp(-h / law.micro_time))
    if abs(w - target) < 0.02 * v + 0.02:
        return target
    return w


@njit(cache=True, error_model="numpy")
def polach(creep, friction, v):  # pyright: ignore
    """Adhesion coefficient at a creep (slip speed over speed), Polach's curve of adhesion with falling friction.

    mu = mu_0 ((1 - A) exp(-B w) + A) of the slip speed w; f = 2 mu / pi (kA e / (1 + (kA e)^2) + atan(kS e)) with
    e = C creep / mu; dry kA 1, kS .4, B .6 s/m, wet (friction under 0.30) .3, .1, .2; A .4. C = 25 (dry) or 14 (wet) is
    chosen here. Polach, Wear 258, 2005; the parameters are quoted second hand."""
    dry = friction >= 0.3
    stiff = 25.0 if dry else 14.0
    ka, ks, fall = (1.0, 0.4, 0.6) if dry else (0.3, 0.1, 0.2)
    mu = friction * (0.6 * np.exp(-fall * creep * v) + 0.4)
    e = stiff * creep / mu
    return 2.0 * mu / np.pi * (ka * e / (1.0 + (ka * e) ** 2) + np.arctan(ks * e))


@njit(cache=True, error_model="numpy")
def polach_slip(use, friction, v):  # pyright: ignore
    """Slip speed (m/s) at which the rising branch of Polach's curve bears `use` of its greatest adhesion."""
    peak, best = 0.0, 0.0
    for i in range(1, 61):
        creep = 0.002 * i
        f = polach(creep, friction, v)
        if f <= best:
            break
        peak, best = creep, f
    low, high = 0.0, peak
    for _ in range(30):
        middle = 0.5 * (low + high)
        if polach(middle, friction, v) < use * best:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high) * v


@njit(cache=True, error_model="numpy", inner=True)
def friction_at(s, piece, edge, base, low, cells, begin, cell, run):  # pyright: ignore
    """(friction, piece, cell) at s (m); piece: that of the step before."""
    while piece + 1 < edge.shape[0] and s >= edge[piece + 1]:
        piece += 1
    where = min(max(int((s - begin) / cell), 0), cells.shape[0] - 1)
    return (cells[where, run] if low[piece] else base[piece]), piece, where
