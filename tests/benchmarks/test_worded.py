"""Whole tables and sentences of hand-made verdict lines, word by word, and where the page's panels draw them.

Every number is written down here; nothing is simulated or judged."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from railstate.benchmarks.commands.tune import _remarks
from railstate.benchmarks.telling import sentences
from railstate.benchmarks.telling.estimators import record
from railstate.benchmarks.telling.figures.data import assign_styles
from railstate.benchmarks.telling.figures.swept import over_key
from railstate.benchmarks.telling.markup import to_latex, to_markdown
from railstate.benchmarks.telling.rankings import Cell, Ranking, cells_of
from railstate.benchmarks.telling.report import plots
from railstate.benchmarks.telling.report.matrix import View, _tally
from railstate.benchmarks.telling.report.tuned import tuned_table
from railstate.benchmarks.telling.sentences import finding, least, short_finding
from railstate.benchmarks.telling.tables import cell_table, outage_tables, phase_tables, window_tables
from railstate.benchmarks.telling.wording import change

ABOUT = {"variants": {"v": {"title": "calm", "notes": []}}, "quantities": ["position"],
         "table": [["rmse", "position"], ["nees", "state"], ["headway", "headway-65"], ["violations", "late"]]}


def line(estimator: str, value: float = np.nan, half: float = 0.0, **facts: Any) -> dict[str, Any]:
    """A line of the verdict table of 40 runs."""
    nothing = dict.fromkeys(("ratio", "ratio_low", "ratio_high", "efficiency", "floor", "deciding", "won"), np.nan)
    return {"scenario": "s", "variant": "v", "kind": "error", "metric": "rmse", "quantity": "position", "unit": "m",
            "shown_unit": "cm", "factor": 100.0, "estimator": estimator, "value": value, "low": value - half,
            "high": value + half, "runs": 40, "lost": 0, "against": "a", "verdict": "none", "eligible": True,
            "family": 4, "floor_kind": "", "note": "", **nothing, **facts}


def ratio(value: float, low: float, high: float, verdict: str) -> dict[str, Any]:
    return {"ratio": value, "ratio_low": low, "ratio_high": high, "verdict": verdict}


def lost(estimator: str, number: int = 0) -> dict[str, Any]:
    return line(estimator, number / 40, kind="reliability", metric="lost", quantity="runs", lost=number)


A, B, C, D = (
    line("a", 0.01, 0.0005, **ratio(1.0, 1.0, 1.0, "best"), floor=0.009, efficiency=0.9),
    line("b", 0.0101, 0.0005, **ratio(1.01, 0.98, 1.05, "undecided"), floor=0.009, efficiency=0.891, deciding=320.0),
    line("c", 0.0102, 0.0005, **ratio(1.02, 0.97, 1.09, "undecided"), floor=0.0, efficiency=0.0),
    line("d", 0.02, 0.001, **ratio(2.0, 1.8, 2.2, "worse")))
E = line("e", runs=0, lost=40, verdict="lost", eligible=False)


def cell(*lines: dict[str, Any], timing: dict[str, Any] | None = None) -> Cell:
    return Cell("s", "v", lines, ABOUT, {}, {}, {}, frozenset(), timing or {})


def full() -> Cell:
    rest = [line("a", 1.03, kind="consistency", metric="nees", quantity="state", verdict="consistent"),
            line("d", kind="claim", metric="bound", quantity="performance", verdict="kept"),
            *(line(label, 0.9, 0.05, kind="requirement", metric="kept", quantity="near", verdict="met")
              for label in "ab"),
            line("b", 20.0, 0.5, kind="value", metric="headway", quantity="headway-65", shown_unit="s", factor=1.0),
            *(lost(label, 40 * (label == "e")) for label in "abcde")]
    return cell(A, B, C, D, E, *rest, timing={label: {"latency_us_median": 12.0} for label in "ade"})


def test_a_cell_as_a_table() -> None:
    """A floor of 0 is no efficiency; who lost every run has no time of a step; what only one entry has is there."""
    assert cell_table(full()).to_dict("list") == {
        "entry": list("abcde"),
        "position": ["best", "undecided", "undecided", "worse", "lost"],
        "RMSE position [cm]": ["1.000 ± 0.050", "1.010 ± 0.050", "1.020 ± 0.050", "2.00 ± 0.10", ""],
        "position: ratio": ["1", "1.01 [0.98, 1.05]", "1.02 [0.97, 1.09]", "2.00 [1.80, 2.20]", ""],
        "position: eff.": ["90.0 %", "89 %", "", "", ""],
        "claim (ANEES)": ["consistent 1.03", "", "", "", ""],
        "requirement near": ["met 90.0 % [85.0, 95.0]", "met 90.0 % [85.0, 95.0]", "", "", ""],
        "headway headway-65 [s]": ["", "20.00 ± 0.50", "", "", ""],
        "lost": ["", "", "", "", "40 of 40"],
        "step [µs]": ["12.0", "", "", "12.0", ""],
        "claim (bound)": ["", "", "", "kept", ""]}


def test_errors_by_window_and_by_outage() -> None:
    manifest = {"scenarios": {"s": {"quantities": ["position"]}}}
    names = ("position", "position-open", "position-tunnel")
    table = pd.DataFrame([line(label, value, 0.0012, kind="value", quantity=name) for name, values in zip(
        names, ((0.1, 0.2), (0.01, 0.02), (0.3, 0.4)), strict=True) for label, value in zip("ab", values, strict=True)])
    (title, frame), = window_tables(table, manifest)
    assert title == "s/v: rmse of position [cm] by window"
    assert frame.to_dict("list") == {"window": ["open", "tunnel"], "a": ["1.00 ± 0.12", "30.00 ± 0.12"],
                                     "b": ["2.00 ± 0.12", "40.00 ± 0.12"]}
    assert list(window_tables(table[table["quantity"] != "position-open"], manifest)) == []  # one window is no table
    both = pd.concat([table.assign(scenario="z"), table])
    of = {"scenarios": dict.fromkeys("sz", manifest["scenarios"]["s"])}
    assert [title[:3] for title, _ in window_tables(both, of)] == ["z/v", "s/v"]  # as the rows have them
    assert list(phase_tables(table, manifest)) == []
    table["quantity"] = table["quantity"].str.replace("open", "coasting").str.replace("tunnel", "braking")
    (title, frame), = phase_tables(table, manifest)
    assert title == "s/v: rmse of position [cm] by phase" and list(window_tables(table, manifest)) == []
    assert frame.to_dict("list") == {"entry": ["a", "b"], "coasting": ["1.00 ± 0.12", "2.00 ± 0.12"],
                                     "braking": ["30.00 ± 0.12", "40.00 ± 0.12"]}
    rows = pd.DataFrame({"scenario": "s", "variant": "v", "estimator": ["b", "b", "a", "a"],
                         "begin:outage:s": [90.0, 30.0] * 2, "rmse:position-outage-end:m": [4.0, 3.0, 2.0, 1.0]})
    (key, frame), = outage_tables(rows)
    assert (key, frame.to_dict("list")) == ("s/v", {"outage begins [s]": [30.0, 90.0], "b": [3.0, 4.0],
                                                    "a": [1.0, 2.0]})


def test_a_finding_in_short_and_in_full() -> None:
    made = full()
    assert short_finding(made, made.rankings[0]) == (
        "Position: best a; undecided b (+1.0 %, 320 runs), c; worse 1 of 5, d 2.0 times; lost e 40 of 40; floor 0.900 "
        "cm, best at 90.0 % of it.")
    assert finding(made, made.rankings[0]) == (
        "Position: least RMSE 1.000 ± 0.050 cm (a, 40 runs). Undecided: b (+1.0 % [−2.0, +5.0]; about 320 runs would "
        "decide), c (+2.0 % [−3.0, +9.0]). Worse: 1 of 5, d (2.0 times [1.8, 2.2]). Lost runs: e 40 of 40; ranked "
        "after every entry that finished. Floor 0.900 cm: a reaches 90.0 %.")
    none = cell(E, lost("e", 40))
    assert short_finding(none, none.rankings[0]) == "Position: no entry finished a run."


def test_what_of_smoothers_and_of_none_that_finished_is_said() -> None:
    smooth = line("s", 0.005, 0.0001, **ratio(1.0, 1.0, 1.0, "best"), against="s")
    both = Ranking.of([A, D, smooth], {"s"})
    made = replace(cell(A, D, smooth, *map(lost, "ads")), smoothers=frozenset("s"))
    assert short_finding(made, both) == (
        "Position: best a; worse 1 of 2, d 2.0 times; floor 0.900 cm, best at 90.0 % of it; of the smoothers s.")
    assert least(both) == "RMSE of position: a has the least, 1.00 cm."
    none = Ranking.of([E])
    assert finding(cell(E, lost("e", 40)), none) == "Position: no entry finished a run."
    assert least(none) == "RMSE of position: no entry finished a run."
    assert [change({"ratio": value}) for value in (np.nan, np.inf, 2.0, 1.995, 1.0, 0.9)] == [
        "–", "∞", "2.0 times", "+100 %", "±0.0 %", "−10 %"]
    endless = replace_all(A, B, ratio=np.inf)
    assert plots._ratios(Ranking.of([A, B]), endless, 10) == "" == plots._ratios(none, [E], 10)


@pytest.mark.parametrize(("n", "compared"), [((1, 1, 1, 1), "4 comparisons"), ((2, 2, 2, 2), "8 comparisons"),
                                             ((1, 0, 0, 0), "1 comparison"), ((0, 1, 2, 0), "3 comparisons")])
def test_numbers_of_words_over_a_folder(n: tuple[int, ...], compared: str, monkeypatch: pytest.MonkeyPatch) -> None:
    worse, tie, undecided, gone = n
    claims = {"claim too sure": n[0], "claim too cautious": n[1], "claim consistent": n[2], "claim not certified": n[3]}
    found = {"worse": worse, "tie": tie, "undecided": undecided, "lost": gone, "rows": 12345, "lost runs": 1234}
    monkeypatch.setattr(sentences, "counts", lambda cells: Counter({**found, **claims}))
    first, second = sentences.over_all([], worse)
    assert first == (
        f"At {worse} {'run' if worse == 1 else 'runs'}, of {compared} with the best of their setting {worse} "
        f"{'is' if worse == 1 else 'are'} worse, {tie} {'ties' if tie == 1 else 'tie'} within 1 % and {undecided} "
        f"{'is' if undecided == 1 else 'are'} undecided{f'; {gone} lost runs' if gone else ''}.")
    assert second == ("Lost runs: 1,234 of 12,345. "
                      f"Of {sum(n)} covariance {'claim' if sum(n) == 1 else 'claims'} {n[0]} "
                      f"{'is' if n[0] == 1 else 'are'} too sure, {n[1]} too unsure, {n[2]} consistent, 0 undecided"
                      f"{f', {n[3]} not certified' if n[3] else ''}.")
    monkeypatch.setattr(sentences, "counts", lambda cells: Counter(found))
    assert sentences.over_all([], 1)[1] == "Lost runs: 1,234 of 12,345."


@pytest.mark.parametrize(("families", "said"), [
    ((1, 1), "± is half of the 95 % interval. "), ((0,), "± is half of the 95 % interval. "),
    ((2, 1), "± and [ ] are 95 %: ± of the entry alone, [ ] of the ratio to the best over the same runs, simultaneous "
             "over all pairs of the 2 entries; the verdict follows [ ]. ")])
def test_what_a_table_s_signs_mean(families: tuple[int, ...], said: str) -> None:
    found = sentences.caption(cell(*({**A, "family": family} for family in families), lost("a")))
    assert found == f"{said}40 runs."


def replace_all(*lines: dict[str, Any], **facts: Any) -> list[dict[str, Any]]:
    return [{**one, **facts} for one in lines]


@pytest.mark.parametrize(("facts", "said"), [
    ({"floor": 0.0105, "efficiency": 1.05}, "Floor 1.05 cm: a reaches 105.0 % (over 100 % by chance)."),
    ({"floor": 0.0105, "efficiency": 1.05, "floor_kind": "linear optimum"},
     "Linear optimum 1.05 cm: a reaches 105.0 % (its interval covers it)."),
    ({"floor": 0.0098, "efficiency": 0.98}, "Floor 0.980 cm: a reaches 98.0 % (its interval covers it)."),
    ({"floor": 0.005, "efficiency": 0.5, "floor_kind": "linear optimum"}, "Linear optimum 0.500 cm: a reaches 50 %.")])
def test_how_near_the_best_comes_to_the_floor(facts: dict[str, Any], said: str) -> None:
    made = cell({**A, **facts}, D, lost("a"), lost("d"))
    assert finding(made, made.rankings[0]).endswith(f" {said}")


def test_a_cell_of_one_entry() -> None:
    made = cell(A, lost("a"), line("a", 20.0, kind="value", metric="headway", quantity="headway-65", shown_unit="s"))
    assert cell_table(made).columns.tolist() == ["entry", "position", "RMSE position [cm]", "position: ratio",
                                                 "position: eff.", "headway headway-65 [s]"]
    assert [found.key for found in cells_of(pd.DataFrame([A]), {"scenarios": {"s": ABOUT}, "estimators": {}, "replay": {
        "cells": {"s/v": {"entries": {}, "table": {}}}}})] == ["s/v"]


def test_what_the_panels_draw_stands_beside_its_name_and_inside() -> None:
    """Each entry's sign, value, markers and words on one height in both panels; a margin of 6 % to both sides."""
    panels = plots.ranked(Ranking.of([A, B, C, D])).split("<svg")[1:]
    heights = [{round(float(y), 3) for y in found} for found in (
        [float(y) - 4 for y in re.findall(r'<text y="([\d.]+)">.<', panels[0])],
        [float(y) - 4 for y in re.findall(r'<text y="([\d.]+)">[\d.]', panels[0])],
        re.findall(r'[\d.]+ ([\d.]+)H', "".join(re.findall(r'<path class="i[^>]*>', panels[0]))),
        re.findall(r'[\d.]+ ([\d.]+)m', "".join(re.findall(r'<path class="m[^>]*>', panels[0]))),
        [float(y) - 4 for y in re.findall(r'<text y="([\d.]+)">', panels[1])])]
    rows = {plots.TOP + plots.ROW * (i + 0.5) for i in range(4)}
    assert heights == [rows, rows, rows, rows, rows - {min(rows)}]  # the best has no word beside its ratio
    for panel in panels:
        width, height = map(int, re.search(r'viewBox="0 0 (\d+) (\d+)"', panel).groups())  # type: ignore[union-attr]
        assert f'width="{width}" height="{height}"' in panel
        places = re.findall(r'M([\d.]+) ([\d.]+)', panel)
        assert places and all(0 <= float(x) <= width and 0 <= float(y) <= height for x, y in places)
        texts = [float(text) for text in re.findall(r'<text x="[^>]*>([\d.]+)<', panel.split('"t"')[1])]
        assert 2 <= len(texts) <= 5 and texts == sorted(texts)
    narrow, wide, one = (plots._scale(values, 4.0) for values in ([2.0, 3.0], [1.0, 10.0], [5.0]))
    assert (narrow.low, narrow.high, narrow.log) == (pytest.approx(1.94), pytest.approx(3.06), False)
    assert (wide.low, wide.high, wide.log) == (pytest.approx(10**-0.04), pytest.approx(10**1.04), True)
    assert (one.low, one.high) == (pytest.approx(4.5), pytest.approx(5.5))
    assert plots._ticks(narrow) == [2.0, 2.5, 3.0]


