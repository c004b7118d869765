"""`railstate timing`: both sides of every comparison do the same work; a peer that is not there is one message."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from railstate.benchmarks import speed
from railstate.benchmarks.running.drive import drive
from railstate.benchmarks.running.machinery import Machinery
from railstate.benchmarks.speed import COMPARISONS, cars, cluster, measure, metro, particles, race, robust, start
from railstate.scenarios.railway.dynamics import Forces

from ..conftest import Command

SMALL = {"metro": (metro, {"RUNS": (1, 12), "STEPS": 30}, 2e-8), "cars": (cars, {"RUNS": (1, 12), "STEPS": 25}, 1e-9),
         "robust": (robust, {"RUNS": 5, "STEPS": 10, "PEER_STEPS": 8}, 1e-5),
         "particles": (particles, {"RUNS": 4, "STEPS": 10, "PEER_STEPS": 10}, 1e-9)}


class Clock:
    """Readings 1, 2, 3 .. ms apart."""

    def __init__(self) -> None:
        self.readings, self.now = 0, 0.0

    def __call__(self) -> float:
        self.readings += 1
        self.now += self.readings / 1000
        return self.now


def test_every_comparison_is_tried() -> None:
    assert [*SMALL, "cluster"] == list(COMPARISONS)


@pytest.mark.parametrize("name", SMALL)
def test_the_two_sides_estimate_the_same(name: str, monkeypatch: pytest.MonkeyPatch,
                                         expected: Callable[[str, str], None]) -> None:
    """And what is made of their times, by a clock of ours."""
    module, sizes, apart = SMALL[name]
    for constant, size in sizes.items():
        monkeypatch.setattr(module, constant, size)
    monkeypatch.setattr(measure, "perf_counter", Clock())
    clock = Clock()
    monkeypatch.setattr(measure, "drive", lambda *given: replace(drive(*given), seconds=clock()))
    lines = race(name, 1)
    for line in lines:
        assert float(line.pop("estimates differ by")) < apart, line
    expected(f"timing-{name}", pd.DataFrame(lines).to_string())


def test_a_plain_train_s_motion_and_its_slope() -> None:
    """With every constant of the law at work, by the formula; the Jacobian by differences."""
    q = Forces(1.1, 20.0, 0.2, 1e-3, -3e-5, 2e-7, 0.9, 15.0, 0.3, -2e-3, 4e-5, -1e-7, 0.02, 3e-4, 6e-6)
    train = metro.PlainMetro.__new__(metro.PlainMetro)
    train.forces, train.origin, train.cells, train.count = q, 100.0, 0.01, 2
    train.base, train.edge, train.jump = [0.0, 0.1, -0.2], [np.inf, 250.0, np.inf], [0.0, 0.05, 0.0]
    for s, climb in ((50.0, 0.0), (180.0, 0.0), (240.0, 0.1), (250.0, 0.15), (310.0, -0.2), (900.0, -0.2)):
        for v in (0.0, 3.0, 9.0, 16.0, 22.0):
            for u in (-0.8, 0.0, 0.6):
                V, top, c = 3.6 * v, q.brake if u < 0 else q.drive, q[7:12] if u < 0 else q[1:6]
                W = max(V, 0.1)
                left = min(max(c[0] / W + c[1] + c[2] * W + c[3] * W**2 + c[4] * W**3, 0.0), 1.0)
                a = u * top * left - (q.r0 + q.r1 * V + q.r2 * V**2) - climb
                np.testing.assert_allclose(train.f(np.array([s, v]), 0.4, u), [s + 0.4 * v + 0.08 * a, v + 0.4 * a],
                                           rtol=1e-12)
                if v:
                    ends = [train.f(np.array([s, v + h]), 0.4, u) for h in (-1e-5, 1e-5)]
                    F = train.F(np.array([s, v]), 0.4, u)
                    np.testing.assert_allclose(F[:, 1], (ends[1] - ends[0]) / 2e-5, rtol=1e-7)
                    assert F[:, 0].tolist() == [1.0, 0.0]


def test_times_are_minimums_and_ratios_of_one_process() -> None:
    def side(name: str, *seconds: float, count: int = 100, last: tuple[float, ...] = (1.0, 2.0)) -> measure.Side:
        given = iter(seconds)
        return measure.Side(name, lambda: (next(given), count, np.array([last, last])))

    ours, other = side("ekf", 0.1, 3.0, 2.0), side("peer", 9.0, 4.0, 5.0, count=50, last=(1.5,))
    row = {"estimator": "ekf", "states": "2", "runs": "7", "ns/run-step": "20000000"}
    (line,) = measure.contest(ours, 2, 7, [other], 2)
    assert line.row == {**row, "peer": "peer", "peer ns/run-step": "80000000", "times faster": "4.00",
                        "estimates differ by": "5.0e-01"}
    short, slow = side("ekf", 1.0, 1.0, last=(3.0,)), side("slow", 7.0, 8.0, count=10, last=(1.0,))
    (parts,) = measure.contest_of_parts(side("ekf", 0.1, 3.0, 2.0), short, slow, 2, 7, 2)
    assert parts.row == {**row, "peer": "slow", "peer ns/run-step": "800000000", "times faster": "40.0",
                         "estimates differ by": "2.0e+00"}
    several = [line._replace(mine=mine, theirs=theirs, faster=faster, apart=apart) for mine, theirs, faster, apart in (
        (9.994, 99.94, 3.0, 0.1), (9.996, 99.96, 1.0, 0.3), (10.0, 100.0, 2.0, 0.2))]
    assert measure.Line.least(several) == line._replace(mine=9.994, theirs=99.94, faster=2.0, apart=0.3)
    assert [(one.row["ns/run-step"], one.row["peer ns/run-step"]) for one in several] == [
        ("9.99", "99.9"), ("10.00", "100.0"), ("10.0", "100")]
    both = [cluster.Line(2, 100, 0.8, 0.5), cluster.Line(2, 100, 0.7, 0.6)]
    assert cluster.Line.least(both) == cluster.Line(2, 100, 0.7, 0.5)
    assert all(kind.least([one]) == one for kind, one in ((measure.Line, line), (cluster.Line, both[1])))
    assert both[0].row == {"workers": "2", "runs a task": "100", "work a task [ms]": "50.0",
                           "cost of a task [ms]": "12.5", "efficiency": "0.80"}


def test_a_peer_that_is_not_installed_is_one_message(railstate: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "simdkalman", None)
    monkeypatch.setattr(cars, "STEPS", 3)
    done = railstate("timing", "--only", "cars", "--repeats", 1, "--processes", 1)
    assert done.code == 2 and "its peer simdkalman is not installed" in done.err and "Traceback" not in done.err
    refused = railstate("timing", "--only", "horses")
    assert refused.code == 2 and "allowed: metro, cars, robust, particles, cluster, start" in refused.err


def test_how_long_commands_take(railstate: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whole commands, each in a process of its own; one that fails is no time."""
    assert start._taken(("--version",)) > 0
    with pytest.raises(RuntimeError, match=r"railstate --nothing: (.|\n)*No such option"):
        start._taken(("--nothing",))
    given = []

    def ran(program: list[str], cwd: str | None, env: dict[str, str], **_: Any) -> Any:
        assert program[:2] == [sys.executable, "-c"] and env.keys() >= os.environ.keys()
        fresh = {key: value for key, value in env.items() if os.environ.get(key) != value}
        given.append((program[3:], cwd, fresh))
        return SimpleNamespace(returncode=0)

    clock = Clock()
    monkeypatch.setattr(start, "perf_counter", lambda: 100 * clock())  # the n-th command takes n / 5 s
    monkeypatch.setattr(subprocess, "run", ran)
    monkeypatch.setenv("COLUMNS", "120")
    said = railstate("timing", "--only", "start", "--repeats", 2).out
    monkeypatch.undo()
    found = [line.rsplit(maxsplit=1) for line in said.splitlines() if line.startswith("railstate")]
    many = "railstate run ningbo-metro/switching --estimators ekf --runs 100000 --jobs"
    assert [" ".join(line.split()) for line, _ in found] == [
        "railstate --version", "railstate --help", "railstate list", *(
            f"railstate run {name} {what}" for name in ("rap-example-1", "ningbo-metro/switching")
            for what in ("nothing compiled", "again")), f"{many} 1", f"{many} 2"]
    assert [float(taken) for _, taken in found] == [0.2, 0.6, 1.0, 1.4, 1.6, 1.8, 2.0, 2.4, 2.6]
    assert [" ".join(line) for line, *_ in given] == [
        *("--version", "--version", "--help", "--help", "list", "list"), *(
            f"run {name} --out {what}" for name in ("rap-example-1", "ningbo-metro/switching")
            for what in ("nothing-compiled", "again")), *(
            f"run ningbo-metro/switching --estimators ekf --runs {more}" for more in (
                "20 --out compiled", "100000 --jobs 1 --out jobs-1", "100000 --jobs 2 --out jobs-2"))]
    rooms = [room for _, room, _ in given]
    assert rooms[:6] == [None] * 6 and rooms[6] == rooms[7] != rooms[8] == rooms[9] != rooms[10]
    assert len(set(rooms[10:])) == 1 and all(fresh == ({
        "NUMBA_CACHE_DIR": f"{room}/code", "RAILSTATE_CACHE": f"{room}/designs"} if 6 <= place < 10 else {})
        for place, (_, room, fresh) in enumerate(given))


