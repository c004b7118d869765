"""The train over the line with its driver, its axles' slip and the balises that it passes, compiled, run by run.

The driver sees the true state; what he asks of the train and whether it stands are the inputs that estimators hear."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import Array, Mask
from ..machine_code import njit
from ..railway.adhesion import Rail, friction_at, held, slip
from ..railway.dynamics import GRAVITY, climb, level
from .config import Driver, Plant

LONGEST_STEP = 0.1
"""The plant's own step is at most this, s."""


@dataclass(frozen=True)
class Drawn:
    """What a run draws: courage c (the share of the speed limit driven), braking b m/s^2 (S,), dwell (stops - 1, S) s
    before each departure, rail, and the unit errors of the places where balises are read (balises, S)."""

    courage: Array
    braking: Array
    dwell: Array
    rail: Rail
    place: Array


@dataclass(frozen=True)
class Ride:
    """Truth of S runs at the end of each of K steps.

    state (K, 2, S): m, m/s; acceleration (K, S): mean over the step, m/s^2; wheel (K, 2, S): distance rolled by the
    sensors' wheels at their circumference, m; force (K, S): what the drive and brakes exert over the mass, m/s^2;
    standing, active (K, S); passed (balises, S): time at which each is read, s (infinite: never), place (balises, S):
    where; slides (2, S): seconds that each axle slid; slipping (K, 2, S): whether an axle slides."""

    state: Array
    acceleration: Array
    wheel: Array
    force: Array
    standing: Mask
    active: Mask
    passed: Array
    place: Array
    slides: Array
    slipping: Mask

    @property
    def duration(self) -> Array:
        """Time to the last stop (S,), in steps."""
        return self.active.sum(axis=0).astype(float)


def simulate(plant: Plant, drawn: Drawn, reach: tuple[float, float], period: float, steps: int) -> Ride:
    """The rides of all runs. reach: the greatest error (m) of the place where a balise is read, at 40 and 500 km/h."""
    runs, parts = len(drawn.courage), max(1, int(np.ceil(period / LONGEST_STEP - 1e-9)))
    state, wheel = np.zeros((steps, 2, runs)), np.zeros((steps, 2, runs))
    acceleration, force = np.zeros((steps, runs)), np.zeros((steps, runs))
    standing, active = np.zeros((steps, runs), dtype=np.bool_), np.zeros((steps, runs), dtype=np.bool_)
    balises = np.array(plant.places)
    passed, place = np.full((len(balises), runs), np.inf), np.zeros((len(balises), runs))
    slides, slipping = np.zeros((2, runs)), np.zeros((steps, 2, runs), dtype=np.bool_)
    line, train, driver, rail = plant.line, plant.train, plant.driver, drawn.rail
    limits = np.array(line.speed_limits)
    _simulate(period, parts, train.forces, train.mass * (1 + train.rotating), train.mass, train.max_speed,
              line.slope(train.rotating), np.array(line.stops), limits[:, 0], limits[:, 1], _hand(driver),
              drawn.courage, drawn.braking, drawn.dwell, rail.edge, rail.base, rail.low, rail.begin, rail.cell,
              rail.friction, rail.strength, rail.phase, plant.adhesion.law, balises, drawn.place, reach, state,
              acceleration, wheel, force, standing, active, passed, place, slides, slipping)
    return Ride(state, acceleration, wheel, force, standing, active, passed, place, slides, slipping)


def _hand(driver: Driver) -> tuple[float, ...]:
    return driver.gain, *driver.asked, driver.lag, driver.near


@njit(cache=True, error_model="numpy", inner=True)
def _reference(s, v, courage, braking, stop, edge, top, limit, fastest):  # pyright: ignore
    """(reference speed, limit here as driven): under each lower limit ahead and to stand at the stop."""
    here = courage * min(top[limit], fastest)
    wanted = min(here, np.sqrt(2.0 * braking * max(stop - s, 0.0)))
    ahead = limit + 1
    while ahead < edge.shape[0] and edge[ahead] < stop:
        lower = courage * min(top[ahead], fastest)
        if lower < here:
            wanted = min(wanted, np.sqrt(lower * lower + 2.0 * braking * max(edge[ahead] - s, 0.0)))
        ahead += 1
    return wanted, here


