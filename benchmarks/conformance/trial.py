"""Feeding a tape to an estimator and comparing what it says bit for bit: what the rules are made of."""

from __future__ import annotations

import os
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...estimators.interface import Estimate, Estimator, Innovation
from ...scenarios.arrays import Array, Mask
from ...scenarios.measurement import Measurement
from ...scenarios.model import DesignModel
from ...scenarios.randomness import Streams
from ...scenarios.world import Step
from ..running.loop import Loop, Observer
from .tapes import Case, Tape

HERE = Path(__file__).resolve().parents[2]
ROUNDING = 1e-10
"""Differences below this, relative to the largest number at hand, are rounding."""
CLAIMS = tuple(item.name for item in fields(Estimate))


@dataclass(frozen=True)
class Record:
    """What an estimator said while a tape was fed: its estimate at the start and after each prediction and update (in
    words: `when`), and status (S,), reasons at the end. innovations by when, NaN where nothing was received."""

    estimates: list[Estimate]
    when: list[str]
    status: NDArray[np.int8]
    reasons: dict[int, str]
    innovations: dict[str, Innovation] = field(default_factory=dict)

    def first(self, events: int) -> Record:
        """The part before the end of `events` events."""
        when = self.when[:1 + 2 * events]
        return Record(self.estimates[:1 + 2 * events], when, self.status, self.reasons,
                      {name: value for name, value in self.innovations.items() if name in when})

    def of(self, which: list[int]) -> Record:
        """The part of some runs."""
        def take(value: Array | None) -> Array | None:
            return value if value is None or value.shape[-1] == 1 else value[..., which]

        return Record([Estimate(*(take(getattr(e, name)) for name in CLAIMS)) for e in self.estimates],  # pyright: ignore
                      self.when, self.status[which], {place: self.reasons[run] for place, run in enumerate(which)
                                                      if run in self.reasons},
                      {when: Innovation(*map(take, said)) for when, said in self.innovations.items()})


@dataclass(frozen=True)
class Trial:
    """An estimator class on a case, with the record of its first, undisturbed run."""

    cls: type[Estimator]
    case: Case
    record: Record

    def feed(self, tape: Tape | None = None, **how: Any) -> Record:
        """Feed a copy of a tape (the case's own where none is given) to a fresh instance, or to `instance`."""
        return feed(self.cls, self.case, (self.case.tape if tape is None else tape).copy(), **how)


class DoesNotApply(Exception):
    """A rule that a case or an estimator gives no occasion to break."""


class Rule(NamedTuple):
    """`test` returns what happened where the rule is broken, None where it is kept. Raises DoesNotApply where this case
    cannot show it."""

    name: str
    expected: str
    mend: str
    test: Callable[[Trial], str | None]


class _Recorder(Observer):
    """Copies every estimate, in words when it was made."""

    predicted_wanted = updated_wanted = every = True

    def __init__(self, first: Estimate) -> None:
        self.estimates, self.when, self.event = [copied(first)], ["at the start"], 0
        self.innovations: dict[str, Innovation] = {}

    def measured(self, step: Step, measurement: Measurement, innovation: Innovation) -> None:
        self.innovations[f"after the measurement of event {self.event}"] = told(measurement.received, innovation)

    def predicted(self, step: Step, event: int, estimate: Estimate) -> None:
        self.estimates.append(copied(estimate))
        self.when.append(f"after the prediction of event {self.event}")

    def updated(self, step: Step, event: int, estimate: Estimate) -> None:
        self.estimates.append(copied(estimate))
        self.when.append(f"after the measurement of event {self.event}")
        self.event += 1


def feed(cls: type[Estimator], case: Case, tape: Tape, *, instance: Estimator | None = None,
         model: DesignModel | None = None, skip: bool = False) -> Record:
    """What an estimator says of a tape. skip: it is not called where no run has anything to do. Raises what it raises,
    Infeasible too."""
    with np.errstate(all="ignore"):
        estimator = begun(cls, case, tape, instance, model)
        recorder = _Recorder(estimator.estimate())
        for _ in Loop(tape, estimator, recorder, idle=not skip).steps():
            pass
    return Record(recorder.estimates, recorder.when, np.array(estimator.status), dict(estimator.reasons),
                  recorder.innovations)


