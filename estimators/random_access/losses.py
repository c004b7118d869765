"""The Kalman filter's mean covariance where whole packets are lost at random: bounds, and its value by renewal.

Sample means of P show no threshold (near it P has no variance), so none are taken."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...scenarios.arrays import Array
from ...scenarios.errors import Unsupported
from ...scenarios.model import DesignModel
from ...scenarios.randomness import Streams

CHAINS, STEPS, LEFT_OUT = 400, 1500, 100
"""How the mean covariance after an arrival is simulated: chains of so many steps, the first ones left out."""
ROUNDS, ENOUGH = 100_000, 1e-10


@dataclass(frozen=True)
class Losses:
    """Traces of the predicted covariance in the long run where each packet arrives with probability p: lower <= mean <=
    upper, inf where they grow without end. error: the mean's standard error. The mean is None where one packet does not
    tell the whole state."""

    p: float
    lower: float
    mean: float | None
    error: float | None
    upper: float


def plant(model: DesignModel) -> tuple[Array, Array, Array, Array]:
    """A, C, Q, R of a linear model that does not change. Raises Unsupported."""
    linear = model.linear
    if linear is None or not linear.constant:
        raise Unsupported("the mean covariance under losses needs a linear plant that does not change with time")
    return linear.A(0), linear.C(1), linear.Q(0), linear.R(1)


def growth(A: Array) -> float:
    """rho(A)^2: with packets lost, the covariance grows by it. Bounded iff (1 - p) rho^2 < 1 where one packet tells the
    whole state; in bursts iff (1 - p_bad_good) rho^2 < 1, whatever the mean loss."""
    return float(np.abs(np.linalg.eigvals(A)).max() ** 2)


def losses(model: DesignModel, p: float) -> Losses:
    """Sinopoli et al., IEEE TAC 49(9), 2004: S = (1 - p) A S A' + Q <= E P <= V = A V A' + Q - p A V C' (C V C' +
    R)^-1 C V A'. By renewal E P = (1 - p) A E P A' + p A M A' + Q with M the mean updated covariance at arrivals, which
    is bounded and simulated. Raises Unsupported where the plant is not linear or changes."""
    A, C, Q, R = plant(model)
    whole = np.linalg.matrix_rank(C) == len(A)
    upper = _upper(A, C, Q, R, p)
    if not (1 - p) * growth(A) < 1:
        return Losses(p, np.inf, np.inf, None, np.inf)
    lower = float(np.trace(_settled(A, Q, p)))
    if not whole:
        return Losses(p, lower, None, None, upper)
    each = np.array([np.trace(_settled(A, p * A @ M @ A.T + Q, p)) for M in _at_arrivals(A, C, Q, R, p)])
    return Losses(p, lower, float(each.mean()), float(each.std(ddof=1) / np.sqrt(len(each))), upper)


def _settled(A: Array, Q: Array, p: float) -> Array:
    """X = (1 - p) A X A' + Q."""
    from scipy.linalg import solve_discrete_lyapunov

    return solve_discrete_lyapunov(np.sqrt(1 - p) * A, Q)


def _upper(A: Array, C: Array, Q: Array, R: Array, p: float) -> float:
    """Trace of V, inf where its recursion has no end."""
    V = Q.copy()
    for _ in range(ROUNDS):
        gain = V @ C.T @ np.linalg.inv(C @ V @ C.T + R)
        after = A @ (V - p * gain @ C @ V) @ A.T + Q
        if not np.trace(after) < 1e12:
            return np.inf
        if np.abs(after - V).max() <= ENOUGH * np.abs(after).max():
            return float(np.trace(after))
        V = (after + after.T) / 2
    return np.inf


def _at_arrivals(A: Array, C: Array, Q: Array, R: Array, p: float) -> Array:
    """Mean updated covariance at arrivals, a chain each (CHAINS, n, n)."""
    arrived = Streams(1, "losses", f"{p:g}", tuple(range(CHAINS)))("channel").uniform(0.0, 1.0, STEPS) < p
    P, total, count = np.broadcast_to(Q, (CHAINS, *Q.shape)), np.zeros((CHAINS, *Q.shape)), np.zeros(CHAINS)
    for k in range(STEPS):
        cross = P @ C.T
        updated = P - cross @ np.linalg.solve(C @ cross + R, np.swapaxes(cross, 1, 2))
        here = arrived[k][:, None, None]
        if k >= LEFT_OUT:
            total, count = total + np.where(here, updated, 0.0), count + arrived[k]
        P = A @ np.where(here, updated, P) @ A.T + Q
    return total / np.maximum(count, 1)[:, None, None]
