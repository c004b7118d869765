"""What commands and Python calls say and hand on, with nothing computed: `check`, `report`, entries, results.

Whoever would compute writes down what it was told."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pandas as pd
import pytest
import typer
from railstate.benchmarks.api.results import Figures, Results, load
from railstate.benchmarks.commands.check import check
from railstate.benchmarks.commands.report import PUBLISHED, _published, report
from railstate.benchmarks.conformance import Finding, Report, checking
from railstate.benchmarks.isolation.process import Ended
from railstate.benchmarks.planning.catalogue import Catalogue
from railstate.benchmarks.planning.plan import make_plan
from railstate.benchmarks.running.machinery import Machinery
from railstate.benchmarks.store.folder import Store
from railstate.benchmarks.store.manifest import description, stored_cell, stored_plan
from railstate.benchmarks.studies.entries import plain, put, toml
from railstate.estimators.interface import Status
from railstate.estimators.registry import GIVEN
from railstate.estimators.sigma_point import UnscentedKalman
from railstate.scenarios.errors import InputError


def test_published_numbers_a_page_may_show(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                           capsys: pytest.CaptureFixture[str]) -> None:
    """None where none are asked for, or the usual place has none; every other file has to be one of them."""
    monkeypatch.chdir(tmp_path)
    assert _published("") is _published(PUBLISHED) is None
    Path(PUBLISHED).parent.mkdir(parents=True)
    Path(PUBLISHED).write_text('{"papers": ["å"]}', encoding="utf-8")
    assert _published(PUBLISHED) == {"papers": ["å"]}
    for text, said in ((None, "cannot be read: [Errno 2] No such file or directory: 'x.json'"),
                       ("{", "cannot be read: Expecting property name enclosed in double quotes: line 1 column 2 "
                        "(char 1)"), *((one, "has no papers; expected the published.json of railstate reproduce")
                                       for one in ('["papers"]', '{"paper": 1}', "1"))):
        if text:
            Path("x.json").write_text(text)
        with pytest.raises(InputError) as caught:
            _published("x.json")
        assert str(caught.value) == f"--published x.json: {said}"
    told = list[Any]()

    def written(*given: Any) -> Path:
        told.append(given)
        Path("page.html").write_bytes(bytes(1_270_000))
        return Path("page.html")

    monkeypatch.setattr("railstate.benchmarks.telling.report.write_report", written)
    report("folder", "out.html")
    assert told == [("folder", "out.html", {"papers": ["å"]})] and capsys.readouterr().out == "page.html (1.3 MB)\n"


def checked(plugin: str, answer: Any) -> str:
    """What is printed of a report with so many findings, or of who ended or answered nonsense."""
    if not isinstance(answer, int):
        return (f"\nBROKEN runs ({plugin} on some case)\n  expected: design, start, predict, update and estimate come "
                f"back\n  happened: {answer or 'the process running it answered nonsense'}\n  mend:     see what it "
                f"does to its process, or for how long it may go on\n{plugin}: 1 broken\n")
    broken = f"\nBROKEN runs ({plugin} on cart)\n  expected: a\n  happened: b\n  mend:     c\n"
    return (f"{plugin} on cart: 2 rules kept: shapes, inputs\n{plugin} on small: left out: too few states\n"
            f"{broken * answer}{plugin}: {f'{answer} broken' if answer else 'all rules kept'}\n")


@pytest.mark.parametrize(("name", "loose", "answers", "code"), [
    ("kalman", [], {"kalman": 0}, 0), ("kalman", [], {"kalman": 2}, 1), ("other", [], {"other": 0}, 0),
    ("gone.py", ["one", "two"], {"one": 1, "two": 0}, 1), ("here", ["one", "two"], {"one": "hung", "two": None}, 1)])
def test_who_is_checked_where(name: str, loose: list[str], answers: dict[str, Any], code: int, tmp_path: Path,
                              monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """The suite's own in this process, all others in processes of their own; a file may have any name."""
    monkeypatch.chdir(tmp_path)
    Path("here").touch()
    command, asked = import_module("railstate.benchmarks.commands.check"), list[Any]()

    def answer(plugin: str) -> Any:
        findings = answers[plugin]
        if not isinstance(findings, int):
            return Ended(Status.timeout, findings) if findings else {"kept": 1}
        return Report({"cart": ["shapes", "inputs"]}, {"small": "too few states"},
                      [Finding("runs", "cart", "a", "b", "c")] * findings)

    def conform(cls: Any, plugin: str, *given: Any) -> Any:
        asked.append((cls, plugin, *given))
        return answer(plugin)

    @contextmanager
    def process(plugin: str, *limits: Any) -> Iterator[Any]:
        asked.append(limits)
        yield SimpleNamespace(call=lambda function, *given: asked.append((function, *given)) or (
            asdict(found) if isinstance(found := answer(plugin), Report) else found))

    def catalogue(files: list[str]) -> Any:
        asked.append(files)
        return SimpleNamespace(loose=loose, process=process)

    monkeypatch.setattr("railstate.benchmarks.conformance.conform", conform)
    monkeypatch.setattr(command, "Catalogue", catalogue)
    monkeypatch.setattr(command, "estimators", lambda: {"kalman": "its class"})
    monkeypatch.setattr(command, "machinery", lambda jobs, **how: asked.append((jobs, how)) or Machinery(jobs, **how))
    for given, words in (({}, {}), ({"gain": 0.25}, {"parameter": ["gain=0.25"], "scenario": "cart.toml/calm",
                                                     "timeout": 2.0, "memory": 3})):
        asked.clear()
        if code:
            with pytest.raises(typer.Exit) as caught:
                check(name, **words)
            assert caught.value.exit_code == code
        else:
            check(name, **words)
        limits, place = (words.get("timeout", 300.0), words.get("memory", 0.0)), words.get("scenario", "")
        assert asked[:2] == [[name] if loose else [], (1, dict(zip(("timeout", "memory"), limits, strict=True)))]
        if name == "kalman":
            assert asked[2:] == [("its class", "kalman", given, place)]
        else:
            place = place and f"{tmp_path}/{place}"
            assert asked[2:] == [part for plugin in answers for part in (
                limits, (command._check, plugin, given, place))]
        assert capsys.readouterr().out == "".join(checked(*pair) for pair in answers.items())