def test_tasks_on_a_cluster_and_here_in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    """From the first result on, the least of the repetitions after the first, as if every task counted."""
    clusters, asked, clock = [], [], Clock()

    class Local:
        def __init__(self, **words: Any) -> None:
            clusters.append(words)
            self.scheduler_address = f"tcp://{words['n_workers']}"

        def __enter__(self) -> Local:
            return self

        def __exit__(self, *_: object) -> None:
            clusters.append({})

    def ran(plan: Any, done: Any, machinery: Any) -> Any:
        asked.append((plan.runs, [cell.key for cell in plan.cells], list(plan.cells[0].entries), done, machinery))
        yield from range(3)
        clock.readings += 1  # each repetition takes longer than the one before

    monkeypatch.setitem(sys.modules, "distributed", SimpleNamespace(LocalCluster=Local))
    monkeypatch.setattr(cluster, "run", ran)
    monkeypatch.setattr(cluster, "perf_counter", clock)
    lines = cluster.race(2)
    assert clusters == [found for n in (1, 2) for found in (
        {"n_workers": n, "threads_per_worker": 1, "dashboard_address": None}, {})]
    assert asked == [(16 * block, ["ningbo-metro/white"], ["ekf"], {}, Machinery(1, block, address))
                     for n in (1, 2) for block in (1, 100) for _ in range(3) for address in ("", f"tcp://{n}")]
    assert [(line.workers, line.block) for line in lines] == [(1, 1), (1, 100), (2, 1), (2, 100)]
    seconds = [(line.alone, line.there) for line in lines]  # by readings 7, 10, then 23, 26 .. of the clock
    assert seconds == [pytest.approx((n / 1000 * 16 / 15, (n + 3) / 1000 * 16 / 15)) for n in (7, 23, 39, 55)]


