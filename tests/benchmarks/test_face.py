"""`import railstate`: light, the same rows as the command line's, classes and functions of a notebook by value."""

from __future__ import annotations

import inspect
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
import railstate
from railstate.benchmarks.cli import COMMANDS, main
from railstate.estimators.kalman import Kalman

from ..conftest import SCENARIO

CELL = '''
import numpy as np
import railstate
from pydantic import Field
from railstate.estimators.interface import Parameters

GAIN = 0.5

class Drag(railstate.Estimator):
    """x+ = x- + g (y - x-)"""
    summary = "a gain on the position"

    class Parameters(Parameters):
        gain: float = Field(default=GAIN, description="gain of the position")

    def start(self, model, runs, random):
        super().start(model, runs, random)
        self.x = model.initial_mean.copy()

    def predict(self, u, interval):
        self.x = self.model.transition(self.x, u, interval)

    def update(self, measurement):
        innovation = np.where(measurement.received[0], measurement.y[0] - self.x[0], 0.0)
        self.x = self.x + np.stack([self.parameters.gain * innovation, 0.1 * innovation])

    def estimate(self):
        return railstate.Estimate(self.x)

class Primed(Drag):
    def __init__(self, word):
        super().__init__({"gain": 0.25})
        self.word = word

    def start(self, model, runs, random):
        super().start(model, runs, random)
        assert self.word == "go", self.word

def hold_last(model):
    x = model.x0.copy()

    def step(y, u):
        x[0] = x[0] if np.isnan(y[0]) else GAIN * x[0] + (1 - GAIN) * y[0]
        return x

    return step
'''


@pytest.fixture(scope="module")
def notebook() -> dict[str, Any]:
    """What a notebook's cell defines: in a `__main__` that nobody can import."""
    names: dict[str, Any] = {"__name__": "__main__"}
    exec(CELL, names)
    return names


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    here = tmp_path_factory.mktemp("face")
    (here / "cart.toml").write_text(SCENARIO)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(here)
        yield here


@pytest.fixture(scope="module")
def found(folder: Path, notebook: dict[str, Any]) -> railstate.Results:
    drag = notebook["Drag"]
    return railstate.run("cart.toml/calm", {
        "kalman": "kalman", "drag": drag, "eager": drag({"gain": 0.9}), "primed": notebook["Primed"]("go"),
        "hold": notebook["hold_last"], "own": Kalman(), "late": {"plugin": "kalman", "late": "as-new"}},
        runs=20, jobs=1, folder="mine", quiet=True)


def test_import_is_light() -> None:
    code = ("import sys, railstate; assert not {'numpy', 'pandas', 'numba'} & set(sys.modules); "
            "assert 'run' in dir(railstate); railstate.__version__; "
            "import railstate.estimators.interface; assert railstate.estimators.interface.Estimator is "
            "railstate.Estimator; import railstate.scenarios as s; assert s.__file__; s.errors")
    subprocess.run([sys.executable, "-c", code], check=True)
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = railstate.nonsense


def test_what_is_given_runs_and_says_what_it_is(found: railstate.Results) -> None:
    assert len(found.rows) == 140
    assert set(found.rows["status"]) == {"ok"}
    rmse = found.rows.groupby("estimator")["rmse:position:m"].mean()
    assert rmse["kalman"] == rmse["own"]
    assert rmse["kalman"] < min(rmse[name] for name in ("drag", "eager", "primed", "hold"))
    assert len({rmse[name] for name in ("drag", "eager", "primed", "hold")}) == 4
    manifest = found.store.manifest()
    assert [name for name, about in manifest["estimators"].items() if about["given"]] == [
        "drag", "eager", "primed", "hold"]
    assert manifest["replay"]["plugins"] == []
    assert manifest["configuration"]["cells"]["cart/calm"]["estimators"]["eager"]["parameters"] == {"gain": 0.9}
    assert manifest["command"].startswith("railstate.run('cart.toml/calm', ['kalman', 'drag', 'eager'")


