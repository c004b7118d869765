"""How, not what, to run: options that change no row."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass

from ...scenarios.errors import InputError

SHARE = 0.8
"""Share of the machine's memory that isolated processes may take together."""


@dataclass(frozen=True)
class Machinery:
    """How, not what, to run: none of it changes a row.

    jobs: processes. batch: runs per task (None: by the memory a run takes, the jobs and the number of runs). scheduler:
    address of a Dask cluster's ("": this machine alone). timeout: seconds a single task may take before it counts as
    hung. memory: bytes that an isolated process may take (0: an equal share of the machine's)."""

    jobs: int = 1
    batch: int | None = None
    scheduler: str = ""
    timeout: float = 900.0
    memory: int = 0

    def allowed(self) -> int:
        """Bytes that an isolated process may take (0: no limit known)."""
        with suppress(OSError, ValueError, AttributeError):
            whole = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
            return self.memory or int(SHARE * whole / max(1, self.jobs))
        return self.memory


def machinery(jobs: int, batch: int = 0, backend: str = "local", scheduler: str = "", timeout: float = 900.0,
              memory: float = 0.0) -> Machinery:
    """The options that say how to run. Raises InputError."""
    if batch < 0 or jobs < 0:
        raise InputError("--batch and --jobs: must be 0 (chosen) or more")
    if not timeout > 0:
        raise InputError("--timeout: must be more than 0 seconds")
    if backend not in ("local", "dask"):
        raise InputError(f"--backend {backend}: unknown; allowed: local, dask")
    if backend == "dask" and not scheduler:
        raise InputError("--backend dask: needs --scheduler ADDRESS, such as tcp://host:8786")
    if scheduler and backend == "local":
        raise InputError(f"--scheduler {scheduler}: goes with --backend dask")
    return Machinery(jobs or os.cpu_count() or 1, batch or None, scheduler, timeout, int(memory * 1e9))
