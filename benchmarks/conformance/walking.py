"""The rule for estimators that go many whole periods in one call: `walk` says what `predict` and `update` say.

A case's tape is walked in two parts, once for the estimates after the measurements and once for those before."""

from __future__ import annotations

import numpy as np

from ...estimators.interface import Estimate, Innovation
from ...scenarios.arrays import read_only
from ...scenarios.measurement import Course
from .tapes import Tape
from .trial import DoesNotApply, Record, Trial, begun, copied, difference, told


def walks(trial: Trial) -> str | None:
    """Where a walk first differs from the steps. Raises DoesNotApply for who walks nowhere on this tape."""
    tape, record, any_walked = trial.case.tape, trial.record, False
    if not _straight(tape) or trial.cls.lag != 0 or trial.cls.oracle:
        raise DoesNotApply
    for early in (False, True):
        walked = _walked(trial, early)
        if walked is None:
            continue
        which, any_walked = slice(1 if early else 2, None, 2), True
        stepped = Record(record.estimates[which], record.when[which], record.status, record.reasons, record.innovations)
        found = difference(walked, stepped)
        if found:
            return f"walked, {found}"
    if not any_walked:
        raise DoesNotApply
    return None


def _straight(tape: Tape) -> bool:
    """Whether it is whole periods of one length, with one measurement at the end of each of which nobody tells how good
    it is."""
    return (all(isinstance(part, float) for part in (*tape.shares, *tape.spans, *tape.starts)) and all(tape.begins)
            and set(tape.shares) == {1.0} and len(set(tape.spans)) == 1
            and all(covariance is None for covariance in tape.covariances))


def _walked(trial: Trial, early: bool) -> Record | None:
    """What a fresh instance says of the tape, walked; None where it does not walk all of it."""
    tape, events = trial.case.tape.copy(), len(trial.case.tape.y)
    period, when = float(tape.spans[0]), trial.record.when[1 if early else 2::2]
    times = np.array(tape.starts, dtype=float) + period
    innovations, estimates = dict[str, Innovation](), list[Estimate]()
    with np.errstate(all="ignore"):
        estimator = begun(trial.cls, trial.case, tape)
        for part in (slice(0, events // 2), slice(events // 2, events)):
            course = Course(tape.numbers[part.start], period, times[part], read_only(tape.u[part]),
                            read_only(tape.y[part]), read_only(tape.received[part]))
            walk = estimator.walk(course, early)
            if walk is None:
                return None
            for b, got in enumerate(course.received):
                estimates.append(copied(walk.at(b)))
                innovations[when[part.start + b]] = told(got, Innovation(*(
                    None if value is None else value[b] for value in walk.innovation)))
    return Record(estimates, when, np.array(estimator.status), dict(estimator.reasons), {} if early else innovations)