def test_rows_are_those_of_the_command_line(found: railstate.Results, folder: Path,
                                            monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["railstate", "run", "cart.toml/calm", "-e", "kalman", "--runs", "20", "-j", "1",
                                      "-q", "--out", "theirs"])
    with pytest.raises(SystemExit, match="0"):
        main()
    theirs = railstate.load("theirs").rows.drop(columns="seconds")
    mine = found.rows[found.rows["estimator"] == "kalman"].drop(columns="seconds")
    pd.testing.assert_frame_equal(mine[list(theirs)].reset_index(drop=True), theirs)


def test_what_is_there_counts_in_this_session(found: railstate.Results, notebook: dict[str, Any],
                                              recwarn: pytest.WarningsRecorder) -> None:
    """Not after a cell has been executed again: its class is another one then."""
    written = {path: path.stat().st_mtime_ns for path in (found.folder / "rows").iterdir()}
    again = railstate.run("cart.toml/calm", [notebook["Drag"]], runs=20, jobs=1, folder="mine", quiet=True)
    railstate.run("cart.toml/calm", {"hold": notebook["hold_last"]}, runs=20, jobs=1, folder="mine", quiet=True)
    assert {path: path.stat().st_mtime_ns for path in (again.folder / "rows").iterdir()} == written
    assert not [one for one in recwarn if "computed anew" in str(one.message)]
    names: dict[str, Any] = {"__name__": "__main__"}
    exec(CELL, names)
    with pytest.warns(UserWarning, match="its code changed, computed anew: cart/calm/drag"):
        railstate.run("cart.toml/calm", [names["Drag"]], runs=20, jobs=1, folder="mine", quiet=True)


def test_results_are_tables_comparisons_figures_and_a_page(found: railstate.Results, folder: Path) -> None:
    pair = found.compare("kalman", "hold").set_index("quantity")
    assert pair.loc["position", "verdict"] == "worse"
    assert pair.loc["position", "b"] == pytest.approx(pair.loc["position", "ratio"] * pair.loc["position", "a"])
    assert len(found.compare(found)) == 0 or set(found.compare(found)["ratio"]) == {1.0}
    assert {"kalman", "drag"} <= set(found.summary()["estimator"])
    assert set(found.verdicts()["verdict"]) >= {"best", "worse"}
    assert "kalman" in found._repr_html_()
    figures = found.plot("error-over-time", entries=["kalman", "drag"])
    assert list(figures) == ["error-over-time~cart~calm"]
    assert figures._repr_html_().count("<svg") == 1
    assert [path.name for path in figures.save("figures", "svg")] == ["error-over-time~cart~calm.svg"]
    assert found.report("page.html").stat().st_size > 20_000
    with pytest.raises(railstate.InputError, match="nobody: not among these results; allowed: kalman, drag"):
        found.compare("kalman", "nobody")


