"""What seldom happens, each with its whole message: answers that are none, machines that lack something, odd files.

Nothing is run; what a process, a system or a disk would say is said by hand."""

from __future__ import annotations

import errno
import os
import platform
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from railstate.benchmarks.api.results import load
from railstate.benchmarks.commands import inspect, replay, report
from railstate.benchmarks.commands.compare import _works_here
from railstate.benchmarks.isolation import process
from railstate.benchmarks.isolation.process import Ended, Isolation
from railstate.benchmarks.planning import catalogue, plan
from railstate.benchmarks.planning.plan import make_plan
from railstate.benchmarks.running.cluster import _client
from railstate.benchmarks.store import folder, lock, parts, provenance
from railstate.benchmarks.store.growth import differing
from railstate.benchmarks.telling.figures.canvas import Canvas
from railstate.benchmarks.telling.figures.data import Results
from railstate.benchmarks.telling.report import page
from railstate.estimators.interface import Status
from railstate.scenarios.errors import InputError

FOUND = {"name": "mine", "summary": "s", "family": "", "source": "", "about": "", "needs": [], "claims": [],
         "oracle": False, "smoother": False, "parameters": [], "hash": "h"}


def refusal(call: Any, *given: Any, **named: Any) -> str:
    with pytest.raises(InputError) as caught:
        call(*given, **named)
    return str(caught.value)


def test_what_a_plug_in_s_process_answers(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """About its classes, and about their parameters: the process ended, it said something else, or all is well."""
    answer: list[Any] = [[FOUND]]
    asked = list[Any]()

    class Process:
        owner = ""

        def call(self, *given: Any) -> Any:
            asked.append(given)
            return answer[0]

    @contextmanager
    def isolation(owner: str, *_: Any, **__: Any) -> Iterator[Process]:
        one = Process()
        yield one
        asked.append((owner, one.owner))

    monkeypatch.setattr(catalogue, "isolation", isolation)
    file = str(tmp_path / "mine.py")
    known = catalogue.Catalogue([file])
    assert known.loose == ["mine"] and known.source("mine") == "h" and known["mine"].file == file
    assert asked == [(catalogue.said_by_file, file), (file, f"mine of {file}")]
    for answer[0], said in (
            (Ended(Status.crashed, "it died"), f"{file}: cannot be imported: it died"),
            *((odd, f"{file}: its description is not of the form that estimators have")
              for odd in (None, [7], FOUND, [{**FOUND, "name": 7}]))):
        assert refusal(catalogue.Catalogue, [file]) == said
    asked.clear()
    answer[0] = {"gain": 2}
    assert known.parameters("mine", {"gain": 2.0}, "x", tmp_path) == {"gain": 2}
    assert asked == [(catalogue.checked_parameters, "mine", {"gain": 2.0}, "x", str(tmp_path.resolve())),
                     (f"mine of {file}", "")]
    for answer[0], why in ((Ended(Status.timeout, "it hung"), "it hung"), ([1], "they are no table")):
        assert refusal(known.parameters, "mine", {}, "x") == f"x: mine cannot check them: {why}"


def test_a_process_that_refuses_its_plug_in_and_tables_that_are_none(monkeypatch: pytest.MonkeyPatch) -> None:
    told = list[str]()

    def exchange(self: Isolation, function: Any, *_: Any, **__: Any) -> Any:
        told.append(str(function))
        raise InputError("x.py: no such file")

    monkeypatch.setattr(process.nursery, "bear", socket.socketpair)
    monkeypatch.setattr(Isolation, "_exchange", exchange)
    one = Isolation("mine")
    one.first = "first"  # type: ignore[assignment]
    assert one.call("then") == Ended(Status.failed, "when it was imported: x.py: no such file")  # type: ignore[arg-type]
    assert told == ["first"] and one._sockets is None and not one.ended
    table = pa.table({"a": [1, 2]})
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table)
    whole = sink.getvalue().to_pybytes()
    assert process._table({process.TABLE: 1}, [b"", b"", whole]).equals(table)
    assert process._table({"a": 1, process.TABLE: 0}, []) == {"a": 1, process.TABLE: 0}
    with pytest.raises(ValueError, match=r"^no table$"):
        process._table({process.TABLE: 0}, [b"", b"odd"])


