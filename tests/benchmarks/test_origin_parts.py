"""Where rows come from, who may write them, and which process computes which: each part alone, nothing computed.

Git, locks and pools are stand-ins that write down what they were asked."""

from __future__ import annotations

import atexit
import errno
import fcntl
import gc
import os
import platform
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import joblib
import pytest
from joblib.externals.loky.process_executor import TerminatedWorkerError  # pyright: ignore[reportMissingImports]
from railstate.benchmarks.running import runner
from railstate.benchmarks.running.machinery import Machinery
from railstate.benchmarks.store import lock, provenance
from railstate.scenarios.errors import InputError


def test_where_rows_come_from(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(provenance, "_git", lambda: ("abc", True))
    monkeypatch.setattr(provenance, "_processor", lambda: "a processor")
    monkeypatch.setattr(provenance.platform, "platform", lambda aliased=False, terse=False: f"a system, {terse}")
    monkeypatch.setattr(provenance, "version", lambda name: f"{name}-2")
    python = ".".join(map(str, sys.version_info[:3])) + "+" * sys.version.split()[0].endswith("+")
    assert provenance.environment() == {
        "python": python, "platform": "a system, True", "processor": "a processor", "cores": os.cpu_count(),
        "packages": {name: f"{name}-2" for name in (
            "numpy", "scipy", "numba", "filterpy", "cvxpy", "clarabel", "pandas", "pyarrow", "joblib", "pydantic")},
        "git_commit": "abc", "git_dirty": True}
    before = {"packages": {"numpy": "numpy-1", "numba": "numba-2", "pandas": "pandas-1"}}
    assert list(provenance.other_versions(before)) == ["numpy numpy-1 -> numpy-2", "scipy not known -> scipy-2"]


def test_the_commit_of_railstate_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """Asked without what says which repository a shell is in, for some seconds; every failure is no commit."""
    clean = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    monkeypatch.setenv("GIT_DIR", "/elsewhere")
    usual: dict[str, Any] = {"rev-parse --show-toplevel": f"{provenance.ROOT}\n", "rev-parse HEAD": "abc\n",
                             f"ls-files --error-unmatch {Path(provenance.__file__).resolve()}": "",
                             "status --porcelain --untracked-files=no": " M file\n"}
    answers = dict[str, Any]()

    def run(words: list[str], *, cwd: Path, env: dict[str, str], **how: Any) -> Any:
        assert how == {"capture_output": True, "text": True, "check": True, "timeout": 10} and cwd == provenance.ROOT
        assert words[0] == "git" and env == clean
        answer = answers[" ".join(words[1:])]
        if isinstance(answer, Exception):
            raise answer
        return SimpleNamespace(stdout=answer)

    monkeypatch.setattr(provenance.subprocess, "run", run)
    for changes, found in (({}, ("abc", True)), ({"status --porcelain --untracked-files=no": "\n"}, ("abc", False)),
                           ({"rev-parse --show-toplevel": "/\n"}, (None, None)),
                           *(({words: error}, (None, None)) for words in usual for error in (
                               OSError(), subprocess.CalledProcessError(1, "git"),
                               subprocess.TimeoutExpired("git", 10)))):
        answers.update({**usual, **changes})
        assert provenance._git() == found


@pytest.mark.parametrize(("text", "processor", "found"), [
    ("vendor\t: V\nmodel name\t: A: B 3 \nmodel name : C\n", "P", "A: B 3"), ("vendor : V\n", "P", "P"),
    (None, "P", "P"), (None, "", "M")])
def test_the_processor_s_name(text: str | None, processor: str, found: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def read(encoding: str) -> str:
        if text is None:
            raise FileNotFoundError
        return text

    monkeypatch.setattr(provenance, "Path", lambda path: SimpleNamespace(read_text=read, name=path))
    monkeypatch.setattr(provenance.platform, "processor", lambda: processor)
    monkeypatch.setattr(provenance.platform, "machine", lambda: "M")
    assert provenance._processor() == found


def test_a_lock_s_holder_and_file_systems_without_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What stands in the file of a process that died goes; nothing stays open."""
    asked, errors, path = list[Any](), list[Any](), tmp_path / lock.LOCK

    def lockf(handle: int, kind: int) -> None:
        asked.append(kind)
        if errors:
            raise errors.pop()

    monkeypatch.setattr(lock.fcntl, "lockf", lockf)
    there = os.listdir("/proc/self/fd") if sys.platform == "linux" else []
    before = os.umask(0)
    for held, holder in (("", "another process"), (" process 7 on x\n", "process 7 on x"), ("x" * 5000, "x" * 4096)):
        path.write_text(held)
        for number in (errno.EACCES, errno.EAGAIN):
            errors.append(OSError(number, "held"))
            with pytest.raises(InputError) as caught, lock.locked(tmp_path, "railstate run"):
                pass
            assert str(caught.value) == (f"{tmp_path}: is being written by {holder}; wait for it, or choose another "
                                         "--out")
            assert path.read_text() == held
    path.unlink()
    for command, error in (("railstate run", None), ("railstate list", OSError(errno.ENOLCK, "No locks")),
                           ("é" * 9000, None), ("\udcff", None)):
        errors += [error] if error else []
        if not error and path.exists():
            path.write_text("y" * 9000)
        with pytest.warns() if error else pytest.MonkeyPatch.context() as told, lock.locked(tmp_path, command):
            content = path.read_bytes()
        start = f"process {os.getpid()} on {platform.node()} since "
        words = f" UTC ({command})\n".encode("utf-8", "backslashreplace")
        assert content.decode(errors="replace").startswith(start) and content[len(start.encode()) + 19:] == words[
            :4096 - len(start.encode()) - 19]
        assert path.read_bytes() == b"" and path.stat().st_mode & 0o777 == 0o644
        if error:
            assert [(str(one.message), one.filename) for one in told] == [(  # pyright: ignore
                f"{tmp_path}: cannot be locked there (No locks): see that nothing else writes to it", __file__)]
    os.umask(before)
    assert asked == [fcntl.LOCK_EX | fcntl.LOCK_NB] * 10 and lock._held == set()
    assert not there or len(os.listdir("/proc/self/fd")) == len(there)


@pytest.mark.parametrize(("jobs", "tasks", "lost", "parallel"), [
    (1, "abc", 9, False), (2, "abc", 9, True), (2, "ab", 9, True), (2, "a", 9, False), (2, "", 9, False),
    (1, "a", 9, False), (2, "aXbYc", 9, True), (2, "aX", 9, False), (2, "abXc", 1, True), (2, "abc", 0, True)])
def test_whose_tasks_run_where(jobs: int, tasks: str, lost: int, parallel: bool,
                               monkeypatch: pytest.MonkeyPatch) -> None:
    """Strangers' (capitals) apart and last, with what a lost worker left undone; the suite's own here if it is one."""
    asked, how = list[Any](), Machinery(jobs)

    def found(given: list[str], machinery: Any) -> Iterator[Any]:
        asked.append("parallel")
        for number in reversed(range(lost if lost < len(given) else 0, len(given))):
            yield number, f"{given[number]} done"
        if lost < len(given):
            raise runner._Lost

    def isolated(given: list[str], machinery: Any, losses: Any) -> Iterator[str]:
        assert machinery is how and isinstance(losses, runner.Losses)
        yield from (f"{task} apart" for task in given)

    monkeypatch.setattr(runner, "make_tasks", lambda *given: asked.append(given) or list(tasks))
    monkeypatch.setattr(runner, "strange", str.isupper)
    monkeypatch.setattr(runner.nursery, "begin", lambda: asked.append("nursery"))
    monkeypatch.setattr(runner, "execute", lambda task: f"{task} done")
    monkeypatch.setattr(runner, "_parallel", found)
    monkeypatch.setattr(runner, "isolated", isolated)
    plan: Any = "plan"
    results: list[Any] = list(runner.run(plan, {}, how))
    own, others = [task for task in tasks if task.islower()], [task for task in tasks if task.isupper()]
    assert asked == [("plan", {}, jobs, None), *(["nursery"] if others else []), *(["parallel"] if parallel else [])]
    finished = [f"{task} done" for task in own[lost if lost < len(own) else 0:]]
    assert results == [*(finished[::-1] if parallel else finished), *(
        f"{task} apart" for task in [*(own[:lost] if lost < len(own) else []), *others])]
    monkeypatch.setattr(runner, "isolated", lambda given, *how: [SimpleNamespace(rows=(task, *how)) for task in given])
    monkeypatch.setattr(runner, "joined", list)
    table: Any = runner.apart(list(tasks), how)  # pyright: ignore[reportArgumentType]
    assert [(task, given is how) for task, given, _ in table] == [(task, True) for task in tasks]


@pytest.mark.parametrize("error", [None, TerminatedWorkerError("x"), TimeoutError(), ArithmeticError()])
def test_workers_of_a_pool(error: Exception | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that dies or hangs ends them all; what a worker has imported is frozen once."""
    asked = list[Any]()

    class Parallel:
        def __init__(self, **words: Any) -> None:
            asked.append(words)

        def __call__(self, calls: Any) -> Iterator[Any]:
            yield from (function(*given) for function, given, _ in calls)
            if error:
                raise error

    counts = iter((0, 5))
    monkeypatch.setattr(joblib, "Parallel", Parallel)
    monkeypatch.setattr("joblib.externals.loky.get_reusable_executor", lambda: SimpleNamespace(
        shutdown=lambda **how: asked.append(how)))
    monkeypatch.setattr(gc, "get_freeze_count", lambda: next(counts))
    monkeypatch.setattr(gc, "freeze", lambda: asked.append("frozen"))
    monkeypatch.setattr(atexit, "register", lambda call: asked.append(call is gc.freeze))
    monkeypatch.setattr(runner, "execute", lambda task: asked.append(task) or f"{task} done")
    found, tasks, how = list[Any](), ["a", "b"], Machinery(3, timeout=4.5)

    def all_of() -> None:
        found.extend(runner._parallel(tasks, how))  # pyright: ignore[reportArgumentType]

    if error is None:
        all_of()
        assert found == [(0, "a done"), (1, "b done")]
    else:
        lost = not isinstance(error, ArithmeticError)
        with pytest.raises(runner._Lost if lost else ArithmeticError):
            all_of()
        assert (asked.pop() == {"wait": False, "kill_workers": True}) if lost else asked[-1] == "b"
    assert asked == [{"n_jobs": 3, "backend": "loky", "timeout": 4.5, "batch_size": 1, "return_as":
                      "generator_unordered", "pre_dispatch": "2*n_jobs"}, "frozen", True, "a", "b"]
