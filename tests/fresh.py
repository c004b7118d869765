"""A fresh virtual environment for tests that install packages: own site-packages, own scripts, nothing downloaded.

It sees what the running environment has installed (the suite and what it depends on) through one .pth line."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

FORKING = '''
import importlib, json, os, site, sys, sysconfig
from railstate.benchmarks import cli

for name in ["numba", "pandas", "pyarrow.parquet", "rich.table", "scipy.linalg", "typer.testing"]:
    importlib.import_module(name)
for module, *_ in cli.COMMANDS.values():
    importlib.import_module(f"railstate.benchmarks.commands.{module}")
for line in sys.stdin:
    if not (child := os.fork()):
        break
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
else:
    sys.exit()
words, out, err = json.loads(line)
for number, path in enumerate((os.devnull, out, err)):
    os.dup2(os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC), number)
site.addsitedir(sysconfig.get_path("purelib"))  # what has been installed meanwhile
importlib.invalidate_caches()
sys.argv = ["railstate", *words]
cli.main()
'''
"""Runs commands, each in a process forked from one that has imported the suite; says each one's exit code."""


class Fresh:
    """An environment in `folder`; commands are executed in `home`, its scripts first on the path."""

    def __init__(self, folder: Path, home: Path) -> None:
        self.folder, self.home = folder, home
        self._forking: subprocess.Popen[str] | None = None
        venv.create(folder, with_pip=False, symlinks=True)
        self.python = folder / "bin" / "python"
        running = sysconfig.get_path("purelib")
        (self.site / "running.pth").write_text(f"import site; site.addsitedir({running!r})\n")
        # What an installation of the suite and of pip would put here: the same entry points, run by this Python.
        self._script("railstate", f"exec {self.python} -c 'from railstate.benchmarks.cli import main; main()' \"$@\"")
        self._script("pip", f"exec {sys.executable} -m pip --python {self.python} \"$@\"")
        self._script("pytest", f"exec {self.python} -m pytest -p no:cacheprovider \"$@\"")

    @property
    def site(self) -> Path:
        """Its own site-packages."""
        return next((self.folder / "lib").glob("python*/site-packages"))

    def run(self, *words: str | Path) -> subprocess.CompletedProcess[str]:
        """Run a command; its output is kept as text. Packages are built offline, with what is installed."""
        return subprocess.run(list(map(str, words)), cwd=self.home, env=self._environment(), capture_output=True,
                              text=True, timeout=300, check=False)

    def railstate(self, *words: str) -> subprocess.CompletedProcess[str]:
        """`railstate WORDS` without its start, which takes longer than most commands."""
        if self._forking is None:
            self._forking = subprocess.Popen([self.python, "-c", FORKING], cwd=self.home, env=self._environment(),
                                             stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self._forking.stdin and self._forking.stdout
        out, err = (self.folder / name for name in ("out", "err"))
        print(json.dumps([words, str(out), str(err)]), file=self._forking.stdin, flush=True)
        code = int(self._forking.stdout.readline())
        return subprocess.CompletedProcess(words, code, out.read_text("utf-8"), err.read_text("utf-8"))

    def _environment(self) -> dict[str, str]:
        environment = {key: value for key, value in os.environ.items()
                       if key not in ("PYTHONPATH", "PYTHONHOME", "PYTEST_ADDOPTS")}
        return environment | {"PATH": f"{self.folder / 'bin'}:{environment['PATH']}", "PIP_NO_INDEX": "1",
                              "PIP_NO_DEPS": "1", "PIP_NO_BUILD_ISOLATION": "0", "PIP_DISABLE_PIP_VERSION_CHECK": "1"}

    def _script(self, name: str, line: str) -> None:
        path = self.folder / "bin" / name
        path.write_text(f"#!/bin/sh\n{line}\n")
        path.chmod(0o755)
