"""A variant's table on the page and the table of faults by filters, of verdict lines made by hand: every cell's words,
the numbers behind it, notes."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from railstate.benchmarks.telling.figures.data import CellResults, Results
from railstate.benchmarks.telling.report import sections
from railstate.benchmarks.telling.report.sections import Table

from .test_worded import A, B, C, D, E, full, line, lost


def words(table: Table) -> dict[str, dict[str, tuple[str, str]]]:
    """By entry and column its words, signs of HTML left out, and its numbers."""
    heads = [re.sub("<[^>]*>", " ", str(head)) for head, _, _ in table.heads]
    return {label: {head: (re.sub("<[^>]*>", "", str(entry.html)), entry.data)
                    for head, entry in zip(heads, entries, strict=True) if entry.html}
            for label, entries in table.lines}


def share(estimator: str, value: float, runs: int = 40, **facts: Any) -> dict[str, Any]:
    return {**line(estimator, value, 0.05, kind="requirement", metric="kept", quantity="near", against="0.95"),
            "runs": runs, "note": "P95 over runs: 2 m", **facts}


def test_every_column_of_a_variant() -> None:
    nees = {"kind": "consistency", "metric": "nees", "quantity": "state"}
    lines = [
        {**A, "note": "one run carries 22 % of the mean"}, B, C, D, E,
        line("o", 0.005, 0.0001, verdict="oracle"), line("n", 0.03, 0.0),
        share("a", 0.975, verdict="met"), share("b", 0.9, verdict="undecided", note="", deciding=320.0),
        share("c", 0.9, verdict="undecided", deciding=np.inf), share("d", 0.9, verdict="undecided", deciding=41.0),
        share("a", 0.5, metric="inside", quantity="often", against="0.5", verdict="not met", note=""),
        line("a", 1.03, 0.1, **nees, verdict="consistent", median=0.98, inside=0.949),
        line("b", 9.0, 0.1, **nees, verdict="too sure", median=np.nan, inside=np.nan),
        line("c", 1.0, 0.1, **nees, verdict="", median=1.0, inside=1.0),
        line("d", **nees, runs=0, median=2.0, inside=0.5),
        line("b", 0.9, kind="claim", metric="coverage", verdict="broken"),
        line("b", 0.9, kind="claim", metric="bound", verdict="undecided"),
        line("a", 1.1, kind="consistency", metric="nis", quantity="innovation", verdict="too cautious"),
        line("b", 20.0, 0.5, kind="value", metric="headway", quantity="headway-65", shown_unit="s", factor=1.0),
        line("a", 0.25, 0.1, kind="share", metric="violations", quantity="late", shown_unit="", factor=1.0),
        *(lost(label, 40 * (label == "e")) for label in "abcdeon")]
    told = {label: {"plugin": "ekf", "parameters": {"q": 0.5}} if label == "a" else {"plugin": label} for label in "ab"}
    timing = {label: {"latency_us_median": taken} for label, taken in (("a", 12.0), ("b", np.nan), ("e", 9.0))}
    timing["c"] = {}
    found = sections.table(replace(full(), lines=tuple(lines), entries=told, timing=timing))
    assert [label for label, _ in found.lines] == [*"abcdeon"]
    assert [(re.sub("<[^>]*>", " ", str(head)), data, right) for head, data, right in found.heads] == [
        ("position", "position verdict", False), ("RMSE [cm]", "position value|position low|position high", True),
        ("ratio", "position ratio|position ratio low|position ratio high", True),
        ("eff.", "position efficiency", True), ("near in 95 % of the runs", "near kept|near low|near high", False),
        ("often in 50 % of the time", "often kept|often low|often high", False), ("claim", "claim", False),
        ("headway-65 [s]", "headway-65|low|high", True), ("late violations", "late violations|low|high", True),
        ("lost", "lost", True), ("step [µs]", "step us", True),
        ("median, inside 95 %", "nees median|nees inside", True), ("NIS", "nis", False),
        ("differs by", "differs by", False)]
    assert words(found) == {
        "a": {"position": ("★ best", ""), "RMSE [cm]": ("1.000 ± 0.050 †", "1|0.95|1.05"), "ratio": ("1", "1|1|1"),
              "eff.": ("90.0 %", "0.9"), "near in 95 % of the runs": ("✓ 39/40 [92.5, 102] %", "0.975|0.925|1.025"),
              "often in 50 % of the time": ("✗ 50 % [45.0, 55.0] %", "0.5|0.45|0.55"),
              "claim": ("✓ consistent 1.03", ""), "late violations": ("10 of 40", "0.25|0.15|0.35"), "lost": ("0", ""),
              "step [µs]": ("12.0", "12"), "median, inside 95 %": ("0.980, 94.9 %", "0.98|0.949"),
              "NIS": ("✗ 1.10", "1.1"), "differs by": ("ekf, q = 0.5", "")},
        "b": {"position": ("? undecided", ""), "RMSE [cm]": ("1.010 ± 0.050", "1.01|0.96|1.06"),
              "ratio": ("1.01 [0.98, 1.05]", "1.01|0.98|1.05"), "eff.": ("89 %", "0.891"),
              "near in 95 % of the runs": ("? 36/40 [85.0, 95.0] %", "0.9|0.85|0.95"),
              "claim": ("✗ too sure 9.00 ✗ set broken ? bound", ""), "headway-65 [s]": ("20.00 ± 0.50", "20|19.5|20.5"),
              "lost": ("0", "")},
        "c": {"position": ("? undecided", ""), "RMSE [cm]": ("1.020 ± 0.050", "1.02|0.97|1.07"),
              "ratio": ("1.02 [0.97, 1.09]", "1.02|0.97|1.09"), "eff.": ("0 %", "0"),
              "near in 95 % of the runs": ("? 36/40 [85.0, 95.0] %", "0.9|0.85|0.95"), "claim": ("? 1.00", ""),
              "lost": ("0", ""), "median, inside 95 %": ("1.00, 100 %", "1|1")},
        "d": {"position": ("▲ worse", ""), "RMSE [cm]": ("2.00 ± 0.10", "2|1.9|2.1"),
              "ratio": ("2.00 [1.80, 2.20]", "2|1.8|2.2"), "lost": ("0", ""),
              "near in 95 % of the runs": ("? 36/40 [85.0, 95.0] %", "0.9|0.85|0.95"),
              "median, inside 95 %": ("2.00, 50 %", "2|0.5")},
        "e": {"position": ("✕ lost", ""), "ratio": ("40 lost", ""), "lost": ("40", "")},
        "n": {"RMSE [cm]": ("3.00", "3|3|3"), "lost": ("0", "")},
        "o": {"position": ("○ oracle", ""), "RMSE [cm]": ("0.500 ± 0.010", "0.5|0.49|0.51"), "lost": ("0", "")}}
    assert found.notes == ["near, 95th percentiles over the runs: a 2 m; c 2 m; d 2 m.",
                           "near: what is undecided, about 320 runs or 50 runs would decide.",
                           "† one run carries more than 20 % of the mean square."]
    assert {label: [entry.right for entry in entries][:4] for label, entries in found.lines if label in "abd"} == {
        "a": [False, True, True, True], "b": [False, True, True, True], "d": [False, True, True, False]}


def variants(results: Results, *given: tuple[list[dict[str, Any]], list[dict[str, Any]]]) -> list[CellResults]:
    cell = results.scenarios["ningbo-metro"][0]
    return [replace(cell, variant=f"v{place}", lines=tuple(lines), table={"faults": faults} if faults else {})
            for place, (faults, lines) in enumerate(given)]


def against(estimator: str, value: float, **facts: Any) -> dict[str, Any]:
    word = "best" if value == 1 else "worse"
    return line(estimator, value / 100, 0.0005, ratio=value, ratio_low=value, ratio_high=value, verdict=word, **facts)


def outliers(percent: float, **facts: Any) -> dict[str, Any]:
    return {"kind": "outliers", "share": percent / 100, **facts}


def test_faults_by_filters(results: Results) -> None:
    """Broken down over twice the best, not at it; locked or lost as well; one-sided outliers and others do not tell."""
    locked = line("b", 0.1, kind="share", metric="locked", quantity="position")
    never = line("a", 0.0, kind="share", metric="locked", quantity="position")
    back = {"kind": "value", "metric": "recovery", "quantity": "position", "unit": "s", "factor": 1.0}
    gone = line("d", runs=0, lost=40, verdict="lost", eligible=False)
    cells = variants(
        results, ([], [against("a", 1.0), against("b", 1.5), against("c", 9.0), gone]),
        ([outliers(2)], [against("a", 1.0), against("b", 2.0), against("c", 2.1), gone]),
        ([outliers(10, sign="both")], [against("a", 1.0), against("b", 1.2), locked, never, against("c", 3.0),
                                         line("a", 4.0, **back), line("b", 6.5, **back), line("c", runs=0, **back),
                                         line("o", 0.001, verdict="oracle", ratio=0.1)]),
        ([outliers(1, sign="up")], [against("a", 1.0), against("b", 50.0)]),
        ([outliers(1), {"kind": "dropout"}], [against("a", 1.0), against("b", 50.0), line("c", 0.1)]),
        ([{"kind": "bias"}, {"kind": "bias"}], []))
    found = sections.fault_table(cells)
    assert found is not None and found.heads == [(name, name, False) for name in ("faults", *"abcdo")]
    dot = ("·", "")
    shown = {label: [(re.sub("<[^>]*>", "|", str(entry.html)).strip("|"), entry.data) for entry in entries]
             for label, entries in found.lines}
    assert shown == {
        "v0": [("none", ""), ("★ 1", "1"), ("▲ 1.50", "1.5"), ("▲ 9.00", "9"), ("✕ 40 lost", ""), dot],
        "v1": [("outliers 2 %", ""), ("★ 1", "1"), ("▲ 2.00", "2"), ("▲ 2.10", "2.1"), ("✕ 40 lost", ""), dot],
        "v2": [("outliers 10 %", ""), ("★ 1||4.00 s back", "1"), ("▲ 1.20||10 % locked, 6.50 s back", "1.2"),
               ("▲ 3.00", "3"), dot, ("○ ", "0.1")],
        "v3": [("outliers 1 %", ""), ("★ 1", "1"), ("▲ 50.0", "50"), dot, dot, dot],
        "v4": [("outliers 1 %, dropout", ""), ("★ 1", "1"), ("▲ 50.0", "50"), dot, dot, dot],
        "v5": [("bias", ""), dot, dot, dot, dot, dot],
        "all shares": [("breaks down at outliers of", ""), ("none up to 10 %", "1"), ("10 %", "0.1"), ("2 %", "0.02"),
                       ("2 %", "0.02"), ("none up to 10 %", "1")]}
    one = sections.fault_table([cells[0], cells[2]])
    assert one is not None and [label for label, _ in one.lines] == ["v0", "v2"]
    assert sections.fault_table(cells[:1]) is None and sections.fault_table([]) is None


@pytest.mark.parametrize(("value", "data"), [((1.0, np.nan, 2.5), "1||2.5"), ((1e-7,), "1e-07"), ((), "")])
def test_saved_numbers(value: tuple[float, ...], data: str) -> None:
    assert sections._data(*value) == data


def test_lost_runs_of_a_variant(results: Results) -> None:
    """Each kind by estimator, status and reason, with the line that replays its first run."""
    cell = results.scenarios["cbtc-csma"][0]
    rows = cell.rows[cell.rows["run"] < 3].copy()
    rows["status"] = ["ok", "failed", "failed", "crashed", "failed", "failed", *["ok"] * (len(rows) - 6)]
    rows["reason"] = ["", "a <b>", "a <b>", "", None, np.nan, *[""] * (len(rows) - 6)]
    labels = list(rows["estimator"])
    found = sections.failures(replace(cell, rows=rows), "DIR")
    replay = f"railstate replay {cell.key}"
    assert found == [(f"{labels[1]}: failed in 2 runs", "a <b>", f"{replay}/{labels[1]}/1 --out DIR"),
                     (f"{labels[3]}: crashed in 1 run", "no reason given", f"{replay}/{labels[3]}/0 --out DIR"),
                     (f"{labels[4]}: failed in 2 runs", "no reason given", f"{replay}/{labels[4]}/1 --out DIR")]
