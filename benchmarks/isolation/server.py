"""The other side of an isolated process: a nursery that imports the suite once, a guard for each process, the process.

The nursery is started once a command; a guard and its worker are forked from it, which takes milliseconds. The worker
runs strangers' code in a session of its own; the guard runs none: it watches what the worker starts and takes, and
ends whatever descends from it. All end when the command does, however it ends: its ends of their sockets close."""

from __future__ import annotations

import ctypes
import importlib
import json
import os
import pickle
import resource
import select
import signal
import socket
import struct
import sys
import time
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn

PROCESSES = 64
"""How many processes a worker may have started that are still there."""
WATCH = 0.5
"""Seconds between two looks at what a busy worker's processes take."""
ENDING = 1.5
"""Seconds that a guard goes on killing what comes after."""
WORDS = 300
"""Characters of a warning that are passed on."""
TABLE = "arrow table"
"""The key that stands for a table in an answer's JSON."""
PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER = 1, 36
SUITE = Path(__file__).resolve().parents[2]
"""The folder of the suite's own code."""
WORD = struct.Struct("!cQ")
"""What a guard is told: `b` and the bytes of memory allowed (it gets work), `?` (has it left anything behind?)."""
_LENGTH = struct.Struct("!Q")


def send(channel: socket.socket, *frames: bytes) -> None:
    """Send frames, each behind its length."""
    channel.sendall(b"".join(part for frame in (_LENGTH.pack(len(frames)), *frames)
                             for part in (_LENGTH.pack(len(frame)), frame)))


def receive(channel: socket.socket, until: float | None = None) -> list[bytes]:
    """The frames that `send` sent. until: when to give up, on the monotonic clock. Raises TimeoutError, EOFError."""

    def exactly(count: int) -> bytes:
        parts: list[bytes] = []
        while count:
            channel.settimeout(None if until is None else max(until - time.monotonic(), 1e-3))
            part = channel.recv(min(count, 1 << 20))
            if not part:
                raise EOFError
            parts.append(part)
            count -= len(part)
        return b"".join(parts)

    def frame() -> bytes:
        return exactly(_LENGTH.unpack(exactly(_LENGTH.size))[0])

    return [frame() for _ in range(_LENGTH.unpack(frame())[0])]


def main() -> None:
    """The nursery: `python -c .. FD MODULE..` imports the modules and forks a guard for each pair of sockets."""
    control = socket.socket(fileno=int(sys.argv[1]))
    _prctl(PR_SET_CHILD_SUBREAPER, 1)
    for module in sys.argv[2:]:
        importlib.import_module(module)
    _warm()
    base, guards = _pages(os.getpid()), set[int]()
    wakes, writing = _wakes()
    while True:
        ready, _, _ = select.select([control, wakes], [], [])
        if wakes in ready:
            os.read(wakes, 4096)
            for pid, _ in _reap():
                guards.discard(pid)
            for pid in [pid for pid, parent in _parents().items() if parent == os.getpid() and pid not in guards]:
                _kill(pid)  # whose guard was killed
        if control not in ready:
            continue
        message, descriptors, _, _ = socket.recv_fds(control, 1, 2)
        if not message:
            _all_gone()
            os._exit(0)
        pid = os.fork()
        if pid == 0:
            control.close()
            _unwatched(wakes, writing)
            task, life = (socket.socket(fileno=number) for number in descriptors)
            _guard(task, life, base)
        guards.add(pid)
        for number in descriptors:
            os.close(number)


def _warm() -> None:
    """What each process would otherwise do for itself: import the suite's own estimators, and pandas, as pyarrow does
    with the first array; fill numba's tables."""
    import pyarrow as pa
    from numba.core.registry import cpu_target

    from ...estimators.registry import estimators

    estimators()
    pa.array([0])
    target: Any = cpu_target
    target.typing_context.refresh()
    target.target_context.refresh()


def _guard(task: socket.socket, life: socket.socket, base: int) -> NoReturn:
    """Start a worker and watch it as long as there is anybody at the other end of `life`."""
    _prctl(PR_SET_CHILD_SUBREAPER, 1)
    me, (wakes, writing) = os.getpid(), _wakes()
    worker = os.fork()
    if worker == 0:
        life.close()
        _unwatched(wakes, writing)
        _work(task, me)
    task.close()
    busy, memory = False, 0
    while True:
        ready, _, _ = select.select([life, wakes], [], [], WATCH if busy else None)
        if wakes in ready:
            os.read(wakes, 4096)
            for pid, status in _reap():
                if pid == worker:
                    _leave(life, worker, _died(status))
        if life in ready:
            message = life.recv(WORD.size, socket.MSG_WAITALL)
            if len(message) < WORD.size:
                _leave(life, worker, "")
            word, memory = WORD.unpack(message)
            busy = word == b"b"
            if not busy:
                life.sendall(b"1" if set(_descendants()) - {worker} else b"0")
        elif busy:
            found = _descendants()
            taken = sum(max(_pages(pid) - base, 0) for pid in found)
            if len(found) > PROCESSES:
                _leave(life, worker, f"it started more than {PROCESSES} processes")
            elif memory and taken > memory:
                _leave(life, worker, f"it took more than {memory / 1e9:.3g} GB of memory (--memory)")


def _leave(life: socket.socket, worker: int, reason: str) -> NoReturn:
    """End all that descends from this guard, say why the worker ended, and end."""
    _kill(-worker)  # its process group, where there is no /proc
    _all_gone()
    with suppress(OSError):
        life.sendall(reason.encode())
    os._exit(0)