def test_keys_put_into_an_entry_and_how_it_is_written() -> None:
    entry: dict[str, Any] = {"parameters": {"a": 1}, "other": 2}
    base = {"knowledge": {"v": [1.0, 2.0], "deep": {"w": [3]}}, "gains": [4, 5]}
    for key, value in (("parameters.b", 6), ("knowledge.v.1", 7), ("knowledge.v.0", 8), ("knowledge.deep.w.0", 9),
                       ("gains.0", 10), ("late", "drop"), ("new.table.key", 11)):
        put(entry, key, value, base)
    assert entry == {"parameters": {"a": 1, "b": 6}, "other": 2, "late": "drop", "gains": [10, 5],
                     "knowledge": {"v": [8, 7], "deep": {"w": [9]}}, "new": {"table": {"key": 11}}}
    assert base == {"knowledge": {"v": [1.0, 2.0], "deep": {"w": [3]}}, "gains": [4, 5]}
    for key, said in (("knowledge.v.2", "there are 2 elements, counted from 0"), ("other.x", "other is no table"),
                      *((key, f"{key.split('.')[-2]} is no list here of which one element could be searched; give it "
                         f"first: --set estimators.LABEL.{key[:-2]}=[..]") for key in (
                             "parameters.a.0", "knowledge.none.1", "x.y.z.3"))):
        with pytest.raises(InputError) as caught:
            put(entry, key, 0, base)
        assert str(caught.value) == f"--over {key}: {said}"
    assert plain({"a_1-B": [1, (2.5, True)], "a b": {"c": "Čapek \"x\""}, "é": [{"d": "e"}]}) == (
        '{ a_1-B = [1, [2.5, true]], "a b" = { c = "Čapek \\"x\\"" }, "é" = [{ d = "e" }] }')
    assert toml("mine", {"plugin": "ekf", "knowledge": {"q": 1}}, "by é") == (
        '[origin]\n"estimators.mine" = "by é"\n\n[estimators.mine]\nplugin = "ekf"\nknowledge = { q = 1 }\n')


