"""A limit in seconds for a piece of work in this process and its pool of workers.

By the system's alarm, so that a long loop ends in mid-way; where there is none, or in another thread, nothing is
limited."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class Overdue(BaseException):
    """The time is over. No Exception, so that no run of an estimator takes it for its own."""


@contextmanager
def within(seconds: float) -> Iterator[None]:
    """Raise Overdue in what is done under it once so many seconds are over."""
    if not hasattr(signal, "SIGALRM") or threading.current_thread() is not threading.main_thread():
        yield
        return

    def over(number: int, frame: Any) -> None:
        raise Overdue

    before = signal.signal(signal.SIGALRM, over)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
