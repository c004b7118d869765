"""What a command's words become: cells, tasks and their order, parts of a task whose process dies; whole, beside
committed text (to renew it: `tests/expected.py`)."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from railstate.benchmarks.isolation.process import Ended
from railstate.benchmarks.planning import tasks
from railstate.benchmarks.planning.naming import find, find_one, located
from railstate.benchmarks.planning.plan import Plan, Task, make_plan
from railstate.benchmarks.planning.tasks import make_tasks, task_name
from railstate.benchmarks.running import isolated
from railstate.estimators.interface import Status
from railstate.scenarios.errors import InputError

from ..conftest import PLUGIN, SCENARIO

Expected = Callable[[str, str], None]
PLANS: list[tuple[list[str], dict[str, Any]]] = [
    (["ningbo-metro"], {}), (["ningbo-metro/white"], {"only": ["ukf", "ekf"]}), (["cbtc-csma/protocol-*"], {}),
    (["cbtc-csma/none-*"], {}), (["rap-example-1/printed", "rap-example-1"], {"only": ["kalman"]}), (["nobody"], {}),
    (["cbtc-csma", "rap-example-1"], {"only": ["random-access"]}), (["rap-example-1"], {"only": ["gsma"]}),
    (["rap-example-1"], {"only": ["nobody"]}), (["rap-example-1"], {"only": ["ekf", "nobody"]}),
    (["rap-example-1"], {"runs": 0}), (["rap-example-1"], {"seed": -1}), (["rap-example-1"], {"keep": -1}),
    (["rap-example-1"], {"runs": 1, "seed": 0, "keep": 0}), (["recorded"], {}), (["cart.toml/calm"], {}),
    (["cart.toml/calm"], {"plugins": ["half.py"]}), (["cart.toml"], {"plugins": ["half.py"], "only": ["half", "slow"]}),
    (["cart.toml", "cart.toml/calm"], {"plugins": ["half.py"], "only": ["half"]}),
    (["cart.toml", "twin.toml"], {"plugins": ["half.py"], "only": ["half"]}),
    (["cart.toml", "other.toml"], {"plugins": ["half.py"], "only": ["half"]}), (["cart.toml/rough"], {"only": ["ekf"]}),
    (["rap-example-1"], {"entries": {"mine": {"plugin": "kalman", "late": "drop"}}, "only": ["mine"]}),
    (["rap-example-1"], {"overrides": {"channel": {"kind": "bernoulli", "p": 0.5}}, "only": ["kalman"]}),
    (["ningbo-metro/fault-*"], {"overrides": {"faults.outliers.share": 0.5}, "only": ["ekf"]}),
    (["rap-example-1"], {"overrides": {"estimators.kalman.parameters": {"x": 1}}, "only": ["kalman"]}),
    (["some.toml"], {"only": ["special"]}), (["some.toml/calm"], {"only": ["special"]}),
    (["some.toml/*"], {"overrides": {"channel.p": 0.5}, "only": ["ekf"]})]


def said(call: Callable[[], str]) -> str:
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        try:
            text = call()
        except InputError as error:
            text = f"error: {error}"
    return "\n".join([text, *(f"warning of {Path(one.filename).name}: {one.message}" for one in heard)])


def of(plan: Plan) -> str:
    cells = "\n".join(f"  {cell.key} {cell.runs} " + "; ".join(
        f"{label}: {entry.model_dump(exclude_defaults=True, exclude={'note'})}"
        for label, entry in cell.entries.items()) for cell in plan.cells)
    return f"{plan.runs} {plan.seed} {plan.keep} {plan.changes} {plan.catalogue.loose}\n{cells}"


def test_plans(expected: Expected, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("cart.toml").write_text(SCENARIO)
    Path("twin.toml").write_text(SCENARIO.replace("a cart on a line", "the same cart"))
    Path("other.toml").write_text(SCENARIO.replace("steps = 40", "steps = 41"))
    Path("some.toml").write_text(SCENARIO + '[variants.rough]\nchannel = { kind = "delay", steps = 2 }\n'
                                 '[variants.rough.estimators.special]\nplugin = "kalman"\n')
    Path("half.py").write_text(PLUGIN)
    out = [f"{names} {given}\n{said(lambda names=names, given=given: of(make_plan(names, **given)))}"
           for names, given in PLANS]
    for name in ("ningbo-metro", "ningbo-metro/white", "ningbo-metro/fault-*", "cart.toml", "cart.toml/rough", "rap/x",
                 "none.toml", "cart.toml/c*", "ningbo-metro/none"):
        out += [f"{name} {located(name)}", said(lambda name=name: str(find(name)[1])),
                said(lambda name=name: str(find_one(name)[1]))]
    expected("plans", "\n".join(out).replace(str(tmp_path), "."))


def test_tasks(expected: Expected, monkeypatch: pytest.MonkeyPatch) -> None:
    """Code is shared here as letters of a module's name are."""
    one = make_plan(["ningbo-metro/white"], only=["ekf", "ukf", "robust-mean-square", "ckf"], runs=7, seed=3, keep=2)
    two = make_plan(["ningbo-metro/white", "rap-example-1/corrected", "cbtc-csma/uniform"], runs=5)
    more = replace(one, cells=(replace(one.cells[0], runs=9),))
    key = one.cells[0].key
    done = {(key, "ekf"): {0, 1, 5}, (key, "ukf"): set(range(9))}
    out = list[str]()
    monkeypatch.setattr(tasks, "machine_code", SimpleNamespace(closure=lambda path: set(path.stem)))
    for room in (tasks.ROOM, 4e6):
        monkeypatch.setattr(tasks, "ROOM", room)
        for plan in (one, two, more):
            for before in ({}, done):
                for jobs, batch in ((1, None), (2, None), (3, 2), (4, None)):
                    made = make_tasks(plan, before, jobs, batch)
                    out.append(f"{room:g} {len(plan.cells)} {bool(before)} {jobs} {batch}: " + "; ".join(
                        f"{task_name(task)} {' '.join(task.labels)} {list(task.runs)}" for task in made))
                    assert {(task.seed, task.keep, task.plugin) for task in made} <= {(plan.seed, plan.keep, "")}
    expected("tasks", "\n".join(out))


