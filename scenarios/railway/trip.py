"""A trip over all stops of a line: the reference speed, the controller that follows it, and the truth of all runs.

The controller sees the true state; what it asks of the train is the input that estimators are told."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, NonNegativeFloat, PositiveFloat, model_validator

from ..arrays import Array
from ..machine_code import njit
from ..schema import Strict
from ..strict import key
from ..units import KMH
from .dynamics import GRAVITY, climb, climbs, effect, level, share
from .line import Line, Train


class Controller(Strict):
    """Automatic train operation."""

    margin: Annotated[NonNegativeFloat, key("how far under each limit the reference speed stays", "m/s")]
    braking: Annotated[PositiveFloat, key(
        "service braking, the reference's slope and feed-forward, less for a train that manages less", "m/s^2")]
    gain: Annotated[PositiveFloat, key("on the speed error", "1/s")]
    effort: Annotated[list[Annotated[float, Field(ge=-1, le=1)]], Field(min_length=2, max_length=2), key(
        "least and greatest share of the force", "1")]
    slew: Annotated[PositiveFloat, key("greatest change of the effort", "1/s")]
    dwell: Annotated[float, Field(ge=0, le=3600), key("stand at each stop on the way", "s")] = 30.0
    ended: Annotated[PositiveFloat, key("a run ends at the last stop when the speed falls to it", "m/s")] = 0.3
    overrun: Annotated[PositiveFloat, key("or so far behind that stop", "m")] = 50.0

    @model_validator(mode="after")
    def _both_ways(self) -> Controller:
        if not self.effort[0] < 0 < self.effort[1]:
            raise ValueError("effort = [least, greatest] needs least < 0 (braking) < greatest (traction)")
        return self


@dataclass(frozen=True)
class Reference:
    """v_ref^2 = base + rate (s - start) from each start on: pieces first[i]..first[i + 1] - 1 lead to stop i + 1."""

    start: Array
    base: Array
    rate: Array
    first: NDArray[np.int64]

    @classmethod
    def of(cls, line: Line, train: Train, controller: Controller, reserve: float) -> Reference:
        """The fastest speed that keeps margin and service braking, which is lowered until the train can brake harder by
        `reserve` (m/s^2) wherever it brakes.

        Raises ValueError where no braking of at least 0.1 m/s^2 can be kept up."""
        braking = controller.braking
        while True:
            plan = cls._with(line, train, controller, braking)
            weakest, where = plan._weakest_braking(line, train, controller)
            weakest -= reserve
            if weakest >= braking:
                return plan
            braking = min(0.98 * braking, weakest)
            if braking < 0.1:
                raise ValueError(f"the train cannot brake from {where:.0f} m on: with a reserve of {reserve:g} "
                                 f"m/s^2 it manages {weakest:.2f} m/s^2 there")

    @classmethod
    def _with(cls, line: Line, train: Train, controller: Controller, braking: float) -> Reference:
        """Backwards from each stop, limit by limit."""
        pieces: list[tuple[float, float, float]] = []
        first = [0]
        edges = [position for position, _ in line.speed_limits]
        for begin, stop in pairwise(line.stops):
            starts = [begin, *(edge for edge in edges if begin < edge < stop)]
            limits = np.minimum(line.limit(np.array(starts)), train.max_speed) - controller.margin
            section: list[tuple[float, float, float]] = []
            after = 0.0
            for a, b, top in zip(reversed(starts), reversed([*starts[1:], stop]), reversed(limits**2), strict=True):
                from_ = max(a, b - max(top - after, 0.0) / (2 * braking))
                if after < top:
                    section.append((from_, after + 2 * braking * (b - from_), -2 * braking))
                if from_ > a or after >= top:
                    section.append((a, float(top), 0.0))
                after = min(float(top), after + 2 * braking * (b - a))
            pieces += reversed(section)
            first.append(len(pieces))
        start, base, rate = (np.array(column) for column in zip(*pieces, strict=True))
        return cls(start, base, rate, np.array(first))

    def _weakest_braking(self, line: Line, train: Train, controller: Controller) -> tuple[float, float]:
        """Least deceleration (m/s^2) the train manages where the reference brakes, and where (m)."""
        forces, g = train.forces, GRAVITY / (1 + train.rotating)
        ends = [*self.start[1:], line.stops[-1]]
        found = [(np.inf, line.stops[0])]
        for start, end, base, rate in zip(self.start, ends, self.base, self.rate, strict=True):
            if rate < 0:
                inside = [position for position, _ in line.gradients if start < position < end]
                rise = float(line.gradient(np.array([start, *inside])).min())
                force = forces.brake * share.py_func(KMH * base**0.5, *forces[7:12])
                found.append((-controller.effort[0] * force + forces.r0 + g * rise, float(start)))
        return min(found)


def check_trip(line: Line, train: Train, controller: Controller, w_bar: float, start_speed: float) -> None:
    """Raise ValueError where this train cannot make this trip: limits, climbing, braking."""
    if train.max_speed <= controller.margin:
        raise ValueError(f"the train's top speed of {train.max_speed:.2f} m/s (plant.train.max_speed) is not above the "
                         f"controller's margin of {controller.margin:.2f} m/s (plant.controller.margin)")
    first = min(float(line.limit(np.array(line.stops[0]))), train.max_speed)
    if start_speed > first:
        raise ValueError(f"start_speed = {start_speed:g} m/s is over the {first:.2f} m/s admitted at the start")
    for position, limit in line.speed_limits:
        if limit <= controller.margin:
            raise ValueError(f"the speed limit of {limit:.2f} m/s from {position:g} m on is not above the controller's "
                             f"margin of {controller.margin:.2f} m/s (plant.controller.margin)")
    forces, g = train.forces, GRAVITY / (1 + train.rotating)
    pull = controller.effort[1] * forces.drive * share.py_func(5.0, *forces[1:6]) - forces.r0 - w_bar
    for position, rise in line.gradients:
        if position < line.stops[-1] and g * rise >= pull:
            raise ValueError(f"the train cannot climb {1e3 * rise:.1f} per mille from {position:g} m on: with a "
                             f"disturbance of {w_bar:g} m/s^2 it manages {1e3 * pull / g:.1f} per mille")
    Reference.of(line, train, controller, w_bar)


@dataclass(frozen=True)
class Trip:
    """Truth of S runs over K steps: state (K, 2, S), u (K, 1, S), w as it acted (K, S) m/s^2, active (K, S), section
    (K, S) under way (counted from 0; dwelling at its end included), reference speed (K, S) m/s."""

    state: Array
    u: Array
    w: Array
    active: NDArray[np.bool_]
    section: NDArray[np.int16]
    reference: Array


def simulate(line: Line, train: Train, controller: Controller, plan: Reference, ease: Array,
             start: tuple[float, float], period: float, w: Array, factors: Array, bound: float,
             physical: bool) -> Trip:
    """The trips of all runs. w (K, S), overwritten by what acted, and factors (5, S) as `Disturbance` draws them; ease
    (sections,): the train's own mass over that on each section; start: position m, speed m/s."""
    steps, runs = w.shape
    state, u = np.empty((steps, 2, runs)), np.empty((steps, 1, runs))
    reference = np.empty((steps, runs))
    active, section = np.empty((steps, runs), dtype=np.bool_), np.empty((steps, runs), dtype=np.int16)
    _simulate(train.forces, line.slope(train.rotating), plan.start, plan.base, plan.rate, plan.first,
              np.array(line.stops), ease, np.array(start), period,
              (controller.gain, *controller.effort, controller.slew, controller.ended, controller.overrun),
              round(controller.dwell / period), factors, bound, GRAVITY / (1 + train.rotating), physical, w, state,
              u, active, section, reference)
    return Trip(state, u, w, active, section, reference)