def test_a_given_class_cannot_be_replayed(found: railstate.Results, folder: Path, monkeypatch: pytest.MonkeyPatch,
                                          capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", ["railstate", "replay", "cart/calm/eager/3", "--out", "mine"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert "was given in Python, by value; only who gave it can run it again" in capsys.readouterr().err


def test_an_estimator_s_page_has_its_record(found: railstate.Results, folder: Path, monkeypatch: pytest.MonkeyPatch,
                                           capsys: pytest.CaptureFixture[str]) -> None:
    """Equations from its docstring, what it claims, and where it was best or worse: counted from the verdict table."""
    monkeypatch.setattr(sys, "argv", ["railstate", "show", "kalman", "--out", "mine"])
    with pytest.raises(SystemExit, match="0"):
        main()
    said = " ".join(capsys.readouterr().out.split())
    table = found.verdicts()
    mine = table[(table["kind"] == "error") & table["estimator"].isin(["kalman", "own", "late"])]
    good = mine[mine["verdict"].isin(["best", "tie"])]
    assert f"Least error, or tied with it, in {len(good)} of {len(mine)} rankings: cart/calm" in said
    assert "claims: mean, covariance" in said and "rap-example-1 (kalman" in said
    page = found.report("page.html").read_text()
    assert f"Least error, or tied with it, in {len(good)} of {len(mine)} rankings" in page
    assert "a gain on the position" in page and "x+ = x- + g (y - x-)" in page
    assert "Shown to be worse in" in page


@pytest.mark.parametrize(("given", "message"), [
    ([], "none is given"), ([3], "got 3; expected a label or a name, a class over"),
    ([lambda model: None], "expected a label"), ({"a b": "ekf"}, "'a b' is no label"),
    ([{"plugin": "ekf"}], "a table needs a label"), ({"x": {"plugin": "kalman", "lat": 1}}, "x.lat: unknown key"),
    (["kalman", "kalman"], "two are called kalman"), (["nobody"], "no such estimator"),
    ({"x": {"plugin": "kalman", "knowledge": {"sigma": 3}}}, "x.knowledge.sigma: unknown"),
    ([type("Kalman", (railstate.Estimator,), {})], "named kalman is installed already"),
    ([type("Part", (railstate.Estimator,), {})], "part: lacks estimate, predict, start, update")])
def test_what_cannot_be_given_is_told(given: Any, message: str, folder: Path) -> None:
    with pytest.raises(railstate.InputError, match=message):
        railstate.run("cart.toml/calm", given, runs=2, jobs=1, folder="none", quiet=True)
    assert not Path("none").exists()


def test_a_run_s_truth_and_measurements(folder: Path) -> None:
    truth, measurements = railstate.simulate("cart.toml/calm", run=3)
    assert list(truth) == ["position", "speed"] and len(truth) == 40
    assert len(measurements) == len(truth)
    assert measurements.iloc[:, -1].isna().any()
    noise = (measurements.iloc[:, -1] - truth["position"]).dropna()
    assert 0.5 < noise.std() < 2.0
    late = railstate.simulate("ningbo-metro/late")
    assert set(late.measurements["position late"].dropna()) == {1}
    moving = railstate.simulate("moving-block")
    assert (moving.truth.index[1:] > moving.truth.index[:-1]).all()
    with pytest.raises(railstate.InputError, match="run = -1"):
        railstate.simulate("cart.toml", run=-1)


def test_what_there_is() -> None:
    assert {"ekf", "robust-bounded"} <= set(railstate.estimators()["estimator"])
    assert railstate.scenarios().set_index("scenario").loc["ningbo-metro", "variants"][0] == "switching"


def test_a_script_without_a_guard(folder: Path) -> None:
    """Two jobs, the suite's own and a class of the script's own: nothing imports the script again."""
    script = f"print('once')\n{CELL}\nprint(railstate.run('cart.toml', ['kalman', Drag], runs=4, jobs=2, folder='two'))"
    (folder / "script.py").write_text(script)
    done = subprocess.run([sys.executable, "script.py"], capture_output=True, text=True, check=False, cwd=folder)
    assert done.stdout.splitlines() == ["once", "16 rows in two"], done.stderr


def test_the_same_option_has_the_same_default_everywhere() -> None:
    """In every command and in Python; only what `reproduce` and `check` do asks for another."""
    usual = {"runs": 100, "seed": 1, "jobs": 0, "keep": 1, "batch": 0, "backend": "local", "scheduler": "",
             "timeout": 900.0, "memory": 0.0, "overwrite": False}
    calls = {name: getattr(import_module(f"railstate.benchmarks.commands.{module}"), function)
             for name, (module, function, _) in COMMANDS.items()}
    other = {(name, key): one.default for name, call in {"railstate.run": railstate.run, **calls}.items()
             for key, one in inspect.signature(call).parameters.items() if one.default != usual.get(key, one.default)}
    assert other == {("reproduce", "runs"): 400, ("check", "timeout"): 300.0}
