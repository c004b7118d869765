"""From what the sensors measure to what an estimator hears: faults of the sensors, then the channel.

The one way from a setting's clean readings to its world, so that every fault and channel works in every setting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .arrays import Array, Mask
from .channels import Base as Channel
from .channels import Sent
from .faults import Base as Fault
from .faults import Readings
from .randomness import Streams
from .world import Sensing, Trajectory


def observe(trajectory: Trajectory, streams: Streams, sensing: Sensing, channel: Channel,
            faults: Sequence[Fault], clean: Array | None = None) -> Trajectory:
    """A trajectory as it is heard. Its `received` says which readings there are before faults and channel.

    clean (K, ny, S): the readings without noise, where they are known."""
    times = np.cumsum(trajectory.lengths)
    readings = faulted(trajectory.y, trajectory.received, times, streams, sensing, faults, clean, trajectory.truth)
    arrived = channel.carry(streams, Sent(readings.y, readings.there, sensing.sd))
    return replace(trajectory, truth=trajectory.truth if readings.truth is None else readings.truth, y=arrived.y,
                   received=arrived.received, late=arrived.late, faulty=readings.faulty if faults else None)


def faulted(y: Array, there: Mask, time: Array, streams: Streams, sensing: Sensing, faults: Sequence[Fault],
            clean: Array | None = None, truth: Array | None = None, following: bool = True) -> Readings:
    """The readings y (K, ny, S) at time (K,) s after all faults; the arrays given are left alone where there is any."""
    nothing = np.zeros(y.shape if faults else (0, *y.shape[1:]), dtype=bool)
    readings = Readings(sensing, time, y, there, clean, truth, nothing, nothing.copy(), following)
    if not faults:
        return readings
    readings.y, readings.there = y.copy(), there.copy()
    readings.truth = None if truth is None else truth.copy()
    readings.clean = None if clean is None else clean.copy()
    for fault in faults:
        fault.apply(streams("fault", fault.label), readings)
    readings.there &= ~readings.told
    return readings
