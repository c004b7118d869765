"""How far wheels roll on a trip that is known: under the adhesion that its motion needs, they slip and slide on it.

Two cars share the mass; the first (axle A) is driven, both brake. What a sliding axle does not bear others do: the trip
stays what it is."""

from __future__ import annotations

import numpy as np

from ..arrays import Array, Mask
from ..machine_code import njit
from ..railway.adhesion import Adhesion, Rail, friction_at, held, slip
from ..railway.dynamics import GRAVITY

LONGEST = 0.1
"""Slip is followed in parts of a step of at most this, s."""


def roll(adhesion: Adhesion, rail: Rail, position: Array, speed: Array, pull: Array, lengths: Array, rotating: float
         ) -> tuple[Array, Mask]:
    """(distance rolled at the circumference (K, 2, S) m, whether an axle slides (K, 2, S)) of axles A and B.

    position, speed (K + 1, S): m, m/s, at the ends of K steps of lengths (K,) s; pull (K, S) m/s^2: what drive and
    brakes do to the mass with its rotating parts, their share being `rotating`."""
    steps, runs = pull.shape
    rolled, sliding = np.zeros((steps, 2, runs)), np.zeros((steps, 2, runs), dtype=np.bool_)
    _roll(position, speed, pull * (1 + rotating), lengths, rail.edge, rail.base, rail.low, rail.begin, rail.cell,
          rail.friction, rail.strength, rail.phase, adhesion.law, rolled, sliding)
    return rolled, sliding


@njit(cache=True, error_model="numpy")
def _roll(position, speed, pull, lengths, edge, base, low, begin, cell, cells, strength, phase, law, rolled,
          sliding):  # pyright: ignore
    """Fill rolled and sliding. An axle bears an eighth of the weight; forces are over the mass."""
    for r in range(pull.shape[1]):
        piece, t, slides, w, gone = 0, 0.0, np.zeros(2, dtype=np.bool_), np.zeros(2), np.zeros(2)
        for k in range(pull.shape[0]):
            parts = max(1, int(np.ceil(lengths[k] / LONGEST - 1e-9)))
            h = lengths[k] / parts
            s, moved = position[k, r], (position[k + 1, r] - position[k, r]) / parts
            for part in range(parts):
                v = speed[k, r] + (speed[k + 1, r] - speed[k, r]) * part / parts
                if v <= 0.0 and moved == 0.0:
                    w[:], slides[:] = 0.0, False
                friction, piece, where = friction_at(s, piece, edge, base, low, cells, begin, cell, r)
                for j in range(2):
                    most = friction * (law.cleaned if j else 1.0) * GRAVITY / 8.0
                    asked = pull[k, r] / 8.0 if pull[k, r] < 0.0 else (pull[k, r] / 4.0 if j == 0 else 0.0)
                    if v > 0.0:
                        borne, slides[j] = held(asked, most, slides[j], law)
                        w[j] = slip(w[j], slides[j], borne, most, v, friction, strength[j, where, r], phase[j, r], t, h,
                                    law)
                    gone[j] += moved + max(w[j] * h, -max(moved, 0.0))
                s, t = s + moved, t + h
            for j in range(2):
                rolled[k, j, r], sliding[k, j, r] = gone[j], slides[j]