def test_processes_one_after_the_other_and_what_is_printed(railstate: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """The least of all; with one process it is this one."""
    given, made = [], iter((0.5, 0.25, 0.75, 0.125))

    class Pool:
        def __init__(self, workers: int, context: Any) -> None:
            given.append((workers, context.get_start_method()))

        def __enter__(self) -> Pool:
            return self

        def __exit__(self, *_: object) -> None:
            given.append("ended")

        def submit(self, function: Any, *words: Any) -> Any:
            return SimpleNamespace(result=lambda: function(*words))

    def raced(repeats: int) -> list[cluster.Line]:
        given.append(repeats)
        return [cluster.Line(1, 2, next(made), 1.0)]

    monkeypatch.setattr(speed, "ProcessPoolExecutor", Pool)
    monkeypatch.setattr(cluster, "race", raced)
    said = railstate("timing", "--only", "cluster", "--repeats", 7, "--processes", 3).out
    assert given == [(1, "spawn"), 7, "ended"] * 3
    assert said.startswith(f"cluster: {COMPARISONS['cluster']}\n")
    assert said.splitlines()[-2].split() == ["1", "2", "15.6", "46.9", "0.25"]
    assert race("cluster", 4)[0]["work a task [ms]"] == "7.8" and given[-1] == 4
    for words, message in ((("--repeats", 0), "--repeats: must be at least 1"),
                           (("--processes", 0), "--processes: must be at least 1")):
        done = railstate("timing", *words)
        assert done.code == 2 and message in done.err and done.out == ""


@pytest.mark.long
def test_what_a_cluster_costs_is_measured(railstate: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "BLOCKS", (2,))
    lines = race("cluster", 1)
    assert [(line["workers"], line["runs a task"]) for line in lines] == [("1", "2"), ("2", "2")]
    assert all(0 < float(line["efficiency"]) < 1.5 for line in lines)
