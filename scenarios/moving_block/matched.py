"""The least error possible on the ring: each train's place along the track and its encoder's scale, by their moments.

A train cannot leave the track, so its place is one number; readings, counts and scales are as they truly are."""

from __future__ import annotations

import numpy as np

from ..arrays import Array
from ..channels import OneAtATime
from ..machine_code import njit
from ..measurement import Interval
from ..model import DesignModel
from ..setting import Matched
from .config import MovingBlockConfig
from .track import StadiumTrack, place, project


def matched(config: MovingBlockConfig, track: StadiumTrack, runs: int) -> Matched | None:
    """States: place along the track and scale, of A, then of B. Counted distance u = ds (1 + b + w): an error of the
    scale moves the place by -u / (1 + b)^2 of it, w by as much.

    What is counted lags behind by up to a pulse, uniform and fresh at each step: it adds to the error of the place and
    is carried by no state. A tag's reading tells the place where it lies; None where a channel may part its x from its
    y. Quantisation is uniform, and that no tag has been read yet tells something too: a linear optimum."""
    channel, encoder = config.channel, config.sensors.encoder
    if isinstance(channel, OneAtATime) or isinstance(getattr(channel, "loss", None), OneAtATime):
        return None
    period, lag = config.time.period, encoder.pulse**2 / 12
    noise = encoder.noise_sd * (encoder.noise_period / period) ** 0.5
    seen = np.zeros((4, 4, 1))
    seen[0, 0] = seen[2, 2] = 1.0
    read = np.eye(4)[:, :, None] * max(config.sensors.tags.sd**2 + lag * 2 / 3, 1e-12)  # between two counts: 2/3 of it

    def slope(u: Array) -> Array:
        return u / (1 + encoder.bias_mean) ** 2

    def jacobian(x: Array, u: Array, interval: Interval) -> Array:
        out = np.zeros((4, 4, u.shape[1]))
        out[range(4), range(4)] = 1.0
        out[0, 1], out[2, 3] = -slope(u * interval.share)
        return out

    def process_covariance(x: Array, u: Array, interval: Interval) -> Array:
        """w is one number a step: over shares g to h of its way the variance grows by h^2 - g^2 of the whole."""
        gone = (np.asarray(interval.start) - interval.depart * period) / period
        grown = (gone + interval.share) ** 2 - gone**2
        out = np.zeros((4, 4, u.shape[1]))
        way = noise * slope(u)
        out[0, 0], out[2, 2] = way * way * grown
        return out

    def outward(truth: Array) -> Array:
        """Along the track at each train's true place."""
        out = np.zeros((4, 4, truth.shape[1]))
        _along(truth, track.half, track.radius, out)
        return out

    sd = np.array([config.sensors.start_sd, encoder.bias_sd] * 2)
    model = DesignModel(
        states=("s-a", "scale-a", "s-b", "scale-b"), measurements=("x-a", "y-a", "x-b", "y-b"), period=period,
        transition=lambda x, u, interval: x, measurement=lambda x, step: x, transition_jacobian=jacobian,
        measurement_jacobian=lambda x, step: seen, process_covariance=process_covariance,
        measurement_covariance=lambda measurement: read, initial_mean=np.zeros((4, runs)),
        initial_covariance=np.diag(sd**2)[:, :, None])
    return Matched(model, "linear optimum", outward, np.array([lag, 0.0, lag, 0.0]))


@njit(cache=True)
def _along(truth, half, radius, out):
    """out (4, 4, S), zero on entry: cos and sin of the heading at the place of each train, truth (4, S)."""
    for train in range(2):
        i = 2 * train
        for run in range(truth.shape[1]):
            _, _, out[i, i, run], out[i + 1, i, run] = place(project(truth[i, run], truth[i + 1, run], half, radius),
                                                             half, radius)
