"""What the speed comparisons hand to each other: sides with their runs and steps, peers, processes; nothing is timed.

Whoever would measure writes down what it was given."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from railstate.benchmarks import speed
from railstate.benchmarks.commands.timing import timing
from railstate.benchmarks.speed import cars, cluster, measure, metro, particles, robust, start
from railstate.benchmarks.speed.measure import Side
from railstate.scenarios.errors import InputError
from railstate.scenarios.randomness import Streams


@pytest.fixture(autouse=True)
def nothing_is_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A side of ours says what it is of, a line what it was asked for."""
    for module in (cars, metro, particles, robust):
        monkeypatch.setattr(module, "ours", lambda cell, label, *size: Side(
            label, (cell.key, cell.entries[label].plugin, cell.entries[label].parameters, *size)))
        for name in {"contest", "contest_of_parts"} & vars(module).keys():
            monkeypatch.setattr(module, name, lambda *given: [given])


def test_robust_estimators_against_their_convex_form() -> None:
    found: list[Any] = robust.race(7)
    assert [mine.name for mine, *_ in found] == ["robust-bounded", "robust-mean-square", "robust-ellipsoid"]
    for mine, short, slow, *rest in found:
        setting, plugin, given, *size = mine.run
        assert (setting, size, rest) == ("ningbo-metro/switching", [100, 200], [2, 100, 7])
        assert plugin == mine.name and given.get("solver") != "cvxpy"
        assert short == Side(mine.name, (setting, plugin, given, 1, 40))  # pyright: ignore[reportArgumentType]
        convex = (setting, plugin, {**given, "solver": "cvxpy"}, 1, 40)
        assert slow == Side("cvxpy, Clarabel", convex)  # pyright: ignore[reportArgumentType]


def test_particle_filters_against_a_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """In both forms, the loop on the first run and with the filter's own stream."""
    asked = list[Any]()

    def loop(estimator: Any, model: Any, u: Any, y: Any, random: Any) -> Any:
        asked.append((estimator, model, u, y, random.normal(3)))
        return np.arange(12.0).reshape(6, 2), None, None

    monkeypatch.setattr(particles, "particle_loop", loop)
    found: list[Any] = particles.race(7)
    assert [mine.name for mine, *_ in found] == [f"{label}, {form}" for label in ("rbpf", "sma", "gsma")
                                                 for form in ("factorised", "full")]
    for mine, short, slow, *rest in found[::2]:
        label = mine.name.partition(",")[0]
        cell = measure.cell_of("braking-rate/paper", label)
        entry, world = cell.entries[label], measure.recorded(cell, 1)
        form = {**entry.parameters, "form": "factorised"}
        assert mine.run == (cell.key, entry.plugin, form, 200, 150) and rest == [4, 200, 7]
        assert short == Side(label, (cell.key, entry.plugin, form, 1, 30))  # pyright: ignore[reportArgumentType]
        seconds, count, last = slow.run()
        assert slow.name == "numpy loop over particles" and (seconds >= 0, count, last.tolist()) == (
            True, 30, [10.0, 11.0])
        estimator, model, u, y, drawn = asked.pop()
        assert type(estimator).summary and estimator.parameters == type(estimator)(entry.parameters).parameters
        np.testing.assert_array_equal(u, world.u[:30, :, 0])
        np.testing.assert_array_equal(y, world.y[:30, :, 0])
        assert model.initial_mean.shape[1] == 1
        streams = Streams(1, cell.scenario, cell.variant, (0,))
        np.testing.assert_array_equal(drawn, streams("estimator", label).normal(3))
    full = [mine.run[2]["form"] for mine, *_ in found]
    assert full == ["factorised", "full"] * 3 and [short.run[2]["form"] for _, short, *_ in found] == full


