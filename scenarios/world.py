"""The truth as the runner sees it: a `World` that is stepped, open loop (a recorded `Trajectory`) or closed loop.

One interface for both, so that the same runner and the same estimators serve either."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import InitVar, dataclass, field, fields
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from .arrays import Array, Index, Mask, read_only
from .errors import InputError
from .measurement import Course, PerRun


@dataclass(slots=True)
class Event:
    """One prediction and one measurement inside a step.

    share: of the step, since the event before; a number or one per run (S,). The number 0.0 means no prediction at all.
    y (ny, S); received (ny, S): which elements arrived (elements that did not are never read). covariance (ny, ny, S or
    1): as `Measurement` has it. late (ny, S): by how many steps an element that is not received yet comes late, 0:
    never; None: none is late. faulty (ny, S): elements that a sensor's fault has made wrong, for scores alone; None: no
    faults."""

    share: PerRun
    y: Array
    received: Mask
    covariance: Array | None = None
    late: Index | None = None
    faulty: Mask | None = None


FIRST_EDITION = -1
"""The number of a step that was made without one."""


@dataclass(slots=True)
class Step:
    """What happens on the way to one scored instant.

    u (nu, S): the input as the estimator is told it, over the interval that ends here. events: in time order, their
    shares adding up to 1 (or 0: measured at the start). truth (nt, S): the state, then the parameters to be estimated,
    at the instant (NaN: unknown). active (S,): runs still under way (a train that has stopped is scored no further, and
    hears nothing any more). scored (nt, S): elements of the truth that still count in runs under way (one of several
    trains may have finished); None: all of them. window (S,): index of the world's named window each run is in (a
    section of a trip), -1 for none. number: of the step the interval leads to, 0 being the start. start, length: of the
    interval, s, numbers or (S,). reference (2, S): where the last place known on the way (a balise that was read) lies
    as told and in truth, NaN before the first."""

    u: Array
    events: tuple[Event, ...]
    truth: Array
    active: Mask
    scored: Mask | None = None
    window: NDArray[np.int16] | None = None
    number: int = FIRST_EDITION
    start: PerRun = 0.0
    length: PerRun = 0.0
    reference: Array | None = None

    def kept(self) -> Step:
        """A copy to be scored later, without its events: worlds may use their arrays again."""
        parts: dict[str, Any] = {item.name: getattr(self, item.name) for item in fields(self)}
        copies = {name: value.copy() for name, value in parts.items() if isinstance(value, np.ndarray)}
        return Step(**{**parts, **copies, "events": ()})


class Straight(NamedTuple):
    """Steps of an open-loop world from k on that are whole periods with one measurement at the end, with the same runs
    under way: what estimators are told of them, and the rest of `Step`, of B steps each; `last` is the last one."""

    course: Course
    truth: Array
    active: Mask
    scored: Mask | None
    window: NDArray[np.int16] | None
    reference: Array | None
    last: Step


class World(Protocol):
    """A batch of runs being simulated. `step(k, mean)` is called for k = 0, 1, .., steps - 1, in order.

    mean (nx, S) is the estimator's latest estimate (before this step); open-loop worlds ignore it."""

    @property
    def steps(self) -> int:
        """How many steps there are at the most."""
        ...

    @property
    def lengths(self) -> Array:
        """Length of the interval that ends at each of the scored instants, s, (K,)."""
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

    # Worlds in open loop may have `straight(k, most)`: the steps from k on, at most so many, that are `Straight`; None
    # where there are none.


@dataclass(frozen=True)
class Sensing:
    """What a setting's sensors are, for faults and channels that look at the readings.

    names (ny,) of the measurement elements; sd (ny,) or (K, ny): standard deviations of their noise, in the reading's
    own unit. place: by how much one metre further along the line moves the truth (nt,) and the readings (ny,); None
    where no such thing is meant."""

    names: tuple[str, ...]
    sd: Array
    place: tuple[Array, Array] | None = None

    def chosen(self, wanted: tuple[str, ...]) -> list[int]:
        """The elements meant by names, or by their first words (`position` of `position 1`); all where none is wanted.
        Raises ValueError naming those there are."""
        unknown = [name for name in wanted if not any(_means(name, mine) for mine in self.names)]
        if unknown:
            raise ValueError(f"there is no sensor {', '.join(unknown)}; allowed: {', '.join(self.names)}")
        return [i for i, mine in enumerate(self.names) if not wanted or any(_means(name, mine) for name in wanted)]


def _means(name: str, sensor: str) -> bool:
    return name == sensor or name == sensor.split(" ")[0]


def step_times(world: World) -> Array:
    """Time of each scored instant since the first one, s, (K,)."""
    return np.cumsum(world.lengths) - world.lengths[0]


class Later(Mapping[str, Array]):
    """Arrays by name that are computed when one of them is first asked for."""

    def __init__(self, make: Callable[[], dict[str, Array]]) -> None:
        self._make = make

    @cached_property
    def _made(self) -> dict[str, Array]:
        return self._make()

    def __getitem__(self, name: str) -> Array:
        return self._made[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._made)

    def __len__(self) -> int:
        return len(self._made)


