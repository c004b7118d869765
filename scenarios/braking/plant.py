"""The brake's dynamics, discretised exactly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import Array


@dataclass(frozen=True)
class Affine:
    """x(k+1) = (A0 + f A1) x(k) + (B0 + f B1) a_t, exact zero-order hold over one sampling period.

    A0, A1 (4, 4), B0, B1 (4, 1). Affine in f without approximation: f enters the chain a_z -> a^ -> v -> D once."""

    A0: Array
    A1: Array
    B0: Array
    B1: Array

    def at(self, f: float) -> tuple[Array, Array]:
        """Transition and input matrix for the braking rate f."""
        return self.A0 + f * self.A1, self.B0 + f * self.B1

    def step(self, x: Array, f: Array | float, target: Array | float) -> Array:
        """One period: x (4, .., S), f and a_t (.., S) or numbers. Sums over the small index, so batch-independent."""
        out = np.zeros_like(x)
        for i in range(4):
            for j in range(4):
                if self.A0[i, j] != 0.0:
                    out[i] += self.A0[i, j] * x[j]
                if self.A1[i, j] != 0.0:
                    out[i] += f * (self.A1[i, j] * x[j])
            out[i] += (self.B0[i, 0] + f * self.B1[i, 0]) * target
        return out


def discretise(response_time: float, pade_rate: float, period: float) -> Affine:
    """Exact discretisation of eq. (4) over `period` seconds (Euler is unstable at 1 s: 1 - 1/0.4 = -1.5)."""
    from scipy.linalg import expm

    held = []
    for f in (0.0, 1.0):
        block = np.zeros((5, 5))
        block[0, 1] = block[1, 2] = 1.0
        block[2, 2], block[2, 3], block[2, 4] = -1 / response_time, f / response_time, -f / response_time
        block[3, 3], block[3, 4] = -pade_rate, 2 * pade_rate
        held.append(expm(period * block))
    off, on = held
    change = on - off
    change[np.abs(change) < 1e-15] = 0.0
    return Affine(off[:4, :4], change[:4, :4], off[:4, 4:], change[:4, 4:])
