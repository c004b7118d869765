"""Processes of their own: kept for whose code they have run, used again, ended with what fails."""

from __future__ import annotations

import os

import pytest
from railstate.benchmarks.isolation.process import Isolation, end_idle, isolation


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
