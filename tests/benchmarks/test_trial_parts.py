"""Records of what an estimator said, made by hand: their parts, where two differ and how far, in words."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from railstate.benchmarks.conformance import rules
from railstate.benchmarks.conformance.rules import _unflagged
from railstate.benchmarks.conformance.tapes import Case, Tape, small_case
from railstate.benchmarks.conformance.trial import Record, Trial, difference, feed, told
from railstate.estimators.interface import Estimate, Innovation
from railstate.estimators.kalman import Kalman

from ..expected import digest

WHEN = ["at the start", "after the prediction of event 0", "after the measurement of event 0",
        "after the prediction of event 1", "after the measurement of event 1"]


def record() -> Record:
    """Two states, three runs, two events; one covariance for all runs, and a bound for each."""
    x = np.arange(6.0).reshape(2, 3)
    estimates = [Estimate(x + k, covariance=np.eye(2)[:, :, None] * (k + 1), bound=np.array([1.0, 2.0, 3.0]) + k)
                 for k in range(5)]
    heard = Innovation(np.array([[1.0, np.nan, 3.0]]), None, np.array([0.5, np.nan, 0.7]))
    return Record(estimates, WHEN, np.array([0, 2, 0], np.int8), {1: "tired"}, {WHEN[2]: heard})


def changed(one: Record, place: int, **parts: np.ndarray | None) -> Record:
    estimates = list(one.estimates)
    estimates[place] = replace(estimates[place], **parts)
    return replace(one, estimates=estimates)


def test_parts_of_a_record() -> None:
    one = record()
    first = one.first(1)
    assert first.when == WHEN[:3] and len(first.estimates) == 3 and first.innovations.keys() == {WHEN[2]}
    assert one.first(0).innovations == {} and first.reasons == {1: "tired"} and first.status is one.status
    some = one.of([2, 1])
    assert some.status.tolist() == [0, 2] and some.reasons == {1: "tired"} and some.when == WHEN
    assert some.estimates[1].mean.tolist() == [[3.0, 2.0], [6.0, 5.0]]
    covariance, bound = some.estimates[1].covariance, some.estimates[1].bound
    assert covariance is not None and covariance.shape == (2, 2, 1) and bound is not None and bound.tolist() == [4, 3]
    residual, variance, said = some.innovations[WHEN[2]]
    np.testing.assert_array_equal(residual, [[3.0, np.nan]])  # type: ignore[arg-type]
    np.testing.assert_array_equal(said, [0.7, np.nan])  # type: ignore[arg-type]
    assert variance is None and one.of([0]).reasons == {}
    received = np.array([[True, False], [False, False]])
    for found, wanted in zip(told(received, Innovation(np.ones((2, 2)), 2 * np.ones((2, 2)), np.ones(2))), (
            [[1, np.nan], [np.nan] * 2], [[2, np.nan], [np.nan] * 2], [1, np.nan]), strict=True):
        np.testing.assert_array_equal(found, wanted)  # type: ignore[arg-type]
    assert told(received, Innovation()) == Innovation()


def test_what_the_rules_feed(expected: Callable[[str, str], None], monkeypatch: pytest.MonkeyPatch) -> None:
    """Each rule's tapes: which runs of them, all that is in them, whether to a fresh instance."""
    case, fed = small_case({}), list[str]()

    class Watched(Trial):
        def feed(self, tape: Tape | None = None, **how: Any) -> Record:
            seen(self.case.tape if tape is None else tape, *how)
            return super().feed(tape, **how)

    def seen(tape: Tape, *how: str) -> None:
        fed.append(f"  {tape.runs} {' '.join(how)}")
        fed.extend(f"    {field.name} {digest(getattr(tape, field.name))}" for field in fields(tape)
                   if field.name in ("u", "shares", "y", "received", "truth"))

    def direct(cls: Any, case: Case, tape: Tape, **how: Any) -> Record:
        seen(tape, *how)
        return feed(cls, case, tape, **how)

    monkeypatch.setattr(rules, "feed", direct)
    trial = Watched(Kalman, case, feed(Kalman, case, case.tape.copy()))
    for rule in rules.RULES[:-1]:  # it walks nowhere on this tape
        fed.append(rule.name)
        assert rule.test(trial) is None
    expected("fed", "\n".join(fed))


