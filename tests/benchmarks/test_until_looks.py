"""`--until`, look by look: what each look is told to compute, who waits for the next one, and the reasons; no run."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from railstate.benchmarks.studies import until


@dataclass(frozen=True)
class Plan:
    """As far as `until` reads one."""

    cells: tuple[Any, ...]
    runs: int = 0


@dataclass
class Folder:
    """A store that remembers what it is told."""

    writable: bool = True
    said: dict[str, Any] = field(default_factory=dict)

    def rows(self) -> str:
        return "rows"

    def manifest(self) -> dict[str, Any]:
        return {"configuration": {"cells": {key: {"estimators": [f"{key}-ekf"]} for key in "abc"}}}

    def told(self, key: str, _: str) -> Any:
        return self.said.get(key, {}).get("until")

    def writing(self, command: str) -> Any:
        assert command == "the command"
        return nullcontext()

    def tell(self, said: dict[str, Any]) -> None:
        self.said |= said


@pytest.mark.parametrize("writable", [True, False])
def test_each_look(writable: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    calls, written, store = list[Any](), list[Any](), Folder(writable)
    enough = {"a": 10, "b": 20, "c": 99}  # runs after which a cell's rule is met

    def complete(plan: Any, folder: Path, machinery: Any, command: str, **how: Any) -> Folder:
        calls.append(("".join(cell.key for cell in plan.cells), plan.runs, how))
        return store

    rule: Any = SimpleNamespace(
        looks=(10, 20, 40), most=40, level=0.99, reached=lambda: "narrow", about=lambda: "a rule",
        missing=lambda seen, manifest: "" if seen[2] >= enough[seen[0]] else f"{seen[0]} is wide")
    monkeypatch.setattr(until, "complete", complete)
    monkeypatch.setattr(until, "Store", lambda folder: store)
    monkeypatch.setattr(until, "first_runs", lambda rows, key, labels, look: (key, tuple(labels), look))
    monkeypatch.setattr(until, "write_tables", lambda *given: written.append(given))
    plan: Any = Plan(tuple(SimpleNamespace(key=key) for key in "abc"))
    machinery: Any = None
    assert store is until.complete_until(plan, rule, Path("x"), machinery, "the command", retry=("timeout",),
                                         overwrite=True)
    assert calls == [("abc", 10, {"timing": True, "retry": ("timeout",), "overwrite": True}),
                     ("bc", 20, {"timing": False, "retry": (), "overwrite": False}),
                     ("c", 40, {"timing": False, "retry": (), "overwrite": False})]
    assert store.said == ({} if not writable else {
        "a": {"until": "Stopped after 10 runs: narrow (a rule).", "level": 0.99},
        "b": {"until": "Stopped after 20 runs: narrow (a rule).", "level": 0.99},
        "c": {"until": "Stopped after 40 runs, the most allowed: c is wide (a rule).", "level": 0.99}})
    assert written == ([(store, "rows")] if writable else [])
    until.complete_until(plan, rule, Path("x"), machinery, "the command")
    assert len(written) == writable  # the same reasons again: nothing is written
    assert calls[3] == ("abc", 10, {"timing": True, "retry": (), "overwrite": False})
    enough.update(b=10, c=20)
    calls.clear()
    until.complete_until(plan, rule, Path("x"), machinery, "the command")
    assert [call[:2] for call in calls] == [("abc", 10), ("c", 20)]  # nobody waits for another look
