"""`railstate timing`: both sides of every comparison do the same work; a peer that is not there is one message."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from railstate.benchmarks.running.drive import drive
from railstate.benchmarks.speed import COMPARISONS, cars, cluster, measure, metro, particles, race, robust, start

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
    """What is measured of whole commands is what they are; one that fails is no time."""
    monkeypatch.setattr(start, "QUICK", (("--version",),))
    monkeypatch.setattr(start, "SETTINGS", ())
    monkeypatch.setattr(start, "RUNS", 4)
    monkeypatch.setattr(start, "perf_counter", Clock())
    monkeypatch.setenv("COLUMNS", "120")
    lines = railstate("timing", "--only", "start", "--repeats", 1).out.splitlines()
    found = [line.split() for line in lines if line.startswith("railstate")]
    assert [" ".join(words[1:-1]) for words in found] == ["--version", *(
        f"run ningbo-metro/switching --estimators ekf --runs 4 --jobs {jobs}" for jobs in (1, 2))]
    assert [words[-1] for words in found] == ["0.00", "0.01", "0.01"]
    monkeypatch.setattr(start, "QUICK", (("--nothing",),))
    with pytest.raises(RuntimeError, match="No such option"):
        start.seconds(1)


@pytest.mark.long
def test_what_a_cluster_costs_is_measured(railstate: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "BLOCKS", (2,))
    lines = race("cluster", 1)
    assert [(line["workers"], line["runs a task"]) for line in lines] == [("1", "2"), ("2", "2")]
    assert all(0 < float(line["efficiency"]) < 1.5 for line in lines)