def test_a_tally_of_a_column_and_the_shares_of_its_bar() -> None:
    words = ["best", "worse", "tie", "reference", "worse", "undecided", "lost", "better"]
    views = [View("", "", "", None, word) for word in words]
    assert _tally([*views, None]) == ("★= 2 ▼ 1 ◇ 1 ? 1 ▲ 2 ✕ 1", [
        ("best", 25.0), ("tie", 12.5), ("outline", 12.5), ("open", 12.5), ("w2", 25.0), ("lost", 12.5)])
    assert _tally([views[1], None, views[1]]) == ("▲ 2", [("w2", 100.0)]) and _tally([None]) == ("", [])


def test_what_a_search_has_to_say() -> None:
    fine, lost, over = {"loss": 1.0, "broken": 0.0}, {"loss": None, "broken": None}, {"loss": None, "over": True}
    found = SimpleNamespace(found=SimpleNamespace(edge=["a", "b"]), kept=True, limit=1.25, evaluations=[
        fine, lost, lost, over, {"loss": 1.0, "broken": 0.1}, {"loss": 2.0, "broken": None}, {"loss": 2.0}])
    edges = [f"the optimum of {key} lies at a limit of the search: it may be better beyond" for key in "ab"]
    assert _remarks(found) == [  # pyright: ignore[reportArgumentType]
        *edges, "none is better than the untuned entry, which stays",
        "1 evaluations took more than 1.25 s and were given up", "2 evaluations ended infeasible or with lost runs",
        "3 evaluations broke --subject-to", ""]
    found.found.edge, found.kept, found.evaluations = [], False, [fine]
    assert _remarks(found) == []  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(("key", "x"), [([1.0, 2.0], [1.0, 2.0]), ([0.0, 100.0], [0.0, 100.0]),
                                        (["low", "high"], [0, 1])])