def _all_gone() -> None:
    """Kill whatever descends from this process until there is nothing more."""
    until = time.monotonic() + ENDING
    while (found := _descendants()) and time.monotonic() < until:
        for number in (signal.SIGSTOP, signal.SIGKILL):  # who is stopped starts nothing more
            for pid in found:
                _kill(pid, number)
        _reap()


def _work(task: socket.socket, guard: int) -> NoReturn:
    """Serve calls until there are no more: `(function, arguments, memory)` in, what it returns out (see `answer`)."""
    _prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != guard:
        os._exit(1)
    os.setsid()
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)  # what a plug-in prints is no part of a table
    me = os.getpid()
    with suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    heard: list[str] = []
    try:
        place = pickle.loads(receive(task)[0])
        os.chdir(place["folder"])
        os.environ.clear()
        os.environ.update(place["environment"])
        sys.path[:] = place["path"]
        while True:
            function, arguments, memory = pickle.loads(receive(task)[0])
            _hear(heard)
            if memory and sys.platform == "linux":
                most = resource.getrlimit(resource.RLIMIT_DATA)[1]
                resource.setrlimit(resource.RLIMIT_DATA, (memory + _pages(me, 5), most))
            frames = answer(function, arguments, heard)
            if os.getpid() != me:  # a child that the plug-in forked came back here
                os._exit(0)
            task.setblocking(True)
            send(task, *frames)
    except BaseException:
        os._exit(1)


def answer(function: Any, arguments: tuple[Any, ...], heard: list[str]) -> list[bytes]:
    """What a call comes to, as frames: JSON `{"value" | "input" | "raised", "heard"}`, then the Arrow tables that stand
    in the value. Plain data, so that reading it runs nothing."""
    import pyarrow as pa

    tables: list[bytes] = []

    def put(item: Any) -> Any:
        if not isinstance(item, pa.Table):
            raise TypeError(f"{type(item).__name__} cannot be sent")
        sink = pa.BufferOutputStream()
        with pa.ipc.new_stream(sink, item.schema) as writer:
            writer.write_table(item)
        tables.append(sink.getvalue().to_pybytes())
        return {TABLE: len(tables) - 1}

    from ...scenarios.errors import InputError

    try:
        text = json.dumps({"value": function(*arguments), "heard": heard}, default=put)
    except InputError as error:
        tables.clear()
        text = json.dumps({"input": str(error), "heard": heard})
    except BaseException as error:
        tables.clear()
        text = json.dumps({"raised": f"{type(error).__name__}: {error}", "heard": heard})
    heard.clear()
    return [text.encode(), *tables]


def _hear(heard: list[str]) -> None:
    """Collect warnings, each once, instead of printing them."""

    def note(message: Warning | str, category: type[Warning], file: str, line: int, *_: Any) -> None:
        text = worded(str(message)[:WORDS].encode("utf-8", "replace").decode(), category, file, line)
        if text not in heard and len(heard) < 20:
            heard.append(text)

    warnings.showwarning = note


def worded(message: str, category: type[Warning], file: str, line: int) -> str:
    """A warning with whose it is: the place it comes from, where it is none that the suite words itself (with a stack
    level that may point to a caller among the libraries)."""
    place = Path(file).resolve()
    ours = category is UserWarning and (place.is_relative_to(SUITE) or "site-packages" in place.parts)
    return message if ours else f"{message} ({file}:{line})"


def _died(status: int) -> str:
    if os.WIFSIGNALED(status):
        number = os.WTERMSIG(status)
        return f"the process running it died ({signal.strsignal(number) or f'signal {number}'})"
    return f"the process running it died (exit code {os.WEXITSTATUS(status)})"


def _wakes() -> tuple[int, int]:
    """A pipe whose first end becomes readable whenever a child ends."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    return reading, writing


def _unwatched(*pipe: int) -> None:
    """In a forked child: the parent's watch is none of its business."""
    signal.set_wakeup_fd(-1)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    for number in pipe:
        os.close(number)


def _reap() -> list[tuple[int, int]]:
    """(pid, status) of the children that have ended."""
    found: list[tuple[int, int]] = []
    with suppress(ChildProcessError):
        while (ended := os.waitpid(-1, os.WNOHANG))[0]:
            found.append(ended)
    return found


def _parents() -> dict[int, int]:
    """Parent of each living process of this machine, by pid; nothing where there is no /proc."""
    found: dict[int, int] = {}
    with suppress(OSError):
        for name in os.listdir("/proc"):
            if name.isdecimal():
                with suppress(OSError, IndexError, ValueError):
                    state, parent = Path(f"/proc/{name}/stat").read_bytes().rpartition(b")")[2].split()[:2]
                    if state != b"Z":
                        found[int(name)] = int(parent)
    return found


def _descendants() -> list[int]:
    """All living processes that descend from this one."""
    parents, found = _parents(), [os.getpid()]
    for above in found:
        found += [pid for pid, parent in parents.items() if parent == above]
    return found[1:]


def _pages(pid: int, column: int = 1) -> int:
    """Bytes of memory that a process holds; column 5: that it has data in."""
    with suppress(OSError, IndexError, ValueError):
        return int(Path(f"/proc/{pid}/statm").read_bytes().split()[column]) * resource.getpagesize()
    return 0


def _kill(pid: int, number: int = signal.SIGKILL) -> None:
    with suppress(OSError):
        os.kill(pid, number)


def _prctl(option: int, value: int) -> None:
    """Linux only; elsewhere nothing."""
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(option, value, 0, 0, 0)
