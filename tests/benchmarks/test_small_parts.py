"""What small parts say and leave behind: lists of differences, locks, limits of time, refused kinds of files.

Each with an input made by hand and its whole answer."""

from __future__ import annotations

import copy
import os
import signal
import threading
import time
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from railstate.benchmarks.api import listing
from railstate.benchmarks.api.results import load
from railstate.benchmarks.judging.comparison import _other_truths, _settings
from railstate.benchmarks.planning import naming
from railstate.benchmarks.store.lock import LOCK, locked
from railstate.benchmarks.studies.deadline import Overdue, within
from railstate.benchmarks.telling.figures.data import Results
from railstate.scenarios.errors import InputError
from railstate.scenarios.files import Scenario


def test_what_differs_between_two_manifests() -> None:
    entry = {"plugin": "ekf", "parameters": {}, "knowledge": {}, "source": "x"}
    a = {"railstate": "1", "configuration": {"seed": 1, "runs": 2, "cells": {
        "s/v": {"scenario": "aa", "estimators": {"one": entry, "two": entry}},
        "s/w": {"scenario": "aa", "estimators": {}}}},
        "environment": {"processor": "p", "python": "3", "git_commit": "c", "packages": {"numpy": "1", "scipy": "1"}},
        "replay": {"cells": {"s/v": {"table": {"plant": 1, "channel": 1, "estimators": 1}}}}}
    b = copy.deepcopy(a)
    assert list(_settings(a, b)) == [] and _other_truths(a, b, "s/v") == ""
    b["railstate"], b["configuration"]["seed"], b["configuration"]["runs"] = "2", 3, 4
    b["environment"] = {"processor": "q", "python": "4", "git_commit": "d", "packages": {"numpy": "2"}}
    b["configuration"]["cells"] = {"s/v": {"scenario": "bb", "estimators": {
        "one": entry, "two": {**entry, "plugin": "ukf", "source": "y"}}}}
    assert list(_settings(a, b)) == [
        "railstate: 1 -> 2", "seed: 1 -> 3", "runs: 2 -> 4", "processor: p -> q", "python: 3 -> 4",
        "git_commit: c -> d", "numpy: 1 -> 2", "scipy: 1 -> None", "s/v: the scenario's content changed",
        "s/v/two: plugin, source changed"]
    assert _other_truths(a, b, "s/v") == "the seed changed"
    b["configuration"]["seed"] = 1
    b["replay"]["cells"]["s/v"]["table"] = {"plant": 2, "channel": 2, "estimators": 2}
    assert _other_truths(a, b, "s/v") == "[plant], [channel] of the scenario changed"


def test_a_folder_is_written_once_at_a_time(tmp_path: Path) -> None:
    for _ in range(2):
        with locked(tmp_path, "railstate run"):
            said = (tmp_path / LOCK).read_text()
            assert said.startswith(f"process {os.getpid()} on ") and said.endswith(" UTC (railstate run)\n")
            with pytest.raises(InputError, match="this very process is writing to it already"), locked(tmp_path, ""):
                pass
        assert (tmp_path / LOCK).read_text() == ""


def test_a_limit_of_time() -> None:
    before = signal.getsignal(signal.SIGALRM)
    with pytest.raises(Overdue), within(0.02):
        time.sleep(5)
    with within(5):
        assert 4 < signal.getitimer(signal.ITIMER_REAL)[0] <= 5
    assert signal.getitimer(signal.ITIMER_REAL) == (0, 0) and signal.getsignal(signal.SIGALRM) == before


def test_no_limit_of_time_where_there_is_no_alarm(monkeypatch: pytest.MonkeyPatch) -> None:
    """In a thread, and on systems without the signal."""
    done = []

    def slow() -> None:
        with within(0.001):
            time.sleep(0.01)
        done.append(threading.current_thread() is thread)

    thread = threading.Thread(target=slow)
    thread.start()
    thread.join()
    with monkeypatch.context() as patch:
        patch.delattr(signal, "SIGALRM")
        slow()
    assert done == [True, False]