def test_cells_of_a_plan_told_and_read_back() -> None:
    """All entries or those asked for; pickles of what Python gave are no files to name."""
    plan = make_plan(["rap-example-1/corrected"], runs=3, seed=7, keep=2)
    (cell,) = plan.cells

    class Named(dict[str, Any]):
        files = ("a.py", f"b{GIVEN}", "c.py")

    catalogue: Any = Named({entry.plugin: plan.catalogue[entry.plugin] for entry in cell.entries.values()})
    told = description(replace(plan, catalogue=catalogue))
    assert told["replay"]["plugins"] == ["a.py", "c.py"]
    labels = list(cell.entries)
    manifest = {**told, "configuration": {"runs": 3, "seed": 7, "keep": 2, "cells": {cell.key: {"estimators": dict.
                                                                                               fromkeys(labels)}}}}
    again = stored_plan(manifest, Catalogue([]))
    assert (again.cells, again.runs, again.seed, again.keep) == (plan.cells, 3, 7, 2) and len(labels) > 1
    for some in (labels[:1], labels[1:], []):
        assert stored_cell(manifest, cell.key, dict.fromkeys(some)).entries == {
            label: cell.entries[label] for label in some}


def test_comparisons_and_figures_asked_for_in_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two estimators of a folder, or two folders; figures of one kind or of all, in points."""
    with pytest.raises(InputError) as caught:
        load(tmp_path)
    assert str(caught.value) == (f"{tmp_path}: not a results folder (no manifest.json); `railstate run --out DIR` "
                                 "makes one")
    store: Any = SimpleNamespace(folder=tmp_path, manifest=lambda: "manifest",
                                 rows=lambda: pd.DataFrame({"estimator": ["x", "y", "x"]}))
    ours, asked = Results(store), list[Any]()
    line = {"metric": "rmse", "quantity": "speed", "unit": "m/s", "value": 2.0, "ratio": 0.5, "ratio_low": 0.4,
            "ratio_high": 0.6, "won": 0.9, "runs": 7}
    each = SimpleNamespace(cell="s/v", label="", a={"value": 4.0}, b=line, verdict="better")
    row = {"setting": "s/v", **line, "a": 4.0, "b": 2.0, "verdict": "better"}
    del row["value"]

    def folders(a: Any, b: Any) -> Any:
        asked.append((a.folder, b))
        return SimpleNamespace(found=[SimpleNamespace(**{**vars(each), "label": "ekf"})])

    monkeypatch.setattr("railstate.benchmarks.judging.comparison.between_folders", folders)
    monkeypatch.setattr("railstate.benchmarks.judging.comparison.between_estimators",
                        lambda rows, *given: asked.append((list(rows["estimator"]), *given)) or [each])
    assert ours.compare("x", "y").to_dict("records") == [row]
    other: Any = Results(Store("other"))
    for a in ("other", Path("other"), other):
        assert ours.compare(a).to_dict("records") == [{**row, "estimator": "ekf"}]
    assert asked == [(["x", "y", "x"], "manifest", "x", "y"), *[(Path("other"), store)] * 3]
    for a, b, name in (("x", "z", "z"), ("w", "y", "w")):
        with pytest.raises(InputError) as caught:
            ours.compare(a, b)
        assert str(caught.value) == f"{name}: not among these results; allowed: x, y"
    found = [(SimpleNamespace(name="nees"), "s", "v", "canvas"), (SimpleNamespace(name="cost"), "", "", "other")]
    monkeypatch.setattr("railstate.benchmarks.telling.figures.data.load_results", lambda *given, **how: (given, how))
    monkeypatch.setattr("railstate.benchmarks.telling.figures.catalogue.drawn",
                        lambda *given: asked.append(given) or found)
    for words, how, figure in (({}, {"run": 0, "only": (), "entries": (), "width": 252.0}, None), (
            {"figure": "nees", "entries": ["a"], "quantities": ["b"], "width": 2.0, "run": 3},
            {"run": 3, "only": ["b"], "entries": ["a"], "width": 144.0}, "nees")):
        drawn = ours.plot(**words)
        assert drawn.drawn == {"nees~s~v": "canvas", "cost": "other"} and asked[-1] == (((tmp_path,), how), figure)
    found.clear()
    for figure, said in (("", f"{tmp_path}: has no data for this figure; settings' own figures and the example run "
                          "need trajectories (railstate run --keep 1)"), ("bees", "--figure bees: unknown; allowed: ")):
        with pytest.raises(InputError) as caught:
            ours.plot(figure)
        assert str(caught.value).startswith(said) and (not figure or str(caught.value).endswith(", ".join(
            item.name for item in import_module("railstate.benchmarks.telling.figures.catalogue").FIGURES)))


def test_figures_are_saved_into_any_folder(tmp_path: Path) -> None:
    saved = list[Path]()
    canvases: Any = {name: SimpleNamespace(save=saved.append) for name in ("nees~s~v", "cost")}
    figures = Figures(canvases)
    for kind, folder in (("pdf", tmp_path / "a" / "b"), ("svg", tmp_path / "a" / "b"), ("png", tmp_path / "c")):
        paths = figures.save(folder, *([] if kind == "pdf" else [kind]))
        assert paths == saved[-2:] == [folder / f"nees~s~v.{kind}", folder / f"cost.{kind}"] and folder.is_dir()
    (tmp_path / "file").touch()
    for kind, place, said in (("gif", "d", "--format gif: unknown; allowed: svg, pdf, png"), (
            "svg", "file", f"{tmp_path}/file: cannot be written: [Errno 17] File exists: '{tmp_path}/file'")):
        with pytest.raises(InputError) as caught:
            figures.save(tmp_path / place, kind)
        assert str(caught.value) == said and len(saved) == 6 and not (tmp_path / "d").exists()


def test_a_class_that_is_not_checked_further(monkeypatch: pytest.MonkeyPatch) -> None:
    """Parameters that cannot be, all at once; an __init__ of its own; needs that are none of a design model's."""
    def case(*given: Any) -> Any:
        raise error

    monkeypatch.setattr(checking, "scenario_case", case)
    error: Exception = LookupError("so far")
    with pytest.raises(LookupError, match="so far"):
        checking.conform(UnscentedKalman, "ukf", {"alpha": 0.5})
    with pytest.raises(InputError) as caught:
        checking.conform(UnscentedKalman, "ukf", {"alpha": "wide", "gamma": 1})
    assert [line.partition(":")[0] for line in str(caught.value).splitlines()] == [
        "parameters.alpha", "parameters.gamma"]
    for error in (TypeError("no parameters"), AttributeError("no parameters")):
        report = checking.conform(UnscentedKalman, "ukf", {})
        (found,) = report.findings
        assert (report.kept, report.left_out, found.rule, found.case, found.expected, found.mend) == (
            {}, {}, "runs", "the class", "it can be made from its parameters",
            "let __init__(self, parameters=None) call super().__init__(parameters)")
        assert f"{type(error).__name__}: no parameters" in found.happened
    for needs in ("linear", ("linear", "wheels")):
        monkeypatch.setattr(UnscentedKalman, "needs", needs)
        assert checking.conform(UnscentedKalman, "ukf", {}) == Report({}, {}, [Finding(
            "description", "the class", "needs = (..) names parts of DesignModel", f"needs = {needs!r}",
            'a tuple of names, such as needs = ("linear",)')])
