"""The least error possible: closed forms, a textbook recursion, and that no estimator is under a Gaussian floor."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from railstate.benchmarks.judging.floors import UNDER, beneath
from railstate.benchmarks.judging.table import verdicts_of
from railstate.benchmarks.planning.plan import make_plan
from railstate.benchmarks.running.execute import execute
from railstate.benchmarks.scoring.floor import basis, floor_kind, floor_of
from railstate.benchmarks.store.folder import Store
from railstate.scenarios.files import load
from railstate.scenarios.randomness import Streams
from railstate.scenarios.registry import scenario_files, settings

from ..conftest import Command


def scalar(tmp_path: Path, a: float, q: float, r: float, p0: float, steps: int = 400, channel: str = '"ideal"') -> Any:
    """The setting of x+ = a x + w, y = x + v over a channel (the rest of its table, from the kind's value on)."""
    path = tmp_path / "scalar.toml"
    path.write_text(f"""
name = "scalar"
title = "one state"
time = {{ period = 1.0, steps = {steps} }}
plant = {{ kind = "linear", A = [[{a}]], B = [[1]], C = [[1]], Q = [[{q}]], R = [[{r}]], x0 = [0], P0 = [[{p0}]] }}
estimators.kalman = {{ plugin = "kalman" }}
variants.plain = {{ title = "plain" }}
channel = {{ kind = {channel} }}
""")
    return load(str(path)).setting("plain")


def squares(setting: Any, runs: int = 5) -> tuple[np.ndarray, Any]:
    """Least mean squares (K, S) of the first quantity, and the world."""
    world = setting.world(Streams(1, "scalar", "plain", tuple(range(runs))))
    found = floor_of(setting, world, predicted=False)
    assert found is not None
    return found.squares[:, 0], world


def steady(a: float, q: float, r: float) -> float:
    """P- of the scalar Riccati equation P- = a^2 P- r / (P- + r) + q."""
    b = r * (1 - a * a) - q
    return (-b + np.sqrt(b * b + 4 * q * r)) / 2


def test_steady_riccati(tmp_path: Path) -> None:
    a, q, r = 0.95, 0.3, 2.0
    before = steady(a, q, r)
    found, _ = squares(scalar(tmp_path, a, q, r, 1.0))
    np.testing.assert_allclose(found[200:], before * r / (before + r), rtol=1e-12)


def test_bernoulli_losses_of_a_random_walk_read_exactly(tmp_path: Path) -> None:
    """P is q times the steps since the last reading: q (1 - p) / p in the mean."""
    q, p = 0.5, 0.3
    found, world = squares(scalar(tmp_path, 1.0, q, 1e-9, 1.0, 500, f'"bernoulli", p = {p}'), 200)
    age, start = np.zeros(200), np.ones(200)
    for k in range(500):
        age, start = np.where(world.received[k, 0], 0.0, [age + 1, start])
        np.testing.assert_allclose(found[k], q * age + start, atol=1e-8)
    mean = found[100:].mean(axis=0)
    assert abs(mean.mean() - q * (1 - p) / p) < 4 * mean.std() / np.sqrt(200)


def test_bernoulli_losses_of_a_constant(tmp_path: Path) -> None:
    """1 / P is 1 / P0 plus the readings so far over r, run by run."""
    r, p0 = 2.0, 3.0
    found, world = squares(scalar(tmp_path, 1.0, 0.0, r, p0, 60, '"bernoulli", p = 0.4'), 30)
    heard = np.cumsum(world.received[:, 0], axis=0)
    np.testing.assert_allclose(found, 1 / (1 / p0 + heard / r), rtol=1e-12)


@pytest.mark.parametrize("late", [1, 3])
def test_late_readings_count_from_their_arrival(tmp_path: Path, late: int) -> None:
    a, q, r = 0.9, 0.3, 2.0
    before = steady(a, q, r)
    wanted = before * r / (before + r)
    for _ in range(late):
        wanted = a * a * wanted + q
    found, _ = squares(scalar(tmp_path, a, q, r, 1.0, 200, f'"delay", steps = {late}'))
    np.testing.assert_allclose(found[150:], wanted, rtol=1e-12)


def test_out_of_order_packets_of_a_constant(tmp_path: Path) -> None:
    """What counts is how many have come, in whatever order."""
    found, world = squares(scalar(tmp_path, 1.0, 0.0, 2.0, 3.0, 80, '"delay", steps = [0, 4]'), 9)
    come = np.zeros(found.shape)
    for stamp in range(80):
        for run in range(9):
            if (at := stamp + world.late[stamp, 0, run]) < 80:
                come[at, run] += 1
    np.testing.assert_allclose(found, 1 / (1 / 3.0 + np.cumsum(come, axis=0) / 2.0), rtol=1e-12)


@pytest.mark.parametrize("name", ["rap-example-1/corrected", "rap-example-2/printed"])
def test_textbook_recursion(name: str) -> None:
    """P in Joseph form, run by run, over the elements that each received, R correlated."""
    scenario, _, variant = name.partition("/")
    setting: Any = load(scenario, {"plant.R": [[0.09, 0.05], [0.05, 0.09]]}).setting(variant)
    world = setting.world(Streams(1, scenario, variant, (0, 4, 7)))
    found, model, early = floor_of(setting, world, predicted=False), basis(setting, 3), floor_of(setting, world, True)
    assert found is not None and early is not None and model is not None
    linear = model.model.linear
    for run in range(3):
        P = model.model.initial_covariance[:, :, 0]
        for k in range(60):
            P = linear.A(k) @ P @ linear.A(k).T + linear.Q(k)
            np.testing.assert_allclose(early.squares[k, :, run], np.diag(P), rtol=1e-9)
            got = world.received[k, :, run]
            H, R = linear.C(k + 1)[got], linear.R(k + 1)[np.ix_(got, got)]
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
            left = np.eye(len(P)) - K @ H
            P = left @ P @ left.T + K @ R @ K.T
            np.testing.assert_allclose(found.squares[k, :, run], np.diag(P), rtol=1e-9)


def table(name: str, runs: Any, only: tuple[str, ...] = (), **changes: Any) -> pd.DataFrame:
    plan = make_plan([name], only=only, overrides=changes)
    cell = plan.cells[0]
    return execute(plan.task(cell, tuple(cell.entries), tuple(runs))).rows.to_pandas()


def floors(frame: pd.DataFrame) -> list[str]:
    return [column for column in frame.columns if column.startswith("floor:")]


@pytest.mark.parametrize("name", ["ningbo-metro/gaussian", "rap-example-1/corrected", "moving-block/law-r-missed-tags"])
def test_a_run_has_the_same_floor_in_any_batch(name: str) -> None:
    labels = ("ekf",) if "rap" not in name else ("random-access",)
    many, one = table(name, range(6), labels), table(name, [3], labels)
    assert floors(many)
    for column in floors(many):
        assert many.loc[many["run"] == 3, column].tolist() == one[column].tolist()


@pytest.mark.parametrize(("name", "label", "wanted"), [
    ("ningbo-metro/gaussian", "ekf", [0.0649, 0.0242]),
    ("rap-example-1/corrected", "random-access-conditional", [0.2174, 0.3925, 0.1737])])
def test_known_floors(name: str, label: str, wanted: list[float]) -> None:
    """Of an independent program, 100 runs, within 1 %."""
    frame = table(name, range(100), (label,))
    np.testing.assert_allclose([np.sqrt((frame[c] ** 2).mean()) for c in floors(frame)], wanted, rtol=0.01)


def gaussian() -> list[str]:
    """Built-in variants with a floor of Gaussian noise."""
    out = []
    for name in scenario_files():
        scenario = load(name)
        if getattr(settings().get(scenario.variants[scenario.default]["plant"]["kind"]), "needs_file", ""):
            continue
        out += [f"{name}/{variant}" for variant in scenario.variants
                if floor_kind(scenario.setting(variant)) == "floor"]
    return out


def under(name: str, runs: int, *only: str) -> list[str]:
    """Estimators under the floor by more than chance."""
    frame = table(name, range(runs), only)
    assert floors(frame)
    return [f"{label} {column}" for label, part in frame.groupby("estimator") for column in floors(frame)
            if beneath(part[column.replace("floor", "rmse")].to_numpy(), part[column].to_numpy()) > UNDER]


def test_no_estimator_is_under_a_gaussian_floor() -> None:
    names = gaussian()
    assert {"ningbo-metro/gaussian", "rap-example-1/corrected", "rap-example-2/printed"} <= set(names)
    nearest = {"ningbo-metro/gaussian": ("ekf", "ukf")}  # the others are in the long study, as are variants on request
    requested = {f"{name}/{variant}" for name in scenario_files() for variant in load(name).requested}
    assert not [found for name in names if name not in requested for found in under(name, 60, *nearest.get(name, ()))]


@pytest.mark.long
@pytest.mark.parametrize("name", gaussian())
def test_no_estimator_is_under_a_gaussian_floor_in_2000_runs(name: str) -> None:
    assert not under(name, 2000)


def test_what_a_floor_is_called() -> None:
    def kind(name: str, **changes: Any) -> str:
        scenario, _, variant = name.partition("/")
        return floor_kind(load(scenario, changes).setting(variant))

    assert kind("ningbo-metro/white") == kind("ningbo-metro/constant") == kind("moving-block/law-p") == "linear optimum"
    outliers = [{"kind": "outliers", "share": 0.1}]
    assert kind("ningbo-metro/gaussian", faults=outliers) == "floor without faults"
    assert kind("ningbo-metro/white", faults=outliers) == "linear optimum without faults"
    for none in ("ningbo-metro/switching", "ningbo-metro/physical", "cbtc-csma/uniform"):
        assert kind(none) == ""
    assert kind("ningbo-metro/gaussian", channel={"kind": "bernoulli", "p": 0.5, "silent": "hold"}) == ""
    assert kind("ningbo-metro/gaussian", channel={"kind": "try-once-discard", "nodes": [[0], [1]]}) == ""


def test_floor_takes_the_truth_not_what_is_told_and_closed_loops_their_own() -> None:
    plain = table("rap-example-2/printed", range(3), ("random-access",))
    misled = table("rap-example-2/printed", range(3), ("random-access",), **{"knowledge.R": [[9, 0], [0, 9]]})
    closed = table("moving-block/law-r", range(3), ("ekf", "dead-reckoning"))
    for column in floors(plain):
        assert plain[column].tolist() == misled[column].tolist()
        assert plain[column.replace("floor", "rmse")].tolist() != misled[column.replace("floor", "rmse")].tolist()
    first, second = (closed.loc[closed["estimator"] == label, floors(closed)].to_numpy()
                     for label in ("ekf", "dead-reckoning"))
    assert (first != second).all() and (first > 0).all()


def test_verdicts_and_tables_have_the_floor(railstate: Command) -> None:
    done = railstate("run", "rap-example-2/printed", "--runs", 25, "--jobs", 1, "--out", "out")
    assert done.code == 0
    store = Store("out")
    rows, lines = store.rows(), verdicts_of(store)
    errors = lines[lines["kind"] == "error"]
    assert set(errors["floor_kind"]) == {"floor"} and set(lines.loc[lines["kind"] == "yardstick", "floor_kind"]) <= {""}
    for line in errors.to_dict("records"):
        mine = rows[rows["estimator"] == line["estimator"]]
        least = np.sqrt((mine[f"floor:{line['quantity']}:1"] ** 2).mean())
        np.testing.assert_allclose([line["floor"], line["efficiency"]], [least, least / line["value"]], rtol=1e-12)
        each = mine[f"efficiency:{line['quantity']}:1"]
        np.testing.assert_allclose(each, mine[f"floor:{line['quantity']}:1"] / mine[f"rmse:{line['quantity']}:1"])
    curves = store.curves()
    x1 = curves[(curves["quantity"] == "x1") & (curves["estimator"] == "random-access")]
    least = rows.loc[rows["estimator"] == "random-access", "floor:x1:1"]
    assert x1["floor"].sum() / x1["active"].sum() == pytest.approx((least**2).mean())
    assert curves.loc[curves["quantity"] == "nees", "floor"].isna().all()
    assert railstate("plot", "out", "--figure", "error-over-time").code == 0
    summary = pd.read_csv("out/summary.csv")
    assert len(summary[summary["metric"].isin(["floor", "efficiency"])]) == 8
    assert "eff." in Path("out/tables/rap-example-2~printed.md").read_text()
