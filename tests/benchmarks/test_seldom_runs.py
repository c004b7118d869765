"""Runs that seldom go so: halved blocks, code of the suite's own that raises, losses of all, code that moved.

Worlds and processes are made by hand; what is computed is compared with the same computed the usual way."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
import threadpoolctl
from railstate.benchmarks import speed
from railstate.benchmarks.planning.plan import Plan, make_plan
from railstate.benchmarks.running import execute, isolated, latency
from railstate.benchmarks.running.loop import Loop, Observer
from railstate.benchmarks.running.machinery import Machinery
from railstate.benchmarks.running.result import lost
from railstate.benchmarks.store.folder import Store
from railstate.benchmarks.store.growth import _merged, grown
from railstate.benchmarks.store.manifest import description
from railstate.benchmarks.studies import complete, tune, verify
from railstate.estimators.interface import Estimate, Estimator, Innovation, Status
from railstate.estimators.kalman import Kalman
from railstate.scenarios.errors import InputError, Interrupted
from railstate.scenarios.world import Event, Step


@pytest.fixture(scope="module")
def plan() -> Plan:
    return make_plan(["rap-example-1/corrected"], only=["kalman", "rts"], runs=5, seed=3, overrides={"time.steps": 12})


def tables(plan: Plan, label: str) -> dict[str, pd.DataFrame]:
    """Rows, curves and kept runs of runs 0 to 4, whatever they take."""
    found = execute.execute_apart(plan.task(plan.cells[0], (label,), tuple(range(5))))
    return {name: table.to_pandas().drop(columns="seconds", errors="ignore") for name, table in found.items() if table}


def added(curves: pd.DataFrame) -> pd.DataFrame:
    keys = ["scenario", "variant", "estimator", "step", "time", "quantity"]
    return curves.groupby(keys, sort=True, observed=True).sum().reset_index()


def test_blocks_that_would_keep_too_much_are_halved(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    """Into single runs, or as far as needed; only who keeps much is."""
    usual, sizes = tables(plan, "rts"), list[int]()
    drive = execute.drive

    def watched(setting: Any, world: Any, *given: Any) -> Any:
        sizes.append(world.initial_mean.shape[1])
        return drive(setting, world, *given)

    monkeypatch.setattr(execute, "drive", watched)
    monkeypatch.setattr(execute, "_warm", type("All", (), {"__contains__": lambda *_: True})())
    nx = len(plan.cells[0].table["plant"]["A"])
    need = 8 * (4 * nx**2 + 3 * nx) * 12
    for room, wanted in ((0, [1] * 5), (2 * need, [2, 1, 2]), (2 * need - 1, [1] * 5), (5 * need, [5])):
        sizes.clear()
        monkeypatch.setattr(execute, "ROOM", room)
        found = tables(plan, "rts")
        assert sizes == wanted
        pd.testing.assert_frame_equal(found["rows"], usual["rows"], check_exact=True)
        pd.testing.assert_frame_equal(added(found["curves"]), added(usual["curves"]), rtol=1e-12)
    monkeypatch.setattr(execute, "ROOM", 0)
    sizes.clear()
    tables(plan, "kalman")
    assert sizes == [5]


def test_what_the_suite_s_own_raises_costs_its_run_and_bad_input_is_the_command_s(
        plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    usual, update, start = tables(plan, "kalman")["rows"], Kalman.update, Kalman.start
    raised: BaseException = ArithmeticError("run 3\ud800")

    def begun(self: Any, model: Any, runs: int, random: Any) -> None:
        start(self, model, runs, random)
        self.numbers = random.runs

    def odd(self: Any, measurement: Any) -> Any:
        if 3 in self.numbers and measurement.step > 4:
            raise raised
        return update(self, measurement)

    monkeypatch.setattr(Kalman, "start", begun)
    monkeypatch.setattr(Kalman, "update", odd)
    monkeypatch.setattr(execute, "TRACE", 60)
    found = tables(plan, "kalman")["rows"].set_index("run").sort_index()
    line = found.loc[3]
    assert (line["status"], line["reason"]) == ("failed", "ArithmeticError: run 3\\ud800")
    assert len(line["exception"]) == 60 + len("ud800") and line["exception"].endswith("ArithmeticError: run 3\\ud800\n")
    rest = usual.set_index("run").drop(index=3)
    pd.testing.assert_frame_equal(found.drop(index=3)[rest.columns], rest, check_exact=True, check_dtype=False)
    raised = InputError("no such thing")
    with pytest.raises(InputError, match=r"^no such thing$"):
        tables(plan, "kalman")


def test_input_that_a_process_refuses(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    """The suite's own: the command's error, from whatever thread; a plug-in's: its rows are lost."""
    task = plan.task(plan.cells[0], ("kalman",), (4,))

    class Process:
        ended = 0

        def call(self, *given: Any) -> Any:
            assert given == (execute.execute_apart, task)
            raise InputError("no file x")

        def close(self) -> None: ...

        def end(self) -> None:
            self.ended += 1

    process: Any = Process()
    with pytest.raises(InputError, match=r"^no file x$"):
        next(isolated._narrowed(task, process, isolated.Losses()))

    @contextmanager
    def isolation(*_: Any) -> Iterator[Any]:
        yield process

    monkeypatch.setattr(isolated, "isolation", isolation)
    with pytest.raises(InputError, match=r"^no file x$"):
        list(isolated.isolated([task], Machinery(2), isolated.Losses()))
    assert process.ended == 1
    monkeypatch.setattr(isolated, "estimators", dict)
    (found,) = isolated._narrowed(task, process, isolated.Losses())
    assert found.rows.equals(lost(task, Status.failed, "no file x").rows)


