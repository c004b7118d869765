"""Seeded faults in the three packages against the tests that reach their lines: run by hand, not by pytest.

`python tests/mutate.py reach DIR [TEST..]`, then `python tests/mutate.py try DIR --seed 7`: in a copy of the tree in
DIR, as another user under limits (only root can), since a fault may loop or fork. `coverage` has to be installed."""

from __future__ import annotations

import argparse
import ast
import compileall
import importlib
import json
import os
import re
import resource
import shutil
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from mutants import PACKAGES, Fault, drawn

ROOT = Path(__file__).resolve().parents[1]
USER, PROCESSES, LARGEST = 47_029, 300, 12 << 30
"""Who runs the tests, and how many processes and bytes of address space that user gets."""
PRELOADED = ("numba", "pandas", "pyarrow.parquet", "pyarrow.compute", "scipy.linalg", "scipy.stats", "scipy.integrate",
             "scipy.optimize", "scipy.signal", "matplotlib.pyplot", "pydantic", "typer", "rich.console",
             "rich.progress", "jinja2", "joblib", "cvxpy", "hypothesis", "pytest", "threadpoolctl", "filterpy.kalman")
"""What a trial need not import anew: libraries, nothing of ours."""
FAILED = re.compile(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", re.MULTILINE)
JIT = re.compile(r"^ *@(njit|kernel|compiled)\b|\bcompiled\(", re.MULTILINE)


def copied(folder: Path) -> Path:
    """The tree in `folder`, importable from there as `railstate`."""
    tree = folder / "tree"
    if not tree.exists():
        shutil.copytree(ROOT, tree, ignore=shutil.ignore_patterns(".git", "__pycache__", "*.egg-info", ".venv"))
        (tree / "railstate").mkdir()
        (tree / "railstate" / "__init__.py").symlink_to(Path("..") / "benchmarks" / "face" / "__init__.py")
        for package in PACKAGES:
            (tree / "railstate" / package).symlink_to(Path("..") / package)
            compileall.compile_dir(str(tree / "railstate" / package), quiet=1)
        for path in [tree / "tests", *(tree / "tests").iterdir()]:
            if path.is_dir():
                (path / "__pycache__").mkdir(exist_ok=True)
                os.chown(path / "__pycache__", USER, USER)
    for name in ("cache", "home"):
        (folder / name).mkdir(exist_ok=True)
        os.chown(folder / name, USER, USER)
    return tree


def child(folder: Path, tree: Path, cache: Path, words: list[str], log: Path, plugins: list[Any]) -> int:
    """Fork a process that runs pytest as the other user."""
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
        os.setgid(USER)
        os.setuid(USER)
        os.environ.update(HOME=str(folder / "home"), TMPDIR=str(folder / "home"), NUMBA_CACHE_DIR=str(cache),
                          PYTHONPATH=str(tree))
        os.chdir(tree)
        sys.path.insert(0, str(tree))
        import pytest

        code = int(pytest.main(["-n", "0", "--dist", "no", "-p", "no:cacheprovider", "--timeout", "120", *words],
                               plugins=plugins))
    finally:
        sys.stdout.flush()
        os._exit(code)


def ended(pid: int, seconds: float) -> int | None:
    """How a child ended; None: not in time. All that its user has started is ended."""
    until, status = time.monotonic() + seconds, 0
    while (done := os.waitpid(pid, os.WNOHANG))[0] == 0 and time.monotonic() < until:
        time.sleep(0.05)
    status = os.waitstatus_to_exitcode(done[1]) if done[0] else None
    for _ in range(20):
        left = [number for number in map(int, filter(str.isdecimal, os.listdir("/proc"))) if _owner(number) == USER]
        for number in left:
            with suppress(ProcessLookupError):
                os.kill(number, signal.SIGKILL)
        with suppress(ChildProcessError):
            os.waitpid(pid, os.WNOHANG)
        if not left:
            break
        time.sleep(0.1)
    return status


def _owner(number: int) -> int:
    try:
        return os.stat(f"/proc/{number}").st_uid
    except OSError:
        return -1


class Reach:
    """A plug-in of pytest that writes down the lines each test reaches, and how long it takes."""

    def __init__(self, tree: Path, out: Path) -> None:
        import coverage

        self.out, self.seconds, self.failed = out, dict[str, float](), set[str]()
        self.tree, self.saved = tree, time.monotonic()
        self.coverage = coverage.Coverage(data_file=None, include=[f"{tree}/{name}/*" for name in PACKAGES],
                                          messages=False, config_file=False)
        self.coverage.start()

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self.coverage.switch_context(nodeid)
        self.seconds[nodeid] = time.monotonic()

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.failed:
            self.failed.add(report.nodeid)

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        self.seconds[nodeid] = time.monotonic() - self.seconds[nodeid]
        if time.monotonic() > self.saved + 120:
            self.pytest_sessionfinish()

    def pytest_sessionfinish(self) -> None:
        """Write down what is known, from time to time and in the end."""
        self.saved = time.monotonic()
        data = self.coverage.get_data()
        names = sorted(set(self.seconds) - self.failed)
        places = {name: number for number, name in enumerate(names)}
        lines = {}
        for file in data.measured_files():
            found = {line: sorted(places[name] for name in contexts if name in places)
                     for line, contexts in data.contexts_by_lineno(file).items()}
            lines[str(Path(file).relative_to(self.tree))] = found
        self.out.write_text(json.dumps({"tests": [[name, self.seconds[name]] for name in names],
                                        "failed": sorted(self.failed), "lines": lines}))


class Tests:
    """What `reach` has written down: which tests reach a line, and how long each takes."""

    def __init__(self, folder: Path, tree: Path) -> None:
        self.tree, self.names = tree, list[str]()
        self.seconds: list[float] = []
        self.lines: dict[str, dict[int, set[int]]] = {}
        for path in sorted((folder / "home").glob("reach*.json")):
            found, before = json.loads(path.read_text()), len(self.names)
            self.names += [name for name, _ in found["tests"]]
            self.seconds += [seconds for _, seconds in found["tests"]]
            for file, lines in found["lines"].items():
                mine = self.lines.setdefault(file, {})
                for line, numbers in lines.items():
                    mine.setdefault(int(line), set()).update(number + before for number in numbers)
        self.text = {str(path.relative_to(tree)): path.read_text(encoding="utf-8") for package in PACKAGES
                     for path in (tree / package).rglob("*.py")}

    def of(self, fault: Fault, most: float) -> list[str]:
        """Those that reach a fault: its line, the callers of its compiled function, its module, its package; the quick
        ones first, as many as take so many seconds."""
        found = self._at(fault.path, range(fault.line, fault.line + 1)) or self._callers(fault) or self._at(fault.path)
        folder = os.path.dirname(fault.path)
        found = found or set().union(*(self._at(path) for path in self.lines if os.path.dirname(path) == folder))
        taken, spent = list[str](), 0.0
        for number in sorted(found, key=lambda number: self.seconds[number]):
            spent += self.seconds[number]
            if taken and spent > most:
                break
            taken.append(self.names[number])
        return taken

    def _at(self, path: str, lines: range | None = None) -> set[int]:
        mine = self.lines.get(path, {})
        return set().union(*(mine.get(line, set()) for line in (mine if lines is None else lines)))

    def _callers(self, fault: Fault) -> set[int]:
        """Tests of the lines of Python that name the compiled function around a fault, or one that calls it."""
        if not JIT.search(self.text[fault.path]):
            return set()
        around = [node.name for node in ast.walk(ast.parse(self.text[fault.path])) if isinstance(node, ast.FunctionDef)
                  and node.lineno <= fault.line <= (node.end_lineno or 0)]
        names, found = set(around[:1]), set[int]()
        for _ in range(4):
            word = re.compile(rf"\b({'|'.join(map(re.escape, names))})\b") if names else None
            if word is None:
                break
            more = set[str]()
            for path, text in self.text.items():
                if not word.search(text):
                    continue
                for node in ast.walk(ast.parse(text)):
                    if isinstance(node, ast.FunctionDef) and word.search(ast.get_source_segment(text, node) or ""):
                        more.add(node.name)
                        for number, line in enumerate(text.splitlines(), 1):
                            if node.lineno < number <= (node.end_lineno or 0) and word.search(line):
                                found |= self._at(path, range(number, number + 1))
            if found or more <= names:
                break
            names |= more
        return found


def failing(folder: Path, tree: Path, names: list[str]) -> set[str]:
    """Those of the tests that fail here without any fault: what they need is not there for the other user."""
    log = folder / "sound.log"
    if not names or ended(child(folder, tree, folder / "cache", names, log, []), 60 + 20 * len(names)) == 0:
        return set()
    return set(FAILED.findall(log.read_text(errors="replace")))


def attempt(folder: Path, tree: Path, options: argparse.Namespace) -> None:
    """Try drawn faults one after the other; a line of JSON each in tried.jsonl."""
    tests, faults = Tests(folder, tree), drawn(tree, options.seed, options.modules, options.each)
    only = set(map(int, options.only.split(","))) if options.only else set(range(len(faults)))
    done = folder / f"tried{options.name}.jsonl"
    mine = {number: tests.of(fault, options.seconds) for number, fault in enumerate(faults) if number in only}
    unfit = failing(folder, tree, sorted(set().union(*mine.values())))
    print(f"{len(unfit)} tests fail without a fault: left out", *sorted(unfit), sep="\n  ", flush=True)
    for number, names in mine.items():
        fault, chosen = faults[number], [name for name in names if name not in unfit]
        text = tests.text[fault.path]
        place = tree / fault.path
        before = place.stat()
        begun, how = time.monotonic(), "no test reaches it"
        if chosen:
            place.write_text(text[:fault.begin] + fault.new + text[fault.end:], encoding="utf-8")
            try:
                pid = child(folder, tree, folder / "cache", ["-x", *chosen], folder / "trial.log", [])
                code = ended(pid, 90 + 6 * options.seconds)
                how = {0: "survives", None: "caught: no end"}.get(code, "caught")
                if code not in (0, 1, None):
                    how = f"caught: pytest ends with {code}"
            finally:
                place.write_text(text, encoding="utf-8")
                os.utime(place, ns=(before.st_atime_ns, before.st_mtime_ns))
        line = text.splitlines()[fault.line - 1].strip()
        log = (folder / "trial.log").read_text(errors="replace") if chosen else ""
        by = FAILED.findall(log)
        said = {"number": number, "how": how, "path": fault.path, "line": fault.line, "new": fault.new, "text": line,
                "old": text[fault.begin:fault.end][:80], "tests": len(chosen), "by": by[:1],
                "seconds": round(time.monotonic() - begun)}
        with done.open("a") as out:
            out.write(json.dumps(said) + "\n")
        print(f"{number} {how}: {fault.path}:{fault.line} {said['old'][:30]!r} -> {fault.new!r} ({len(chosen)} tests, "
              f"{said['seconds']:.0f} s)", flush=True)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["reach", "try"])
    parser.add_argument("folder", type=Path)
    parser.add_argument("tests", nargs="*", default=["tests"])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--modules", type=int, default=50)
    parser.add_argument("--each", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=20.0, help="of tests a fault is tried against")
    parser.add_argument("--only", default="", help="numbers of the faults to try, 3,17,..")
    parser.add_argument("--name", default="", help="of the file of reach")
    options = parser.parse_intermixed_args()
    folder = options.folder.resolve()
    folder.mkdir(exist_ok=True, parents=True)
    os.environ.update({f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "OMP", "MKL")})
    os.environ.update(ARROW_DEFAULT_MEMORY_POOL="system")
    tree = copied(folder)
    for name in PRELOADED:
        importlib.import_module(name)
    if options.what == "reach":
        out = folder / "home" / f"reach{options.name}.json"
        pid = child(folder, tree, folder / "cache", options.tests, folder / f"reach{options.name}.log",
                    [Late(tree, out)])
        print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), out)
    else:
        attempt(folder, tree, options)


class Late:
    """`Reach`, made in the child."""

    def __init__(self, tree: Path, out: Path) -> None:
        self.given = tree, out

    def pytest_configure(self, config: Any) -> None:
        config.pluginmanager.register(Reach(*self.given))


if __name__ == "__main__":
    main()
