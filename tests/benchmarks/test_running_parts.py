"""How rows are computed, its parts: options of a machine, measured times, what estimators remember; by hand.

Times come from scripts, so that every number of timing.csv is known."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import joblib
import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from railstate.benchmarks.isolation.process import Ended
from railstate.benchmarks.planning.plan import make_plan
from railstate.benchmarks.running import latency
from railstate.benchmarks.running.machinery import SHARE, Machinery, machinery
from railstate.benchmarks.running.result import OTHERS, Result, arrow_table, lost, sound
from railstate.estimators.interface import Status
from railstate.estimators.memento import Memento
from railstate.scenarios.errors import InputError


def test_a_machine_s_options(monkeypatch: pytest.MonkeyPatch) -> None:
    assert machinery(0) == Machinery(os.cpu_count() or 1, None, "", 900.0, 0)
    assert machinery(3, 5, "dask", "tcp://x:1", 7.0, 1.5) == Machinery(3, 5, "tcp://x:1", 7.0, 1_500_000_000)
    assert machinery(1, timeout=0.1).timeout == 0.1
    monkeypatch.setattr(os, "sysconf", {"SC_PHYS_PAGES": 1000, "SC_PAGE_SIZE": 4096}.__getitem__)
    assert [Machinery(jobs=jobs).allowed() for jobs in (0, 1, 4)] == [
        int(SHARE * 4_096_000), int(SHARE * 4_096_000), int(SHARE * 1_024_000)]
    assert Machinery(memory=5).allowed() == 5
    monkeypatch.setattr(os, "sysconf", {}.__getitem__)
    with pytest.raises(KeyError):
        Machinery().allowed()
    monkeypatch.delattr(os, "sysconf")
    assert (Machinery().allowed(), Machinery(memory=7).allowed()) == (0, 7)
    for given, said in (((1, -1), "--batch and --jobs: must be 0 (chosen) or more"),
                        ((-1,), "--batch and --jobs: must be 0 (chosen) or more"),
                        ((1, 0, "local", "", 0.0), "--timeout: must be more than 0 seconds"),
                        ((1, 0, "local", "", np.nan), "--timeout: must be more than 0 seconds"),
                        ((1, 0, "mpi"), "--backend mpi: unknown; allowed: local, dask"),
                        ((1, 0, "dask"), "--backend dask: needs --scheduler ADDRESS, such as tcp://host:8786"),
                        ((1, 0, "local", "tcp://x:1"), "--scheduler tcp://x:1: goes with --backend dask")):
        with pytest.raises(InputError) as caught:
            machinery(*given)
        assert str(caught.value) == said


def rows(**seconds: float) -> pd.DataFrame:
    return pd.DataFrame([{"scenario": "rap-example-1", "variant": "corrected", "estimator": label, "seconds": second,
                          "steps": steps, "status": "ok"} for label, second in seconds.items()
                         for steps in (100, 300, 0, np.nan)])


def test_what_timing_csv_says(monkeypatch: pytest.MonkeyPatch) -> None:
    plan = make_plan(["rap-example-1/corrected", "cbtc-csma/uniform"], only=["kalman", "random-access"], seed=7)
    asked = []

    def measure(cell: Any, label: str, seed: int) -> tuple[float, list[float]]:
        asked.append((cell.key, label, seed))
        return 0.25, [] if label == "random-access" else [1e-6 * k for k in range(1, 102)]

    monkeypatch.setattr(latency, "measure", measure)
    found = latency.timing_table(plan, rows(kalman=2e-3), Machinery(jobs=2))
    assert tuple(found) == latency.TIMING
    assert asked == [(cell.key, label, 7) for cell in plan.cells for label in cell.entries] and len(asked) < latency.FEW
    for line in found.to_dict("records"):
        kalman = line["estimator"] == "kalman"
        assert line["samples"] == (101 if kalman else 0) and line["design_s"] == 0.25
        assert line["latency_us_median"] == pytest.approx(51.0 if kalman else np.nan, nan_ok=True)
        assert line["latency_us_p99"] == pytest.approx(100.0 if kalman else np.nan, nan_ok=True)
        known = kalman and line["scenario"] == "rap-example-1"
        assert line["throughput_ns"] == pytest.approx(1e9 * 4e-3 / 400 if known else np.nan, nan_ok=True)
        assert line["sampling_period_s"] == {"rap-example-1": 1.0, "cbtc-csma": 0.1}[line["scenario"]]
    assert latency.timing_table(replace(plan, cells=()), pd.DataFrame(), Machinery()).empty
    assert latency._throughput(pd.DataFrame({"seconds": [1.0]})) == {}


def test_who_measures_what(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few estimators here, more by as many processes as there are jobs, in their order; a plug-in in a process of its
    own, where it ever finished a run."""
    pairs: list[Any] = [(f"cell {place}", f"label {place}") for place in range(9)]
    monkeypatch.setattr(latency, "measure", lambda *given: (given, []))
    begun = []

    class Parallel:
        def __init__(self, **words: Any) -> None:
            begun.append(words)

        def __call__(self, calls: Any) -> Any:
            return (function(*given) for function, given, _ in calls)

    monkeypatch.setattr(joblib, "Parallel", Parallel)
    for some, jobs, parallel in ((pairs, 1, False), (pairs[:8], 2, False), (pairs, 2, True)):
        begun.clear()
        assert [given for given, _ in latency._ours(some, 5, jobs)] == [(*pair, 5) for pair in some]
        assert begun == [{"n_jobs": 2, "backend": "loky", "return_as": "generator",
                          "pre_dispatch": "2*n_jobs"}] * parallel
    plan = make_plan(["rap-example-1/corrected"], only=["kalman"], seed=7)
    cell, asked = plan.cells[0], []

    def apart(answer: Any) -> Any:
        @contextmanager
        def process(plugin: str, timeout: float, memory: int) -> Iterator[Any]:
            asked.append((plugin, timeout, memory))
            yield SimpleNamespace(call=lambda *given: answer if given == (latency.measure, cell, "kalman", 7) else None)
        return SimpleNamespace(catalogue=SimpleNamespace(process=process), seed=7)

    how, told = Machinery(memory=9, timeout=3.0), rows(kalman=1.0, other=1.0)
    nothing = (pytest.approx(np.nan, nan_ok=True), [])
    for answer, found in (([0.5, [1, 2.5]], (0.5, [1.0, 2.5])), (Ended(Status.timeout, "hung"), nothing),
                          ([None, []], nothing), ([0.5, ["x"]], nothing)):
        for status in ("ok", "diverged", "failed"):
            one = told.assign(status=np.where(told["estimator"] == "kalman", status, "ok"))
            measured = latency._measured(apart(answer), cell, "kalman", one, how)
            assert measured == (nothing if status == "failed" else found)
    assert asked == [("kalman", 3.0, 9)] * 8
    for name in ("scenario", "variant"):
        assert latency._measured(apart([0.5, []]), cell, "kalman", told.assign(**{name: "another"}), how) == nothing
    assert len(asked) == 8


