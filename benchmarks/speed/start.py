"""How long commands take from their first moment, each in a process of its own: help, lists, a first run with nothing
compiled and the same once more, many runs with one job and with two."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

from .measure import Row

QUICK = (("--version",), ("--help",), ("list",))
SETTINGS = ("rap-example-1", "ningbo-metro/switching")
"""Run with all their estimators, nothing compiled and no design remembered."""
MANY, ESTIMATOR, RUNS = "ningbo-metro/switching", "ekf", 100_000


def seconds(repeats: int) -> list[Row]:
    """A line a command: seconds, of the quick ones the least of the repetitions. Raises RuntimeError where one fails.

    The machine should have nothing else to do: two processes compile side by side, and share nothing with others."""
    rows = [_row(words, min(_taken(words) for _ in range(repeats))) for words in QUICK]
    for name in SETTINGS:
        with TemporaryDirectory() as room:
            afresh = {"NUMBA_CACHE_DIR": str(Path(room, "code")), "RAILSTATE_CACHE": str(Path(room, "designs"))}
            for what in ("nothing compiled", "again"):
                words = ("run", name, "--out", what.replace(" ", "-"))
                rows.append(_row(words[:2], _taken(words, room, afresh), what))
    with TemporaryDirectory() as room:
        words = ("run", MANY, "--estimators", ESTIMATOR)
        _taken((*words, "--runs", "20", "--out", "compiled"), room)
        for jobs in ("1", "2"):
            many = (*words, "--runs", str(RUNS), "--jobs", jobs)
            rows.append(_row(many, _taken((*many, "--out", f"jobs-{jobs}"), room)))
    return rows


def _row(words: tuple[str, ...], taken: float, what: str = "") -> Row:
    return {"command": " ".join(("railstate", *words)), "state": what, "seconds": f"{taken:.2f}"}


def _taken(words: tuple[str, ...], room: str | None = None, environment: dict[str, str] | None = None) -> float:
    program = [sys.executable, "-c", "from railstate.benchmarks.cli import main; main()", *words]
    begun = perf_counter()
    done = subprocess.run(program, cwd=room, env={**os.environ, **(environment or {})}, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"railstate {' '.join(words)}: {done.stderr}")
    return perf_counter() - begun
