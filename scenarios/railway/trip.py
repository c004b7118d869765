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
from .dynamics import GRAVITY, climb, effect, level, share
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
    """The trips of all runs. w (K, S) and factors (5, S) as `Disturbance` draws them; ease (sections,): the train's own
    mass over that on each section; start: position m, speed m/s."""
    steps, runs = w.shape
    state, u = np.empty((steps, 2, runs)), np.empty((steps, 1, runs))
    reference, acted = np.empty((steps, runs)), w.copy()
    active, section = np.empty((steps, runs), dtype=np.bool_), np.empty((steps, runs), dtype=np.int16)
    _simulate(train.forces, line.slope(train.rotating), plan.start, plan.base, plan.rate, plan.first,
              np.array(line.stops), ease, np.array(start), period,
              (controller.gain, *controller.effort, controller.slew, controller.ended, controller.overrun),
              round(controller.dwell / period), factors, bound, GRAVITY / (1 + train.rotating), physical, acted, state,
              u, active, section, reference)
    return Trip(state, u, acted, active, section, reference)


@njit(cache=True, inner=True)
def _effort(a, s, v, forces, slope):  # pyright: ignore
    """The input u that gives the acceleration a: the inverse of the plant, not yet limited."""
    V = KMH * v
    force = a + forces.r0 + V * (forces.r1 + V * forces.r2) + climb(s, slope)
    top, c0, c1, c2, c3, c4 = effect(force, forces)
    return force / (top * max(share(V, c0, c1, c2, c3, c4), 1e-3))


@njit(cache=True, inner=True)
def _disturbed(s, v, u, forces, slope, mass, pull, hold, rise, wind, g):  # pyright: ignore
    """The acceleration of a train whose mass, forces, gradient and wind are not the nominal ones (page: `physical`).

    Rolling resistance is per weight, so the mass leaves it alone; the wind changes the air's part, r2."""
    V, air = KMH * v, KMH * (v + wind)
    top, c0, c1, c2, c3, c4 = effect(u, forces)
    force = top * share(V, c0, c1, c2, c3, c4) * (hold if u < 0.0 else pull)
    drag = forces.r0 + forces.r1 * V + forces.r2 * air * abs(air)
    return u * force / mass - drag - climb(s, slope) - g * rise


@njit(cache=True)
def _simulate(forces, slope, start, base, rate, first, stops, ease, begin, T, control, dwell, factors, bound, g,
              physical, w, state, u, active, section, reference):  # pyright: ignore
    """Fill state, u, active, section, reference; w is overwritten by what acted.

    RUNNING follows the reference. LANDING (one step between sections) asks for standstill, HELD (one more) reaches it
    exactly; the residual speed is at most T w_bar, so that w keeps its bound. WAITING counts the dwell. At standstill
    u holds the train against gradient and resistance. Efforts are shares of the force on the train's own mass, so what
    a load leaves of them is ease[leg]."""
    RUNNING, LANDING_STEP, HELD, WAITING, DONE = 0, 1, 2, 3, 4
    gain, least, greatest, slew, ended, overrun = control
    steps, runs = w.shape
    sections = first.shape[0] - 1
    for r in range(runs):
        s, v = begin[0], begin[1]
        effort = 0.0 if v > 0.0 else _effort(0.0, s, v, forces, slope)  # at rest it is held
        mode, leg, piece, waited, departed = RUNNING, 0, 0, 0, False
        for k in range(steps):
            wanted = 0.0
            if mode == DONE:
                v = 0.0
            if mode == RUNNING:
                while piece + 1 < first[leg + 1] and s >= start[piece + 1]:
                    piece += 1
                square = base[piece] + rate[piece] * (s - start[piece])
                wanted = np.sqrt(max(square, 0.0))
                # past the stop it brakes to stand at once
                a_asked = 0.5 * rate[piece] + gain * (wanted - v) if square > 0.0 else -v / T
                asked = _effort(a_asked, s, v, forces, slope)
                asked = min(max(asked, least * ease[leg]), greatest * ease[leg])
                change = slew * ease[leg] * T
                effort = min(max(asked, effort - change), effort + change)
                V = KMH * v
                stand = -v / T + forces.r0 + V * (forces.r1 + V * forces.r2) + climb(s, slope)
                if departed and (stand >= 0.0 or stand > effort * forces.brake):
                    # brakes bring the train to a stand, not backwards: where all of their force would not, no share of
                    # it does
                    effort = max(effort, _effort(-v / T, s, v, forces, slope))
            else:
                effort = _effort(-v / T, s, v, forces, slope)
            a = level(v, effort, forces) - climb(s, slope)
            if mode in (RUNNING, LANDING_STEP):
                if physical:
                    off = _disturbed(s, v, effort, forces, slope, factors[0, r], factors[1, r], factors[2, r],
                                     factors[3, r], factors[4, r], g) - a
                    w[k, r] = min(max(off, -bound), bound)
                if mode == RUNNING and not departed and v + T * (a + w[k, r]) < 0.0:
                    w[k, r] = -v / T - a  # brakes off, but the train does not roll back
            else:
                w[k, r] = 0.0
            total = a + w[k, r]
            s += T * v + 0.5 * T * T * total
            v += T * total
            if mode in (HELD, WAITING):
                v = 0.0  # but for rounding it is
            state[k, 0, r], state[k, 1, r], u[k, 0, r] = s, v, effort
            active[k, r], section[k, r], reference[k, r] = mode != DONE, leg, wanted
            if mode == DONE:
                for rest in range(k + 1, steps):
                    state[rest, 0, r], state[rest, 1, r], u[rest, 0, r], w[rest, r] = s, v, effort, 0.0
                    active[rest, r], section[rest, r], reference[rest, r] = False, leg, wanted
                break
            if mode == RUNNING:
                departed = departed or v > 1.0
                if leg + 1 == sections:
                    if (departed and v <= ended) or s > stops[leg + 1] + overrun:
                        mode = DONE
                elif departed and v <= (bound - 0.5 * rate[piece]) * T:
                    mode = LANDING_STEP
            elif mode == LANDING_STEP:
                mode = HELD
            elif mode == HELD:
                mode, waited = WAITING, 0
            elif mode == WAITING:
                waited += 1
                if waited >= dwell:
                    mode, leg, departed = RUNNING, leg + 1, False
                    piece = first[leg]