@pytest.mark.parametrize(("passes", "kept"), [
    ([[0.02] * 4, [0.02] * 4], 8), ([[0.03] * 2, [0.02] * 2, [0.02] * 1], 3), ([[0.022] * 2, [0.02] * 2, [0.02]], 5),
    ([[0.101]], 1), ([[0.1], [0.1]], 2), ([[0.01], []], 1), ([[]], 0), ([[1e-6] * 400, [1e-6] * 100], 500),
    ([[1e-6] * 499, [1e-6] * 3], 502), ([[2e-6] * 300, [1e-6] * 300, [1e-6] * 200], 500)])
def test_passes_until_they_agree_or_the_time_is_up(monkeypatch: pytest.MonkeyPatch, passes: list[list[float]],
                                                   kept: int) -> None:
    """A first pass slower than 1.1 times the second is left out; 500 samples or 0.1 s are enough; an empty one ends."""
    (cell,) = make_plan(["rap-example-1/corrected"], only=["kalman"]).cells
    given, limits = iter(passes), []

    def one(loop: Any, limit: float) -> list[float]:
        assert loop.own == 3 and loop.world.steps == 300
        limits.append(limit)
        return next(given)

    monkeypatch.setattr(latency, "_pass", one)
    monkeypatch.setattr(latency, "SECONDS", 0.1)
    monkeypatch.setattr(latency, "SAMPLES", 500)
    design, seconds = latency._timed(cell, "kalman", 1)
    assert design >= 0 and len(seconds) == kept and next(given, None) is None
    assert limits[0] == latency.SECONDS and limits[-1] == pytest.approx(latency.SECONDS - sum(map(sum, passes[:-1])))


@pytest.mark.parametrize(("steps", "cost", "limit", "count"), [
    (300, 1e-3, 10.0, 250), (255, 1e-3, 10.0, 250), (254, 1e-3, 10.0, 249), (5, 1e-3, 10.0, 0), (6, 1e-3, 10.0, 1),
    (300, 0.5, 2.0, 5), (300, 0.5, 1.9, 4)])
def test_a_pass_leaves_its_first_steps_out(monkeypatch: pytest.MonkeyPatch, steps: int, cost: float, limit: float,
                                           count: int) -> None:
    monkeypatch.setattr(latency, "STEPS", 250)
    loop = SimpleNamespace(world=SimpleNamespace(steps=steps), seconds=0.0)

    def step(k: int) -> str:
        loop.seconds += cost
        return "step"

    loop.step = step
    found = latency._pass(loop, limit)  # pyright: ignore[reportArgumentType]
    assert len(found) == count and np.allclose(found, cost)
    loop.step = lambda k: "step" if k < 7 else None
    assert latency._pass(loop, limit) == [0.0] * min(count, 2)  # pyright: ignore[reportArgumentType]


