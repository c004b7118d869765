"""Second moments of a constant gain: how fast they fall, and where they stay; exact, and measured from a start error.

What a certificate bounds from above, computed for a known reception probability; no solver."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...scenarios.arrays import Array
from ...scenarios.errors import Unsupported
from ...scenarios.model import DesignModel
from ...scenarios.world import Trajectory
from .lmi import ErrorSystem

LARGEST = 32
"""States up to which the moments are computed: their operator has the square of that many rows."""


class MeanSquare(NamedTuple):
    """decay: spectral radius of S -> E[(A - a K C) S (A - a K C)'], the factor a step by which E e e' falls. noise,
    forced: E |M e|^2 in the long run from the sensors' noise alone, and with every force constantly at its bound as
    well; None where the second moments do not fall."""

    decay: float
    noise: float | None
    forced: float | None


def mean_square(system: ErrorSystem, K: Array, probability: float | None = None) -> MeanSquare:
    """The second moments of gain K (nx, ny), by E[(A - a K C) (x) (A - a K C)] over what arrives. probability: of the
    packet's arrival; None: the mean of each node's. Raises Unsupported for more than 32 states."""
    A, nx = system.A, len(system.A)
    if nx > LARGEST:
        raise Unsupported(f"exact second moments are computed for up to {LARGEST} states, here are {nx}")
    missed, mean = 1.0, np.zeros_like(A)
    operator, noise = np.zeros((nx * nx, nx * nx)), np.zeros_like(A)
    for node in system.nodes:
        chance, rows = node.mean if probability is None else probability, list(node.elements)
        gain, closed = K[:, rows], A - K[:, rows] @ system.C[rows]
        missed -= chance
        mean += chance * closed
        operator += chance * np.kron(closed, closed)
        noise += chance * gain @ (system.noise_root @ system.noise_root.T)[np.ix_(rows, rows)] @ gain.T
    mean += missed * A
    operator += missed * np.kron(A, A)
    decay = float(np.abs(np.linalg.eigvals(operator)).max())
    if decay >= 1:
        return MeanSquare(decay, None, None)
    push = system.E @ system.delta
    cross = np.outer(mean @ np.linalg.solve(np.eye(nx) - mean, push), push)
    rest = np.eye(nx * nx) - operator

    def settled(source: Array) -> float:
        S = np.linalg.solve(rest, source.ravel()).reshape(nx, nx)
        return float(np.trace(system.M @ S @ system.M.T))

    return MeanSquare(decay, settled(noise), settled(noise + np.outer(push, push) + cross + cross.T))


def measured_fall(model: DesignModel, K: Array, world: Trajectory) -> int | None:
    """The steps after which a hundredth is left of the start error's E |M e|^2: the mean over a world's runs before
    each packet, less what stays (the last quarter's mean). None where there is no such fall."""
    linear, M = model.linear, model.performance
    assert linear is not None and M is not None
    A, C, own = linear.A(0), linear.C(0), world.truth.shape[1]
    correction, mean, squares = np.linalg.solve(A, K), np.array(model.initial_mean), np.empty(world.steps)
    for k in range(world.steps):
        if world.lengths[k]:
            mean = A @ mean + linear.B(0) @ world.u[k] + linear.h(0)[:, None]
        squares[k] = np.square(M[:, :own] @ (world.truth[k] - mean[:own])).sum(axis=0).mean()
        mean = mean + correction @ np.where(world.received[k], world.y[k] - C @ mean, 0.0)
    excess = squares - squares[-(len(squares) // 4):].mean()
    fallen = np.flatnonzero(excess <= excess[0] / 100)
    if excess[0] < 0.5 * squares[0] or not fallen.size:
        return None
    return int(fallen[0])
