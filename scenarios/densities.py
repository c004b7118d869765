"""Noise as it is drawn and weighed, for particle filters that are told more of it than two moments.

Uniform noise here; without densities a particle filter takes Gaussian noise of the same moments."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .arrays import Array
from .measurement import Interval, Measurement


@dataclass(frozen=True)
class Densities:
    """drawn: how many uniform numbers the process noise of a particle takes. process(z, interval): from z in [0, 1)
    (drawn, .., S), the noise (nx, .., S) that is added to a particle's f(x, u). log_measurement(v, measurement): the
    logarithm of the density (.., S) of residuals v = y - h(x) (ny, .., S), -inf where they cannot be; of the elements
    received alone, 0 of runs that received nothing."""

    drawn: int
    process: Callable[[Array, Interval], Array]
    log_measurement: Callable[[Array, Measurement], Array]


def uniform(gain: Callable[[Interval], Array], w_bar: Array, v_bar: Array) -> Densities:
    """Independent uniform noise: gain(interval) (nx, nw, S or 1) times w within +-w_bar (nw,); v within +-v_bar
    (ny,)."""

    def process(z: Array, interval: Interval) -> Array:
        G, between = gain(interval), (1,) * (z.ndim - 2)
        out = np.zeros((len(G), *z.shape[1:]))
        for j, bar in enumerate(w_bar):
            out += G[:, j].reshape(len(G), *between, -1) * (bar * (2.0 * z[j] - 1.0))
        return out

    def log_measurement(v: Array, measurement: Measurement) -> Array:
        out = np.zeros(v.shape[1:])
        for residual, bar, received in zip(v, v_bar, measurement.received, strict=True):
            out += np.where(received, np.where(np.abs(residual) <= bar, -np.log(2.0 * bar), -np.inf), 0.0)
        return out

    return Densities(len(w_bar), process, log_measurement)
