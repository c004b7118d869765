"""The report and the verdicts: what they say of rows whose truth is known, and that the page holds all of it.

The page is parsed here; a real browser opens it in `test_report_browser.py`."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from railstate.benchmarks.commands.report import report
from railstate.benchmarks.judging import statistics as st
from railstate.benchmarks.judging.selection import Aligned
from railstate.benchmarks.store.folder import Store
from railstate.benchmarks.telling import sayings, wording
from railstate.benchmarks.telling.figures.data import Results, load_results
from railstate.benchmarks.telling.paragraphs import paragraph
from railstate.benchmarks.telling.report import write_report
from railstate.benchmarks.telling.report.table import Entry, contest_table, failures, table
from railstate.scenarios.errors import InputError
from scipy import stats

from ..synthetic_results import BRAKING, CBTC, METRO, RUNS, write_results


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    return load_results(write_results(tmp_path_factory.mktemp("report") / "run"))


@pytest.fixture(scope="module")
def html(results: Results) -> str:
    return write_report(results.folder).read_text(encoding="utf-8")


def entry(results: Results, scenario: str, variant: str, label: str, head: str) -> Entry:
    cell = next(cell for cell in results.scenarios[scenario] if cell.variant == variant)
    made = table(cell)
    column = next(i for i, (name, _) in enumerate(made.heads) if name.startswith(head))
    return next(line for line in made.lines if line.label == label).entries[column]


def test_errors_stand_with_their_interval_and_a_verdict_against_the_best(results: Results) -> None:
    rows = results.rows
    cell = rows[(rows["variant"] == "switching")]
    column = "rmse:position:m"
    ekf, naive = (cell.loc[cell["estimator"] == name, column].to_numpy() for name in ("ekf", "ekf-naive"))
    best = entry(results, "ningbo-metro", "switching", "ekf", "position")
    value, half = (float(v) for v in best.text.split(" ± "))
    assert value == pytest.approx(np.sqrt((ekf**2).mean()), abs=1e-4)
    hall = st.rooted(st.hall(ekf**2, positive=True))
    assert half == pytest.approx(float(hall.high - hall.low) / 2, rel=0.02)
    assert (best.detail, best.kind) == ("best", "good")
    worse = entry(results, "ningbo-metro", "switching", "ekf-naive", "position")
    ratio = np.sqrt((naive**2).mean() / (ekf**2).mean())
    assert worse.detail.startswith(f"worse: {ratio:.1f} times [")
    assert worse.detail.endswith("wins 0 %")
    assert worse.kind == "bad"
    assert entry(results, "ningbo-metro", "switching", "ukf", "position").detail.startswith("tie: +0.")


def test_promises_are_held_against_the_rows(results: Results) -> None:
    assert entry(results, "ningbo-metro", "switching", "ekf", "ANEES").kind == "good"
    assert "too sure" in entry(results, "ningbo-metro", "switching", "ekf-naive", "ANEES").detail
    assert "too cautious" in entry(results, "ningbo-metro", "switching", "ekf-inflated", "ANEES").detail
    coverage = entry(results, "ningbo-metro", "switching", "robust-ellipsoid", "set")
    assert coverage.text == "99.9 %"
    assert coverage.detail.startswith("left in 1 of 24 runs; position ±0.6")
    assert entry(results, "cbtc-csma", "uniform", "ultimate-bound", "measured").detail.startswith("kept")
    assert entry(results, "cbtc-csma", "uniform", "fastest-decay", "measured").detail.startswith("broken")


def test_cells_without_a_claim_are_empty_with_the_reason(results: Results) -> None:
    for scenario, variant, label, head, reason in (
            ("ningbo-metro", "white", "robust-mean-square", "ANEES", "claims no covariance"),
            ("ningbo-metro", "white", "ekf", "set", "claims no set"),
            ("cbtc-csma", "uniform", "kalman", "measured", "certifies no bound"),
            ("cbtc-csma", "table3", "fastest-decay", "position", "no finished run")):
        found = entry(results, scenario, variant, label, head)
        assert (found.text, found.kind, found.sort) == (reason, "none", None)


def test_shown_units_latency_and_oracles(results: Results) -> None:
    cell = results.scenarios["braking-rate"][0]
    assert ("displacement MAE", "cm") in table(cell).heads
    raw = cell.rows.loc[cell.rows["estimator"] == "sma", "mae:displacement:m"].mean()
    assert entry(results, "braking-rate", "paper", "sma", "displacement").sort == pytest.approx(100 * raw)
    assert entry(results, "braking-rate", "paper", "kalman-known-f", "f ").detail.startswith("not ranked")
    latency = entry(results, "braking-rate", "paper", "sma", "latency")
    assert latency.detail == "fits 0.2 s with a factor 3500"


def test_outcomes_have_intervals_and_shares_are_counted(results: Results) -> None:
    cell = results.scenarios["cbtc-csma"][0]
    values = cell.rows.loc[cell.rows["estimator"] == "kalman", "headway:headway-65:s"].to_numpy()
    found = entry(results, "cbtc-csma", "uniform", "kalman", "headway-65")
    mean, half = (float(v) for v in found.text.split(" ± "))
    assert mean == pytest.approx(values.mean(), abs=0.005)
    hall = st.hall(values)
    assert half == pytest.approx(float(hall.high - hall.low) / 2, rel=0.05)
    shares = entry(results, "cbtc-csma", "uniform", "kalman", "late")
    assert shares.text == "6 of 24"
    assert shares.sort == 0.25
    low, high = st.share(np.arange(RUNS) < 6)[1:3]
    assert shares.detail == f"{wording.percent(low)} to {wording.percent(high)}"


def test_failures_carry_the_line_that_replays_them(results: Results) -> None:
    uniform, table3 = results.scenarios["cbtc-csma"]
    assert [f.replay for f in failures(uniform, "out")] == ["railstate replay cbtc-csma/uniform/direct/3 --out out"]
    assert {f.text for f in failures(table3, "out")} == {"direct: diverged in 1 run",
                                                         "fastest-decay: infeasible in 24 runs"}
    assert entry(results, "cbtc-csma", "table3", "fastest-decay", "not finished").text == "24 of 24"
    low, high = stats.binomtest(1, RUNS).proportion_ci(0.95, method="wilson")
    assert entry(results, "cbtc-csma", "uniform", "direct", "not finished").detail == \
        f"1 diverged; {wording.percent(low)} to {wording.percent(high)}"


def test_short_verdicts_of_the_terminal(results: Results) -> None:
    short = sayings.short_verdicts(results.verdicts)
    assert short["ningbo-metro", "switching", "ekf"] == "best"
    assert short["ningbo-metro", "switching", "ukf"] == "tie"
    assert re.fullmatch(r"(4\.\d|3\.9)( to 4\.\d)? times; too sure \(ANEES 9\.\d+\)",
                        short["ningbo-metro", "switching", "ekf-naive"])
    assert short["ningbo-metro", "white", "robust-ellipsoid"].endswith("; leaves its set in 1 of 24 runs")
    assert short["cbtc-csma", "table3", "fastest-decay"] == "infeasible"
    assert "exceeds its bound (0." in short["cbtc-csma", "uniform", "fastest-decay"]
    assert short["braking-rate", "paper", "kalman-known-f"] == "oracle"


def test_headlines_say_where_the_robust_estimator_wins_and_where_not(results: Results) -> None:
    lines = sayings.headlines(results.verdicts, "ningbo-metro")
    assert len(lines) == 2 * 3 * 2
    line = next(text for text in lines if "robust-mean-square against ekf, position" in text)
    assert re.search(r"better in 1 of 3 variants \(constant −(19|20|21) % \[−\d+, −\d+\], 100 % of runs\), "
                     r"worse in 2 \(switching \+\d+ %, white \+\d+ %\)$", line)
    assert not [text for text in lines if "ukf" in text]
    duels = contest_table(sayings.robust_contests(results.verdicts, "ningbo-metro"))
    assert [head for head, _ in duels.heads] == ["better in", "switching", "white", "constant"]
    assert len(duels.lines) == 12
    entries = next(line.entries for line in duels.lines
                   if (line.label, line.note) == ("robust-mean-square", "position, against ekf"))
    assert [entry.kind for entry in entries] == ["", "bad", "bad", "good"] and entries[0].text == "1 of 3"
    assert entries[3].text in line and entries[3].detail == "better, wins 100 %"


def test_paragraphs_in_plain_words(results: Results) -> None:
    metro = " ".join(paragraph(results.verdicts, "ningbo-metro"))
    assert metro.startswith("Variant switching: ekf and ukf tie as best (position 0.")
    assert "; the least worse, ekf-inflated, has " in metro
    assert "ekf and ukf are best or tied for position and speed in 2 of 3 variants" in metro
    assert "Too sure of its own errors: ekf-naive in all 3 variants (ANEES up to 9." in metro
    assert "leaves it: robust-ellipsoid in all 3 variants (in up to 4.2 % of the runs)" in metro
    cbtc = " ".join(paragraph(results.verdicts, "cbtc-csma"))
    assert "Exceeds its certified bound: fastest-decay in 1 of 2 variants (by up to 1.5 times)" in cbtc
    assert "Has runs that diverged, failed or could not be designed: direct in both variants" in cbtc
    braking = " ".join(paragraph(results.verdicts, "braking-rate"))
    assert "kalman-known-f: not ranked" in braking
    assert "Nobody broke a promise" in braking


def line(ratio: float, low: float = np.nan, high: float = np.nan) -> dict[str, float]:
    return {"ratio": ratio, "ratio_low": low, "ratio_high": high}


def test_changes_ranges_and_long_lists() -> None:
    assert wording.change_range([1.39, 1.41]) == "+39 to +41 %"
    assert wording.change_range([1.39]) == "+39 %"
    assert wording.change_range([1.39, 1.41, 3.0]) == "1.4 to 3.0 times"
    assert wording.change_interval(line(1.15, 1.0004, 1.31)) == "+15 % [0.04, 31]"
    assert wording.change_interval(line(0.8, 0.7, 0.9)) == "−20 % [−30, −10]"
    assert wording.change_interval(line(4.0, 3.5, 4.6)) == "4.0 times [3.5, 4.6]"
    assert wording.change_interval(line(1.0, 1.0, 1.0)) == "±0.0 %"
    assert [wording.ratio(value) for value in (1.0, 1.0021, 0.9951, 1.29, 12.34, 345.6)] == [
        "1.00", "1.002", "0.995", "1.29", "12.3", "346"]
    assert wording.some(["a", "b", "c", "d", "e"]) == "a, b, c and 2 others"


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


class Page(HTMLParser):
    """Collects what a test wants to know of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in ("meta", "link", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))