RUNNING, LANDING, HELD, WAITING, DONE, STOOD = 0, 1, 2, 3, 4, 5
"""RUNNING follows the reference. LANDING (one step between sections) asks for standstill, HELD (one more) reaches it
exactly; the residual speed is at most T w_bar, so that w keeps its bound. WAITING counts the dwell. DONE is the first
step after the trip, STOOD are all others, where nothing changes."""
TOGETHER = 512
"""How many runs go side by side: loops over them without a branch or a look-up vectorise."""
PLACE, SPEED, EFFORT, WANTED, SQUARE, RATE, STEEP, EASE, ACTS, MODE, GONE = range(0, 11 * TOGETHER, TOGETHER)
"""Where in the numbers of such a block each begins: in one array, so that it is plain that they do not overlap."""


@njit(cache=True, error_model="numpy", inner=True)
def _effort(a, steep, v, forces):  # pyright: ignore
    """The input u that gives the acceleration a where the gradient takes `steep` off: the inverse of the plant, not yet
    limited."""
    V = KMH * v
    force = a + forces.r0 + V * (forces.r1 + V * forces.r2) + steep
    top, c0, c1, c2, c3, c4 = effect(force, forces)
    return force / (top * max(share(V, c0, c1, c2, c3, c4), 1e-3))