def test_a_memento_puts_back_all_that_an_estimator_changes() -> None:
    array, generator, fixed = np.arange(3.0), np.random.default_rng(1), np.arange(2.0)
    fixed.flags.writeable = False
    inner = SimpleNamespace(x=array, of=None, name="a")
    inner.of = inner
    thing = SimpleNamespace(inner=inner, view=array[1:], items=[array, {"k": [1]}], names={"s"},
                            table={"a": np.ones(1)}, pair=(np.zeros(2), [5]), frozen=frozenset({3}),
                            generator=generator, count=1, fixed=fixed, call=len)
    memento = Memento(thing)
    for _ in range(2):
        drawn = generator.random()
        array += 9.0
        thing.pair[0][:] = 4.0
        thing.pair[1].append(6)
        thing.items[1]["k"].append(2)
        thing.items.pop()
        thing.table["b"] = 1
        thing.table["a"][0] = 7.0
        thing.names.add("t")
        thing.count, thing.more, inner.name = 2, 3, "b"
        thing.inner = None
        memento.restore()
        assert generator.random() == drawn
        memento.restore()
        assert vars(thing).keys() == {"inner", "view", "items", "table", "names", "pair", "frozen", "generator",
                                      "count", "fixed", "call"}
        assert thing.inner is inner and inner.x is array and inner.name == "a" and thing.count == 1
        assert array.tolist() == [0.0, 1.0, 2.0] and thing.view.base is array and thing.view.tolist() == [1.0, 2.0]
        assert thing.items == [array, {"k": [1]}] and thing.names == {"s"}
        assert thing.pair[0].tolist() == [0.0, 0.0] and thing.pair[1] == [5]
        assert thing.table.keys() == {"a"} and thing.table["a"].tolist() == [1.0]


def test_what_a_process_sends_back_has_the_form_of_a_result() -> None:
    """Every way not to: columns that lack, are twice there or of another type, what is empty, what belongs to other
    runs, statuses nobody knows."""
    task: Any = SimpleNamespace(cell=SimpleNamespace(scenario="s", variant="v"), labels=("a", "b"), runs=(0, 1))
    rows = lost(task, Status.failed, "why").rows

    def table(name: str, estimator: str) -> pa.Table:
        return pa.table({key: pa.array([estimator if key == "estimator" else "sv"[key == "variant"]] if pa.types.
                                       is_string(kind) else [0], kind) for key, kind in OTHERS[name].items()})

    for found in ({"rows": rows}, {"rows": rows, "curves": None, "kept": table("kept", "b")},
                  {"rows": rows.append_column("rmse:x:", pa.array([None, 1.0, 2.0, 3.0]))},
                  {"rows": rows, "curves": table("curves", "")},
                  {"rows": rows.append_column("steps", pa.array([None, 1, 2, 3], pa.int32()))},
                  {"rows": rows.take([3, 1, 0, 2])}):
        assert sound(task, found) == Result(task, found["rows"], found.get("curves"), found.get("kept"))
    bad = [rows.append_column("steps", pa.array([1.0] * 4)), rows.append_column("note", pa.array([1.0] * 4)),
           rows.append_column("rmse:x:", pa.array([1] * 4)), rows.append_column("run", rows["run"]),
           rows.drop_columns("exception"), rows.slice(1), pa.concat_tables([rows, rows]), rows.to_pydict(), None,
           *(rows.set_column(k, rows.column_names[k], pa.array([None] * 4, rows.schema.field(k).type))
             for k in range(8)),
           *(rows.set_column(k, rows.column_names[k], pa.array(["else"] * 4)) for k in (0, 1, 2, 3, 4, 7))]
    others = [(name, damaged) for name in OTHERS for good in [table(name, "a")]
              for damaged in (good.slice(1).append_column("x", pa.nulls(0)).drop_columns("step"), good.to_pydict(),
                              table(name, "c"), good.append_column("step", good["step"]),
                              *(good.set_column(k, key, pa.nulls(1, good.schema.field(k).type))
                                for k, key in enumerate(good.column_names)),
                              *(good.set_column(good.column_names.index(key), key, pa.array(["else"]))
                                for key in ("scenario", "variant", "estimator", "time")))]
    assert [sound(task, found) for found in (None, [rows], {}, *({"rows": one} for one in bad),
                                             *({"rows": rows, name: one} for name, one in others))] == [None] * (
                                                 3 + len(bad) + len(others))


def test_every_status_may_come_back_in_one_task() -> None:
    task: Any = SimpleNamespace(cell=SimpleNamespace(scenario="s", variant="v"), labels=("a",),
                                runs=tuple(range(len(Status))))
    rows = lost(task, Status.failed, "why").rows
    rows = rows.set_column(rows.column_names.index("status"), "status", pa.array([status.name for status in Status]))
    assert sound(task, {"rows": rows}) == Result(task, rows, None, None)


def test_tables_are_those_of_pyarrow_s_own_arrays():
    columns = {"none": [], "same": ["Zürich"] * 3, "texts": ["", "Čapek", ""], "numbers": np.arange(6.0)[::2],
               "counts": np.array([3, -1, 2**31 - 1], dtype=np.int32), "unknown": pa.nulls(3, pa.int32()),
               "gaps": np.array([np.nan, np.inf, -0.0])}
    for name, values in columns.items():
        expected = pa.table({name: pa.array(values, pa.string()) if isinstance(values, list) else values})
        found = arrow_table({name: values})
        assert found.equals(expected) or (name == "gaps" and str(found) == str(expected)), name
