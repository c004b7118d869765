"""One writer at a time: a lock on a results folder that the system takes back when its process dies."""

from __future__ import annotations

import errno
import fcntl
import os
import platform
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from ...scenarios.errors import InputError

LOCK = ".lock"
"""Name of the file in the folder that is locked; it stays, empty, when the lock is given back."""
_held: set[Path] = set()


@contextmanager
def locked(folder: Path, command: str) -> Iterator[None]:
    """Hold a folder's lock. Raises InputError saying who holds it, OSError where it cannot be written.

    A record lock: processes that are started meanwhile do not inherit it, and none survives its owner."""
    path = folder.resolve() / LOCK
    if path in _held:
        raise InputError(f"{folder}: this very process is writing to it already")
    handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
    try:
        try:
            fcntl.lockf(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno in (errno.EACCES, errno.EAGAIN):
                holder = os.pread(handle, 4096, 0).decode("utf-8", "replace").strip() or "another process"
                raise InputError(f"{folder}: is being written by {holder}; wait for it, or choose another --out"
                                 ) from None
            warnings.warn(f"{folder}: cannot be locked there ({error.strerror}): see that nothing else writes to it",
                          stacklevel=3)
        _held.add(path)
        try:
            os.ftruncate(handle, 0)
            os.pwrite(handle, f"process {os.getpid()} on {platform.node()} since {datetime.now(UTC):%Y-%m-%d %H:%M:%S} "
                              f"UTC ({command})\n".encode("utf-8", "backslashreplace")[:4096], 0)
            yield
            os.ftruncate(handle, 0)
        finally:
            _held.discard(path)
    finally:
        os.close(handle)
