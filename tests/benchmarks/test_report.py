"""What people read: sentences, terminal and page say what the verdict table says, and nothing of their own.

The page is parsed here; a real browser opens it in `test_report_browser.py`."""

from __future__ import annotations

import io
import itertools
import json
import re
import time
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from railstate.benchmarks.commands.report import report
from railstate.benchmarks.judging.selection import Aligned
from railstate.benchmarks.store.folder import Store
from railstate.benchmarks.telling import console, sentences, wording
from railstate.benchmarks.telling.figures.data import Results, load_results
from railstate.benchmarks.telling.marks import ASCII, MARKS, drawn
from railstate.benchmarks.telling.rankings import Cell, Ranking
from railstate.benchmarks.telling.report import write_report
from railstate.benchmarks.telling.report.matrix import anchor, matrix
from railstate.benchmarks.telling.report.published import papers, sentence
from railstate.benchmarks.telling.report.sections import Entry, failures, fault_table, table
from railstate.benchmarks.telling.results import print_results, print_results_json
from railstate.scenarios.errors import InputError

from ..synthetic_results import BRAKING, CBTC, METRO, write_results


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    return load_results(write_results(tmp_path_factory.mktemp("report") / "run"))


@pytest.fixture(scope="module")
def html(results: Results) -> str:
    return write_report(results.folder).read_text(encoding="utf-8")


def cell_of(results: Results, key: str) -> Cell:
    return next(found.cell for cells in results.scenarios.values() for found in cells if found.key == key)


def entry(cell: Cell, label: str, head: str) -> Entry:
    made = table(cell)
    column = next(i for i, (_, name, _) in enumerate(made.heads) if name.startswith(head))
    return next(entries for name, entries in made.lines if name == label)[column]


# -- sentences -----------------------------------------------------------------------------------------------------
def test_every_number_of_a_finding_is_the_verdict_tables(results: Results) -> None:
    """Each sentence is taken apart; its numbers are looked up in the table and worded anew here."""
    for cells in results.scenarios.values():
        for found in cells:
            lines = results.verdicts[(results.verdicts["scenario"] == found.scenario)
                                     & (results.verdicts["variant"] == found.variant)
                                     & (results.verdicts["kind"] == "error")]
            for ranking in found.cell.rankings:
                mine = lines[(lines["metric"] == ranking.metric) & (lines["quantity"] == ranking.quantity)].set_index(
                    "estimator")
                text = sentences.finding(found.cell, ranking)
                value, half, best, runs = re.search(  # type: ignore[union-attr]
                    r"least [\w -]+? ([\d.]+) ± ([\d.]+)[^(]*\(([\w-]+), (\d+) runs\)", text).groups()
                row = mine.loc[best]
                assert row["verdict"] == "best" and int(runs) == row["runs"]
                digit = 0.51 * 10.0 ** -len(half.partition(".")[2])
                assert float(value) == pytest.approx(row["value"] * row["factor"], abs=digit)
                assert float(half) == pytest.approx((row["high"] - row["low"]) / 2 * row["factor"], abs=digit)
                for name, size, low, high in re.findall(r"([\w-]+) \(([+−\d.]+) % \[([+−\d.]+), ([+−\d.]+)\]", text):
                    shown = [float(number.replace("−", "-")) for number in (size, low, high)]
                    assert shown == pytest.approx([100 * (mine.loc[name, c] - 1) for c in (
                        "ratio", "ratio_low", "ratio_high")], abs=0.51)
                for name, size, low, high in re.findall(r"([\w-]+) \(([\d.]+) times \[([\d.]+), ([\d.]+)\]", text):
                    assert [float(size), float(low), float(high)] == pytest.approx(
                        [mine.loc[name, c] for c in ("ratio", "ratio_low", "ratio_high")], rel=0.06)
                counts = re.search(r"Worse: (\d+) of (\d+)", text)
                assert (int(counts[1]) if counts else 0) == (mine["verdict"] == "worse").sum()
                if counts:
                    assert int(counts[2]) == (~mine["verdict"].isin(["oracle", "none"])).sum()
                ties = re.search(r"Tied, within 1 %: ([\w, -]+)\.", text)
                assert (set(ties[1].split(", ")) if ties else set()) == set(mine.index[mine["verdict"] == "tie"])


