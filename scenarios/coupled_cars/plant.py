"""The train of coupled cars of Zou et al. 2018, eqs. (1) to (5): its matrices, its resistive force, its motion.

The motion is compiled; runs are the innermost loop and no result depends on how many there are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import Array
from ..machine_code import njit


@dataclass(frozen=True)
class Matrices:
    """x(k+1) = A x + B u + E f + h of eq. (5), exact zero-order hold; x = [positions, speeds], front car first.

    A (2n, 2n), B (2n, nu), E (2n, n), h (2n,): f (n,) are the resistive forces in N, u (nu,) the driving forces."""

    A: Array
    B: Array
    E: Array
    h: Array


def matrices(masses: Array, stiffness: float, length: float, driven: list[int], period: float) -> Matrices:
    """Eq. (5). masses (n,) kg; stiffness N/m; length: a coupler's free length from car centre to car centre (slack and
    car length of eq. (2)), m; driven: the cars with a driving force of their own; period s."""
    from scipy.linalg import expm

    n = len(masses)
    couple = np.zeros((n, n))
    preload = np.zeros(n)
    for i in range(n - 1):
        couple[i:i + 2, i:i + 2] += stiffness * np.array([[-1.0, 1.0], [1.0, -1.0]])
        preload[i:i + 2] += stiffness * length * np.array([1.0, -1.0])
    inverse = np.diag(1 / masses)
    whole = np.zeros((3 * n, 3 * n))
    whole[:n, n:2 * n] = np.eye(n)
    whole[n:2 * n, :n] = inverse @ couple
    whole[n:2 * n, 2 * n:] = inverse
    held = expm(whole * period)
    push = held[:2 * n, 2 * n:]
    return Matrices(held[:2 * n, :2 * n].copy(), push[:, driven].copy(), -push, push @ preload)


@njit(cache=True, error_model="numpy")
def simulate(A, B, E, h, force, masses, c0, c1, c2, ramp, ramp_length, phase, truth):
    """Fill truth (K, 2n, S) from its first row: truth[k] follows from truth[k-1] under force[k] (K, nu).

    Resistive force of Remark 2, held over the step (eq. (5)) and opposing the motion, none while a car stands:
    (c0 + c1 |v_i|) m_i on each car, and c2 (sum of masses) v_1^2 on the first. Ramp force: `ramp` N times a triangle
    wave of the car's position, wavelength ramp_length m, shifted by phase (S,) wavelengths."""
    steps, size, runs = truth.shape
    n = size // 2
    total = masses.sum()
    resistive = np.empty((n, runs))
    for k in range(1, steps):
        past, now = truth[k - 1], truth[k]
        for i in range(n):
            drag = c2 * total if i == 0 else 0.0
            for s in range(runs):
                v = past[n + i, s]
                speed = abs(v)
                size_of = (c0 + c1 * speed) * masses[i] + drag * speed * speed
                sign = 1.0 if v > 0 else (-1.0 if v < 0 else 0.0)
                resistive[i, s] = sign * size_of
            if ramp != 0.0:
                for s in range(runs):
                    turn = past[i, s] / ramp_length + phase[s]
                    resistive[i, s] += ramp * (4.0 * abs(turn - np.floor(turn + 0.5)) - 1.0)
        for i in range(size):
            constant = h[i]
            for j in range(B.shape[1]):
                constant += B[i, j] * force[k, j]
            for s in range(runs):
                now[i, s] = constant
            for j in range(size):
                factor = A[i, j]
                for s in range(runs):
                    now[i, s] += factor * past[j, s]
            for j in range(n):
                factor = E[i, j]
                for s in range(runs):
                    now[i, s] += factor * resistive[j, s]


def largest_force(masses: Array, c0: float, c1: float, c2: float, ramp: float, speed_limit: float) -> Array:
    """delta_i of Remark 2 (n,), N: the resistive law at the speed limit, the ramp force at its largest."""
    delta = (c0 + c1 * speed_limit) * masses + ramp
    delta[0] += c2 * masses.sum() * speed_limit**2
    return delta
