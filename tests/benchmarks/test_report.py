"""The report's page and its tables, parsed; a real browser opens it in `test_report_browser.py`."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
from railstate.benchmarks.commands.report import report
from railstate.benchmarks.store.folder import Store
from railstate.benchmarks.telling import sentences, wording
from railstate.benchmarks.telling.figures.data import Results
from railstate.benchmarks.telling.rankings import Cell
from railstate.benchmarks.telling.report import write_report
from railstate.benchmarks.telling.report.matrix import anchor, matrix
from railstate.benchmarks.telling.report.published import papers, sentence
from railstate.benchmarks.telling.report.sections import Entry, failures, fault_table, table
from railstate.scenarios.errors import InputError

from ..synthetic_results import BRAKING, CBTC, METRO, write_results
from .test_sentences import cell_of


@pytest.fixture(scope="module")
def html(results: Results) -> str:
    return write_report(results.folder).read_text(encoding="utf-8")


def entry(cell: Cell, label: str, head: str) -> Entry:
    made = table(cell)
    column = next(i for i, (_, name, _) in enumerate(made.heads) if name.startswith(head))
    return next(entries for name, entries in made.lines if name == label)[column]


class Page(HTMLParser):
    """Collects what a test wants to know of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in ("meta", "link", "br", "input"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))


def test_the_page_is_well_formed_self_contained_and_in_order(html: str) -> None:
    page = Page(html)
    assert page.open == []
    ids = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    for _, attributes in page.tags:
        for name in ("src", "href", "data", "action"):
            assert re.match(r"#|data:|$", attributes.get(name) or ""), attributes
        if (attributes.get("href") or "").startswith("#"):
            assert attributes["href"][1:] in ids, attributes  # type: ignore[index]
    assert "http://" not in html.replace("http://www.w3.org", "") and "https://" not in html and "url(" not in html
    levels = [int(tag[1]) for tag, _ in page.tags if re.fullmatch("h[1-6]", tag)]
    assert levels[0] == 1 and levels.count(1) == 1
    assert all(b <= a + 1 for a, b in itertools.pairwise(levels))
    assert len(html) < 1e6
    assert html.index('id="matrix"') < html.index('id="ningbo-metro"') < html.index('id="provenance"')


def test_the_page_tells_what_was_run_and_how_to_run_it_again(html: str, results: Results) -> None:
    environment = results.manifest["environment"]
    for text in ("railstate run --runs 24 --seed 5", environment["processor"], "6 settings, 23 entries, 24 runs each, "
                 "seed 5, 936 rows: 910 ok, 24 infeasible, 2 diverged", f"numpy {environment['packages']['numpy']}",
                 "Note on switching &amp; &lt;its&gt; numbers.", "&lt;no certificate&gt;",
                 "railstate replay cbtc-csma/uniform/direct/3 --out"):
        assert text in html, text
    for label in {*METRO, *CBTC, *BRAKING}:
        assert f">{label}" in html


def test_the_matrix_says_the_verdict_of_the_entry_that_stands_for_a_family(results: Results) -> None:
    cells = [cell for found in results.scenarios.values() for cell in found]
    made = matrix(cells)
    assert made.families == ["Other"]  # these rows' plug-ins tell no family
    for row, cell in zip(made.rows, cells, strict=True):
        best = cell.rankings[0].best
        shown = row.cells["Other"][0]
        assert best and shown and (shown.text, shown.entry, shown.css) in (
            ("★ 1", best["estimator"], "best"), ("★ 1 ✕", best["estimator"], "best"))
        assert row.id == anchor(cell.scenario, cell.variant)
    assert made.tallies["Other"][0] == ("★= 6", [("best", 100.0)])
    against = made.rows[0].cells["Other"][2]  # against the yardstick, the first quantity: the best is the yardstick
    assert against and against.text == "◇ 1"
    lost = next(row for row in made.rows if row.variant == "table3").cells["Other"][0]
    assert lost and lost.text.endswith("✕")  # another entry of the family lost runs


def test_a_family_is_spoken_for_by_its_tuned_entry(results: Results) -> None:
    cell = replace(cell_of(results, "ningbo-metro/switching"),
                   origin={"estimators.ekf-inflated": "tuned: railstate tune .."})
    shown = matrix([cell]).rows[0].cells["Other"][0]
    assert shown and shown.entry == "ekf-inflated" and re.fullmatch(r"▲ 1\.1\d", shown.text)