def test_counts_over_a_folder_are_the_verdict_tables(results: Results) -> None:
    errors = results.verdicts[results.verdicts["kind"] == "error"]
    claims = results.verdicts[(results.verdicts["kind"] == "consistency") & (results.verdicts["metric"] == "nees")]
    first, second = sentences.over_all([c.cell for cells in results.scenarios.values() for c in cells], 24)
    compared, worse, ties, undecided, lost = map(int, re.findall(r"\d+", first.replace("1 %", ""))[1:6])
    words = [drawn(line) for line in errors.to_dict("records")]
    assert [worse, ties, undecided, lost] == [words.count(word) for word in ("worse", "tie", "undecided", "lost")]
    assert compared == worse + ties + undecided + lost
    assert f"Lost runs: {(results.rows['status'] != 'ok').sum()} of {len(results.rows)}." in second
    assert f"Of {len(claims)} covariance claims {(claims['verdict'] == 'too sure').sum()} are too sure" in second


def test_a_scenario_over_its_variants(results: Results) -> None:
    position, speed = sentences.over_variants([cell.cell for cell in results.scenarios["ningbo-metro"]])
    assert position == ("Position, 3 variants. Best or tied in 2: ekf, ukf; in 1: robust-mean-square. Worse in every "
                        "variant: ekf-inflated, robust-ellipsoid, ekf-naive.")
    assert speed.startswith("Speed, 3 variants.")
    assert sentences.over_variants([cell.cell for cell in results.scenarios["braking-rate"]]) == []


def test_claims_and_lost_runs_are_said(results: Results) -> None:
    told = sentences.claims_of(cell_of(results, "ningbo-metro/switching"))
    assert re.fullmatch(r"Claims: too sure 1 of 4, most ekf-naive \(ANEES 9\.\d+; 1 is right\)\. Too unsure: "
                        r"ekf-inflated\. robust-ellipsoid left its set in 1 of 24 runs\.", told)
    table3 = cell_of(results, "cbtc-csma/table3")
    said = sentences.finding(table3, table3.rankings[0])
    assert "Lost runs: fastest-decay 24 of 24; ranked after every entry" in said
    assert "exceeds its certified bound: 1." in sentences.claims_of(cell_of(results, "cbtc-csma/uniform"))


def test_who_is_worse_than_no_error_has_no_ratio(results: Results) -> None:
    cell = cell_of(results, "ningbo-metro/switching")
    lines = [dict(item, value=0.0, low=0.0, high=0.0) if item["verdict"] == "best" else
             dict(item, ratio=np.inf, ratio_low=np.inf, ratio_high=np.inf, verdict="worse")
             for item in cell.rankings[0].lines]
    exact = Ranking.of(lines)
    assert sentences.finding(cell, exact).startswith("Position: least RMSE 0 m (ekf, 24 runs). Worse: 5 of 6, than no "
                                                     "error at all: ukf,")
    assert "∞" not in sentences.finding(cell, exact) + sentences.short_finding(cell, exact)


def test_smoothers_are_told_apart_from_filters(results: Results) -> None:
    cell = cell_of(results, "ningbo-metro/switching")
    apart = [dict(item, estimator=f"s-{item['estimator']}", against="s-ekf", value=item["value"] / 2)
             for item in cell.rankings[0].lines if item["estimator"] in ("ekf", "ukf")]
    both = Ranking.of([*apart, *cell.rankings[0].lines], {"s-ekf", "s-ukf"})
    assert both.best and both.best["estimator"] == "ekf" and len(both.ranked) == 6
    said = sentences.finding(cell, both)
    assert said.startswith(sentences.finding(cell, cell.rankings[0]))
    assert re.search(r"Smoothers, ranked among themselves: least 0\.0\d+ ± 0\.0\d+ m \(s-ekf\)\.$", said)


def line(ratio: float, low: float = np.nan, high: float = np.nan, **facts: object) -> dict[str, object]:
    return {"ratio": ratio, "ratio_low": low, "ratio_high": high, "verdict": "worse", **facts}