def test_a_metric_over_a_swept_key(key: list[Any], x: list[float]) -> None:
    """Marks where the numbers are, words side by side in the order of the sweep."""
    part = pd.DataFrame([{**line(label, value, 0.001), "k": at} for label, values in (("a", (0.01, 0.02)), (
        "b", (0.03, np.nan))) for at, value in zip(key, values, strict=True)])
    canvas = over_key(part, "k", "RMSE [cm]", assign_styles([["b", "c", "a"]]))
    root = ElementTree.fromstring(canvas.svg())
    said = [node.text for node in root.iter() if node.tag.endswith("title")]
    assert canvas.label == "RMSE [cm] over k" and [text for text in said if text and "=" in text] == [
        f"b, k = {x[0]:g}: 3", *(f"a, k = {at:g}: {value}" for at, value in zip(x, (1, 2), strict=True))]
    texts = [node.text for node in root.iter() if node.tag.endswith("text")]
    assert {"RMSE [cm]", "k", "a", "b"} <= set(texts) and "c" not in texts
    assert set(map(str, key)) <= set(texts) if isinstance(key[0], str) else "low" not in texts


def test_what_tuning_gained_as_a_table() -> None:
    """Train and test of the tuned entry, and what of the gap the entry before had as well."""
    found = {"a": {"plugin": "ekf", "parameters": {"q": 0.5}, "tuned": {
        "variant": "v", "untuned": "d", "train": {"rmse:position": (0.008, 0.016), "nees:state": (1.0, 1.0)}}},
        "d": {"plugin": "ekf", "tuned": {"variant": "another", "untuned": "d", "train": {"rmse:position": (1.0, 1.0)}}}}
    made = tuned_table([replace(full(), entries=found, origin={"estimators.a": "tuned: by hand"})])
    assert made is not None and [label for label, _ in made.lines] == ["v"] and made.notes == ["a: tuned: by hand"]
    assert [head for head, _, _ in made.heads] == ["entry", "was", "differs by", "error", "train", "test",
                                                   "test over train", "the same, before", "tuning adds"]
    (_, entries), = made.lines
    assert [(entry.html, entry.data) for entry in entries] == [
        ("a", ""), ("d", ""), ("ekf, q = 0.5", ""), ("RMSE position [cm]", ""), ("0.8000", "0.8"),
        ("1.000 ± 0.050", "1|0.95|1.05"), ("+25.0%", "0.25"), ("+25.0%", "0.25"), ("+0.0%", "0")]
    assert [right for _, _, right in made.heads] == [entry.right for entry in entries]
    assert tuned_table([full()]) is None