@dataclass(frozen=True)
class Trajectory:
    """An open-loop world, simulated beforehand and shared by all estimators.

    truth (K, nt, S); u (K, nu, S): input over the interval that ends at step k; y (K, ny, S); received (K, ny, S);
    active (K, S); lengths (K,): of the interval that ends at step k, s (0.0: measured at the start, no prediction).
    initial_mean (nx, S): the estimators' start, before step 0. extra: what figures of this setting want, free form
    (`Later`: what costs much and is wanted for few runs).
    windows: names of parts of the trip whose errors are reported on their own; window (K, S): which part a step is in,
    -1 for none. covariance (K, ny, ny, S or 1): what the sensors tell of each measurement, NaN where they do not.
    late, faulty (K, ny, S): as in `Event`; reference (K, 2, S): as in `Step`. variance (K, ny, S), in place of
    covariance: of each element by itself, NaN where its sensor tells none. inside: (element, share (K, S)): it is read
    inside its step, after that share of it. Raises InputError without lengths."""

    truth: Array
    u: Array
    y: Array
    received: Mask
    active: Mask
    lengths: Array = field(default_factory=lambda: np.zeros(0))
    initial_mean: Array = field(default_factory=lambda: np.zeros((0, 0)))
    extra: Mapping[str, Array] = field(default_factory=dict)
    closed_loop: bool = False
    windows: tuple[str, ...] = ()
    window: NDArray[np.int16] | None = None
    covariance: Array | None = None
    late: Index | None = None
    faulty: Mask | None = None
    reference: Array | None = None
    variance: Array | None = None
    inside: tuple[int, Array] | None = None
    portions: InitVar[object] = None

    def __post_init__(self, portions: object) -> None:
        if portions is not None or len(self.lengths) != len(self.truth):
            raise InputError("a Trajectory takes lengths (K,), the length of each interval in seconds; portions, in "
                             "sampling periods, are of railstate's first edition: write lengths=portions * period")
        for name in ("u", "y", "received", "covariance"):  # what estimators are handed, step by step
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, read_only(value))

    @cached_property
    def _clock(self) -> tuple[list[float], list[float]]:
        """Start and length of each interval, s."""
        return (np.cumsum(self.lengths) - self.lengths).tolist(), self.lengths.tolist()

    @property
    def steps(self) -> int:
        return self.truth.shape[0]

    def step(self, k: int, mean: Array) -> Step:
        starts, lengths = self._clock
        covariance = self._diagonal(k) if self.covariance is None else self.covariance[k]
        event = Event(1.0 if lengths[k] else 0.0, self.y[k], self.received[k], covariance,
                      None if self.late is None else self.late[k], None if self.faulty is None else self.faulty[k])
        window = None if self.window is None else self.window[k]
        return Step(self.u[k], (event,) if self.inside is None else _parted(event, self.inside[0], self.inside[1][k]),
                    self.truth[k], self.active[k], None, window, k + (lengths[0] > 0), starts[k],
                    lengths[k], None if self.reference is None else self.reference[k])

    @cached_property
    def _ends(self) -> Index:
        """Steps before which something changes: the period, or which runs are under way (K,), the world's end last."""
        turns = (self.active[1:] != self.active[:-1]).any(axis=1) | (self.lengths[1:] != self.lengths[:-1])
        return np.append(np.flatnonzero(turns) + 1, self.steps)

    @cached_property
    def _plain(self) -> bool:
        """Whether every step has all that it brings at its end, in arrays as compiled code takes them."""
        return not self.closed_loop and self.received.flags.c_contiguous and all(
            part is None for part in (self.covariance, self.late, self.faulty, self.inside)) and all(
            part.flags.c_contiguous and part.dtype == np.float64 for part in (self.u, self.y))

    def straight(self, k: int, most: int) -> Straight | None:
        """Steps of one length."""
        starts, lengths = self._clock
        period, listens = lengths[k], self.active[k]
        if not self._plain or not period or not listens.any():
            return None
        end = min(k + most, int(self._ends[np.searchsorted(self._ends, k, side="right")]))
        part = slice(k, end)
        heard = self.received[part] if listens.all() else read_only(self.received[part] & listens)
        course = Course(k + (lengths[0] > 0), period, np.array(starts[part]) + period, self.u[part], self.y[part],
                        heard, None if self.variance is None else self.variance[part])
        return Straight(course, self.truth[part], self.active[part], None,
                        None if self.window is None else self.window[part],
                        None if self.reference is None else self.reference[part], self.step(end - 1, self.truth[-1]))

    def _diagonal(self, k: int) -> Array | None:
        if self.variance is None:
            return None
        told = self.variance[k]
        gaps = np.where(np.isnan(told), np.nan, 0.0)
        out = gaps[:, None] + gaps
        np.einsum("iis->is", out)[:] = told
        return out


def _parted(event: Event, element: int, share: Array) -> tuple[Event, ...]:
    """A step's event as two, where `element` is heard anywhere inside the step: it first, then the others."""
    sent = event.received[element] if event.late is None else event.received[element] | (event.late[element] > 0)
    if not sent.any() or (isinstance(event.share, float) and event.share == 0.0):
        return (event,)
    at, own = np.where(sent, share, 0.0), np.zeros((len(event.y), 1), dtype=bool)
    own[element] = True

    def half(share: Array, mine: Mask) -> Event:
        late, faulty = (None if part is None else np.where(mine, part, 0) for part in (event.late, event.faulty))
        return Event(share, event.y, event.received & mine, event.covariance, late,
                     None if faulty is None else faulty.astype(bool))

    return half(at, own), half(1.0 - at, ~own)