def test_changes_ratios_and_long_lists() -> None:
    assert wording.change_interval(line(1.15, 1.0004, 1.31)) == "+15 % [+0.04, +31]"
    assert wording.change_interval(line(0.8, 0.7, 0.9)) == "−20 % [−30, −10]"
    assert wording.change_interval(line(2.0, 1.5, 2.6)) == "2.0 times [1.5, 2.6]"
    assert [wording.ratio(value) for value in (1.0, 1.0021, 1.29, 12.34, 345.6, 9.996)] == [
        "1.00", "1.00", "1.29", "12.3", "346", "10.0"]
    assert wording.ratio_of(line(1.0021)) == "1.002"  # called worse: not 1.00
    assert wording.ratio_interval(line(1.15, 1.002, 1.29)) == "[1.002, 1.29]"
    assert wording.some(["a", "b", "c", "d", "e"]) == "a, b, c, d, e"
    assert wording.some(["a", "b", "c", "d", "e", "f"]) == "a, b, c, d and 2 others"
    assert [wording.deciding({"deciding": runs}) for runs in (38, 12_345, 2e6, np.nan, np.inf)] == [
        "40 runs", "12,000 runs", "more than 100,000 runs", "", ""]
    assert wording.split_error(0.12345, 0.0021) == ("0.1235", "0.0021")
    assert wording.split_error(1.2e-7, 3e-9) == ("1.200·10⁻⁷", "0.030·10⁻⁷")
    assert [wording.capital(name) for name in ("position", "f", "x1")] == ["Position", "f", "x1"]


def test_runs_are_paired_by_their_number_and_only_those_that_all_have_count() -> None:
    frame = pd.DataFrame({"estimator": ["a", "a", "a", "b", "b"], "run": [0, 1, 2, 2, 0], "status": "ok",
                          "rmse:x:m": [1.0, 5.0, 3.0, 4.0, 2.0]})
    aligned = Aligned(frame)
    assert aligned.values("rmse:x:m").tolist() == [[1.0, 3.0], [2.0, 4.0]]
    assert (aligned.runs, aligned.left_out, aligned.labels) == (2, 1, ["a", "b"])


@pytest.mark.parametrize(("share", "text"), [(1.0, "100 %"), (0.0, "0 %"), (0.99996, "99.996 %"), (0.123, "12 %"),
                                             (0.0004, "0.04 %"), (0.067, "6.7 %"), (float("nan"), "–")])
def test_percentages_never_round_to_certainty(share: float, text: str) -> None:
    assert wording.percent(share) == text


@pytest.mark.parametrize(("value", "text"), [(0.1136, "0.114"), (158.914, "159"), (5160.4, "5160"), (1e-7, "1.00·10⁻⁷"),
                                             (0, "0"), (float("inf"), "∞"), (-2.5, "−2.50")])
def test_numbers_have_few_digits(value: float, text: str) -> None:
    assert wording.number(value) == text


# -- terminal ------------------------------------------------------------------------------------------------------
def printed(results: Results, monkeypatch: pytest.MonkeyPatch, encoding: str = "utf-8",
            columns: int | None = 80) -> str:
    raw = io.BytesIO()
    monkeypatch.setattr("sys.stdout", io.TextIOWrapper(raw, encoding=encoding, write_through=True))
    monkeypatch.delenv("COLUMNS", raising=False)
    if columns:
        monkeypatch.setenv("COLUMNS", str(columns))
    print_results(Store(results.folder))
    return raw.getvalue().decode(encoding)


