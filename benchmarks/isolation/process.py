"""This side of an isolated process: calls with a time limit, and processes kept for the next who runs the same code.

What comes back is JSON and Arrow tables: reading it runs nothing of a stranger's."""

from __future__ import annotations

import atexit
import json
import os
import pickle
import selectors
import socket
import struct
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, NamedTuple

from ...estimators.interface import Status
from ...scenarios.errors import InputError
from .server import TABLE, WORD, receive, send

IMPORTED = ("railstate.benchmarks.running.execute", "railstate.benchmarks.running.latency",
            "railstate.benchmarks.conformance")
"""What the nursery imports before anybody needs a process: all that runs in one, and nothing of a stranger's."""
IMPORT = 300.0
"""Seconds that the import of a plug-in may take."""
LEAVING = 2.0
"""Seconds to wait for all that an ended process has started to be gone."""
ANSWER = 60.0
"""Seconds to wait for a guard's answer, which it has at once on a machine that is not overloaded."""


class Ended(NamedTuple):
    """How a call ended that did not return."""

    status: Status
    reason: str


class _Nursery:
    """The process that others are forked from, started when it is first needed."""

    def __init__(self) -> None:
        self._lock, self._process, self._control = threading.Lock(), None, None

    def begin(self) -> None:
        """Start it, so that it imports while this process does something else."""
        with self._lock:
            if self._process is not None and self._process.poll() is None:
                return
            self._control, theirs = socket.socketpair()
            environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
            for library in ("OPENBLAS", "OMP", "MKL"):  # a process with threads cannot be forked
                environment[f"{library}_NUM_THREADS"] = "1"
            environment["ARROW_DEFAULT_MEMORY_POOL"] = "system"
            environment["JE_ARROW_MALLOC_CONF"] = "background_thread:false"
            program = "from railstate.benchmarks.isolation.server import main; main()"
            self._process = subprocess.Popen(
                [sys.executable, "-c", program, str(theirs.fileno()), *IMPORTED], env=environment,
                stdin=subprocess.DEVNULL, pass_fds=(theirs.fileno(),), start_new_session=True)
            theirs.close()

    def bear(self) -> tuple[socket.socket, socket.socket]:
        """A new process: the sockets of its tasks and of its guard."""
        self.begin()
        task, their_task = socket.socketpair()
        life, their_life = socket.socketpair()
        with their_task, their_life, self._lock:
            assert self._control is not None
            socket.send_fds(self._control, [b"1"], [their_task.fileno(), their_life.fileno()])
        send(task, pickle.dumps({"folder": os.getcwd(), "environment": dict(os.environ), "path": sys.path}))
        return task, life


nursery = _Nursery()


