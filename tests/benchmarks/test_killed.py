"""SIGKILL at any moment of a run: the same command goes on, to the same rows bit for bit and the same files.

A process kills itself right before the n-th thing that it does to its results folder, so that each point is known."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from ..conftest import Command
from .test_run import rows, same

WORDS = ("run", "cart.toml", "-e", "kalman,ekf", "--runs", "12", "--jobs", "1", "--batch", "1")
PROGRAM = '''
import json, os, signal, sys
import numpy as np
from contextlib import suppress
from railstate.benchmarks import cli


def main(folder):
    sys.argv = ["railstate", *words, "--quiet", "--out", folder]
    with suppress(SystemExit):
        cli.main()


early, late, words = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:]
main("warm")  # all is imported and compiled


def spread():
    """The points, by what a whole run has told."""
    yield -1
    with open("seen.json") as file:
        texts = json.load(file)
    last = max(number for number, text in enumerate(texts) if text.startswith("os.rename rows/"))
    yield from np.linspace(0, last, early).astype(int).tolist()
    yield from np.linspace(last + 1, len(texts) - 1, late).astype(int).tolist()


for point in spread():  # -1: none, all that happens is told
    if not (child := os.fork()):
        folder, seen = os.path.abspath(f"out{point}"), []

        def hear(event, arguments):
            if event in ("open", "os.rename", "os.mkdir", "os.remove") and isinstance(arguments[0], str | os.PathLike):
                writes = event != "open" or arguments[1] not in ("r", "rb", None)
                if writes and os.path.abspath(os.fspath(arguments[0])).startswith(folder + os.sep):
                    if len(seen) == point:
                        os.kill(os.getpid(), signal.SIGKILL)
                    what = os.path.relpath(arguments[event == "os.rename"], folder)
                    seen.append(f"{event} {what}")

        sys.addaudithook(hear)
        main(folder)
        if point < 0:
            with open("seen.json", "w") as file:
                json.dump(seen, file)
        os._exit(0)
    status = os.waitpid(child, 0)[1]
    assert status == (0 if point < 0 else signal.SIGKILL), (point, status)
'''


def killed(early: int, late: int) -> list[str]:
    """Run whole into `out-1`, then into `outN` for each point N, killed there; what a whole run does. early: points
    from the first file to the last row; late: between the rows and the end of the last table."""
    words = [sys.executable, "-c", PROGRAM, str(early), str(late), *WORDS]
    one = {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "OMP", "MKL")}  # a process with threads cannot be forked
    subprocess.run(words, check=True, env={**os.environ, **one})
    return json.loads(Path("seen.json").read_text())


@pytest.mark.parametrize(("early", "late"), [(3, 2), pytest.param(74, 26, marks=pytest.mark.long)])
def test_killed_anywhere_and_resumed_rows_and_files_are_the_same(railstate: Command, early: int, late: int) -> None:
    seen = killed(early, late)
    points = sorted(int(path.name[3:]) for path in Path().glob("out[0-9]*"))
    assert len(points) == early + late and points[-1] == len(seen) - 1
    whole = Path("out-1")
    right = rows(whole)
    names = sorted(str(path.relative_to(whole)) for path in whole.rglob("*"))
    for point in points:
        folder = Path(f"out{point}")
        again = railstate(*WORDS, "--out", folder)
        assert again.code == 0 and not again.err, (seen[point], again.err)
        same(right, rows(folder))
        assert json.loads((folder / "manifest.json").read_text())["finished"], seen[point]
        there = sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))
        assert [name for name in there if "parquet" not in name] == [name for name in names if "parquet" not in name]
        for name in ("verdicts.csv", "summary.csv"):  # tables tell of latencies too
            assert (folder / name).read_text() == (whole / name).read_text(), seen[point]
