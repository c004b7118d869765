"""A process of its own for what may die or hang: plug-ins, and tasks of a worker that did not come back.

What is called survives pickling; the process is started anew after each call that did not return, and kept for the next
one who needs it."""

from __future__ import annotations

import atexit
import multiprocessing
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures import TimeoutError as FutureTimeout
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any, NamedTuple

from ...estimators.interface import Status


class Ended(NamedTuple):
    """How a call ended that did not return."""

    status: Status
    reason: str


class Isolation:
    """One process of its own, replaced when it dies or hangs. timeout: seconds a call may take."""

    def __init__(self, timeout: float) -> None:
        self.timeout, self.ended = timeout, False
        self._pool: ProcessPoolExecutor | None = None

    def call(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """What the function returns, or an `Ended`; what it raises is raised here. Raises RuntimeError after `end`."""
        if self.ended:
            raise RuntimeError("this process has ended")
        if self._pool is None:
            self._pool = ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"),
                                             initializer=signal.signal, initargs=(signal.SIGINT, signal.SIG_IGN))
            self._pool.submit(_ready).result()  # starting it and importing are not the call's time
        future = self._pool.submit(function, *arguments)
        try:
            return future.result(self.timeout)
        except BrokenProcessPool:
            ended = Ended(Status.crashed, "the process running it died")
        except FutureTimeout:
            ended = Ended(Status.timeout, f"did not finish within {self.timeout:g} s")
        self.close()
        return ended

    def end(self) -> None:
        """Close for good, from whatever thread: nothing is started any more."""
        self.ended = True
        self.close()

    def close(self) -> None:
        """Kill the process, whatever it is doing."""
        pool, self._pool = self._pool, None
        if pool is not None:
            for process in list((getattr(pool, "_processes", None) or {}).values()):
                process.kill()
            pool.shutdown(wait=False, cancel_futures=True)


_idle: list[Isolation] = []


@contextmanager
def isolation(timeout: float) -> Iterator[Isolation]:
    """An idle process, or a new one, for the time of the context. timeout: seconds a call may take."""
    process = _idle.pop() if _idle else Isolation(timeout)
    process.timeout = timeout
    try:
        yield process
    except BaseException:
        process.end()
        raise
    if not process.ended:
        _idle.append(process)


@atexit.register
def _end_all() -> None:
    for process in _idle:
        process.end()


def _ready() -> None:
    """Unpickling this in a new process imports most of what is needed."""
    from . import execute  # noqa: F401