def test_all_scenarios_that_need_no_file_and_entries_of_other_variants(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plan, "scenario_files", lambda: ("rap-example-1", "recorded", "rap-example-2"))
    assert plan._self_contained() == ["rap-example-1", "rap-example-2"]
    assert [cell.key for cell in make_plan([], only=["kalman"]).cells] == [
        cell.key for name in ("rap-example-1", "rap-example-2") for cell in make_plan([name], only=["kalman"]).cells]


def test_machines_that_lack_something(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert refusal(_client("tcp://x:1").__enter__) == (
        "--backend dask: dask is not installed; pip install 'railstate[cluster]'")
    said = "processor\t: 0\nmodel name\t: Fast: 3 GHz \nmodel name\t: other\n"
    monkeypatch.setattr(Path, "read_text", lambda self, encoding: said if str(self) == "/proc/cpuinfo" else "")
    monkeypatch.setattr(platform, "processor", lambda: "")
    monkeypatch.setattr(platform, "machine", lambda: "x86")
    assert provenance._processor() == "Fast: 3 GHz"
    said = "processor\t: 0\n"
    assert provenance._processor() == "x86"

    def none(self: Path, encoding: str) -> str:
        raise FileNotFoundError

    monkeypatch.setattr(Path, "read_text", none)
    monkeypatch.setattr(platform, "processor", lambda: "arm")
    assert provenance._processor() == "arm"


def test_a_place_without_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Who holds a folder is said; where there are no locks that is said, and the work is done."""
    raised = OSError(errno.ENOLCK, "No locks available")

    def lockf(handle: int, *_: Any) -> None:
        raise raised

    monkeypatch.setattr(lock.fcntl, "lockf", lockf)
    (tmp_path / lock.LOCK).write_text("of who died holding it\n" * 20)
    with pytest.warns(UserWarning) as heard, lock.locked(tmp_path, "railstate run"):
        assert (tmp_path / lock.LOCK).read_text().endswith("(railstate run)\n")
        assert len((tmp_path / lock.LOCK).read_text().splitlines()) == 1
    assert (tmp_path / lock.LOCK).read_text() == ""
    assert [str(one.message) for one in heard] == [
        f"{tmp_path}: cannot be locked there (No locks available): see that nothing else writes to it"]
    for number in (errno.EACCES, errno.EAGAIN):
        raised = OSError(number, "taken")
        for text, holder in (("", "another process"), ("process 7 on x\n", "process 7 on x")):
            (tmp_path / lock.LOCK).write_text(text)
            with pytest.raises(InputError) as caught, lock.locked(tmp_path, ""):
                pass
            assert str(caught.value) == (f"{tmp_path}: is being written by {holder}; wait for it, or choose another "
                                         "--out")
    raised = None  # type: ignore[assignment]


def test_parts_that_are_no_file_may_not_be_read_or_hold_a_column_twice(tmp_path: Path,
                                                                       monkeypatch: pytest.MonkeyPatch) -> None:
    path, damaged = tmp_path / "p.parquet", "; remove it and run again: only its rows are computed anew"
    os.mkfifo(path)
    assert refusal(parts.read_part, path, "rows") == f"{path}: damaged (no file){damaged}"
    path.unlink()
    names = ["scenario", "variant", "estimator", "run", "status", "reason", "exception", "seconds", "own", "own"]
    pq.write_table(pa.Table.from_arrays([pa.array([1 if name == "run" else 0.5 if name == "seconds" else "x"])
                                         for name in names], names), path)
    assert refusal(parts.read_part, path, "rows") == f"{path}: damaged (a column stands in it twice){damaged}"

    def denied(*_: Any, **__: Any) -> Any:
        raise PermissionError(errno.EACCES, "denied")

    monkeypatch.setattr(parts.pq, "ParquetFile", denied)
    assert refusal(parts.read_part, path, "rows") == f"{path}: may not be read"


def test_curves_of_parts_with_other_steps_are_added(tmp_path: Path) -> None:
    """A naive loop over all lines, step by step."""
    (tmp_path / "rows").mkdir()
    (tmp_path / "curves").mkdir()
    sums: dict[tuple[str, int], list[float]] = {}
    for number, steps in enumerate(((0, 1, 2), (1, 2, 5), (0, 1, 2))):
        lines = [{"scenario": "s", "variant": "v", "estimator": label, "quantity": "x", "step": step,
                  "time": step / 4, **{name: 10.0 * number + step + k for k, name in enumerate(parts.SUMS)}}
                 for label in "ab"[:1 + number % 2] for step in steps]
        for one in lines:
            before = sums.setdefault((one["estimator"], one["step"]), [0.0] * len(parts.SUMS))
            sums[one["estimator"], one["step"]] = [a + one[name] for a, name in zip(before, parts.SUMS, strict=True)]
        pq.write_table(pa.Table.from_pylist(lines), tmp_path / "curves" / f"{number}.parquet")
        pq.write_table(pa.table({"scenario": ["s"] * 2, "variant": ["v"] * 2, "estimator": ["a", "b"],
                                 "run": pa.array([number] * 2, pa.int32()), "status": ["ok"] * 2, "reason": [""] * 2,
                                 "exception": [""] * 2, "seconds": [0.1] * 2}),
                       tmp_path / "rows" / f"{number}.parquet")
    found = parts.read_curves(tmp_path)
    assert [(line["estimator"], line["step"]) for line in found.to_dict("records")] == sorted(sums)
    for line in found.to_dict("records"):
        assert [line[name] for name in parts.SUMS] == sums[line["estimator"], line["step"]]
        assert line["time"] == line["step"] / 4 and (line["scenario"], line["variant"], line["quantity"]) == (
            "s", "v", "x")


def test_files_that_cannot_be_read_or_written(results: Results, tmp_path: Path,
                                              monkeypatch: pytest.MonkeyPatch) -> None:
    full = OSError(errno.ENOSPC, "No space left")
    for raised, told in ((full, (errno.ENOSPC, "No space left")), (OSError("odd"), (0, "odd"))):
        with pytest.raises(OSError) as caught, folder._whole(tmp_path / "x") as temporary:
            temporary.write_text("half")
            raise raised
        assert (caught.value.errno, caught.value.strerror, caught.value.filename) == (*told, str(tmp_path / "x"))
        assert list(tmp_path.iterdir()) == []
    store = folder.Store(tmp_path)
    (tmp_path / "manifest.json").write_text("{}")
    (tmp_path / "rows").mkdir()
    for name in ("rows/p.parquet", "verdicts.parquet"):
        (tmp_path / name).write_text("no parquet")
    assert store.verdicts() is None
    with monkeypatch.context() as patch:
        patch.setattr(Path, "read_bytes", lambda self: (_ for _ in ()).throw(PermissionError(13, "denied")))
        assert refusal(store.manifest) == f"{tmp_path / 'manifest.json'}: cannot be read: denied"
    file = tmp_path / "file"
    file.write_text("")
    assert refusal(load(results.folder).plot("nees").save, file / "x", "svg") == (
        f"{file / 'x'}: cannot be written: [Errno 20] Not a directory: '{file / 'x'}'")
    monkeypatch.setattr(page, "load_results", str)
    monkeypatch.setattr(page, "render", lambda of, published: f"{of} {published}")
    assert page.write_report(tmp_path, tmp_path / "deep" / "r.html", {"a": 1}) == tmp_path / "deep" / "r.html"
    assert (tmp_path / "deep" / "r.html").read_text() == f"{tmp_path} {{'a': 1}}"
    assert refusal(page.write_report, tmp_path, file / "r.html") == (
        f"{file / 'r.html'}: cannot be written: File exists")
    assert refusal(page.write_report, file) == (
        f"{file / 'report.html'}: cannot be written: File exists; --out FILE.html writes it elsewhere")


def test_a_link_where_a_figure_goes_is_replaced(tmp_path: Path) -> None:
    theirs, link = tmp_path / "theirs.svg", tmp_path / "x.svg"
    theirs.write_text("theirs")
    link.symlink_to(theirs)
    Canvas(10.0, "x", 10.0).save(link)
    assert theirs.read_text() == "theirs" and not link.is_symlink() and link.read_text().startswith("<svg")


def test_differences_of_nested_tables_and_times_in_words() -> None:
    assert differing({"a": {"b": 1, "c": [1]}, "d": 2, "e": {}}, {"a": {"b": 2, "f": 3}, "d": 2, "e": 5}, "x") == [
        "x.a.b: 1 -> 2", "x.a.c: given -> absent", "x.a.f: absent -> given", "x.e: {} -> 5"]
    assert differing({"a": 1}, {"b": 1}) == ["a: given -> absent", "b: absent -> given"] and differing([1], [1]) == []
    begun = "2024-05-01T10:00:00+00:00"
    assert [page._period(begun, end) for end in (None, "2024-05-01T10:01:59+00:00", "2024-05-01T10:02:00+00:00")] == [
        f"2024-05-01 10:00 UTC, {text}" for text in ("not finished", "took 119 s", "took 2 min")]


def test_files_that_are_not_what_reproduce_writes(tmp_path: Path) -> None:
    file = tmp_path / "p.json"
    said = f"--published {file}: has no papers; expected the published.json of railstate reproduce"
    for text in ("{}", "[]", '["papers"]', '"papers"', '{"paper": []}'):
        file.write_text(text)
        assert refusal(report._published, str(file)) == said
    file.write_text('{"papers": []}')
    assert report._published(str(file)) == {"papers": []} and report._published("") is None


def test_a_row_beside_the_stored_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same, another number, another status, one more number; a plug-in of another source."""
    row = {"scenario": "s", "variant": "v", "estimator": "a", "run": 1, "status": "ok", "reason": "", "rmse:x:m": 0.5,
           "nees:state:1": float("nan")}
    again = pd.DataFrame([row])
    for change, said in (({}, "bit-identical to the row in out"), ({"rmse:x:m": np.nextafter(0.5, 1)},
            "DIFFERS from the row in out"), ({"nees:state:1": 1.0}, "DIFFERS from the row in out"), (
            {"status": "failed", "reason": "it fell"}, "DIFFERS from the row in out, which is failed: it fell")):
        assert replay._compared(again, again.iloc[0], pd.DataFrame([{**row, **change}]), "out") == said
    less = pd.DataFrame([row]).drop(columns="rmse:x:m")
    assert replay._compared(again, again.iloc[0], less, "out") == "DIFFERS from the row in out"
    assert replay._compared(again, again.iloc[0], less.iloc[:0], "out") == "out has no such row yet"
    for status, said in (("diverged", "bit-identical to the row in out"), ("failed", "failed like the row in out")):
        lost = pd.DataFrame([{**row, "status": status}])
        assert replay._compared(lost, lost.iloc[0], lost, "out") == said
    stored = {"estimators": {"a": {"source": "old"}}}
    monkeypatch.setattr(replay, "Store", lambda out: SimpleNamespace(manifest=lambda: {"configuration": {
        "cells": {"s/v": stored}}}))
    given: Any = SimpleNamespace(cells=[SimpleNamespace(key="s/v", entries={"a": SimpleNamespace(plugin="mine")})],
                                 catalogue=SimpleNamespace(names=lambda: ["mine"], own=lambda name: False,
                                                           source=lambda name: f"new {name}"))
    assert refusal(replay._same_source, given, "out", "s/v", "a") == (
        "out: a was made by a plug-in mine of another source (old; here new mine); replay needs the same one: --plugin "
        "FILE.py")
    stored["estimators"]["a"]["source"] = "new mine"
    assert replay._same_source(given, "out", "s/v", "a") is None


def test_who_works_where() -> None:
    assert [_works_here("rap-example-1", name, 1) for name in ("kalman", "gsma", "imm-models")] == [True, False, False]


def test_a_recording_that_sorting_does_not_mend(monkeypatch: pytest.MonkeyPatch) -> None:
    mistakes = ["x.csv: time must increase", "x.csv: no speed"]
    asked, wrong = list[Any](), list[str]()

    def read(file: str, meaning: Any) -> Any:
        asked.append(meaning)
        if len(asked) <= len(mistakes):
            raise ValueError(mistakes[len(asked) - 1])
        return "the recording"

    monkeypatch.setattr(inspect, "read_recording", read)
    plant: Any = SimpleNamespace(meaning="as mapped", model_copy=lambda update: SimpleNamespace(meaning=update))
    assert inspect._recording("x.csv", plant, wrong) is None and wrong == ["time must increase", "no speed"]
    assert asked == ["as mapped", {"order": "sort", "duplicates": "first"}]
    for left, found in ((mistakes[:1], "the recording"), (["x.csv: odd"], None), ([], "the recording")):
        wrong.clear(), asked.clear()
        mistakes[:] = left
        assert inspect._recording("x.csv", plant, wrong) == found and len(wrong) == len(left)
