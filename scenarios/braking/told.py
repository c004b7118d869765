"""The brake plant of Zheng et al. 2015, eq. (4), discretised exactly, and what estimators are told of it.

Kept apart from the setting so that truth and design model share one discretisation and nothing else."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import Array
from ..measurement import Interval
from ..measurement import told as told_covariance
from ..model import Bounds, DesignModel, Grid, Linear, grid_modes, linear_model, product, whole_steps
from .plant import Affine

STATES = ("displacement", "speed", "control-acceleration", "target-acceleration")
PARAMETER = "f"


@dataclass(frozen=True)
class Told:
    """What every design model of the brake shares. initial_mean (4, S), initial_variance (4,), C (ny, 4), R (ny, ny).

    noise (4, 4): process covariance per step."""

    plant: Affine
    period: float
    initial_mean: Array
    initial_variance: Array
    noise: Array
    C: Array
    R: Array
    measurements: tuple[str, ...]


def grid_model(told: Told, grid: Array, prior: Array, nominal: float) -> DesignModel:
    """The four-state model with one mode per grid value of f, prior (m,) over them; its plain linear part
    believes f = `nominal`."""
    matrices = [told.plant.at(float(value)) for value in grid]
    Q = told.noise
    modes = Grid(PARAMETER, grid, np.array([A for A, _ in matrices]), np.array([B for _, B in matrices]), told.C, Q,
                 told.R, prior)
    A, B = told.plant.at(nominal)
    zero = np.zeros(4)
    linear = Linear(lambda k: A, lambda k: B, lambda k: zero, lambda k: told.C, lambda k: Q, lambda k: told.R)
    model = linear_model(linear, states=STATES, measurements=told.measurements, period=told.period,
                         initial_mean=told.initial_mean, initial_covariance=np.diag(told.initial_variance)[:, :, None])
    return replace(model, modes=grid_modes(modes, model))


@dataclass(frozen=True)
class Walk:
    """f as a random walk: f(0) ~ N(mean, variance), step variance `step`; target_variance keeps a_z's covariance
    positive (the plant itself has no noise there)."""

    mean: float
    variance: float
    step: float
    target_variance: float

    def start(self, told: Told) -> tuple[Array, Array]:
        """Initial mean (5, S) and covariance (5, 5, 1)."""
        runs = told.initial_mean.shape[1]
        mean = np.concatenate([told.initial_mean, np.full((1, runs), self.mean)])
        return mean, np.diag([*told.initial_variance, self.variance])[:, :, None]

    def covariance(self, gain: Array, noise: Array) -> Array:
        """Process covariance (5, 5, S) when f's step moves (D, v, a^) by gain (3, S), and noise (4, 4) is the rest:
        f(k+1) acts on the step into k + 1, so its noise does too."""
        runs = gain.shape[1]
        out = np.zeros((5, 5, runs))
        direction = np.concatenate([gain, np.zeros((1, runs)), np.ones((1, runs))])
        for i in range(5):
            for j in range(5):
                out[i, j] = self.step * (direction[i] * direction[j])
        out[:4, :4] += noise[:, :, None]
        out[3, 3] += self.target_variance
        return out


def augmented_model(told: Told, walk: Walk) -> DesignModel:
    """The state with f appended, x = (D, v, a^, a_z, f): bilinear in f and a_z, whole steps only."""
    plant = told.plant
    mean, covariance = walk.start(told)
    C = np.hstack([told.C, np.zeros((told.C.shape[0], 1))])

    def sensitivity(x: Array, target: Array) -> Array:
        """d (D, v, a^) / d f, shape (3, S)."""
        return np.stack([plant.A1[i, 3] * x[3] + plant.B1[i, 0] * target for i in range(3)])

    def transition(x: Array, u: Array, interval: Interval) -> Array:
        whole_steps(interval, "this model of the brake")
        return np.concatenate([plant.step(x[:4], x[4], u[0]), x[4:]])

    def jacobian(x: Array, u: Array, interval: Interval) -> Array:
        out = np.zeros((5, 5, x.shape[1]))
        out[:4, :4] = plant.A0[:, :, None]
        out[:4, :4] += plant.A1[:, :, None] * x[4]
        out[:3, 4] = sensitivity(x, u[0])
        out[4, 4] = 1.0
        return out

    return DesignModel(
        states=(*STATES, PARAMETER),
        measurements=told.measurements,
        period=told.period,
        transition=transition,
        measurement=lambda x, step: product(C, x),
        transition_jacobian=jacobian,
        measurement_jacobian=lambda x, step: C[:, :, None],
        linear_measurement=True,
        process_covariance=lambda x, u, interval: walk.covariance(sensitivity(x, u[0]), told.noise),
        measurement_covariance=told_covariance(lambda step: told.R[:, :, None]),
        initial_mean=mean,
        initial_covariance=covariance,
    )


def scheduled_model(told: Told, walk: Walk, targets: Array) -> DesignModel:
    """The augmented state with a_z taken as known: linear in (D, v, a^, f), time-varying through a_z and a_t.

    targets (K,): a_t over the step into k. a_z follows from it without noise, the same in every run, so the ordinary
    Kalman filter is exact here. The commanded profile is knowledge of the brake controller, not of the truth.

    Bounds (f as a bounded unknown) where a_t and a_z are constant, so that a change of f always moves the state the
    same way: |f(k+1) - f(k)| <= sqrt(3 variance), as for uniform steps of that variance; speed noise within 3 sigma."""
    plant = told.plant
    steps = len(targets)
    x = told.initial_mean[:, :1]
    gains = np.empty((steps, 3))
    for k, target in enumerate(targets):
        gains[k] = [plant.A1[i, 3] * x[3, 0] + plant.B1[i, 0] * target for i in range(3)]
        x = plant.step(x, 0.0, float(target))
    A = np.zeros((steps, 5, 5))
    A[:, :4, :4] = plant.A0
    A[:, :3, 4] = gains
    A[:, 4, 4] = 1.0
    Q = np.stack([walk.covariance(gain[:, None], told.noise)[:, :, 0] for gain in gains])
    B = np.concatenate([plant.B0, np.zeros((1, 1))])
    C = np.hstack([told.C, np.zeros((told.C.shape[0], 1))])
    zero = np.zeros(5)
    mean, covariance = walk.start(told)
    last = steps - 1
    linear = Linear(lambda k: A[min(k, last)], lambda k: B, lambda k: zero, lambda k: C, lambda k: Q[min(k, last)],
                    lambda k: told.R, constant=False)
    bounds = None
    if np.abs(gains - gains[0]).max() <= 1e-3 * np.abs(gains[0]).max():
        G = np.zeros((5, 2))
        speed = np.sqrt(told.noise[1, 1])
        G[:3, 0], G[4, 0] = gains[0], 1.0
        G[:4, 1] = told.noise[:, 1] / told.noise[1, 1] if speed else 0.0
        w_bar = np.array([np.sqrt(3 * walk.step), 3 * speed])
        bounds = Bounds(G, w_bar, np.full(len(C), np.inf))
    return linear_model(linear, states=(*STATES, PARAMETER), measurements=told.measurements, period=told.period,
                        initial_mean=mean, initial_covariance=covariance, bounds=bounds)