def test_the_page_is_well_formed_self_contained_and_small(html: str) -> None:
    page = Page(html)
    assert page.open == []
    for _, attributes in page.tags:
        for name in ("src", "href", "data", "action"):
            assert re.match(r"#|data:|$", attributes.get(name) or ""), attributes
    assert "http://" not in html.replace("http://www.w3.org", "")
    assert "https://" not in html
    assert "url(" not in html
    assert len(html) < 1e6


def test_the_page_tells_what_was_run_and_how_to_run_it_again(html: str, results: Results) -> None:
    environment = results.manifest["environment"]
    numpy = environment["packages"]["numpy"]
    for text in ("railstate run --runs 24 --seed 5", environment["processor"], f"numpy {numpy}",
                 "936: 910 ok, 24 infeasible, 2 diverged", "6 scenario variants, 24 runs each, seed 5"):
        assert text in html
    for label in {*METRO, *CBTC, *BRAKING}:
        assert f">{label}" in html
    assert "Note on switching &amp; &lt;its&gt; numbers." in html
    assert "&lt;no certificate&gt;" in html
    assert "railstate replay cbtc-csma/uniform/direct/3 --out" in html


def test_the_command_writes_the_page_again_from_the_folder_alone(results: Results, html: str,
                                                                 capsys: pytest.CaptureFixture[str]) -> None:
    report(str(results.folder))
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
    assert "kept no trajectories" in (folder / "report.html").read_text(encoding="utf-8")
    for part in (folder / "rows").iterdir():
        part.unlink()
    with pytest.raises(InputError, match="no finished rows"):
        report(str(folder))
    assert Store(folder).manifest()["railstate"]