@njit(cache=True, error_model="numpy", inner=True)
def _disturbed(steep, v, u, forces, mass, pull, hold, rise, wind, g):  # pyright: ignore
    """The acceleration of a train whose mass, forces, gradient and wind are not the nominal ones (page: `physical`).

    Rolling resistance is per weight, so the mass leaves it alone; the wind changes the air's part, r2."""
    V, air = KMH * v, KMH * (v + wind)
    top, c0, c1, c2, c3, c4 = effect(u, forces)
    force = top * share(V, c0, c1, c2, c3, c4) * (hold if u < 0.0 else pull)
    drag = forces.r0 + forces.r1 * V + forces.r2 * air * abs(air)
    return u * force / mass - drag - steep - g * rise


@njit(cache=True, error_model="numpy", inner=True)
def _control(x, width, forces, T, control):  # pyright: ignore
    """The effort of each run, and the reference speed that it wants."""
    gain, least, greatest, slew = control[:4]
    for i in range(width):
        v, steep, ease, square, before = x[SPEED + i], x[STEEP + i], x[EASE + i], x[SQUARE + i], x[EFFORT + i]
        wanted, stopping = np.sqrt(max(square, 0.0)), -v / T
        # past the stop it brakes to stand at once
        asked = _effort(0.5 * x[RATE + i] + gain * (wanted - v) if square > 0.0 else stopping, steep, v, forces)
        asked = min(max(asked, least * ease), greatest * ease)
        change = slew * ease * T
        to = min(max(asked, before - change), before + change)
        V, halt = KMH * v, _effort(stopping, steep, v, forces)
        stand = stopping + forces.r0 + V * (forces.r1 + V * forces.r2) + steep
        # brakes bring the train to a stand, not backwards: where all of their force would not, no share of it does
        to = max(to, halt) if x[GONE + i] != 0.0 and (stand >= 0.0 or stand > to * forces.brake) else to
        mode = x[MODE + i]
        x[EFFORT + i] = to if mode == RUNNING else before if mode == STOOD else halt
        x[WANTED + i] = wanted if mode == RUNNING else 0.0


@njit(cache=True, error_model="numpy", inner=True)
def _move(x, width, forces, T):  # pyright: ignore
    """Positions and speeds a step later, and what acted of the disturbance."""
    for i in range(width):
        v, mode, acts = x[SPEED + i], x[MODE + i], x[ACTS + i]
        a = level(v, x[EFFORT + i], forces) - x[STEEP + i]
        # brakes off, but the train does not roll back
        acts = -v / T - a if mode == RUNNING and x[GONE + i] == 0.0 and v + T * (a + acts) < 0.0 else acts
        acts = acts if mode <= LANDING else 0.0
        total = a + acts
        x[ACTS + i] = acts
        x[PLACE + i] += 0.0 if mode == STOOD else T * v + 0.5 * T * T * total
        x[SPEED + i] = v if mode == STOOD else 0.0 if HELD <= mode <= WAITING else v + T * total