def test_errors_claims_outcomes_and_lost_runs_of_a_table(results: Results) -> None:
    metro, uniform = cell_of(results, "ningbo-metro/switching"), cell_of(results, "cbtc-csma/uniform")
    by_label = {item["estimator"]: item for item in metro.of("error", "rmse", "position")}
    assert entry(metro, "ekf", "position value").html == wording.plus_minus(by_label["ekf"])
    assert [float(v) for v in entry(metro, "ukf", "position ratio").data.split("|")] == pytest.approx(
        [by_label["ukf"][name] for name in ("ratio", "ratio_low", "ratio_high")], rel=1e-5)
    assert "▲ worse" in str(entry(metro, "ekf-naive", "position verdict").html)
    assert 'class="c w3"' in str(entry(metro, "ekf-naive", "position verdict").html)
    assert "✗ too sure 9." in str(entry(metro, "ekf-naive", "claim").html)
    assert "✗ set broken" in str(entry(metro, "robust-ellipsoid", "claim").html)
    assert "✗ bound broken" in str(entry(uniform, "fastest-decay", "claim").html)
    assert entry(uniform, "kalman", "late violations").html == "6 of 24"
    assert entry(uniform, "direct", "lost").html == "1"
    assert "of 23" in str(entry(uniform, "direct", "position value").html)
    loose = replace(metro, lines=tuple(dict(item, verdict="not certified") if item["kind"] == "consistency" else item
                                       for item in metro.lines))
    assert "– not certified 1.0" in str(entry(loose, "ekf", "claim").html)
    assert "undecided, 4 not certified." in sentences.over_all([loose], 24)[1]
    braking = cell_of(results, "braking-rate/paper")
    assert "○ oracle" in str(entry(braking, "kalman-known-f", "f verdict").html)
    assert braking.labels[-1] == "kalman-known-f"
    folder = results.scenarios["cbtc-csma"]
    assert [replay for _, _, replay in failures(folder[0], "out")] == [
        "railstate replay cbtc-csma/uniform/direct/3 --out out"]
    assert {what for what, _, _ in failures(folder[1], "out")} == {"direct: diverged in 1 run",
                                                                   "fastest-decay: infeasible in 24 runs"}


def test_faults_by_filters_where_a_folder_has_them(results: Results) -> None:
    cells = results.scenarios["ningbo-metro"]
    assert fault_table(cells) is None
    made = fault_table([replace(cells[0], table={"faults": [{"kind": "outliers"}, {"kind": "stuck"}]}), cells[1]])
    assert made and [entries[0].html for _, entries in made.lines] == ["outliers, stuck", "none"]
    assert "★ 1" in str(made.lines[0][1][1 + cells[0].labels.index("ekf")].html)
    both = fault_table([replace(cell, table={"faults": [{"kind": "outliers", "share": share}]})
                        for cell, share in zip(cells, (0.1, 0.3), strict=False)])
    assert both and [entries[0].html for _, entries in both.lines] == [
        "outliers 10 %", "outliers 30 %", "breaks down at outliers of"]
    assert both.lines[-1][1][1 + cells[0].labels.index("ekf")].html in ("none up to 30 %", "30 %")


def test_published_numbers_stand_by_readings_with_their_notes_once() -> None:
    def at(reading: str, ours: float | None, verdict: str, stands: bool = False) -> dict[str, object]:
        return {"reading": reading, "stands": stands, "ours": ours, "standard_error": 0.01 if ours else None,
                "low": None, "high": None, "verdict": verdict}

    cells = [{"cell": "a", "published": 1.0, "unit": "m", "verdict": "fitted",
              "entries": [at("printed", 1.01, "fitted", True), at("mended", 2.0, "not reproduced")]},
             {"cell": "b", "published": 2.0, "unit": "m", "verdict": "unreachable", "entries": [
                 at("printed", None, "unreachable", True)]}]
    paper, = papers({"papers": [{"name": "p", "title": "T", "authors": "A", "year": 2000, "reference": "R",
                                 "stands": "printed", "why": "", "readings": {"printed": "as printed", "mended": "m"},
                                 "groups": [{"group": "Table 1", "note": "n", "cells": cells}]}]})
    assert paper.counts == [("fitted", 1), ("unreachable", 1)]
    with pytest.raises(InputError, match=r"not as railstate reproduce writes them"):
        papers({"papers": [{"name": "p"}]})
    assert sentence([paper]) == "Of 2 published numbers: 1 fitted, 1 unreachable."
    assert paper.table.notes == ["printed: as printed.", "mended: m.", "1: n"]
    (name, entries), (_, second) = paper.table.lines
    assert name == "Table 1: a" and entries[1].html == "1.010 ± 0.020" and "✗ 2.000" in str(entries[5].html)
    assert second[1].html == "" and "– unreachable" in str(second[3].html)


def test_the_command_writes_the_page_again_from_the_folder_alone(results: Results, html: str,
                                                                 capsys: pytest.CaptureFixture[str]) -> None:
    report(str(results.folder), published="")
    assert "report.html (0." in capsys.readouterr().out
    assert (results.folder / "report.html").read_text(encoding="utf-8") == html


def test_what_is_no_results_folder_is_an_input_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no manifest\.json"):
        report(str(tmp_path))
    folder = write_results(tmp_path / "run", keep=False)
    (folder / "timing.csv").write_text("scenario,variant\n")
    with pytest.raises(InputError, match=r"timing\.csv: damaged"):
        report(str(folder))
    (folder / "timing.csv").unlink()
    report(str(folder))
    for part in (folder / "rows").iterdir():
        part.unlink()
    with pytest.raises(InputError, match="no finished rows"):
        report(str(folder))
    assert Store(folder).manifest()["railstate"]
