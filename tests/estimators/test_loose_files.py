"""Estimators in files of one's own: what each is called, and what is said of files that hold none that will do."""

from __future__ import annotations

import pickle
import sys
from pathlib import Path

import pytest
from railstate.estimators import registry
from railstate.estimators.baselines import Truth
from railstate.scenarios.errors import InputError

CLASS = """
class {}(Estimator):
    def start(self, model, runs, random): ...
    def predict(self, u, {}): ...
    def update(self, measurement): ...
    def estimate(self): ...
"""
HEAD = "from railstate.estimators.interface import Estimator\n"
INSTALLED = "an estimator named {} is installed already; rename the {}"
NO_NAME = "{!r} is no name for an estimator, or that of two; rename the {}: letters, digits, and .-_ inside"
OLD = ("{0}: predict(self, u, portion) is of railstate's first edition: write predict(self, u, interval), with "
       "interval.length in seconds, interval.share of the step's input and interval.depart for a step of one's own "
       "counting; functions of the model take (x, u, interval) and (x, step)")


@pytest.fixture(autouse=True)
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the files are; what is loaded is forgotten."""
    monkeypatch.setattr(registry, "_loose", {})
    monkeypatch.setattr(sys, "path", list(sys.path))
    return tmp_path


def written(path: Path, *classes: str, old: str = "") -> str:
    path.write_text(HEAD + "".join(CLASS.format(name, "portion" if name == old else "interval") for name in classes))
    return str(path)


@pytest.mark.parametrize(("name", "classes", "called"), [
    ("my_own.py", ["Whatever"], ["my-own"]), ("two.py", ["HalfGain", "UKFTwice2X"], ["half-gain", "ukftwice2-x"]),
    ("more.py", ["A", "B1"], ["a", "b1"])])
def test_what_they_are_called(place: Path, name: str, classes: list[str], called: list[str]) -> None:
    found = registry.load_file(written(place / name, *classes))
    assert list(found) == called and [cls.__name__ for cls in found.values()] == classes
    assert registry.load_file(str(place / name)) == found and sys.path[-1] == str(place) and sys.path.count(
        str(place)) == 1
    assert [registry.estimator_class(word, "x") for word in called] == list(found.values())


@pytest.mark.parametrize(("name", "classes", "said"), [
    ("ekf.py", ["One"], INSTALLED.format("ekf", "file")), ("x.py", ["Ekf", "Other"], INSTALLED.format("ekf", "class")),
    ("=cmd.py", ["One"], NO_NAME.format("=cmd", "file")),
    ("x.py", ["HalfGain", "HALFGain", "Halfgain"], NO_NAME.format("halfgain", "class")),
    ("x.py", ["_Hidden", "Other"], NO_NAME.format("_hidden", "class")),
    ("x.py", [], "holds no subclass of railstate.estimators.interface.Estimator"),
    ("x.py", ["Fine", "Old"], OLD.format("Old"))])
def test_files_that_will_not_do(place: Path, name: str, classes: list[str], said: str) -> None:
    path = written(place / name, *classes, old="Old")
    with pytest.raises(InputError) as caught:
        registry.load_file(path)
    assert str(caught.value) == f"{path}: {said}" and not registry._loose


def test_files_that_are_none(place: Path) -> None:
    (place / "broken.py").write_text("raise SystemExit('enough')\n")
    (place / "words.txt").write_text(HEAD)
    (place / "abstract.py").write_text(f"{HEAD}class One(Estimator):\n    summary = 'x'\n")
    (place / "bad.pickle").write_bytes(b"no pickle")
    no_file = "no such file; --plugin takes a Python file with an Estimator class"
    for name, said in (("none.py", no_file), (".", no_file), ("a\0b.py", no_file),
                       ("broken.py", "does not import: SystemExit: enough"), ("words.txt", "not a Python file"),
                       ("abstract.py", "holds no subclass of railstate.estimators.interface.Estimator")):
        before = set(sys.modules)
        with pytest.raises(InputError) as caught:
            registry.load_file(f"{place}/{name}")
        assert str(caught.value) == f"{place}/{name}: {said}"
        assert name == "abstract.py" or set(sys.modules) <= before
    with pytest.raises(InputError, match=r"^bad: cannot be handed to a process of its own: "):
        registry.load_file(f"{place}/bad.pickle")


def test_a_class_that_was_given(place: Path) -> None:
    (place / "mine.pickle").write_bytes(pickle.dumps(Truth))
    assert registry.load_file(f"{place}/mine.pickle") == {"mine": Truth}
    assert registry.estimator_class("mine", "x") is Truth


def test_a_file_that_changes_is_another_module(place: Path) -> None:
    first = registry.load_file(written(place / "own.py", "One"))["own"]
    second = registry.load_file(written(place / "own.py", "Two"))["own"]
    assert (first.__name__, second.__name__) == ("One", "Two") and first.__module__ != second.__module__
    assert first.__module__.startswith("railstate_plugin_") and len(first.__module__) == len("railstate_plugin_") + 12