@pytest.mark.parametrize(("columns", "most"), [(80, 80), (100, 100), (140, 120), (None, 120)])
def test_no_line_is_wider_than_the_output_and_names_stand_with_verdicts(
        results: Results, monkeypatch: pytest.MonkeyPatch, columns: int | None, most: int) -> None:
    text = printed(results, monkeypatch, columns=columns)
    long = [line for line in text.splitlines() if len(line) > most]
    assert not [line for line in long if str(results.folder) not in line]  # a path is not broken
    for label in METRO:
        assert re.search(rf"^{label} +[★=?▲✕] ", text, re.MULTILINE), label
    assert ("[" in text.split("RMSE position")[1].split("ukf ")[1].splitlines()[0]) == (most >= 100)
    assert text.count("★ best  = tie, within 1 %") == 1


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp1252"])
def test_signs_of_an_output_that_knows_few_letters(results: Results, monkeypatch: pytest.MonkeyPatch,
                                                   encoding: str) -> None:
    text = printed(results, monkeypatch, encoding)
    half = "+-" if encoding == "ascii" else "±"
    assert re.search(rf"^ekf +\* 0\.0\d+ {re.escape(half)}0\.\d+", text, re.MULTILINE)
    assert "x 24 of 24 lost" in text
    assert not re.search(r"\?[a-z0-9]", text.replace("? undecided", ""))
    assert max(len(line) for line in text.splitlines() if str(results.folder) not in line) <= 80


def test_every_sign_has_its_ascii_form_and_only_one_meaning_an_area() -> None:
    for mark in MARKS.values():
        for sign in mark.sign:
            assert sign.isascii() or ASCII[sign].isascii()
    verdicts = [MARKS[word].sign for word in ("best", "tie", "undecided", "better", "worse", "lost", "oracle")]
    assert len(set(verdicts)) == len(verdicts)


def test_lost_entries_have_no_value_and_the_command_is_there(results: Results, monkeypatch: pytest.MonkeyPatch,
                                                             capsys: pytest.CaptureFixture[str]) -> None:
    text = printed(results, monkeypatch)
    assert re.search(r"^fastest-decay +✕ 24 of 24 lost +✕ 24 of 24 lost$", text, re.MULTILINE)
    assert "railstate replay cbtc-csma/uniform/direct/3" in text
    assert "936 rows: 910 ok, 24 infeasible, 2 diverged" in text
    monkeypatch.undo()
    print_results_json(Store(results.folder))
    told = json.loads(capsys.readouterr().out)
    assert told["rows"] == 936 and len(told["verdicts"]) == len(results.verdicts)


def test_any_table_is_stacked_or_wrapped_at_the_outputs_width(monkeypatch: pytest.MonkeyPatch,
                                                               capsys: pytest.CaptureFixture[str]) -> None:
    frame = pd.DataFrame([{"estimator": f"an-entry-{i}", "about": "words " * 40,
                           **{f"metric {k}": f"{k}.{i}" for k in range(12)}} for i in (1, 2)])
    monkeypatch.setenv("COLUMNS", "80")
    console.print_table("A title", frame, ["A note of many words. " * 8])
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80
    assert sum(line.startswith("an-entry-1 ") for line in lines) > 1 and sum("11.2" in line for line in lines) == 1
    assert " ".join(lines).count("words") == 2 * 40 + 8


def test_a_log_gets_a_line_a_minute_and_quiet_none(monkeypatch: pytest.MonkeyPatch,
                                                   capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(console, "MINUTE", 0.02)
    for quiet in (False, True):
        console.hush(quiet)
        with console.progress(10, "rows") as advance:
            advance(4, "cart/calm")
            time.sleep(0.1)
        told = capsys.readouterr().err.splitlines()
        assert (told == []) == quiet
        assert all(line.startswith("0 min: 4/10 rows, cart/calm, about 0 min left") for line in told)
    console.hush(False)


# -- the page ------------------------------------------------------------------------------------------------------
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
    cells = [cell.cell for found in results.scenarios.values() for cell in found]
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
    assert "★ 1" in str(made.lines[0][1][1 + cells[0].cell.labels.index("ekf")].html)
    both = fault_table([replace(cell, table={"faults": [{"kind": "outliers", "share": share}]})
                        for cell, share in zip(cells, (0.1, 0.3), strict=False)])
    assert both and [entries[0].html for _, entries in both.lines] == [
        "outliers 10 %", "outliers 30 %", "breaks down at outliers of"]
    assert both.lines[-1][1][1 + cells[0].cell.labels.index("ekf")].html in ("none up to 30 %", "30 %")


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
