"""The twelve-state Kalman filter with missing packets against filterpy and simdkalman on the same truths.

simdkalman knows no input, so all three filter the train's free motion: the same matrices, the same arithmetic."""

from __future__ import annotations

import numpy as np
from filterpy.kalman import KalmanFilter

from .measure import Row, cell_of, line, ours, peer, recorded

STEPS, PEER_RUNS = 200, 3


def race(repeats: int) -> list[Row]:
    """Lines for 100 and 1000 runs against each peer."""
    cell = cell_of("cbtc-csma/uniform", "kalman", {"time.steps": STEPS + 1})
    setting = cell.setting()
    rows = []
    for runs in (100, 1000):
        mine, _, _, means = ours(cell, "kalman", runs, STEPS, repeats)
        world = recorded(cell, runs)
        model = setting.design_model(cell.entries["kalman"].knowledge, world.initial_mean)
        linear = model.linear
        assert linear is not None
        A, B, h, C, Q, R = (part(0) for part in (linear.A, linear.B, linear.h, linear.C, linear.Q, linear.R))
        P0 = model.initial_covariance[:, :, 0]

        def filterpy(world=world, A=A, B=B, h=h, C=C, Q=Q, R=R, P0=P0) -> tuple[int, np.ndarray]:
            last = []
            for run in range(PEER_RUNS):
                filter = KalmanFilter(12, 12)
                filter.x, filter.P, filter.F, filter.H, filter.Q, filter.R = (
                    world.initial_mean[:, run].copy(), P0.copy(), A, C, Q, R)
                for k in range(STEPS):
                    if k:
                        filter.predict()
                        filter.x = filter.x + B @ world.u[k, :, run] + h
                    filter.update(world.y[k, :, run] if world.received[k, 0, run] else None)
                last.append(filter.x)
            return PEER_RUNS * STEPS, np.array(last).T

        theirs, last = peer(filterpy, repeats)
        rows.append(line("kalman", runs, mine, "filterpy", theirs, float(np.abs(means[:, :PEER_RUNS] - last).max())))
        theirs, last = peer(_simdkalman(world, A, B, h, C, Q, R, P0), repeats)
        rows.append(line("kalman", runs, mine, "simdkalman", theirs, float(np.abs(means - last).max())))
    return rows


def _simdkalman(world, A, B, h, C, Q, R, P0):  # pyright: ignore
    """simdkalman has no input: it filters the deviation from the motion without error, whose start is the truth."""
    import simdkalman

    runs = world.y.shape[2]
    nominal = np.empty((STEPS, 12, runs))
    x = world.initial_mean.copy()
    for k in range(STEPS):
        x = x if k == 0 else A @ x + B @ world.u[k] + h[:, None]
        nominal[k] = x
    deviation = np.moveaxis(world.y[:STEPS] - np.einsum("ij,kjs->kis", C, nominal), 2, 0)
    deviation = np.where(world.received[:STEPS, 0].T[:, :, None], deviation, np.nan)
    filter = simdkalman.KalmanFilter(A, Q, C, R)

    def loop() -> tuple[int, np.ndarray]:
        found = filter.compute(deviation, 0, initial_value=np.zeros(12), initial_covariance=P0, smoothed=False,
                               filtered=True, observations=False)
        return runs * STEPS, found.filtered.states.mean[:, -1].T + nominal[-1]

    return loop