def test_what_is_timed_and_computed_has_one_thread(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    told = list[int]()

    def limits(threads: int) -> Any:
        told.append(threads)
        raise InputError("no more")

    monkeypatch.setattr(threadpoolctl, "threadpool_limits", limits)
    for call in (lambda: speed._lines("metro", 1), lambda: latency.measure(plan.cells[0], "kalman", 1),
                 lambda: execute.execute(plan.task(plan.cells[0], ("kalman",), (0,)))):
        with pytest.raises(InputError, match=r"^no more$"):
            call()
    assert told == [1, 1, 1]


class World:
    """Two runs of three steps, each of two events of half a step; the second reading is faulty in a run."""

    steps, closed_loop, initial_mean = 3, True, np.zeros((1, 2))

    def __init__(self) -> None:
        self.told = list[list[float]]()

    def step(self, k: int, mean: np.ndarray) -> Step:
        self.told.append(mean[0].tolist())
        faulty = (None, np.array([[False, True]]))
        return Step(np.zeros((0, 2)), tuple(Event(0.5, np.ones((1, 2)), np.array([[True, k > 0]]), faulty=faulty[n])
                                            for n in (0, 1)), np.zeros((1, 2)), np.ones(2, dtype=bool), number=k,
                    start=float(k), length=1.0)


class Counts(Estimator):
    """A state that a prediction raises by 1 and a reading by 100."""

    def start(self, *_: Any) -> None:
        self.x = np.zeros((1, 2))

    def predict(self, u: Any, interval: Any) -> None:
        self.x = self.x + 1.0

    def update(self, measurement: Any) -> Innovation | None:
        self.x = self.x + 100.0 * measurement.received
        return None

    def estimate(self) -> Estimate:
        return Estimate(self.x)


@pytest.mark.parametrize("faults", [False, True])
@pytest.mark.parametrize("early", [False, True])
@pytest.mark.parametrize("late", [False, True])
def test_a_closed_loop_is_told_the_estimate_after_all_measurements(early: bool, late: bool, faults: bool) -> None:
    """Whatever is looked at; who is told of faults gets no faulty reading."""
    class Watch(Observer):
        predicted_wanted, updated_wanted = early, late
        seen = list[Any]()

        def predicted(self, step: Step, event: int, estimate: Estimate) -> None:
            self.seen.append(("before", step.number, event, estimate.mean[0].tolist()))

        def updated(self, step: Step, event: int, estimate: Estimate) -> None:
            self.seen.append(("after", step.number, event, estimate.mean[0].tolist()))

    estimator, world, watch = Counts(), World(), Watch()
    watch.seen = []
    estimator.told_faults = faults
    estimator.start()
    loop = Loop(world, estimator, watch)  # type: ignore[arg-type]
    assert len(list(loop.steps())) == 3
    x, told, seen = np.zeros(2), [[0.0, 0.0]], list[Any]()
    for k in range(3):
        for event in (0, 1):
            x = x + 1
            if early and event:
                seen.append(("before", k, event, x.tolist()))
            x = x + 100.0 * np.array([True, k > 0 and not (faults and event)])
            if late and event:
                seen.append(("after", k, event, x.tolist()))
        told.append(x.tolist())
    assert watch.seen == seen and world.told == told[:3] and loop.mean[0].tolist() == told[3]


def test_tuning_where_every_run_is_lost(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    cell = plan.cells[0]
    scenario: Any = SimpleNamespace(variants={"corrected": cell.table}, where="here", setting=lambda variant: (
        SimpleNamespace(split=lambda training: {}, resolve_knowledge=lambda told: SimpleNamespace(
            model_dump_json=lambda: "{}"))))
    task = tune.Task(scenario, "rap-example-1", "corrected", "kalman", {"time.steps": 12}, (
        ("rmse", "x1"), ("nees", "state")), 4, 1, Machinery(1), plan.catalogue, limit=1234.5)
    assert task.entry("ukf") == {"plugin": "ukf"} and task.entry("kalman") == {
        key: value for key, value in cell.table["estimators"]["kalman"].items() if key != "tuned"}
    with pytest.raises(InputError) as caught:
        task.entry("nobody")
    assert str(caught.value) == (f"--estimator nobody: no such estimator in here; allowed: "
                                 f"{', '.join(cell.table['estimators'])}, or the name of an installed estimator")
    monkeypatch.setattr(tune, "run", lambda given, kept, how: [SimpleNamespace(rows=lost(
        given.task(given.cells[0], ("kalman",), tuple(range(given.runs))), Status.infeasible, "no").rows)])
    found = task.score({"plugin": "kalman"}, training=True)
    assert (found.loss, found.lost) == (np.inf, 4) and np.isnan([*found.values, *found.sds]).all()
    assert len(found.values) == len(found.sds) == 2 and np.isnan(found.pulls).tolist() == [True]
    monkeypatch.setattr(tune, "search", lambda axes, loss, budget: SimpleNamespace(
        loss=loss({})[0], losses=[np.inf] * 7, broken=[-1.0]))
    with pytest.raises(InputError) as caught:
        tune.tune(task, [], 7)
    assert str(caught.value) == ("--over: all 7 evaluations of kalman ended infeasible, lost or over 1.23e+03 s; other "
                                 "limits may do")


def test_why_runs_were_enough_is_kept_where_a_cell_has_the_same_runs_and_entries() -> None:
    """Else it is gone; what is told anew counts, and other variants keep all."""
    def manifest(runs: int, labels: str, **facts: Any) -> dict[str, Any]:
        entries = {label: {"plugin": label} for label in labels}
        variants = {"v": {"title": "calm", **facts}}
        return {"configuration": {"runs": runs, "seed": 1, "cells": {"s/v": {"runs": runs, "estimators": entries}}},
                "scenarios": {"s": {"title": "t", "variants": variants}}, "estimators": entries, "replay": {
                    "plugins": [labels], "cells": {"s/v": {"where": "s", "entries": entries}}}}

    before = manifest(5, "ab", until="rmse", level=0.95, odd=1)
    before["scenarios"]["s"]["variants"]["w"] = {"title": "rough", "until": "x"}
    before["scenarios"]["z"] = {"variants": {}}

    def merged(now: dict[str, Any], stale: Any = ()) -> Any:
        return _merged(before, now, dict.fromkeys(stale, ""))

    told = {"until": "rmse", "level": 0.95}
    for now, stale, kept in ((manifest(5, "ab"), (), told), (manifest(5, "a"), (), told), (manifest(6, "ab"), (), {}),
                             (manifest(5, "abc"), (), {}), (manifest(5, "a"), [("s/v", "b")], {}),
                             (manifest(5, "ba", level=0.9), (), {**told, "level": 0.9})):
        found = merged(now, stale)
        assert found["scenarios"] == {"s": {"title": "t", "variants": {
            "v": {"title": "calm", **kept}, "w": {"title": "rough", "until": "x"}}}, "z": {"variants": {}}}
        labels = [*dict.fromkeys([*("a" if stale else "ab"), *now["estimators"]])]
        assert list(found["configuration"]["cells"]["s/v"]["estimators"]) == labels
        assert list(found["replay"]["cells"]["s/v"]["entries"]) == labels
        assert found["configuration"]["runs"] == now["configuration"]["runs"] and found["replay"]["plugins"] == list(
            dict.fromkeys(["ab", *now["replay"]["plugins"]]))
    new = manifest(3, "a")
    new["configuration"]["cells"] = {"s/n": new["configuration"]["cells"]["s/v"]}
    new["replay"]["cells"] = {"s/n": new["replay"]["cells"]["s/v"]}
    new["scenarios"]["s"]["variants"] = {"n": {"title": "new"}}
    found = merged(new)
    assert found["configuration"]["runs"] == 5 and list(found["configuration"]["cells"]) == ["s/v", "s/n"]
    assert list(found["scenarios"]["s"]["variants"]) == ["v", "w", "n"]


def test_rows_of_other_code_cannot_be_computed_anew(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    """The setting's, the scoring's, an estimator's; another scenario, one that is none here, a plug-in without file."""
    def said(change: Any = None) -> list[tuple[str, str, str]]:
        manifest = {"configuration": json.loads(json.dumps(plan.configuration(), default=str))}
        cell = manifest["configuration"]["cells"]["rap-example-1/corrected"]
        if change:
            change(cell)
        return list(verify._unknown(plan, manifest))

    def each(why: str) -> list[tuple[str, str, str]]:
        return [("rap-example-1/corrected", label, why) for label in ("kalman", "rts")]

    assert said() == []
    assert said(lambda cell: cell.update(setting="x")) == each("other code of the setting here")
    assert said(lambda cell: cell.update(setting="x", scoring="y", scenario="z")) == each(
        "other code of the setting and the scoring here")
    assert said(lambda cell: cell.update(scenario="z")) == each(verify.OTHER)
    assert said(lambda cell: cell["estimators"]["rts"].update(source="z")) == each("other code of rts here")[1:]
    monkeypatch.setattr(plan.catalogue, "names", lambda: ["kalman"])
    assert said() == [("rap-example-1/corrected", "rts", "rts is not known here: give its file with --plugin")]
    manifest = {"configuration": plan.configuration()}

    def none(self: Plan) -> Any:
        raise InputError("no line\nat all")

    monkeypatch.setattr(Plan, "configuration", none)
    assert list(verify._unknown(plan, manifest)) == [
        ("rap-example-1/corrected", "rts", "rts is not known here: give its file with --plugin"),
        ("rap-example-1/corrected", "kalman", "its scenario is not one here: no line")]


def test_a_folder_whose_code_moved_or_that_cannot_be_written(plan: Plan, tmp_path: Path,
                                                             monkeypatch: pytest.MonkeyPatch) -> None:
    store = Store(tmp_path / "out")
    monkeypatch.setattr(Store, "writable", False)
    with pytest.raises(InputError) as caught:
        complete.complete(plan, store.folder, Machinery(1), "c")
    assert str(caught.value) == f"{store.folder}: cannot be written; choose another --out"
    monkeypatch.setattr(Store, "writable", True)
    stored = json.loads(json.dumps(plan.configuration(), default=str))
    store.folder.mkdir()
    store.open(stored, description(plan), "railstate run")
    text = (store.folder / "manifest.json").read_text()
    assert grown(store, plan).stale == {} and text == json.dumps(json.loads(text), indent=1)
    for moved, words in ((("scoring",), "scoring"), (("setting", "scoring"), "setting and the scoring")):
        for name in moved:
            stored["cells"]["rap-example-1/corrected"][name] = "other"
        store.open(stored, description(plan), "railstate run")
        assert grown(store, plan).stale == {("rap-example-1/corrected", label): f"the code of the {words} changed"
                                            for label in ("kalman", "rts")}

    def pressed(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(complete, "_fill", pressed)
    monkeypatch.setattr(Store, "done", lambda self: {("a", "b"): {1, 2}, ("a", "c"): {3}})
    with pytest.raises(Interrupted) as ended:
        complete.complete(plan, store.folder, Machinery(1), "c")
    assert str(ended.value) == (f"interrupted: 3 rows are in {store.folder}; the same command continues "
                                f"(add --out {store.folder})")


@pytest.mark.parametrize(("number", "more"), [(5, ""), (7, " and 2 more")])
def test_five_of_what_is_computed_anew_are_named(number: int, more: str) -> None:
    growth = SimpleNamespace(plan=SimpleNamespace(cells=()), stale={("s", f"e{i}"): "it moved" for i in range(number)})
    with pytest.warns(UserWarning) as said:
        complete._drop(SimpleNamespace(folder="f", drop=len), growth, ())  # pyright: ignore
    assert str(said[0].message) == f"f: it moved, computed anew: s/e0, s/e1, s/e2, s/e3, s/e4{more}"
