"""Slip of each axle as modes: whole design models in which a slipping axle's reading is worth next to nothing."""

from __future__ import annotations

import itertools

import numpy as np

from ...arrays import Array
from ...model import Mode, Modes
from .model import Odometer


def slip_modes(odometer: Odometer, initial_mean: Array, tells: tuple[str, ...]) -> Modes | None:
    """Every combination of slipping axles, none first; axles slip and recover independently of each other.

    None where nothing could slip: dead reckoning, or no wheels measured."""
    wheels = odometer.wheels
    if odometer.told.counting or not wheels:
        return None
    slip, period = odometer.told.slip, odometer.period
    modes, transition = [], np.ones((1, 1))
    # over a whole step of the two-state chain with these rates, exactly
    total = slip.enter + slip.leave
    moved = 1.0 - np.exp(-total * period)
    enter, leave = slip.enter / total * moved, slip.leave / total * moved
    axle = np.array([[1 - enter, enter], [leave, 1 - leave]])
    for pattern in itertools.product((False, True), repeat=len(wheels)):
        slipping = tuple(itertools.compress(wheels, pattern))
        name = " and ".join(name.removeprefix("wheel-") for name in slipping)
        modes.append(Mode(f"slip of {name}" if name else "no slip", odometer.model(initial_mean, tells, slipping)))
    for _ in wheels:
        transition = np.kron(transition, axle)
    prior = np.zeros(len(modes))
    prior[0] = 1.0
    return Modes(tuple(modes), prior, np.asarray(transition, dtype=float))