def begun(cls: type[Estimator], case: Case, tape: Tape, instance: Estimator | None = None,
          model: DesignModel | None = None) -> Estimator:
    """A started estimator. Raises what it raises."""
    estimator = cls(case.parameters) if instance is None else instance
    model = model or case.model(tape.initial_mean)
    cls.require(model)
    estimator.design(model)
    streams = Streams(case.streams.seed, case.streams.scenario, case.streams.variant, tape.runs)
    estimator.start(model, len(tape.runs), streams("estimator", "checked"))
    return estimator


def told(received: Mask, innovation: Innovation) -> Innovation:
    """What an innovation says of the elements received, NaN elsewhere."""
    residual, variance, said = innovation
    return Innovation(None if residual is None else np.where(received, residual, np.nan),
                      None if variance is None else np.where(received, variance, np.nan),
                      None if said is None else np.where(received.any(axis=0), said, np.nan))


def raised(error: BaseException) -> str:
    """An exception with the place in the plug-in where it came from."""
    frames = traceback.extract_tb(error.__traceback__)
    plug_in = [frame for frame in frames if f"{os.sep}railstate{os.sep}" not in frame.filename
               and not Path(frame.filename).is_relative_to(HERE)]
    place = next((f" at {frame.filename}:{frame.lineno} in {frame.name}" for frame in reversed(plug_in or frames)), "")
    return f"it raised {type(error).__name__}: {error}{place}"


def difference(one: Record, other: Record, which: list[int] | None = None, *,
               statuses: bool = True) -> str | None:
    """Where `one` first differs from `other` in a bit, in words; `which`: the runs of `other` that `one` holds.
    statuses: those at the end are compared too."""
    runs = list(range(len(other.status))) if which is None else which
    for a, b, when in zip(one.estimates, other.estimates, one.when, strict=False):
        said, before = one.innovations.get(when, Innovation()), other.innovations.get(when, Innovation())
        pairs = [(name, getattr(a, name), getattr(b, name)) for name in CLAIMS]
        pairs += [(f"innovation.{name}", *both) for name, *both in zip(Innovation._fields, said, before, strict=True)]
        mine: Array | None
        theirs: Array | None
        for name, mine, theirs in pairs:
            if name.startswith("innovation") and mine is None and theirs is not None:  # nobody heard anything
                mine = np.full_like(theirs, np.nan) if which is None else np.full_like(theirs[..., runs], np.nan)
            if (mine is None) != (theirs is None):
                return f"{when} {name} is {'missing' if mine is None else 'given'}, otherwise not"
            if mine is None or theirs is None:
                continue
            theirs = np.broadcast_to(theirs, np.broadcast_shapes(theirs.shape, b.mean.shape[1:]))[..., runs]
            mine = np.broadcast_to(mine, theirs.shape)
            for place in np.argwhere((mine != theirs) & ~(np.isnan(mine) & np.isnan(theirs))).tolist():
                *index, run = place
                return (f"{when} {name}{index or ''} of run {runs[run]} is {mine[tuple(place)]:.17g}, otherwise "
                        f"{theirs[tuple(place)]:.17g}{_how_far(mine, theirs)}")
    ended = other.status if which is None else other.status[which]
    if statuses and (one.status != ended).any():
        return f"statuses at the end are {one.status.tolist()}, otherwise {ended.tolist()}"
    return None


def _how_far(mine: Array, theirs: Array) -> str:
    """Whether two arrays that differ are the same but for rounding, in words."""
    largest = np.abs(theirs).max()
    if np.isfinite(largest) and (np.abs(mine - theirs) <= ROUNDING * largest).all():
        return " (inexact: only the last digits differ)"
    return " (wrong: more than the last digits)"


def copied(estimate: Estimate) -> Estimate:
    return Estimate(*(value.copy() if isinstance(value, np.ndarray) else value for value in
                      (getattr(estimate, name) for name in CLAIMS)))  # pyright: ignore[reportArgumentType]
