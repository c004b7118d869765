"""Where rows come from: versions, processor, the commit of railstate itself; and what of it changed since."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections.abc import Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

PACKAGES = ("numpy", "scipy", "numba", "filterpy", "cvxpy", "clarabel", "pandas", "pyarrow", "joblib", "pydantic")
NUMERICAL = ("numpy", "numba", "scipy")
"""Packages of which another version may change the last bits of a row."""
ROOT = Path(__file__).resolve().parents[2]
"""The folder that railstate's own repository would have."""


def environment() -> dict[str, Any]:
    """Versions, processor and, where railstate runs from its own repository, the state of that."""
    commit, dirty = _git()
    return {"python": sys.version.split()[0], "platform": platform.platform(terse=True), "processor": _processor(),
            "cores": os.cpu_count(), "packages": {name: version(name) for name in PACKAGES},
            "git_commit": commit, "git_dirty": dirty}


def other_versions(there: Mapping[str, Any]) -> Iterator[str]:
    """`numpy 1.26.4 -> 2.1.0` for each numerical package of another version than in a stored environment."""
    for name in NUMERICAL:
        before, now = there["packages"].get(name), version(name)
        if before != now:
            yield f"{name} {before or 'not known'} -> {now}"


def _git() -> tuple[str | None, bool | None]:
    """Commit and whether there are changes; None where the repository around is not railstate's own (an installed
    package lies in anybody's)."""
    clean = {key: value for key, value in os.environ.items() if not key.startswith("GIT_")}

    def git(*words: str) -> str:
        return subprocess.run(["git", *words], cwd=ROOT, env=clean, capture_output=True, text=True, check=True,
                              timeout=10).stdout.strip()

    try:
        if Path(git("rev-parse", "--show-toplevel")).resolve() != ROOT:
            return None, None
        git("ls-files", "--error-unmatch", str(Path(__file__).resolve()))
        return git("rev-parse", "HEAD"), bool(git("status", "--porcelain", "--untracked-files=no"))
    except (OSError, subprocess.SubprocessError):
        return None, None


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
