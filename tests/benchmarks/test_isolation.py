"""Processes of their own: kept for whose code they have run, used again, ended with what fails; who costs too many."""

from __future__ import annotations

import os
import warnings

import pytest
from railstate.benchmarks.isolation.process import Ended, Isolation, end_idle, isolation
from railstate.benchmarks.planning.plan import make_plan
from railstate.benchmarks.running.isolated import LOST_CALLS, LOST_RUNS, Losses
from railstate.estimators.interface import Status


def test_a_process_is_kept_for_its_owner_and_ended_with_what_fails() -> None:
    with isolation("one's", 60.0) as first:
        number = first.call(os.getpid)
    assert isinstance(number, int) and number != os.getpid() and not first.ended
    with isolation("one's", 60.0) as again, isolation("another's", 60.0) as other:
        assert again is first and again.call(os.getpid) == number
        assert other.call(os.getpid) not in (number, os.getpid())
    with pytest.raises(ZeroDivisionError), isolation("one's", 60.0) as failing:
        _ = 1 / 0
    assert failing is first and first.ended
    with pytest.raises(RuntimeError, match="this process has ended"):
        first.call(os.getpid)
    with isolation("one's", 60.0) as fresh:
        assert fresh is not first
    end_idle()
    assert fresh.ended and other.ended


def test_what_was_never_started_can_be_ended() -> None:
    process = Isolation("nobody's")
    process.end()
    with pytest.raises(RuntimeError, match="this process has ended"):
        process.call(os.getpid)


def test_who_costs_too_much_is_not_run_again() -> None:
    """Some single runs, or many processes, of one estimator of a cell; said once, and of nobody else's."""
    plan = make_plan(["ningbo-metro/white"], only=["ekf", "ukf"])
    one, several, other = (plan.task(plan.cells[0], (label,), runs) for label, runs in (
        ("ekf", (3,)), ("ekf", (4, 5)), ("ukf", (3,))))
    ended = Ended(Status.crashed, "it died")
    for task, most in ((one, LOST_RUNS), (several, LOST_CALLS)):
        losses = Losses()
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            for _ in range(most - 1):
                losses.add(task, ended)
        assert losses.over(task) is None
        with pytest.warns(UserWarning, match=f"ningbo-metro/white/ekf: lost {most} processes .it died."):
            losses.add(task, ended)
        assert losses.over(one) == Ended(Status.crashed, f"not run after {most} lost processes: it died")
        assert losses.over(other) is None
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            losses.add(task, ended)
