"""Sixty cells: three commands on twenty machines as they are; permissions bind root too, who loses capabilities.

A cell is right with exit code 0 and nothing on standard error, or with the code and the message that `ENDS` has for it.
"""

from __future__ import annotations

import ctypes
import os
import re
import resource
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from railstate.scenarios.machine_code import FOLDER, SUITE, config

from ..conftest import Command
from .test_run import rows, same

START = "from railstate.benchmarks.cli import main; main()"
RUN = ("run", "cart.toml", "-e", "kalman,ekf", "--runs", "3", "--jobs", "1", "--out")
COMMANDS: dict[str, tuple[str, ...]] = {"list": ("list",), "run": (*RUN, "out"), "report": ("report", "done")}
CACHE = str(Path(config.CACHE_DIR).parents[1]) if config.CACHE_DIR else ""


class Machine:
    """What a command finds. env: more of the environment (None: not there). around: shell before and after it.
    before: done to the folder. limit: bytes that a file may have."""

    def __init__(self, around: str = "{}", before: Callable[[Path], None] = lambda here: None, limit: int = 0,
                 **env: str | None) -> None:
        self.around, self.before, self.limit, self.env = around, before, limit, env


def unwritable(*names: str) -> Callable[[Path], None]:
    def change(here: Path) -> None:
        for name in names:
            for path in [here / name, *(here / name).rglob("*")]:
                path.chmod(0o555 if path.is_dir() else 0o444)

    return change


def temporary(here: Path) -> None:
    """No place for machine code but the temporary folder, which has it."""
    (here / "tmp").mkdir()
    (here / "tmp" / f"{FOLDER}-{os.getuid()}").symlink_to(CACHE)
    unwritable("home")(here)


def copied(here: Path) -> None:
    """The package in a folder that may not be written."""
    (here / "site" / "railstate").mkdir(parents=True)
    shutil.copyfile(SUITE / "benchmarks" / "face" / "__init__.py", here / "site" / "railstate" / "__init__.py")
    for name in ("benchmarks", "estimators", "scenarios"):
        shutil.copytree(SUITE / name, here / "site" / "railstate" / name, ignore=shutil.ignore_patterns("__pycache__"))
    unwritable("site")(here)


MACHINES = {
    "no HOME": Machine(HOME=None),
    "HOME that is no folder": Machine(HOME="/dev/null/home"),
    "HOME that may not be written": Machine(before=temporary, NUMBA_CACHE_DIR=None, TMPDIR="tmp"),
    "a cache that may not be written": Machine(before=temporary, NUMBA_CACHE_DIR="home/cache", TMPDIR="tmp"),
    "a package that may not be written": Machine(before=copied, PYTHONPATH="site"),
    "results that may not be written": Machine(before=unwritable("done", ".")),
    "a full disk": Machine(limit=1500, PYTHONDONTWRITEBYTECODE="1"),  # Python would keep halves of modules
    "a folder that is gone": Machine("mkdir gone; cd gone; rmdir ../gone; {}"),
    "ASCII": Machine(PYTHONIOENCODING="ascii"),
    "Latin-1": Machine(PYTHONIOENCODING="latin-1"),
    "cp1252": Machine(PYTHONIOENCODING="cp1252"),
    "the C locale": Machine(LC_ALL="C", PYTHONUTF8="0", PYTHONCOERCECLOCALE="0"),
    "closed standard output": Machine("{} >&-"),
    "all closed": Machine("{} <&- >&- 2>&-"),
    "full standard output": Machine("{} >/dev/full"),
    "a reader that leaves": Machine("{} | head -n 1; exit ${{PIPESTATUS[0]}}"),
    "a terminal of seven columns": Machine(COLUMNS="7"),
    "odd columns": Machine(COLUMNS="-3", LINES="x", TERM="odd", NO_COLOR="1"),
    "no PATH": Machine(PATH=None),
    "optimised": Machine(PYTHONOPTIMIZE="2", PYTHONDONTWRITEBYTECODE="1"),
}
ENDS = {
    ("results that may not be written", "run"): (2, "error: out: cannot be written; choose another --out"),
    ("results that may not be written", "report"): (2, "error: done/report.html: cannot be written: Permission denied; "
                                                       "--out FILE.html writes it elsewhere"),
    ("a full disk", "run"): (2, "error: out/manifest.json: File too large"),
    ("a full disk", "report"): (2, "error: done/report.html: cannot be written: File too large; --out FILE.html writes "
                                   "it elsewhere"),
    ("a folder that is gone", "run"): (2, "error: cart.toml: no such scenario and no such file"),
    ("a folder that is gone", "report"): (2, "error: done: not a results folder"),
    **{("full standard output", name): (2, "error: input or output: No space left on device") for name in COMMANDS},
    ("a reader that leaves", "list"): (141, ""),
}


@pytest.mark.skipif(sys.platform != "linux", reason="written for a POSIX shell, /dev/full and Linux's capabilities")
@pytest.mark.long
@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("name", MACHINES)
def test_a_machine_as_it_is(railstate: Command, name: str, command: str) -> None:
    machine, here = MACHINES[name], railstate.folder
    assert railstate(*RUN, "done").code == 0
    before = {path: path.read_bytes() for path in (here / "done").rglob("*") if path.is_file()}
    (here / "home").mkdir()
    machine.before(here)
    asked = {"HOME": "home", "PATH": os.environ["PATH"], "NUMBA_CACHE_DIR": CACHE or None, "LC_ALL": "C.UTF-8",
             **machine.env}
    env = {key: str(here / value) if key in ("HOME", "TMPDIR", "PYTHONPATH") else value for key, value in asked.items()
           if value is not None}

    def bound() -> None:
        for capability in (1, 2):  # CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH, by PR_CAPBSET_DROP
            ctypes.CDLL(None).prctl(24, capability, 0, 0, 0)
        if machine.limit:
            resource.setrlimit(resource.RLIMIT_FSIZE, (machine.limit, machine.limit))

    line = machine.around.format(f'"$0" -c "{START}" "$@"')
    try:
        done = subprocess.run([shutil.which("bash") or "bash", "-c", line, sys.executable, *COMMANDS[command]], env=env,
                              capture_output=True, cwd=here, timeout=500, check=False, preexec_fn=bound)
    finally:
        for path in [here, *here.rglob("*")]:
            if not path.is_symlink():
                path.chmod(0o755)
    encoding = env.get("PYTHONIOENCODING", "ascii" if env["LC_ALL"] == "C" else "utf-8")
    out, err = done.stdout.decode(encoding), done.stderr.decode(encoding)
    code, message = ENDS.get((name, command), (0, ""))
    late = name == "a reader that leaves" and command != "list"  # it may have all before it leaves
    assert done.returncode in (code, 141 if late else code), (out, err)
    said = re.sub(r"^\d+ min: .*\n", "", err, flags=re.MULTILINE)  # where much had to be compiled
    assert said.startswith(message) and len(said.splitlines()) == bool(message), err
    assert [path for path in here.rglob(".*.[0-9]*") if CACHE not in str(path)] == []  # no leftovers
    assert before.items() <= {path: path.read_bytes() for path in before}.items()
    if command == "run" and (code != 2 or "standard output" in name):
        same(rows("done"), rows("out"))
    if command == "report" and (code != 2 or "standard output" in name):
        assert (here / "done" / "report.html").stat().st_size > 10_000
    if out and command == "list" and code == 0:
        assert "ningbo-metro" in out and "kalman" in out


def test_there_are_sixty() -> None:
    assert len(MACHINES) * len(COMMANDS) == 60
