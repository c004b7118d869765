"""What commands pass on of their options, each given and left out; what of it is told a cluster or fresh processes.

Nothing is run: whoever would run it writes down what it was told."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from importlib import import_module
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import distributed
import numpy as np
import pandas as pd
import pytest
from railstate.benchmarks import speed
from railstate.benchmarks.api import runs as api
from railstate.benchmarks.commands.options import files, meaning
from railstate.benchmarks.published import reproduce as published
from railstate.benchmarks.published.files import papers
from railstate.benchmarks.running.machinery import Machinery, machinery
from railstate.benchmarks.speed import cluster
from railstate.benchmarks.speed.measure import Line
from railstate.scenarios.errors import InputError

from ..conftest import Command
from .test_reproduce import Asked

reproducing = import_module("railstate.benchmarks.commands.reproduce")
SLOW = ("--timeout", 5, "--memory", 2.5)
SPREAD = ("--jobs", 3, "--batch", 7, "--backend", "dask", "--scheduler", "tcp://x:1", *SLOW)
OURS = Machinery(3, 7, "tcp://x:1", 5.0, 2_500_000_000)
TUNE = ("tune", "cart.toml/calm", "--estimator", "ukf", "--over", "parameters.alpha=0.5..1", "--objective",
        "rmse:position")


@pytest.mark.parametrize(("words", "module", "options", "jobs"), [
    (("run", "cart.toml/calm"), "api.runs", SPREAD, 0), (("reproduce",), "commands.reproduce", SPREAD, 0),
    (("sweep", "rap-example-1", "--over", "time.steps=20", "-e", "kalman"), "commands.sweep", SPREAD, 0),
    (TUNE, "commands.tune", SPREAD, 0), (("verify", "A"), "commands.verify", ("--jobs", 3, *SLOW), 0),
    (("check", "kalman"), "commands.check", SLOW, 1),
    (("replay", "rap-example-1/corrected/kalman/1"), "commands.replay", SLOW, 1)])
def test_how_to_run(words: tuple[str, ...], module: str, options: tuple[Any, ...], jobs: int, railstate: Command,
                    monkeypatch: pytest.MonkeyPatch) -> None:
    found = []

    def told(*given: Any, **named: Any) -> Any:
        found.append(machinery(*given, **named))
        raise InputError("no more")

    monkeypatch.setattr(import_module(f"railstate.benchmarks.{module}"), "machinery", told)
    for more in ((), options):
        assert railstate(*words, *more).err == "error: no more\n"
    ours = OURS if options is SPREAD else Machinery(jobs or 3, timeout=5.0, memory=2_500_000_000)
    usual = 300.0 if words[0] == "check" else 900.0
    assert found == [machinery(jobs, timeout=usual), ours]


def test_what_run_is_told(railstate: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    told = list[Any]()

    def run(*given: Any, **named: Any) -> Any:
        told.append((given, named))
        return SimpleNamespace(store=len(told))

    monkeypatch.setattr(api, "run", run)
    shown = list[Any]()
    for name in ("print_results", "print_results_json"):
        monkeypatch.setattr(import_module("railstate.benchmarks.commands.run"), name,
                            lambda store, name=name: shown.append((name, store)))
    usual = {"runs": 100, "seed": 1, "jobs": 0, "folder": "", "overrides": {}, "plugins": [], "keep": 1, "until": "",
             "retry": [], "overwrite": False, "batch": 0, "backend": "local", "scheduler": "", "timeout": 900.0,
             "memory": 0.0, "quiet": False, "command": "railstate run"}
    words = ("a", "b/c", "-e", "x,y", "-n", 7, "--seed", 3, "--out", "o", "--set", "p.q=2", "--plugin", "half.py",
             "--keep", 5, "--until", "decided", "--retry", "failed,diverged", "--overwrite", "--missing", "-9,NA",
             "--without", "1..2.5", "--to", 8, *SPREAD)
    for more in ((), words, ("-q",), ("--json",)):
        assert railstate("run", *more).code == 0
    assert told == [
        (((), None), usual),
        ((["a", "b/c"], ["x", "y"]), {
            **usual, "runs": 7, "seed": 3, "folder": "o", "plugins": ["half.py"], "keep": 5, "until": "decided",
            "overrides": {"p.q": 2, "plant.missing": [-9, "NA"], "plant.span": [0.0, 8.0],
                          "plant.without": [[1.0, 2.5]]},
            "retry": ["failed", "diverged"], "overwrite": True, "jobs": 3, "batch": 7, "backend": "dask",
            "scheduler": "tcp://x:1", "timeout": 5.0, "memory": 2.5,
            "command": " ".join(map(str, ("railstate", "run", *words)))}),
        (((), None), {**usual, "quiet": True, "command": "railstate run -q"}),
        (((), None), {**usual, "quiet": True, "command": "railstate run --json"})]
    assert shown == [("print_results", 1), ("print_results", 2), ("print_results_json", 4)]


def test_what_tune_is_told(railstate: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """All of a task, and how many evaluations: 30 for each number, 100 at the most, or as many as are asked for."""
    told = list[Any]()

    def tune(task: Any, axes: Any, budget: int) -> Any:
        told.append((task, [axis.keys for axis in axes], budget))
        raise InputError("no more")

    monkeypatch.setattr(import_module("railstate.benchmarks.commands.tune"), "tune", tune)
    keys = [f"parameters.{name}" for name in ("alpha", "beta", "kappa", "x")]
    for many, more, budget in ((1, (), 30), (3, (), 90), (4, (), 100), (1, ("--budget", 120), 120)):
        words = ",".join(f"{key}=0.5..1" for key in keys[:many])
        assert railstate("tune", "cart.toml", "--estimator", "ukf", "--over", words, "--objective", "rmse:speed",
                         *more).err == "error: no more\n"
        task, axes, allowed = told.pop()
        assert axes == [(key,) for key in keys[:many]] and allowed == budget
        assert (task.name, task.variant, task.label, task.fixed, task.objective) == (
            "cart.toml", "calm", "ukf", {}, (("rmse", "speed"),))
        assert (task.runs, task.seed, task.subject_to, task.beside, task.limit) == (100, 1, (), (), 0.0)
    assert railstate(*TUNE, "--objective", "rmse:position,mae:speed", "--runs", 7, "--seed", 3, "--subject-to",
                     "nees:state=0.8..1.25", "--beside", "kalman,ekf", "--limit", 2.5, "--set",
                     "channel.p=0.5").err == "error: no more\n"
    task, _, _ = told.pop()
    assert (task.name, task.variant, task.fixed, task.runs, task.seed, task.limit, task.beside) == (
        "cart.toml", "calm", {"channel.p": 0.5}, 7, 3, 2.5, ("kalman", "ekf"))
    assert [(one.metric, one.quantity, one.low, one.high) for one in task.subject_to] == [("nees", "state", 0.8, 1.25)]
    assert task.objective == (("rmse", "position"), ("mae", "speed"))


def test_what_a_recording_means(railstate: Command) -> None:
    none = ("", "", "", "", "", None, None, [])
    place = str(Path("cart.toml").resolve())
    assert meaning(*none) == {} == files("", "", [])
    assert meaning("time=t,speed=-v [km/h]", "good=0.5,lost=missing", "-9, NA", "cart.toml", "cart.toml", 3.0, None,
                   ["1..2", "5..6.5"]) == {
        "plant.map": {"time": "t", "speed": "-v [km/h]"}, "plant.quality": {"good": 0.5, "lost": "missing"},
        "plant.missing": [-9, "NA"], "plant.track": place, "plant.balises": place, "plant.span": [3.0, 1e12],
        "plant.without": [[1.0, 2.0], [5.0, 6.5]]}
    assert meaning(*none[:5], None, 9.0, []) == {"plant.span": [0.0, 9.0]}
    assert files("cart.toml", "cart.toml", ["half.py"]) == {
        "plant.line": place, "plant.train": place, "plant.recording": str(Path("half.py").resolve())}
    assert files("", "", ["half.py", "cart.toml"]) == {"plant.recording": [str(Path("half.py").resolve()), place]}


@pytest.mark.parametrize(("words", "runs", "seed", "place"), [
    ((), 400, 1, "published"), (("--runs", 2), 2, 1, "reproduction"), (("--seed", 2), 400, 2, "reproduction"),
    (("faruqi2019", "zou-rap"), 400, 1, "reproduction"), (("faruqi2019", "--json", "--rows", "R"), 400, 1, "")])
def test_what_is_reproduced(words: tuple[Any, ...], runs: int, seed: int, place: str, railstate: Command,
                            monkeypatch: pytest.MonkeyPatch) -> None:
    told, names = list[Any](), [word for word in words if word in ("faruqi2019", "zou-rap")]
    some = papers(["faruqi2019"])
    done = published.reproduce
    monkeypatch.setattr(published, "Book", lambda rows: Asked())
    monkeypatch.setattr(published, "plan_for", lambda chosen, *given: told.append((
        [one.name for one in chosen], *given)) or SimpleNamespace(cells=[1]))
    monkeypatch.setattr(published, "reproduce", lambda chosen, rows: told.append(rows) or done(some, pd.DataFrame()))
    monkeypatch.setattr(reproducing, "default_folder", lambda plan: Path("usual"))
    monkeypatch.setattr(reproducing, "complete", lambda plan, folder, how, command, timing: told.append(
        (str(folder), command, timing)) or SimpleNamespace(rows=lambda: "the rows"))
    given = ("--out", "some/where") if not place else ()
    found = railstate("reproduce", *words, *given)
    assert told == [(names or [one.name for one in papers([])], runs, seed), (
        "R" if "R" in words else "usual", " ".join(map(str, ("railstate", "reproduce", *words, *given))), False),
        "the rows"]
    folder = Path("some/where") if not place else Path("results") / place
    assert sorted(path.name for path in folder.iterdir()) == [
        f"published.{kind}" for kind in ("csv", "json", "md", "tex")]
    text = (folder / "published.json").read_text()
    document = json.loads(text)
    assert text == json.dumps(document, indent=1, ensure_ascii=False) + "\n" and not text.isascii()
    verdicts = [cell["verdict"] for group in document["papers"][0]["groups"] for cell in group["cells"]]
    wrong = sum(cell["verdict"] not in (cell["expected"], "undecided")
                for group in document["papers"][0]["groups"] for cell in group["cells"])
    assert found.code == int(wrong > 0) and "undecided" in verdicts and wrong
    if "--json" in words:
        assert json.loads(found.out) == document
        return
    lines = found.out.splitlines()
    assert lines[-1] == (f"{len(verdicts)} cells, {wrong} verdicts other than expected, "
                         f"{verdicts.count('undecided')} undecided with {runs} runs; in {folder}")
    assert len([line for line in lines if ", expected " in line and line.startswith("faruqi2019: ")]) == wrong


def test_what_a_cluster_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Workers of one thread, no dashboard; a repetition more than asked for, of which the first counts for nothing."""
    told, clock = list[Any](), (float(k * k) for k in count())

    def local(**given: Any) -> Any:
        told.append(given)
        return nullcontext(SimpleNamespace(scheduler_address=f"tcp://{len(told)}"))

    def run(plan: Any, kept: Any, how: Machinery) -> Iterator[int]:
        told.append((plan.runs, [*plan.cells[0].entries], kept, how))
        yield from range(3)

    monkeypatch.setattr(distributed, "LocalCluster", local)
    monkeypatch.setattr(cluster, "run", run)
    monkeypatch.setattr(cluster, "perf_counter", lambda: next(clock))
    lines = cluster.race(2)
    assert told == [told for workers in (1, 2) for told in [
        {"n_workers": workers, "threads_per_worker": 1, "dashboard_address": None},
        *(one for block in (1, 100) for one in [
            (16 * block, ["ekf"], {}, Machinery(1, block)),
            (16 * block, ["ekf"], {}, Machinery(1, block, f"tcp://{1 if workers == 1 else 6 + 8}"))] * 3)]]
    starts = iter(np.arange(4) * 10)
    assert [(line.workers, line.block) for line in lines] == [(1, 1), (1, 100), (2, 1), (2, 100)]
    assert [(line.alone, line.there) for line in lines] == [
        tuple((2 * (first + at) + 1) * 16 / 15 for at in (3, 5)) for first in starts]


def test_fresh_processes_one_after_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    told = list[Any]()

    class Fresh:
        def __init__(self, workers: int, context: Any) -> None:
            told.append((workers, context.get_start_method()))

        def __enter__(self) -> Fresh:
            return self

        def __exit__(self, *_: object) -> None:
            told.append("over")

        def submit(self, call: Callable[..., Any], *given: Any) -> Any:
            return SimpleNamespace(result=lambda: call(*given))

    made = (Line("ekf", 2, 1, "peer", float(mine), 8.0, 4.0, 0.1) for mine in (5, 3, 9))
    monkeypatch.setattr(speed, "ProcessPoolExecutor", Fresh)
    monkeypatch.setattr(speed, "_lines", lambda name, repeats: told.append((name, repeats)) or [next(made)])
    (row,) = speed.race("metro", 4, 3)
    assert row["ns/run-step"] == "3.00" and told == [(1, "spawn"), ("metro", 4), "over"] * 3