def test_the_record_of_an_estimator_in_words() -> None:
    plugins = {label: {"plugin": "ekf" if label in "ade" else "other"} for label in "abcde"}
    assert record("ekf", [replace(full(), entries=plugins)]) == [
        "Least error, or tied with it, in 1 of 3 rankings: s/v position (a).",
        "Shown to be worse in 1, at the most 2.00 times the least error: s/v position (d).",
        "Lost runs in s/v (e, 40 of 40).", "Its claim, by entry and setting: consistent in 1, kept in 1."]
    assert record("other", [replace(full(), entries=plugins)]) == [
        "Least error, or tied with it, in 0 of 2 rankings.", "Undecided in 2."]
    assert record("nobody's", [replace(full(), entries=plugins)]) == []
    twice = [replace(full(), entries=plugins, variant=variant) for variant in ("v", "w", "x", "y")]
    assert record("ekf", twice)[:3] == [
        "Least error, or tied with it, in 4 of 12 rankings: s/v position (a), s/w position (a), s/x position (a) and 1 "
        "more.", "Shown to be worse in 4, at the most 2.00 times the least error: s/v position (d).",
        "Lost runs in s/v (e, 40 of 40), s/w (e, 40 of 40), s/x (e, 40 of 40) and 1 more."]


def test_a_table_for_files() -> None:
    frame = pd.DataFrame({"entry": ["a_b", "c"], "step [µs]": ["12.0", "1.5·10⁻⁵"], "ratio": ["1", "2.00 [1.8, 2.2]"]})
    assert to_latex("s/v & 5 %", frame, ["± is half.", "of a_b"]).splitlines() == [
        r"\begin{table}", r"\centering", r"\caption{s/v \& 5 \%}", r"\begin{tabular}{lrr}", r"\toprule",
        r"entry & step [$\mu$s] & ratio \\", r"\midrule", r"a\_b & 12.0 & 1 \\",
        r"c & 1.5$\cdot$10$^{-5}$ & 2.00 [1.8, 2.2] \\", r"\bottomrule", r"\end{tabular}",
        r"\par\footnotesize $\pm$ is half.", r"\par\footnotesize of a\_b", r"\end{table}"]
    assert to_markdown("s/v & 5 %", frame, ["± is half.", "a|b"]).splitlines() == [
        "## s/v & 5 %", "", "| entry | step [µs] | ratio |", "| --- | ---: | ---: |", "| a_b | 12.0 | 1 |",
        "| c | 1.5·10⁻⁵ | 2.00 [1.8, 2.2] |", "", "- ± is half.", r"- a\|b"]