@njit(cache=True, error_model="numpy")
def _simulate(forces, slope, start, base, rate, first, stops, ease, begin, T, control, dwell, factors, bound, g,
              physical, w, state, u, active, section, reference):  # pyright: ignore
    """Fill state, u, active, section, reference; w is overwritten by what acted.

    At standstill u holds the train against gradient and resistance. Efforts are shares of the force on the train's own
    mass, so what a load leaves of them is ease[leg]."""
    ended, overrun = control[4:]
    (steps, runs), sections = w.shape, first.shape[0] - 1
    x = np.empty(GONE + TOGETHER)
    leg, piece, waited = np.empty(TOGETHER, np.int64), np.empty(TOGETHER, np.int64), np.empty(TOGETHER, np.int64)
    held = 0.0 if begin[1] > 0.0 else _effort(0.0, climb(begin[0], slope), begin[1], forces)  # at rest it is held
    for block in range(0, runs, TOGETHER):
        width = min(TOGETHER, runs - block)
        for i in range(width):
            x[PLACE + i], x[SPEED + i], x[EFFORT + i], x[EASE + i] = begin[0], begin[1], held, ease[0]
            x[MODE + i], x[GONE + i], leg[i], piece[i] = RUNNING, 0.0, 0, 0
        for k in range(steps):
            for i in range(width):
                s, p = x[PLACE + i], piece[i]
                while x[MODE + i] == RUNNING and p + 1 < first[leg[i] + 1] and s >= start[p + 1]:
                    p += 1
                piece[i] = p
                x[SQUARE + i], x[RATE + i] = base[p] + rate[p] * (s - start[p]), rate[p]
            climbs(x[PLACE:PLACE + width], slope, x[STEEP:STEEP + width])
            _control(x, width, forces, T, control)
            for i in range(width):
                x[ACTS + i] = w[k, block + i]
            if physical:
                for i in range(width):
                    v, effort, steep, r = x[SPEED + i], x[EFFORT + i], x[STEEP + i], block + i
                    off = _disturbed(steep, v, effort, forces, factors[0, r], factors[1, r], factors[2, r],
                                     factors[3, r], factors[4, r], g) - (level(v, effort, forces) - steep)
                    x[ACTS + i] = min(max(off, -bound), bound)
            _move(x, width, forces, T)
            for i in range(width):
                r = block + i
                state[k, 0, r], state[k, 1, r], u[k, 0, r] = x[PLACE + i], x[SPEED + i], x[EFFORT + i]
                w[k, r], reference[k, r] = x[ACTS + i], x[WANTED + i]
                active[k, r], section[k, r] = x[MODE + i] < DONE, leg[i]
            for i in range(width):
                mode, v = x[MODE + i], x[SPEED + i]
                if mode == RUNNING:
                    if v > 1.0:
                        x[GONE + i] = 1.0
                    if leg[i] + 1 == sections:
                        if (x[GONE + i] != 0.0 and v <= ended) or x[PLACE + i] > stops[leg[i] + 1] + overrun:
                            x[MODE + i], x[SPEED + i] = DONE, 0.0
                    elif x[GONE + i] != 0.0 and v <= (bound - 0.5 * x[RATE + i]) * T:
                        x[MODE + i] = LANDING
                elif mode == LANDING:
                    x[MODE + i] = HELD
                elif mode == HELD:
                    x[MODE + i], waited[i] = WAITING, 0
                elif mode == WAITING:
                    waited[i] += 1
                    if waited[i] >= dwell:
                        leg[i] += 1
                        x[MODE + i], x[GONE + i], x[EASE + i], piece[i] = RUNNING, 0.0, ease[leg[i]], first[leg[i]]
                elif mode == DONE:
                    x[MODE + i] = STOOD