@njit(cache=True, error_model="numpy")
def _simulate(period, parts, forces, inertia, mass, fastest, slope, stops, edge, top, hand, courage, braking, dwell,
              rail_edge, rail_base, rail_low, begin, cell, cells, strength, phase, law, balises, error, reach, state,
              acceleration, wheel, force, standing, active, passed, place, slides, slipping):  # pyright: ignore
    """Fill the arrays of `Ride`. Two cars share the mass; the first (axle A) is driven, both brake; an axle bears an
    eighth of the mass. force: that of drive and brakes over the inertia; the axles' part of it may be less."""
    gain, least, most, lag, near = hand
    h = period / parts
    follow = 1.0 - np.exp(-h / lag)
    axle = mass * GRAVITY / 8.0
    for r in range(state.shape[2]):
        s, v, pull, leg, limit, piece, ahead = stops[0], 0.0, 0.0, 0, 0, 0, 0
        wait, standing_now, done = dwell[0, r], True, False
        sliding, w, rolled = np.zeros(2, dtype=np.bool_), np.zeros(2), np.zeros(2)
        for k in range(state.shape[0]):
            if done:
                state[k, 0, r], state[k, 1, r] = s, v
                wheel[k, 0, r], wheel[k, 1, r], standing[k, r] = rolled[0], rolled[1], True
                continue
            active[k, r] = True
            before = v
            for part in range(parts):
                t = (k * parts + part) * h
                if standing_now:
                    pull = 0.0
                    wait -= h
                    if wait <= 1e-9:
                        standing_now, leg = False, leg + 1
                    w[:] = 0.0
                    sliding[:] = False
                    continue
                while limit + 1 < edge.shape[0] and s >= edge[limit + 1]:
                    limit += 1
                wanted, here = _reference(s, v, courage[r], braking[r], stops[leg], edge, top, limit, fastest)
                asked = gain * (wanted - v) - (braking[r] if wanted < here else 0.0)
                asked = min(max(asked, least), most)
                resist = -level(v, 0.0, forces) if v > 0.0 else 0.0
                steep = climb(s, slope)
                drive = asked + steep + (resist if v > 0.0 else forces.r0)
                strongest = level(v, 1.0, forces) - level(v, 0.0, forces)
                weakest = level(v, -1.0, forces) - level(v, 0.0, forces)
                drive = min(max(drive, weakest), strongest)
                pull += (drive - pull) * follow
                friction, piece, where = friction_at(s, piece, rail_edge, rail_base, rail_low, cells, begin, cell, r)
                total = 0.0
                for j in range(2):
                    bearing = friction * (law.cleaned if j else 1.0) * axle
                    share = pull * inertia / 8.0 if pull < 0.0 else (pull * inertia / 4.0 if j == 0 else 0.0)
                    borne, now = held(share, bearing, sliding[j], law)
                    sliding[j] = now
                    total += 4.0 * borne
                    w[j] = slip(w[j], now, borne, bearing, v, friction, strength[j, where, r], phase[j, r], t, h, law)
                    slides[j, r] += h if now else 0.0
                a = total / inertia - steep - resist
                after = max(v + a * h, 0.0)
                moved = 0.5 * (v + after) * h
                for j in range(2):
                    rolled[j] += max(0.5 * (v + after) + w[j], 0.0) * h
                while ahead < balises.shape[0]:
                    span = reach[0] + (reach[1] - reach[0]) * min(max((3.6 * v - 40.0) / 460.0, 0.0), 1.0)
                    at = balises[ahead] + error[ahead, r] * span
                    if s + moved < at:
                        break
                    if moved <= 0.0:
                        break
                    passed[ahead, r], place[ahead, r] = t + h * max(at - s, 0.0) / moved, at
                    ahead += 1
                s += moved
                v = after
                if v == 0.0 and stops[leg] - s < near:
                    standing_now = True
                    pull = 0.0
                    if leg + 1 == stops.shape[0]:
                        done = True
                        break
                    wait = dwell[leg, r]
            state[k, 0, r], state[k, 1, r] = s, v
            acceleration[k, r] = (v - before) / period
            wheel[k, 0, r], wheel[k, 1, r] = rolled[0], rolled[1]
            force[k, r], standing[k, r] = pull, standing_now
            slipping[k, 0, r], slipping[k, 1, r] = sliding[0], sliding[1]
