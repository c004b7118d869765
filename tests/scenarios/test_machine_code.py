"""Machine code is never older than its source, wherever the helper stands, and there is a place for it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest
from railstate.scenarios import machine_code

HELPER = "from numba import njit\n\n@njit(cache=True)\ndef helper(x):\n    return x + {}\n"
CALLER = ("from numba import njit\n\nfrom .helper import helper\n\n@njit(cache=True)\ndef caller(x):\n"
          "    return helper(x)\n")
MAIN = """
import sys
from pathlib import Path
from railstate.scenarios import machine_code
machine_code.use(machine_code.key(Path("small")))
from small.caller import caller
print(caller(1.0), len(caller.stats.cache_hits))
"""


@pytest.fixture(autouse=True)
def _as_before(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", numba.config.CACHE_DIR)


def run(folder: Path, **environment: str) -> list[str]:
    done = subprocess.run([sys.executable, "-c", MAIN], cwd=folder, capture_output=True, text=True, check=True,
                          env={**os.environ, **environment})
    return done.stdout.split()


def test_an_edited_helper_in_another_file_is_compiled_anew(tmp_path: Path) -> None:
    package, cache = tmp_path / "small", {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "caller.py").write_text(CALLER)
    (package / "helper.py").write_text(HELPER.format("1.0"))
    assert run(tmp_path, **cache) == ["2.0", "0"]
    assert run(tmp_path, **cache) == ["2.0", "1"]
    (package / "helper.py").write_text(HELPER.format("41.0"))
    assert run(tmp_path, **cache) == ["42.0", "0"]


def test_the_key_is_that_of_what_is_compiled(tmp_path: Path) -> None:
    package = tmp_path / "small"
    package.mkdir()
    (package / "kernel.py").write_text("from numba import njit\nfrom .constants import HALF\n")
    (package / "constants.py").write_text("HALF = 0.5\n")
    (package / "words.py").write_text("HELLO = 'hello'\n")
    before = machine_code.key(package)
    (package / "words.py").write_text("HELLO = 'good day'\n")
    assert machine_code.key(package) == before
    (package / "constants.py").write_text("HALF = 0.25\n")
    assert machine_code.key(package) != before


def test_the_first_place_that_can_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file in the way of the user's cache stands for a HOME that cannot be written, for any user."""
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, "")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    (tmp_path / "home").mkdir()
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    name = machine_code.PREFIX + "0"
    assert machine_code.use(name) == tmp_path / "home" / ".cache" / "railstate" / name
    (tmp_path / "file").touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    monkeypatch.setenv("HOME", str(tmp_path / "file"))
    assert machine_code.use(name) == tmp_path / "temporary" / f"{machine_code.PREFIX}{os.getuid()}" / name
    assert os.environ["NUMBA_CACHE_DIR"].endswith(name)
    assert machine_code.use(name + "1") == tmp_path / "temporary" / f"{machine_code.PREFIX}{os.getuid()}" / (name + "1")


def test_old_folders_are_few(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    (tmp_path / "another").mkdir()
    for number in range(20):
        folder = tmp_path / f"{machine_code.PREFIX}{number:02d}"
        folder.mkdir()
        os.utime(folder, (number, number))
    assert machine_code.use(machine_code.PREFIX + "now") == tmp_path / (machine_code.PREFIX + "now")
    names = sorted(path.name.removeprefix(machine_code.PREFIX) for path in tmp_path.iterdir())
    assert names == ["12", "13", "14", "15", "16", "17", "18", "19", "another", "now"]
