"""The truth as the runner sees it: a `World` that is stepped, open loop (a recorded `Trajectory`) or closed loop.

One interface for both, so that the same runner and the same estimators serve either."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .arrays import Array, Mask


@dataclass(frozen=True, slots=True)
class Event:
    """One prediction and one measurement inside a step.

    portion: time since the previous event, in sampling periods; a number or one per run (S,). The number 0.0 means no
    prediction at all. y (ny, S); received (ny, S): which elements arrived (elements that did not are never read)."""

    portion: float | Array
    y: Array
    received: Mask


@dataclass(frozen=True, slots=True)
class Step:
    """What happens on the way to one scored instant.

    u (nu, S): the input as the estimator is told it, over the interval that ends here. events: in time order, their
    portions adding up to the step's length. truth (nt, S): the state, then the parameters to be estimated, at the
    instant. active (S,): runs still under way (a train that has stopped is scored no further). scored (nt, S): elements
    of the truth that still count in runs under way (one of several trains may have finished); None: all of them.
    window (S,): index of the world's named window each run is in (a section of a trip), -1 for none."""

    u: Array
    events: tuple[Event, ...]
    truth: Array
    active: Mask
    scored: Mask | None = None
    window: NDArray[np.int16] | None = None


class World(Protocol):
    """A batch of runs being simulated. `step(k, mean)` is called for k = 0, 1, .., steps - 1, in order.

    mean (nx, S) is the estimator's latest estimate (before this step); open-loop worlds ignore it."""

    @property
    def steps(self) -> int:
        """How many steps there are at the most."""
        ...

    @property
    def initial_mean(self) -> Array:
        """The estimators' start (nx, S)."""
        ...

    @property
    def closed_loop(self) -> bool:
        """Whether the estimate acts on the truth."""
        ...

    def step(self, k: int, mean: Array) -> Step:
        """What happens on the way to instant k."""
        ...


def step_times(world: World, period: float) -> Array:
    """Time of each scored instant since the first one, s, (K,): steps of the world's own lengths where it has any."""
    portions = getattr(world, "portions", np.ones(world.steps))
    return (np.cumsum(portions) - portions[0]) * period


@dataclass(frozen=True)
class Trajectory:
    """An open-loop world, simulated beforehand and shared by all estimators.

    truth (K, nt, S); u (K, nu, S): input over the interval that ends at step k; y (K, ny, S); received (K, ny, S);
    active (K, S); portions (K,): length of the interval that ends at step k in sampling periods (0.0: measure only).
    initial_mean (nx, S): the estimators' start, before step 0. extra: what figures of this setting want, free form.
    windows: names of parts of the trip whose errors are reported on their own; window (K, S): which part a step is in,
    -1 for none."""

    truth: Array
    u: Array
    y: Array
    received: Mask
    active: Mask
    portions: Array
    initial_mean: Array
    extra: dict[str, Array] = field(default_factory=dict)
    closed_loop: bool = False
    windows: tuple[str, ...] = ()
    window: NDArray[np.int16] | None = None

    @property
    def steps(self) -> int:
        return self.truth.shape[0]

    def step(self, k: int, mean: Array) -> Step:
        event = Event(float(self.portions[k]), self.y[k], self.received[k])
        window = None if self.window is None else self.window[k]
        return Step(self.u[k], (event,), self.truth[k], self.active[k], window=window)
