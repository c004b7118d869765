"""The Kalman filter of four and twelve states with missing packets against filterpy, simdkalman and by hand.

The same truths and matrices for all; sigma-point filters stand beside it, as they find the same on a linear model."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from filterpy.kalman import KalmanFilter

from ...scenarios.arrays import Array
from ...scenarios.world import Trajectory
from . import by_hand
from .measure import BY_HAND, Line, cell_of, contest, ours, peer, recorded

RUNS, STEPS, PEER_RUNS, CARS = (1, 100, 1000), 200, 3, (2, 6)
Loop = Callable[[], tuple[int, Array]]


def race(repeats: int) -> list[Line]:
    """The Kalman filter at each number of states and runs against each peer; sigma-point filters, which find the same
    on a linear model, against the loop written by hand for the Kalman filter."""
    lines = []
    for cars in CARS:
        for runs in RUNS:
            lines += _against(cars, runs, "kalman", ("filterpy", "simdkalman", BY_HAND), repeats)
        for plugin in ("ukf", "ckf"):
            lines += _against(cars, RUNS[-1], plugin, (BY_HAND,), repeats)
    return lines


def _against(cars: int, runs: int, plugin: str, names: tuple[str, ...], repeats: int) -> list[Line]:
    overrides = {"time.steps": STEPS + 1, "plant.cars": cars}
    cell = cell_of("cbtc-csma/uniform", "kalman", overrides, plugin)
    world = recorded(cell, runs)
    model = cell.setting().design_model(cell.entries["kalman"].knowledge, world.initial_mean)
    linear, n = model.linear, 2 * cars
    assert linear is not None
    matrices = tuple(np.ascontiguousarray(part(0), dtype=float)
                     for part in (linear.A, linear.B, linear.h, linear.C, linear.Q, linear.R))
    P0 = model.initial_covariance[:, :, 0].copy()
    sides = {"filterpy": _filterpy, "simdkalman": _simdkalman, BY_HAND: _by_hand}
    mine = ours(cell, "kalman", runs, STEPS)._replace(name=plugin)
    return contest(mine, n, runs, [peer(name, sides[name](world, matrices, P0)) for name in names], repeats)


def _filterpy(world: Trajectory, matrices: tuple[Array, ...], P0: Array) -> Loop:
    A, B, h, C, Q, R = matrices
    runs, (n, ny) = min(PEER_RUNS, world.y.shape[2]), (len(A), len(C))

    def loop() -> tuple[int, np.ndarray]:
        last = []
        for run in range(runs):
            filter = KalmanFilter(n, ny)
            filter.x, filter.P, filter.F, filter.H, filter.Q, filter.R = (
                world.initial_mean[:, run].copy(), P0.copy(), A, C, Q, R)
            for k in range(STEPS):
                if k:
                    filter.predict()
                    filter.x = filter.x + B @ world.u[k, :, run] + h
                filter.update(world.y[k, :, run] if world.received[k, 0, run] else None)
            last.append(filter.x)
        return runs * STEPS, np.array(last).T

    return loop


def _by_hand(world: Trajectory, matrices: tuple[Array, ...], P0: Array) -> Loop:
    A, B, h, C, Q, R = matrices
    runs = world.y.shape[2]
    u, y = np.ascontiguousarray(world.u[:STEPS]), np.ascontiguousarray(world.y[:STEPS])
    received = np.ascontiguousarray(world.received[:STEPS, 0])

    def loop() -> tuple[int, np.ndarray]:
        x, P = world.initial_mean.copy(), np.repeat(P0[:, :, None], runs, axis=2)
        by_hand.kalman(x, P, u, y, received, A, B, h, C, Q, R)
        return runs * STEPS, x

    return loop


def _simdkalman(world: Trajectory, matrices: tuple[Array, ...], P0: Array) -> Loop:
    """simdkalman has no input: it filters the deviation from the motion without error, whose start is the truth."""
    import simdkalman

    A, B, h, C, Q, R = matrices
    runs = world.y.shape[2]
    nominal = np.empty((STEPS, len(A), runs))
    x = world.initial_mean.copy()
    for k in range(STEPS):
        x = x if k == 0 else A @ x + B @ world.u[k] + h[:, None]
        nominal[k] = x
    deviation = np.moveaxis(world.y[:STEPS] - np.einsum("ij,kjs->kis", C, nominal), 2, 0)
    deviation = np.where(world.received[:STEPS, 0].T[:, :, None], deviation, np.nan)
    filter = simdkalman.KalmanFilter(A, Q, C, R)

    def loop() -> tuple[int, np.ndarray]:
        found = filter.compute(deviation, 0, initial_value=np.zeros(len(A)), initial_covariance=P0, smoothed=False,
                               filtered=True, observations=False)
        return runs * STEPS, found.filtered.states.mean[:, -1].T + nominal[-1]

    return loop
