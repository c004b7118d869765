"""Where rows come from: the commit, and hashes of the code that follow imports and meaning."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from railstate.benchmarks.store import provenance
from railstate.estimators.registry import load_file
from railstate.scenarios.source import _closure, source_hash

from ..conftest import PLUGIN


def test_the_commit_is_never_that_of_a_repository_around(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def git(*words: str, to: Path = tmp_path) -> None:
        subprocess.run(["git", "-c", "user.name=x", "-c", "user.email=x@y", *words], cwd=to, check=True,
                       capture_output=True)

    git("init")
    other = tmp_path / "other"
    other.mkdir()
    git("init", to=other)
    git("commit", "--allow-empty", "-m", "y", to=other)
    inner = tmp_path / "site" / "railstate"
    inner.mkdir(parents=True)
    (inner / "provenance.py").write_text("")
    git("add", "site")
    git("commit", "-m", "x")
    monkeypatch.setattr(provenance, "ROOT", inner)
    monkeypatch.setattr(provenance, "__file__", str(inner / "provenance.py"))
    assert provenance.environment()["git_commit"] is None
    monkeypatch.setenv("GIT_DIR", str(tmp_path / ".git"))
    assert provenance.environment()["git_commit"] is None
    monkeypatch.setattr(provenance, "ROOT", tmp_path)
    monkeypatch.setenv("GIT_DIR", str(other / ".git"))
    assert len(provenance.environment()["git_commit"]) == 40 and provenance.environment()["git_dirty"] is False


def test_hashes_follow_imports_and_meaning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "strange_filters"
    (package / "inner").mkdir(parents=True)
    files = {"__init__.py": "", "one.py": '"""Doc."""\nfrom . import helper\nX = 1\n', "table.csv": "1,2\n",
             "helper.py": "def f():\n    return 2\n", "inner/__init__.py": "", "inner/far.py": "Y = 1\n"}
    for name, text in files.items():
        (package / name).write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    import strange_filters.one  # noqa: F401  # pyright: ignore

    before = source_hash("strange_filters.one")

    def after(name: str, text: str) -> str:
        (package / name).write_text(text)
        found = source_hash("strange_filters.one")
        (package / name).write_text(files[name])
        return found

    assert after("one.py", '"""Other words."""\n\nfrom . import helper  # why\nX = (1)\n') == before
    for name, text in (("one.py", "from . import helper\nX = 2\n"), ("helper.py", "def f():\n    return 3\n"),
                       ("inner/far.py", "Y = 2\n"), ("table.csv", "1,3\n")):
        assert after(name, text) != before, name
    assert source_hash("strange_filters.one") == before


def test_a_loose_file_and_the_helper_beside_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "gains.py").write_text("GAIN = 0.5\n")
    (tmp_path / "loose.py").write_text(
        "import sys\nfrom pathlib import Path\nsys.path.insert(0, str(Path(__file__).parent))\nfrom gains import GAIN\n"
        + PLUGIN.partition("class Half")[0] + "class Half" + PLUGIN.partition("class Half")[2].partition("\nclass ")[0])
    monkeypatch.setattr(sys, "path", list(sys.path))
    name = next(iter(load_file(str(tmp_path / "loose.py")).values())).__module__
    assert {"gains", "loose.py", "railstate.estimators.interface"} <= set(_closure((name,)))
    before = source_hash(name)
    (tmp_path / "gains.py").write_text("GAIN = 0.25\n")
    assert source_hash(name) != before


def test_an_edit_in_one_family_leaves_the_others(tmp_path: Path) -> None:
    robust, kalman = (set(_closure((f"railstate.estimators.{name}",))) for name in ("robust.estimators", "kalman"))
    assert "railstate.estimators.robust.convex" in robust - kalman and "railstate.estimators.interface" in kalman
    metro = set(_closure(("railstate.scenarios.metro.setting",)))
    assert "railstate.scenarios.railway.trip" in metro and not any("braking" in name for name in metro)
    rows_are_made_by = set(_closure(("railstate.benchmarks.running.execute",)))
    assert {"railstate.benchmarks.scoring.scorer", "railstate.benchmarks.running.drive"} <= rows_are_made_by
    assert not any(word in name for name in rows_are_made_by for word in ("store", "judging", "telling", "kalman_"))
    cars = _closure(("railstate.scenarios.coupled_cars.setting",))
    assert "railstate.scenarios.coupled_cars/zou2018_gain.csv" in cars