class Dying:
    """A process that dies of run 5, and of `ukf` and run 2; it answers nonsense of run 8."""

    def __init__(self, said: list[str]) -> None:
        self.said = said

    def call(self, function: Any, task: Task) -> Any:
        self.said.append(f"call {' '.join(task.labels)} {task.runs}")
        if 5 in task.runs or ("ukf" in task.labels and 2 in task.runs):
            return Ended(Status.timeout, "it hung")
        return "nonsense" if 8 in task.runs else task

    def close(self) -> None:
        self.said.append("close")


def test_a_task_whose_process_dies_is_narrowed(expected: Expected, monkeypatch: pytest.MonkeyPatch) -> None:
    (cell,) = make_plan(["ningbo-metro/white"], only=["ekf", "ukf"]).cells
    monkeypatch.setattr(isolated, "sound", lambda task, found: None if found == "nonsense" else found)
    monkeypatch.setattr(isolated, "lost", lambda task, status, reason: f"{task.runs} {status.name}: {reason}")
    out = list[str]()
    for labels, runs in ((("ekf",), (5,)), (("ekf",), (0, 1)), (("ekf", "ukf"), tuple(range(12))), (("ekf",), (4, 5)),
                         (("ekf",), (5, 6, 7, 8)), (("ekf",), (5,) * 40)):
        losses, heard = isolated.Losses(quiet=True), list[str]()
        found = isolated._narrowed(Task(cell, labels, runs, 1), Dying(heard), losses)  # pyright: ignore
        got = [f"got {one}" if isinstance(one, str) else f"done {' '.join(one.labels)} {one.runs}" for one in found]
        out += [f"{labels} {runs}", *heard, *got, *map(str, losses.found.items())]
    expected("narrowed", "\n".join(out))