def test_filters_against_filterpy_and_by_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each number of runs against each peer; filterpy on three runs of the metro at the most."""
    def cell_of(name: str, label: str, overrides: Any = None, plugin: str = "") -> Any:
        linear = SimpleNamespace(**{part: lambda k, part=part: [[k, ord(part)]] for part in "ABhCQR"})
        model = SimpleNamespace(linear=linear, initial_covariance=np.arange(8).reshape(2, 2, 2))
        return SimpleNamespace(
            key=name, entries={label: SimpleNamespace(plugin=plugin, parameters=overrides, knowledge="known")},
            setting=lambda: SimpleNamespace(design_model=lambda *given: given == ("known", "mean") and model))

    for module in (cars, metro):
        monkeypatch.setattr(module, "cell_of", cell_of)
        monkeypatch.setattr(module, "recorded", lambda cell, runs: SimpleNamespace(initial_mean="mean", runs=runs))
        monkeypatch.setattr(module, "peer", lambda name, loop: (name, loop))
    for name in ("_Loop", "_ByHand"):
        monkeypatch.setattr(metro, name, lambda cell, *given, name=name: SimpleNamespace(run=(name, cell.key, *given)))
    for name in ("_filterpy", "_simdkalman", "_by_hand"):
        monkeypatch.setattr(cars, name, lambda world, matrices, P0, name=name: (
            name, world.runs, [part.tolist() for part in matrices], P0.tolist()))
    key = "ningbo-metro/white"
    found: list[Any] = metro.race(7)
    assert [(mine.name, *mine.run, *rest) for mine, *rest in found] == [
        (label, key, "", None, runs, 200, 2, runs, [("filterpy", ("_Loop", key, label, few)), (
            "written by hand", ("_ByHand", key, label, runs))], 7)
        for label in ("ekf", "ukf", "ckf") for runs, few in ((1, 1), (100, 3), (1000, 3))]
    found = cars.race(7)
    every = {"filterpy": "_filterpy", "simdkalman": "_simdkalman", "written by hand": "_by_hand"}
    assert [(mine.name, *mine.run, *rest) for mine, *rest in found] == [
        (plugin, "cbtc-csma/uniform", plugin, {"time.steps": 201, "plant.cars": states // 2}, runs, 200, states, runs,
         [(name, (every[name], runs, [[[0, ord(part)]] for part in "ABhCQR"], [[0, 2], [4, 6]])) for name in peers], 7)
        for states in (4, 12) for plugin, runs, peers in (
            *(("kalman", runs, every) for runs in (1, 100, 1000)),
            *((other, 1000, ["written by hand"]) for other in ("ukf", "ckf")))]


def test_processes_whose_lines_do_not_match(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each on one thread; lines of several processes are paired, or it is an error."""
    limits, lines = list[Any](), iter([[cluster.Line(1, 2, 0.5, 1.0)] * n for n in (1, 2)])

    class Limit:
        def __init__(self, *given: Any) -> None:
            limits.append(given)

        def __enter__(self) -> None:
            limits.append("begun")

        def __exit__(self, *_: object) -> None:
            limits.append("ended")

    class Pool(Limit):
        def __enter__(self) -> Any:
            return SimpleNamespace(submit=lambda function, *words: SimpleNamespace(result=lambda: function(*words)))

    monkeypatch.setattr("threadpoolctl.threadpool_limits", Limit)
    monkeypatch.setattr(speed, "ProcessPoolExecutor", Pool)
    monkeypatch.setattr(cluster, "race", lambda repeats: next(lines))
    with pytest.raises(ValueError, match="longer"):
        speed.race("cluster", 3, 2)
    assert [limit for limit in limits if limit in ((1,), "begun")] == [(1,), "begun"] * 2


def test_at_least_one_of_all(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    asked = list[Any]()
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setattr(speed, "race", lambda *given: asked.append(given) or [{"what": "it"}])
    for words, said in (({"repeats": 0}, "--repeats: must be at least 1"), ({"repeats": -1}, "--repeats: must be at "
                        "least 1"), ({"processes": 0}, "--processes: must be at least 1"), ({"only": "a,robust,b"},
                        "--only a,b: no such comparison; allowed: metro, cars, robust, particles, cluster, start")):
        with pytest.raises(InputError) as caught:
            timing(**words)
        assert str(caught.value) == said and asked == [] and capsys.readouterr().out == ""
    timing("robust", 1, 1)
    timing()
    assert asked == [("robust", 1, 1), *((name, 5, 3) for name in ("metro", "cars", "robust", "particles", "cluster"))]
    said = capsys.readouterr().out
    assert all(said.count(f"{name}: {what}\n") == 1 + (name == "robust") for name, what in speed.COMPARISONS.items())


def test_a_command_that_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(start.subprocess, "run", lambda *_, **how: SimpleNamespace(
        returncode=1, stderr="why\n" if how["text"] and how["capture_output"] else b"why\n"))
    with pytest.raises(RuntimeError) as caught:
        start._taken(("list", "--all"))
    assert str(caught.value) == "railstate list --all: why\n"
