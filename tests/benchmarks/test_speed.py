"""`railstate timing`: both sides of every comparison do the same work; a peer that is not there is one message."""

from __future__ import annotations

import sys

import pytest
from railstate.benchmarks.speed import COMPARISONS, cars, cluster, metro, particles, race, robust, start

from ..conftest import Command

SMALL = {"metro": (metro, {"RUNS": (1, 12), "STEPS": 30}, 2e-8), "cars": (cars, {"RUNS": (1, 12), "STEPS": 25}, 1e-9),
         "robust": (robust, {"RUNS": 5, "STEPS": 10, "PEER_STEPS": 8}, 1e-5),
         "particles": (particles, {"RUNS": 4, "STEPS": 10, "PEER_STEPS": 10}, 1e-9)}


CONTESTS = {
    "metro": [f"{label} 2 {runs} {peer}" for label in ("ekf", "ukf", "ckf") for runs in (1, 12)
              for peer in ("filterpy", "written by hand")],
    "cars": [line for n in (4, 12) for line in (
        *(f"kalman {n} {runs} {peer}" for runs in (1, 12) for peer in ("filterpy", "simdkalman", "written by hand")),
        f"ukf {n} 12 written by hand", f"ckf {n} 12 written by hand")],
    "robust": [f"robust-{kind} 2 5 cvxpy, Clarabel" for kind in ("bounded", "mean-square", "ellipsoid")],
    "particles": [f"{label}, {form} 4 4 numpy loop over particles" for label in ("rbpf", "sma", "gsma")
                  for form in ("factorised", "full")]}


def test_every_comparison_is_tried() -> None:
    assert [*SMALL, "cluster"] == list(COMPARISONS)


@pytest.mark.parametrize("name", SMALL)
def test_the_two_sides_estimate_the_same(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    module, sizes, apart = SMALL[name]
    for constant, size in sizes.items():
        monkeypatch.setattr(module, constant, size)
    lines = race(name, 1)
    assert [" ".join(line[part] for part in ("estimator", "states", "runs", "peer")) for line in lines] == (
        CONTESTS[name])
    for line in lines:
        assert float(line["estimates differ by"]) < apart, line
        assert float(line["ns/run-step"]) > 0 and float(line["peer ns/run-step"]) > 0


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
    monkeypatch.setenv("COLUMNS", "120")
    lines = railstate("timing", "--only", "start", "--repeats", 1).out.splitlines()
    found = [line.split() for line in lines if line.startswith("railstate")]
    assert [" ".join(words[1:-1]) for words in found] == ["--version", *(
        f"run ningbo-metro/switching --estimators ekf --runs 4 --jobs {jobs}" for jobs in (1, 2))]
    assert all(float(words[-1]) > 0 for words in found)
    monkeypatch.setattr(start, "QUICK", (("--nothing",),))
    with pytest.raises(RuntimeError, match="No such option"):
        start.seconds(1)


@pytest.mark.long
def test_what_a_cluster_costs_is_measured(railstate: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "BLOCKS", (2,))
    lines = race("cluster", 1)
    assert [(line["workers"], line["runs a task"]) for line in lines] == [("1", "2"), ("2", "2")]
    assert all(0 < float(line["efficiency"]) < 1.5 for line in lines)