class Isolation:
    """One process of its own, with all that it starts; replaced when it dies, hangs or leaves something behind.

    owner: whose code it runs. timeout: seconds a call may take. memory: bytes it may take, all that it starts together
    (0: no limit). first: called in each new process, in a time of its own (`IMPORT`): a slow import is no slow step."""

    def __init__(self, owner: str) -> None:
        self.owner, self.timeout, self.memory, self.ended = owner, IMPORT, 0, False
        self.first: Callable[[], Any] | None = None
        self._sockets: tuple[socket.socket, socket.socket] | None = None

    def call(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """What the function returns (JSON, Arrow tables), or an `Ended`. Raises InputError as the function does, and
        RuntimeError after `end`."""
        if self.ended:
            raise RuntimeError("this process has ended")
        if self._sockets is None:
            self._sockets = nursery.bear()
            if self.first is not None:
                try:
                    found = self._exchange(self.first, (), IMPORT, last=False)
                except InputError as error:
                    found = Ended(Status.failed, str(error))
                if isinstance(found, Ended):
                    self.close()
                    return Ended(found.status, f"when it was imported: {found.reason}")
        return self._exchange(function, arguments, self.timeout)

    def _exchange(self, function: Callable[..., Any], arguments: tuple[Any, ...], limit: float, last: bool = True
                  ) -> Any:
        assert self._sockets is not None
        task, life = self._sockets
        try:
            until = time.monotonic() + limit
            life.sendall(WORD.pack(b"b", self.memory))
            send(task, pickle.dumps((function, arguments, self.memory)))
            if not _either(task, life, limit):
                raise TimeoutError
            told = json.loads((frames := receive(task, until))[0], object_hook=lambda item: _table(item, frames))
            if not isinstance(told, dict) or not isinstance(told.get("heard"), list):
                raise ValueError("an answer of another form")
            task.settimeout(None)
            life.settimeout(ANSWER)
            life.sendall(WORD.pack(b"?", 0))
            left = life.recv(1) != b"0"
        except TimeoutError:
            self.close()
            return Ended(Status.timeout, f"did not finish within {limit:g} s")
        except (OSError, EOFError):
            return Ended(Status.crashed, self._why())
        except (ValueError, TypeError, KeyError, IndexError, MemoryError, RecursionError, struct.error):
            self.close()
            return Ended(Status.crashed, "the process running it answered nonsense")
        if left and last:
            self.close()
        for text in told["heard"]:
            warnings.warn(clean(text), stacklevel=2)
        if "input" in told:
            raise InputError(clean(told["input"]))
        return Ended(Status.failed, clean(told["raised"])) if "raised" in told else told.get("value")

    def _why(self) -> str:
        """Why the process ended, as its guard says."""
        reason = ""
        if self._sockets is not None:
            life = self._sockets[1]
            life.settimeout(LEAVING)
            with suppress(OSError):
                while part := life.recv(4096):
                    reason += part.decode("utf-8", "replace")
        self.close()
        return reason.lstrip("01") or "the process running it died"

    def end(self) -> None:
        """Close for good, from whatever thread: nothing is started any more."""
        self.ended = True
        self.close()

    def close(self) -> None:
        """End the process and all that it has started, whatever they are doing."""
        sockets, self._sockets = self._sockets, None
        if sockets is None:
            return
        life = sockets[1]
        for channel in sockets:
            with suppress(OSError):
                channel.shutdown(socket.SHUT_WR)
        with suppress(OSError):
            life.settimeout(LEAVING)
            while life.recv(4096):
                pass
        for channel in sockets:
            with suppress(OSError):
                channel.shutdown(socket.SHUT_RDWR)
            channel.close()


def clean(text: object, most: int = 2000) -> str:
    """Text of a stranger's that can be written: no lone surrogates, not endless."""
    return str(text)[:most].encode("utf-8", "backslashreplace").decode()


def _table(item: dict[str, Any], frames: list[bytes]) -> Any:
    """The table that a place in an answer stands for."""
    if item.keys() != {TABLE}:
        return item
    import pyarrow as pa

    try:
        with pa.ipc.open_stream(frames[1 + item[TABLE]]) as reader:
            table = reader.read_all()
        table.validate(full=True)
    except pa.ArrowException as error:
        raise ValueError("no table") from error
    return table


def _either(task: socket.socket, life: socket.socket, limit: float) -> bool:
    """Wait for an answer. Raises EOFError where the guard speaks first: the process has ended."""
    with selectors.DefaultSelector() as selector:
        selector.register(task, selectors.EVENT_READ)
        selector.register(life, selectors.EVENT_READ)
        found = [key.fileobj for key, _ in selector.select(limit)]
    if found and task not in found:
        raise EOFError
    return bool(found)


_idle: dict[str, list[Isolation]] = {}
_lock = threading.Lock()


@contextmanager
def isolation(owner: str, timeout: float, memory: int = 0,
              first: Callable[[], Any] | None = None) -> Iterator[Isolation]:
    """A process for the time of the context: an idle one that has run nothing but `owner`'s code, or a new one."""
    with _lock:
        kept = _idle.get(owner)
        process = kept.pop() if kept else Isolation(owner)
    process.timeout, process.memory, process.first = timeout, memory, first
    try:
        yield process
    except BaseException:
        process.end()
        raise
    if not process.ended:
        with _lock:
            _idle.setdefault(process.owner, []).append(process)


@atexit.register
def end_idle() -> None:
    """End the processes that are kept."""
    with _lock:
        processes = [process for kept in _idle.values() for process in kept]
        _idle.clear()
    for process in processes:
        process.end()
