"""Sentences, numbers and shares in words: what they say is what the verdict table says, and nothing of their own."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest
from railstate.benchmarks.judging.selection import Aligned
from railstate.benchmarks.telling import sentences, wording
from railstate.benchmarks.telling.figures.data import Results
from railstate.benchmarks.telling.marks import MARKS, drawn, mark, shade
from railstate.benchmarks.telling.rankings import Cell, Ranking


def cell_of(results: Results, key: str) -> Cell:
    return next(found for cells in results.scenarios.values() for found in cells if found.key == key)


def test_every_number_of_a_finding_is_the_verdict_tables(results: Results) -> None:
    """Each sentence is taken apart; its numbers are looked up in the table and worded anew here."""
    for cells in results.scenarios.values():
        for found in cells:
            lines = results.verdicts[(results.verdicts["scenario"] == found.scenario)
                                     & (results.verdicts["variant"] == found.variant)
                                     & (results.verdicts["kind"] == "error")]
            for ranking in found.rankings:
                mine = lines[(lines["metric"] == ranking.metric) & (lines["quantity"] == ranking.quantity)].set_index(
                    "estimator")
                text = sentences.finding(found, ranking)
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
    first, second = sentences.over_all([c for cells in results.scenarios.values() for c in cells], 24)
    compared, worse, ties, undecided, lost = map(int, re.findall(r"\d+", first.replace("1 %", ""))[1:6])
    words = [drawn(line) for line in errors.to_dict("records")]
    assert [worse, ties, undecided, lost] == [words.count(word) for word in ("worse", "tie", "undecided", "lost")]
    assert compared == worse + ties + undecided + lost
    assert f"Lost runs: {(results.rows['status'] != 'ok').sum()} of {len(results.rows)}." in second
    assert f"Of {len(claims)} covariance claims {(claims['verdict'] == 'too sure').sum()} are too sure" in second


def test_a_scenario_over_its_variants(results: Results) -> None:
    position, speed = sentences.over_variants(results.scenarios["ningbo-metro"])
    assert position == ("Position, 3 variants. Best or tied in 2: ekf, ukf; in 1: robust-mean-square. Worse in every "
                        "variant: ekf-inflated, robust-ellipsoid, ekf-naive.")
    assert speed.startswith("Speed, 3 variants.")
    assert sentences.over_variants(results.scenarios["braking-rate"]) == []


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


@pytest.mark.parametrize(("word", "eligible", "shown"), [
    *((word, True, word) for word in ("best", "worse", "tie", "undecided", "oracle", "lost", "met", "kept")),
    *((word, False, "lost") for word in ("best", "worse", "undecided", "lost", "")), ("none", True, ""),
    ("none", False, ""), ("", True, "")])
def test_how_a_verdict_is_drawn(word: str, eligible: bool, shown: str) -> None:
    one = {"verdict": word, "eligible": eligible, "ratio": 1.05}
    assert (drawn(one), mark(one)) == (shown, MARKS[shown])
    assert shade(one) == ("w1" if shown == "worse" else MARKS[shown].css)


def test_shades_of_what_is_worse() -> None:
    assert [shade(line(ratio, eligible=True)) for ratio in (1.01, 1.0999, 1.1, 1.9999, 2.0, np.inf)] == [
        "w1", "w1", "w2", "w2", "w3", "w3"]
