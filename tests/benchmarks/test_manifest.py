"""What a manifest must hold, each rule broken alone and told with its place; what is left out is the usual."""

from __future__ import annotations

import json
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError
from railstate.benchmarks.store.manifest import AboutEstimator, Manifest

from ..synthetic_results import write_results

KEY = "ningbo-metro/white"


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = write_results(tmp_path_factory.mktemp("manifest") / "run", keep=False)
    return json.loads((folder / "manifest.json").read_text(encoding="utf-8"))


def moved(part: str, name: str) -> Callable[[dict[str, Any]], Any]:
    """A cell under another name."""
    def change(content: dict[str, Any]) -> None:
        cells = content[part]["cells"]
        cells[name] = cells.pop(KEY)

    return change


@pytest.mark.parametrize(("change", "said"), [
    *((moved(part, name), "String should match pattern") for part in ("configuration", "replay") for name in (
        "../white", "ningbo-metro/../white", "ningbo-metro", "Ningbo/white", "a/.b", "a/b/c", "a/b\n")),
    (moved("configuration", "ningbo-metro/grey"), "scenarios: nothing is told of ningbo-metro/grey"),
    (moved("replay", "ningbo-metro/grey"), f"replay.cells: {KEY} is missing"),
    (lambda content: content["estimators"].pop("ukf"), "estimators: nothing is told of ukf"),
    (lambda content: content["replay"]["cells"][KEY]["entries"].pop("ukf"),
     f"replay.cells.{KEY}.entries: ukf is missing"),
    (lambda content: content["configuration"]["cells"][KEY].update(runs=0), "greater than 0"),
    (lambda content: content["scenarios"]["ningbo-metro"].update(title="x" * 20_001), "at most 20000 characters"),
    (lambda content: content.update(started="2026-01-01T00:00:00"), "needs its offset from UTC"),
    (lambda content: content["scenarios"]["ningbo-metro"]["variants"]["white"].update(level=1.0), "less than 1")])
def test_each_rule_alone(sound: dict[str, Any], change: Callable[[dict[str, Any]], Any], said: str) -> None:
    content = deepcopy(sound)
    change(content)
    with pytest.raises(ValidationError) as error:
        Manifest.model_validate(content)
    assert said in str(error.value)


def test_what_is_there_is_kept_and_what_is_left_out_is_the_usual(sound: dict[str, Any], tmp_path: Path) -> None:
    content = deepcopy(sound)
    content["scenarios"]["ningbo-metro"].update(title="x" * 20_000, more={"of": "another version"})
    found = Manifest.model_validate(content)
    assert found.model_dump(mode="json", exclude_unset=True) == json.loads(json.dumps(content))
    usual = found.scenarios["ningbo-metro"].variants["white"].model_dump(exclude={"notes", "fitted", "title", "period"})
    assert usual == {
        "requirements": [], "floor": "", "uncertified": {}, "until": "", "level": 0.05}
    assert AboutEstimator(summary="s", source="", claims=[], oracle=False).model_dump() == {
        "summary": "s", "family": "Other", "source": "", "claims": [], "needs": [], "oracle": False, "smoother": False,
        "given": False, "about": ""}
