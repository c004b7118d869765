"""What is installed: the packages named by hand are those on the disk, and the wheel works elsewhere by itself."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from zipfile import ZipFile

from .fresh import Fresh

ROOT = Path(__file__).parents[1]
PACKAGES = ("scenarios", "estimators", "benchmarks")


def test_the_packages_named_are_those_on_the_disk() -> None:
    named = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    folders = {prefix.replace(".", "/"): folder for prefix, folder in named["package-dir"].items()}
    there = {path.parent for package in PACKAGES for path in (ROOT / package).rglob("*.py")}
    found = set()
    for package in named["packages"]:
        prefix = max((key for key in folders if package.replace(".", "/").startswith(key)), key=len)
        found.add(ROOT / folders[prefix] / package.replace(".", "/").removeprefix(prefix).lstrip("/"))
    assert found == there
    assert named["packages"] == sorted(named["packages"])


def test_the_wheel_installed_elsewhere_runs_a_scenario(tmp_path: Path) -> None:
    """Every package and every file is in it. `direct` needs the least machine code, which is compiled anew there."""
    source = tmp_path / "source"  # what an earlier build has left in `build` would be packed again
    for package in PACKAGES:
        shutil.copytree(ROOT / package, source / package, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copyfile(ROOT / name, source / name)
    subprocess.run([sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation", "--no-index", "-w",
                    str(tmp_path), str(source)], check=True, capture_output=True)
    wheel = next(tmp_path.glob("railstate-*.whl"))
    packed = set(ZipFile(wheel).namelist())
    for path in (path for package in PACKAGES for path in (ROOT / package).rglob("*") if path.is_file()):
        name = str(path.relative_to(ROOT)).removeprefix("benchmarks/face/")
        assert path.suffix in (".pyc", ".md", ".ipynb") or f"railstate/{name}" in packed, path
    fresh = Fresh(tmp_path / "environment", tmp_path)
    done = fresh.run("pip", "install", "-q", "--force-reinstall", wheel)
    assert done.returncode == 0, done.stderr
    code = ("import railstate, railstate.scenarios as s; print(s.__file__); print(railstate.__file__); "
            "print(railstate.run('rap-example-1', ['direct'], runs=2, jobs=1, folder='python'), railstate.__version__)")
    said = fresh.run(fresh.python, "-c", code)
    lines = said.stdout.splitlines()
    assert all(line.startswith(str(tmp_path)) for line in lines[:2]), said.stdout + said.stderr
    assert lines[2].startswith("4 rows in python 0."), said.stdout + said.stderr
    listed = fresh.run("railstate", "list")
    assert listed.returncode == 0 and "ningbo-metro" in listed.stdout, listed.stderr
    for words in (("show", "ningbo-metro"), ("new", "estimator", "first-try"),
                  ("run", "rap-example-1", "--estimators", "direct", "--runs", "3", "--jobs", "1", "--out", "out"),
                  ("report", "out")):
        done = fresh.railstate(*words)
        assert done.returncode == 0, f"{words}\n{done.stdout}{done.stderr}"
    assert (tmp_path / "out" / "report.html").stat().st_size > 20_000


CHANGED = {
    "Canvas", "Column", "Event(slots=True)", "Found", "Particle", "Readings", "Section", "Step(slots=True)", "Table",
    "Variant", "Verified", "_Entry", "_Event", "_Past", "_Path", "_Text"}
"""Dataclasses that are changed in place, or made too often to be frozen."""


def test_a_dataclass_is_a_value_unless_it_is_said_here() -> None:
    found = [name + how for package in PACKAGES for path in (ROOT / package).rglob("*.py") for how, name in re.findall(
        r"^@dataclass(.*)\nclass (\w+)", path.read_text(encoding="utf-8"), re.MULTILINE)]
    assert len(found) > 100 and {one for one in found if "frozen=True" not in one} == CHANGED
