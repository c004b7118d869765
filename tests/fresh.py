"""A fresh virtual environment for tests that install packages: own site-packages, own scripts, nothing downloaded.

It sees what the running environment has installed (the suite and what it depends on) through one .pth line."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path


class Fresh:
    """An environment in `folder`; `run` executes commands in `home` with its scripts first on the path."""

    def __init__(self, folder: Path, home: Path) -> None:
        self.folder, self.home = folder, home
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
        environment = {key: value for key, value in os.environ.items()
                       if key not in ("PYTHONPATH", "PYTHONHOME", "PYTEST_ADDOPTS")}
        environment |= {"PATH": f"{self.folder / 'bin'}:{environment['PATH']}", "PIP_NO_INDEX": "1", "PIP_NO_DEPS": "1",
                        "PIP_NO_BUILD_ISOLATION": "0", "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
        return subprocess.run(list(map(str, words)), cwd=self.home, env=environment, capture_output=True, text=True,
                              timeout=300, check=False)

    def _script(self, name: str, line: str) -> None:
        path = self.folder / "bin" / name
        path.write_text(f"#!/bin/sh\n{line}\n")
        path.chmod(0o755)
