"""`railstate new`, and packages outside the suite: installed in a fresh environment, listed, run, checked, compared."""

from __future__ import annotations

import shutil
from pathlib import Path

import pandas as pd
import pytest
from railstate.estimators import registry as estimator_registry
from railstate.scenarios import registry as scenario_registry

from ..conftest import SCENARIO, Command
from ..fresh import Fresh

EXTERNAL = Path(__file__).parents[1] / "external_package"


def test_packages_work_in_a_fresh_environment(railstate: Command, tmp_path: Path) -> None:
    """One environment for the external package and the two that `new` writes: installing them is what takes time."""
    for kind, name in (("estimator", "my-filter"), ("scenario", "my-trolley")):
        made = railstate("new", kind, name)
        assert made.code == 0 and f"pip install -e {name}" in made.out
    shutil.copytree(EXTERNAL, "external", ignore=shutil.ignore_patterns("*.egg-info", "__pycache__", "build"))
    fresh = Fresh(tmp_path / "environment", tmp_path)
    installed = fresh.run("pip", "install", "-e", "external", "-e", "my-filter", "-e", "my-trolley")
    assert installed.returncode == 0, installed.stdout + installed.stderr

    listed = fresh.run("railstate", "list")
    assert listed.returncode == 0
    for name in ("alpha-beta", "my-filter", "my-trolley", "kalman", "as-told rougher"):
        assert name in listed.stdout
    assert listed.stderr == ("warning: plug-in half-finished (railstate_external_unfinished:HalfFinished): does not "
                             "import: ModuleNotFoundError: No module named 'a_library_nobody_has_installed': left "
                             "out\n")

    done = fresh.railstate("run", "my-trolley", "--estimators", "alpha-beta,my-filter,kalman", "--runs", "20",
                           "--jobs", "1", "--out", "out")
    assert done.returncode == 0, done.stderr
    assert "120 rows: 120 ok" in done.stdout
    summary = pd.read_csv(tmp_path / "out" / "summary.csv").query("metric == 'rmse' and quantity == 'position'")
    error = summary.set_index(["variant", "estimator"])["mean"]
    assert error["as-told", "kalman"] < min(error["as-told", "alpha-beta"], error["as-told", "my-filter"])

    checked = fresh.railstate("check", "alpha-beta", "--scenario", "my-trolley")
    assert checked.returncode == 0 and "alpha-beta: all rules kept" in checked.stdout, checked.stdout + checked.stderr
    compared = fresh.railstate("compare", "alpha-beta", "kalman", "--scenario", "my-trolley/as-told", "--runs", "30",
                               "--jobs", "1", "--fail-on", "worse")
    assert compared.returncode == 0, compared.stderr
    assert "position rmse: kalman is better than alpha-beta" in compared.stdout
    tested = fresh.run("pytest", "-q", "my-filter/tests", "my-trolley/tests")
    assert tested.returncode == 0, tested.stdout


def test_what_new_writes_for_an_estimator_is_short_and_keeps_the_rules(railstate: Command) -> None:
    assert railstate("new", "estimator", "gentle-pull").code == 0
    folder = railstate.folder / "gentle-pull"
    assert sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()) == [
        "README.md", "gentle_pull.py", "pyproject.toml", "tests/test_gentle_pull.py"]
    body = (folder / "gentle_pull.py").read_text().split("class GentlePull(Estimator)")[1]
    assert sum(bool(line.strip()) for line in body.splitlines()) <= 22
    checked = railstate("check", "gentle-pull/gentle_pull.py", "--parameter", "gain=0.25")
    assert checked.code == 0 and "gentle-pull: all rules kept" in checked.out
    refused = railstate("check", "gentle-pull/gentle_pull.py", "--parameter", "gain=3")
    assert refused.code == 2 and "parameters.gain" in refused.err and "less than 2" in refused.err


@pytest.mark.parametrize(("words", "message"), [
    (("estimator", "My-Filter"), "not a name for estimators"),
    (("estimator", "2fast"), "not a name for estimators"),
    (("estimator", "a/b"), "not a name for estimators"),
    (("estimator", "lambda"), "not a name for estimators"),
    (("estimator", "true"), "not a name for estimators"),
    (("estimator", "estimate"), "not a name for estimators"),
    (("scenario", "setting"), "not a name for scenarios"),
    (("estimator", "kalman"), "there is such an estimator already"),
    (("scenario", "braking-rate"), "there is such a scenario already"),
    (("scenario", "metro"), "there is such a scenario already"),
    (("estimator", "numpy"), "the Python module numpy is installed already"),
    (("estimator", "statistics"), "the Python module statistics is installed already"),
    (("estimator", "taken"), "exists already"),
    (("scenario", "fine", "--in", "nowhere"), "no such folder"),
])
def test_one_message_for_what_cannot_be(railstate: Command, words: tuple[str, ...], message: str) -> None:
    (railstate.folder / "taken").mkdir()
    before = sorted(railstate.folder.rglob("*"))
    done = railstate("new", *words)
    assert done.code == 2 and message in done.err and len(done.err.splitlines()) == 1
    assert sorted(railstate.folder.rglob("*")) == before


def test_a_plug_in_that_does_not_import_costs_a_warning(
        railstate: Command, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    """Estimators and scenarios alike, whatever they raise."""
    site = railstate.folder / "site"
    (site / "broken-1.0.dist-info").mkdir(parents=True)
    (site / "broken_here.py").write_text("raise RuntimeError('not today')\n")
    (site / "broken-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1.0\n")
    (site / "broken-1.0.dist-info" / "entry_points.txt").write_text(
        "[railstate.estimators]\nsulking = broken_here:Sulking\nnameless = railstate.estimators.baselines:Nobody\n"
        "[railstate.scenarios]\nmissing = nowhere_at_all:Missing\n")
    monkeypatch.syspath_prepend(site)
    caches = (estimator_registry.installed, scenario_registry.settings, scenario_registry.scenario_files)
    for cache in caches:
        request.addfinalizer(cache.cache_clear)
        cache.cache_clear()
    (railstate.folder / "cart.toml").write_text(SCENARIO.replace('plugin = "half"', 'plugin = "kalman"'))
    done = railstate("run", "cart.toml/calm", "--runs", 2, "--jobs", 1, "--out", "out")
    assert done.code == 0 and "2 rows: 2 ok" in done.out
    missing = ("warning: plug-in missing (nowhere_at_all:Missing) is left out: ModuleNotFoundError: No module named "
               "'nowhere_at_all'")
    assert done.err.splitlines() == [missing]  # estimators are not imported where they are not asked for
    for cache in caches:
        cache.cache_clear()
    listed = railstate("list")
    assert listed.code == 0 and "kalman" in listed.out and sorted(listed.err.splitlines()) == [
        missing,
        "warning: plug-in nameless (railstate.estimators.baselines:Nobody): does not import: AttributeError: module "
        "'railstate.estimators.baselines' has no attribute 'Nobody': left out",
        "warning: plug-in sulking (broken_here:Sulking): does not import: RuntimeError: not today: left out"]