def test_where_two_records_differ() -> None:
    one, x = record(), record().estimates[3].mean
    assert difference(one, record()) is None and difference(one.of([2, 0]), one, [2, 0]) is None
    near, far = x.copy(), x.copy()
    near[1, 2] += 5e-10
    far[1, 2] += 1e-9
    for values, words in ((near, " (inexact: only the last digits differ)"), (far, " (wrong: more than the last "
                                                                                    "digits)")):
        said = f"after the prediction of event 1 mean[1] of run 2 is {values[1, 2]:.17g}, otherwise 8{words}"
        assert difference(changed(one, 3, mean=values), one) == said
        assert difference(changed(one, 3, mean=values).of([2]), one, [2]) == said
        assert difference(changed(one, 3, mean=values).of([0]), one, [0]) is None
    endless = x.copy()
    endless[0, 0] = np.inf
    assert difference(one, changed(one, 3, mean=endless)) == (
        "after the prediction of event 1 mean[0] of run 0 is 3, otherwise inf (wrong: more than the last digits)")
    assert difference(changed(one, 0, bound=None), one) == "at the start bound is missing, otherwise not"
    assert difference(one, changed(one, 0, bound=None)) == "at the start bound is given, otherwise not"
    wide = np.repeat(np.eye(2)[:, :, None] * 2, 3, axis=2)
    assert difference(changed(one, 1, covariance=wide), one) is None  # one for all runs is the same as one for each
    wide = wide.copy()
    wide[0, 1, 1] = 3.0
    assert difference(changed(one, 1, covariance=wide), one) == (
        "after the prediction of event 0 covariance[0, 1] of run 1 is 3, otherwise 0 (wrong: more than the last "
        "digits)")
    assert difference(changed(one, 0, bound=np.array([1.0, 2.5, 3.0])), one) == (
        "at the start bound of run 1 is 2.5, otherwise 2 (wrong: more than the last digits)")


def test_innovations_and_statuses_that_differ() -> None:
    one = record()
    deaf = replace(one, innovations={WHEN[2]: Innovation(None, None, np.array([0.5, np.nan, 0.7]))})
    assert difference(deaf, one) == ("after the measurement of event 0 innovation.residual[0] of run 0 is nan, "
                                     "otherwise 1 (wrong: more than the last digits)")
    assert difference(deaf.of([1]), one, [1]) is None  # run 1 heard nothing
    assert difference(one, deaf) == "after the measurement of event 0 innovation.residual is given, otherwise not"
    assert difference(replace(one, innovations={}), one) == (
        "after the measurement of event 0 innovation.residual[0] of run 0 is nan, otherwise 1 (wrong: more than the "
        "last digits)")
    ended = replace(one, status=np.array([0, 0, 0], np.int8))
    assert difference(ended, one) == "statuses at the end are [0, 0, 0], otherwise [0, 2, 0]"
    assert difference(ended, one, statuses=False) is None and difference(ended.of([2, 0]), one, [2, 0]) is None
    assert difference(ended.of([1]), one, [1]) == "statuses at the end are [0], otherwise [2]"


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_numbers_that_are_none_where_the_status_is_ok(value: float) -> None:
    one, x = record(), record().estimates[3].mean.copy()
    assert _unflagged(one) is None
    x[0, 1] = value
    assert _unflagged(changed(one, 3, mean=x)) is None  # run 1 is flagged
    x[1, 2] = value
    assert _unflagged(changed(one, 3, mean=x)) == (
        "after the prediction of event 1 mean of run 2 is not finite although its status is ok at the end")
    bound = _unflagged(changed(one, 0, bound=np.array([1.0, 1.0, value])))
    assert bound == (None if value == np.inf else
                     "at the start bound of run 2 is not finite although its status is ok at the end")
    one_for_all = np.full((2, 2, 1), value)
    assert _unflagged(changed(one, 4, covariance=one_for_all)) == (
        "after the measurement of event 1 covariance of run 0 is not finite although its status is ok at the end")