def test_figures_are_written_as_what_there_is(results: Results, tmp_path: Path) -> None:
    found = load(results.folder).plot("nees")
    assert repr(found) == "3 figures: " + ", ".join(f"nees~ningbo-metro~{name}" for name in (
        "switching", "white", "constant")) == f"{len(found)} figures: {', '.join(found)}"
    with pytest.raises(InputError, match="--figure bees: unknown; allowed: error-over-time, "):
        load(results.folder).plot("bees")
    with pytest.raises(InputError, match="has no data for this figure; settings' own figures and the example run need"):
        load(results.folder).plot("trace")
    assert repr(load(results.folder)) == f"936 rows in {results.folder}"
    with pytest.raises(InputError, match="--format gif: unknown; allowed: svg, pdf, png"):
        found.save(tmp_path, "gif")
    assert [path.name for path in found.save(tmp_path, "svg")] == [f"{name}.svg" for name in found]
    assert found._repr_html_().count("<figcaption>nees, ningbo-metro, ") == 3


def test_estimators_that_do_not_import_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Told to who asked for the lines, in place of theirs."""
    found = SimpleNamespace(summary="a filter", family="Kalman", needs=["linear"], claims=["covariance"], source="here")

    class Few(dict[str, Any]):
        def names(self) -> list[str]:
            return ["bad", "good"]

        def __missing__(self, name: str) -> Any:
            raise InputError(f"plug-in {name}: no")

    monkeypatch.setattr(listing, "Catalogue", lambda: Few(good=found))
    with pytest.warns() as told:
        lines = listing.estimator_lines()
    assert lines == [{"estimator": "good", "about": "a filter", "family": "Kalman", "needs": ["linear"],
                      "claims": ("mean", "covariance"), "source": "here"}]
    assert [(str(one.message), one.category, one.filename) for one in told] == [
        ("plug-in bad: no: left out", UserWarning, __file__)]


def test_what_a_scenario_s_name_means(monkeypatch: pytest.MonkeyPatch) -> None:
    """All of its variants but those on request, one, or a pattern's; whose file lies in a folder has a slash."""
    loaded, checked = list[Any](), list[str]()

    class Fake(Scenario):
        def setting(self, variant: str) -> Any:
            checked.append(variant)

    made = Fake("s", "s.toml", {"a": {}, "a-b": {}, "c": {}, "B": {}}, "a", {"a-u": ["x", "y"], "v": ["z"]},
                requested=frozenset({"c", "v"}))

    def load(*given: Any) -> Scenario:
        loaded.append(given)
        return made

    monkeypatch.setattr(naming, "load", load)
    monkeypatch.setattr(naming, "scenario_files", lambda: ("s", "of/s"))
    plain, some = ("a", "a-b", "B"), ["variant a-u is left out: x; y"]
    for word, variants, heard, asked in (
            ("s", plain, some, ("s", None)), ("of/s", plain, some, ("of/s", None)),
            ("x/s.toml", plain, some, ("x/s.toml", None)), ("s/c", ("c",), [], ("s", None, "c")),
            ("x/s.toml/c", ("c",), [], ("x/s.toml", None, "c")), ("s/a*", ("a", "a-b"), some, ("s", None)),
            ("s/b*", (), [], ("s", None)),
            ("s/*", ("a", "a-b", "c", "B"), [*some, "variant v is left out: z"], ("s", None))):
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            try:
                assert naming.find(word) == (made, variants)
            except InputError as error:
                assert str(error) == f"{word}: there is no such variant; allowed: a, a-b, c, B, a-u, v" and not variants
        assert [(one.filename, str(one.message)) for one in said] == [(__file__, f"s.toml: {text}") for text in heard]
        assert (loaded.pop(), loaded, checked) == (asked, [], list(asked[2:])), word
        checked.clear()
    assert naming.find_one("s", {"k": 1}) == (made, "a") and naming.find_one("s/c") == (made, "c")
    assert loaded[-2:] == [("s", {"k": 1}), ("s", None, "c")] and set(checked) == {"a", "c"}
