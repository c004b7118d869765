"""RBPF, SMA and GSMA as a textbook would program them: one particle after the other, in NumPy.

The oracle of the compiled family, and the peer its speed is measured against. One run at a time, no masks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...scenarios.arrays import Array
from ...scenarios.model import DesignModel, grid_of
from ...scenarios.randomness import RunRandom
from ..stochastic_m.cloud import DRAWS, GridParticles


@dataclass
class Particle:
    """A grid index, a logarithmic weight, and the Gaussian (x, P) of the state."""

    theta: int
    logw: float
    x: Array
    P: Array


def particle_loop(estimator: GridParticles, model: DesignModel, inputs: Array, measurements: Array,
                  random: RunRandom) -> tuple[Array, Array, int]:
    """Run `estimator`'s algorithm for a single run with a full Kalman filter per particle (eqs. (14) to (22)).

    Takes from the estimator only its parameters: children and their prior, pruning, proposal. inputs (K, nu),
    measurements (K, ny), all received; random: that run's stream, drawn from in the estimator's portions.
    Returns mean (K, nx), parameter (K,) and the number of Kalman updates."""
    modes = grid_of(model, "the particle loop")
    children, prior = estimator.offspring(modes)
    n = estimator.first()
    edges = np.cumsum(modes.prior)[:-1]
    theta = np.searchsorted(edges, random.uniform(0.0, 1.0, n)[:, 0], side="right")
    P0 = model.initial_covariance[:, :, 0]
    start = model.initial_mean[:, 0] + random.normal(model.nx, n)[:, :, 0].T * np.sqrt(np.diag(P0))
    cloud = [Particle(int(theta[i]), 0.0, start[i], P0.copy()) for i in range(n)]
    moves = getattr(estimator, "edges", None)
    means, parameters, updates = [], [], 0
    width, waiting = estimator.draws_per_step(), list[Array]()
    for u, y in zip(inputs, measurements, strict=True):
        waiting = waiting or list(random.uniform(0.0, 1.0, max(1, DRAWS // width), width)[:, :, 0])
        draws = waiting.pop(0)
        if moves is not None:
            for i, particle in enumerate(cloud):
                particle.theta = int(np.searchsorted(moves[particle.theta], draws[1 + i], side="right"))
        families: list[list[Particle]] = []
        for particle in cloud:
            families.append([])
            for child, log_prior in zip(children[particle.theta], prior[particle.theta], strict=True):
                logw = 0.0 if estimator.memoryless else particle.logw
                families[-1].append(_kalman(model, int(child), logw + log_prior, particle.x, particle.P, u, y))
                updates += 1
        if estimator.optimal:
            cloud = [_draw(family, draws[1 + i]) for i, family in enumerate(families)]
        else:
            cloud = [particle for family in families for particle in family]
        logw = np.array([particle.logw for particle in cloud])
        w = np.exp(logw - logw.max())
        w /= w.sum()
        means.append(sum(weight * particle.x for weight, particle in zip(w, cloud, strict=True)))
        parameters.append(sum(weight * modes.grid[p.theta] for weight, p in zip(w, cloud, strict=True)))
        keep = estimator.goes_on(len(cloud), children.shape[1])
        if keep and estimator.by_weight:
            cloud = [cloud[i] for i in sorted(np.argsort(-logw, kind="stable")[:keep])]
        elif keep:
            chosen = np.searchsorted(np.cumsum(w), (draws[0] + np.arange(keep)) / keep, side="right")
            cloud = [Particle(cloud[i].theta, 0.0, cloud[i].x, cloud[i].P) for i in chosen]
    return np.array(means), np.array(parameters), updates


def _kalman(model: DesignModel, mode: int, logw: float, x: Array, P: Array, u: Array, y: Array) -> Particle:
    """One child: prediction, likelihood and update with the matrices of its mode."""
    modes = grid_of(model, "the particle loop")
    A, C = modes.A[mode], modes.C
    x = A @ x + modes.B[mode] @ u
    P = A @ P @ A.T + modes.Q
    S = C @ P @ C.T + modes.R
    inverse = np.linalg.inv(S)
    e = y - C @ x
    K = P @ C.T @ inverse
    loglik = -0.5 * (e @ inverse @ e + np.log(np.linalg.det(S)))
    return Particle(mode, logw + loglik, x + K @ e, P - K @ S @ K.T)


def _draw(family: list[Particle], uniform: float) -> Particle:
    """Optimal proposal: one child by its weight, which then carries the family's total weight."""
    logw = np.array([child.logw for child in family])
    top = logw.max()
    w = np.exp(logw - top)
    child = family[int(np.searchsorted(np.cumsum(w), uniform * w.sum(), side="right"))]
    return Particle(child.theta, float(top + np.log(w.sum())), child.x, child.P)
