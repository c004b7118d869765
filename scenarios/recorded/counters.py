"""Odometers whose counter wraps round or is reset, and the steps that they count in.

A fall of the counter is read in one of three ways, and each is said: the wrap that was told, a reset to zero, a way
back."""

from __future__ import annotations

import numpy as np

from ..arrays import Array

STANDING, OFTEN = 1.0, 0.1
"""An odometer is coarse where it stands still at more than this share of the samples at which the train moves (m/s)."""
TOP_SPEED = 170.0
"""m/s; no train has gone faster."""
NEAR_ZERO, LEAST = 0.02, 5.0
"""A counter that falls below this share of where it was, or this many m, was reset."""


def unwound(path: str, time: Array, counted: Array, wrap: float | None,
            name: str = "odometer") -> tuple[Array, list[str]]:
    """A counter (N,) in m as one count that goes on, and what was done, in words. Raises ValueError for a fall that
    is neither the wrap told nor a reset."""
    there = np.flatnonzero(np.isfinite(counted))
    steps, lengths = np.diff(counted[there]), np.diff(time[there])
    added, said = np.zeros(len(steps)), list[str]()
    usual = 5.0 + TOP_SPEED * lengths  # m; less of a fall is a way back
    falls = np.flatnonzero(steps < -np.maximum(usual, LEAST))
    for k in falls:
        before, after, at = counted[there[k]], counted[there[k + 1]], time[there[k + 1]]
        if wrap is not None:
            turns = np.round((before - after) / wrap)
            if turns < 1 or not -LEAST <= after + turns * wrap - before <= usual[k]:
                raise ValueError(f"{path}: the {name} falls from {before:.9g} to {after:.9g} m at t = {at:.6g} s: "
                                 f"wrap = {wrap:g} does not explain it")
            added[k] = turns * wrap
        elif 0 <= after <= max(NEAR_ZERO * before, LEAST):
            added[k] = before - after
            said.append(f"the {name} falls from {before:.9g} to {after:.9g} m at t = {at:.6g} s: taken as a reset, "
                        "the way in between is lost (if its counter wraps: wrap = METRES)")
        else:
            raise ValueError(f"{path}: the {name} falls from {before:.9g} to {after:.9g} m at t = {at:.6g} s: wrap = "
                             "METRES where its counter wraps, or leave the place out (--without)")
    if wrap is not None and len(falls):
        said.append(f"the {name} wrapped {len(falls)} times at {wrap:g} m")
    out = counted.copy()
    out[there[1:]] += np.cumsum(added)
    return out, said


def step_of(counted: Array, speed: Array) -> float:
    """The odometer's step in m: its usual increment where it often stands still while the train moves, else 0.

    counted (N,), NaN where not heard; speed (N,) m/s."""
    there = np.isfinite(counted)
    increments = np.diff(counted[there])[speed[there][1:] > STANDING]
    coarse = increments.size and np.mean(increments == 0) > OFTEN and increments.max() > 0
    return float(np.median(increments[increments > 0])) if coarse else 0.0
