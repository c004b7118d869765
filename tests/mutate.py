"""Seeded faults in the three packages against the tests that reach their lines: run by hand, not by pytest.

`python tests/mutate.py reach DIR [TEST..]`, then `python tests/mutate.py try DIR --seed 7`: in a copy of the tree in
DIR, as another user under limits (only root can), since a fault may loop or fork. `coverage` has to be installed.
A fault is tried against quick tests that reach it, the static checks of CI, then whatever else may see it."""

from __future__ import annotations

import argparse
import compileall
import importlib
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from mutants import PACKAGES, Fault, drawn
from reached import Reach, Tests

ROOT = Path(__file__).resolve().parents[1]
PROCESSES, LARGEST = 300, 12 << 30
"""How many processes and bytes of address space the user gets who runs the tests."""
PRELOADED = ("numba", "pandas", "pyarrow.parquet", "pyarrow.compute", "scipy.linalg", "scipy.stats", "scipy.integrate",
             "scipy.optimize", "scipy.signal", "matplotlib.pyplot", "pydantic", "typer", "rich.console",
             "rich.progress", "jinja2", "joblib", "cvxpy", "hypothesis", "pytest", "threadpoolctl", "filterpy.kalman")
"""What a trial need not import anew: libraries, nothing of ours."""
CHECKS = (("ruff", "check", "--no-cache"), ("pyright",))
"""What CI asks besides the tests; what only these catch is said so."""
LATE, ENDED, MISSING = "+ Timeout +", re.compile(r"^(?:=+ )?\d+ \w+.* in [\d.]+s", re.MULTILINE), "ERROR: not found: "
"""In the log of pytest: a test took too long, the last line, a test that is not there."""
FAILED = re.compile(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", re.MULTILINE)


def copied(folder: Path, user: int) -> Path:
    """The tree as it is now in `folder`, importable from there as `railstate`."""
    tree = folder / "tree"
    kept = [path for name in subprocess.run(["git", "ls-files", "-co", "--exclude-standard", "-z"], cwd=ROOT, text=True,
                                            capture_output=True, check=True).stdout.split("\0")
            if name and (path := Path(name)) and (ROOT / path).is_file()]
    for path in kept:
        if not (tree / path).exists() or (tree / path).read_bytes() != (ROOT / path).read_bytes():
            (tree / path).parent.mkdir(exist_ok=True, parents=True)
            shutil.copy2(ROOT / path, tree / path)
    for path in {path.relative_to(tree) for name in (*PACKAGES, "tests") for path in (tree / name).rglob("*.*")
                 if path.is_file() and path.suffix != ".pyc"} - set(kept):
        (tree / path).unlink()
    if not (tree / "railstate").exists():
        (tree / "railstate").mkdir()
        (tree / "railstate" / "__init__.py").symlink_to(Path("..") / "benchmarks" / "face" / "__init__.py")
        for package in PACKAGES:
            (tree / "railstate" / package).symlink_to(Path("..") / package)
    for package in PACKAGES:
        compileall.compile_dir(str(tree / "railstate" / package), quiet=1)
    for path in [tree / "tests", *(tree / "tests").iterdir()]:
        if path.is_dir() and path.name != "__pycache__":
            (path / "__pycache__").mkdir(exist_ok=True)
            os.chown(path / "__pycache__", user, user)
    for name in ("cache", "home"):
        (folder / name).mkdir(exist_ok=True)
        os.chown(folder / name, user, user)
    return tree


class Room:
    """A folder with the tree, where pytest runs as another user."""

    def __init__(self, folder: Path, user: int) -> None:
        self.folder, self.user, self.tree = folder, user, copied(folder, user)

    def begun(self, words: list[str], log: Path, plugins: list[Any]) -> int:
        """Fork a process that runs pytest."""
        pid = os.fork()
        if pid:
            return pid
        code = 99
        try:
            os.setsid()
            handle = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
            for number in (1, 2):
                os.dup2(handle, number)
            resource.setrlimit(resource.RLIMIT_NPROC, (PROCESSES, PROCESSES))
            resource.setrlimit(resource.RLIMIT_AS, (LARGEST, LARGEST))
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            os.setgroups([])
            os.setgid(self.user)
            os.setuid(self.user)
            home = str(self.folder / "home")
            os.environ.update(HOME=home, TMPDIR=home, NUMBA_CACHE_DIR=str(self.folder / "cache"),
                              PYTHONPATH=str(self.tree))
            os.chdir(self.tree)
            sys.path.insert(0, str(self.tree))
            import pytest

            code = int(pytest.main(["-n", "0", "--dist", "no", "-p", "no:cacheprovider", "--timeout", "150",
                                    "--timeout-method", "thread", *words],
                                   plugins=plugins))
        finally:
            sys.stdout.flush()
            os._exit(code)

    def ended(self, pid: int, seconds: float) -> int | None:
        """How a child ended; None: not in time. All that its user has started is ended."""
        until = time.monotonic() + seconds
        while (done := os.waitpid(pid, os.WNOHANG))[0] == 0 and time.monotonic() < until:
            time.sleep(0.05)
        for _ in range(20):
            left = [number for number in map(int, filter(str.isdecimal, os.listdir("/proc")))
                    if _owner(number) == self.user]
            for number in left:
                with suppress(ProcessLookupError):
                    os.kill(number, signal.SIGKILL)
            with suppress(ChildProcessError):
                os.waitpid(pid, os.WNOHANG)
            if not left:
                break
            time.sleep(0.1)
        return os.waitstatus_to_exitcode(done[1]) if done[0] else None

    def tried(self, words: list[str], seconds: float) -> tuple[int | None, str]:
        """How pytest ends, and what it says."""
        log = self.folder / "trial.log"
        code = self.ended(self.begun(words, log, []), seconds)
        return code, log.read_text(errors="replace")

    def collected(self) -> set[str]:
        """All tests there are."""
        return {line for line in self.tried(["--collect-only", "tests"], 300)[1].splitlines() if "::" in line}


def _owner(number: int) -> int:
    try:
        return os.stat(f"/proc/{number}").st_uid
    except OSError:
        return -1


def attempt(room: Room, options: argparse.Namespace) -> None:
    """Try drawn faults one after the other, in an order drawn too; a line of JSON each in tried.jsonl. In the end the
    tests that caught one run without any fault; what those caught that fail then, too, is tried again."""
    tests = Tests(room.folder, room.tree, room.collected())
    faults = drawn(room.tree, options.seed, options.modules, options.each)
    order = random.Random(options.seed).sample(range(len(faults)), len(faults))
    wanted = set(map(int, options.only.split(","))) if options.only else set(order)
    left, until = [number for number in order if number in wanted], time.monotonic() + 60 * options.minutes
    unfit, sound = set[str](), set[str]()
    while left:
        catchers = dict[int, str]()
        for number in left:
            if time.monotonic() > until:
                break
            said = {"number": number, **one(room, tests, faults[number], options, unfit)}
            catchers |= {number: said["by"]} if said["by"] else {}
            with (room.folder / f"tried{options.name}.jsonl").open("a") as out:
                out.write(json.dumps(said) + "\n")
            print("{number} {how} {stage}: {path}:{line} {old!r} -> {new!r} ({tests} tests, {seconds} s) {by}"
                  .format(**said), flush=True)
        asked = sorted(set(catchers.values()) - sound)
        failing = set(FAILED.findall(room.tried(asked, 60 + 20 * len(asked))[1])) if asked else set()
        sound, unfit = sound | set(asked) - failing, unfit | failing
        left = [number for number, by in catchers.items() if by in failing]
        print(f"{len(failing)} of {len(asked)} tests fail without a fault: {failing}, again {left}", flush=True)


def refused(room: Room, words: Sequence[str], path: str) -> bool:
    """Whether a static check of CI does not pass a module."""
    return subprocess.run([*words, path], cwd=room.tree, capture_output=True, check=False).returncode == 1


def one(room: Room, tests: Tests, fault: Fault, options: argparse.Namespace, unfit: set[str]) -> dict[str, Any]:
    """What becomes of a fault, and who has seen it: the first tests, a static check, or more tests."""
    text, place, begun = tests.text[fault.path], room.tree / fault.path, time.monotonic()
    before, asked, stage, how, by = place.stat(), list[str](), "", "survives", list[str]()

    def tried(names: list[str]) -> tuple[int | None, str]:
        return room.tried(["-x", *names], 600 + 10 * options.seconds) if names else (5, "")

    def failing(names: list[str]) -> bool:
        nonlocal how, by
        asked.extend(names := [name for name in names if name not in {*unfit, *asked}])
        code, said = tried(names)
        if code == 4 and MISSING in said:  # tests for each of something, where the fault leaves one out
            code, said = tried([name for name in names if f"{MISSING}{room.tree / name}" not in said])
        by = FAILED.findall(said)
        how = {0: "survives", 1: "caught", 5: "survives", None: "caught: no end"}.get(code, f"caught: pytest: {code}")
        how = "caught: too long" if code == 1 and LATE in said else how
        how = "caught: ended by something else" if code == 0 and not ENDED.search(said) else how
        return how != "survives"

    place.write_text(text[:fault.begin] + fault.new + text[fault.end:], encoding="utf-8")
    try:
        if failing(tests.of(fault, options.seconds) if options.tests == ["tests"] else options.tests):
            stage = "first tests"
        elif words := next((words for words in CHECKS if refused(room, words, fault.path)), None):
            stage, how = "static", f"caught by {words[0]}"
        elif failing(tests.beyond(fault, asked, options.more)):
            stage = "more tests"
    finally:
        place.write_text(text, encoding="utf-8")
        os.utime(place, ns=(before.st_atime_ns, before.st_mtime_ns))
    return {"how": how, "stage": stage, "path": fault.path, "line": fault.line,
            "old": text[fault.begin:fault.end][:80], "new": fault.new,
            "text": text.splitlines()[fault.line - 1].strip(), "tests": len(asked), "by": by[0] if by else "",
            "seconds": round(time.monotonic() - begun)}


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["reach", "try"])
    parser.add_argument("folder", type=Path)
    parser.add_argument("tests", nargs="*", default=["tests"], help="to reach lines with, or to try faults against "
                        "instead of those that reach them")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--modules", type=int, default=50)
    parser.add_argument("--each", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=20.0,
                        help="of tests a fault is tried against at first, whole outputs apart")
    parser.add_argument("--more", type=float, default=120.0, help="seconds of tests that what has survived is tried "
                        "against")
    parser.add_argument("--only", default="", help="numbers of the faults to try, 3,17,..")
    parser.add_argument("--minutes", type=float, default=1e6, help="after which no more faults are tried")
    parser.add_argument("--name", default="", help="of the file of reach, or of what was tried")
    parser.add_argument("--user", type=int, default=47_029, help="who runs the tests: nobody else's number")
    options = parser.parse_intermixed_args()
    folder = options.folder.resolve()
    folder.mkdir(exist_ok=True, parents=True)
    os.environ.update({f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "OMP", "MKL")})
    os.environ.update(ARROW_DEFAULT_MEMORY_POOL="system")
    room = Room(folder, options.user)
    for name in PRELOADED:
        importlib.import_module(name)
    if options.what == "reach":
        out = folder / "home" / f"reach{options.name}.json"
        log = folder / f"reach{options.name}.log"
        pid = room.begun(["--timeout", "900", *options.tests], log, [Reach(room.tree, out)])
        print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), out)
    else:
        attempt(room, options)


if __name__ == "__main__":
    main()
