"""`railstate reproduce`: verdicts follow the evidence, the exit code the verdicts; the committed table is whole."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from railstate.benchmarks.published import reproduce as engine
from railstate.benchmarks.published.reproduce import Published, papers, reproduce_cell
from railstate.benchmarks.published.rows import Book, ratio

from ..conftest import Command

COMMITTED = Path(__file__).parents[2] / "results" / "published" / "published.csv"
ROWS = pd.DataFrame({"scenario": "s", "variant": "v", "estimator": "e", "run": range(25), "seconds": 0.1,
                     "mae:x:m": np.tile([0.9, 1.0, 1.1, 1.0, 1.0], 5)})  # mean 1.0, s.d. 0.0645, s.e. 0.0129


def cell(**changes: object) -> Published:
    return Published.model_validate({
        "item": "T", "cell": "c", "published": 1.0, "unit": "m", "scenario": "s", "variant": "v", "estimator": "e",
        "metric": "mae", "quantity": "x", "why": "-", "expected": "reproduced", **changes})


@pytest.mark.parametrize(("changes", "verdict"), [
    ({}, "reproduced"),
    ({"published": 1.03}, "reproduced"),  # within 3 s.e. = 0.0387
    ({"published": 1.05}, "not reproduced"),
    ({"published": 1.05, "absolute": 0.02}, "reproduced"),
    ({"published": 1.10, "trials": 1}, "reproduced"),  # 2 s.d. of single runs more
    ({"published": 1.10, "trials": 4}, "reproduced"),  # of means of four
    ({"published": 1.12, "trials": 4}, "not reproduced"),
    ({"published": 1.25, "trials": 1}, "not reproduced"),
    ({"fitted": True}, "fitted"),
    ({"published": 2.0, "fitted": True}, "not reproduced"),
    ({"published": 2.0, "contradicts": True}, "contradicts its text"),
    ({"published": 100.0, "factor": 100.0}, "reproduced"),
    ({"published": "< 1.1", "at_most": 1.1}, "reproduced"),
    ({"published": "< 1", "at_most": 1.0}, "not reproduced"),  # a tie is not a win
    ({"scenario": "", "published": 5.0, "missing": "the data"}, "unreachable"),
    ({"scenario": "", "compute": "follower_ratio", "arguments": [1], "published": 0.618, "absolute": 5e-4},
     "reproduced"),
    ({"scenario": "", "compute": "follower_ratio", "arguments": [-1], "published": 0.618, "contradicts": True},
     "contradicts its text"),
])
def test_verdicts(changes: dict[str, object], verdict: str) -> None:
    assert reproduce_cell(cell(**changes), Book(ROWS)).verdict == verdict


@pytest.mark.parametrize(("changes", "decided"), [
    ({"absolute": 0.05}, True), ({"published": 1.05, "absolute": 0.02}, False), ({"published": 1.2}, True),
    ({"published": "< 1", "at_most": 1.0}, False), ({"published": "< 1.1", "at_most": 1.1}, True)])
def test_what_more_runs_could_turn_is_not_decided(changes: dict[str, object], decided: bool) -> None:
    assert reproduce_cell(cell(**changes), Book(ROWS)).decided == decided


def test_ratios_are_of_the_runs_that_both_finished() -> None:
    rng = np.random.default_rng(2)
    b = rng.gamma(9, size=50)
    a = 0.5 * b * rng.lognormal(0, 0.01, 50)
    whole = ratio(a, b)
    a[7], b[30] = np.nan, np.nan
    less = ratio(a, b)
    assert less.value == pytest.approx(whole.value, rel=2e-3) and less.error == pytest.approx(whole.error, rel=0.2)


def test_every_cell_says_why_and_what_is_missing() -> None:
    for paper in papers():
        keys = [(item.item, item.cell) for item in paper.cells]
        assert len(set(keys)) == len(keys)
        for item in paper.cells:
            reachable = bool(item.scenario or item.compute)
            assert reachable != (item.expected == "unreachable") and reachable != bool(item.missing)
            assert not (item.fitted and item.expected == "reproduced")
            assert item.note or item.expected in ("reproduced", "unreachable", "fitted", "not reproduced")


def test_committed_table_is_the_one_of_these_files() -> None:
    table = pd.read_csv(COMMITTED)
    assert tuple(table.columns) == engine.PUBLISHED_COLUMNS
    expected = [(paper.name, item.item, item.cell, item.expected) for paper in papers() for item in paper.cells]
    assert list(table[["paper", "item", "cell", "expected"]].itertuples(index=False, name=None)) == expected
    assert (table["verdict"] == table["expected"]).all()


def test_the_readme_shows_the_committed_summary() -> None:
    readme = (COMMITTED.parents[2] / "README.md").read_text(encoding="utf-8")
    summary = COMMITTED.with_suffix(".md").read_text(encoding="utf-8").split("\n\n")[1]
    assert summary in readme and len(summary.splitlines()) == 2 + len(papers())


def test_the_committed_tables_come_out_again(railstate: Command) -> None:
    """All papers at the committed number of runs: the same verdicts, and the same numbers but for what another
    processor's rounding may do (a thousandth, or one standard error)."""
    done = railstate("reproduce", "--out", "pub")
    assert done.code == 0, done.out[-3000:] + done.err
    table, committed = pd.read_csv("pub/published.csv"), pd.read_csv(COMMITTED)
    same = ["paper", "item", "cell", "published", "unit", "verdict", "expected", "note"]
    pd.testing.assert_frame_equal(table[same], committed[same])
    room = 1e-3 * committed["ours"].abs() + committed["standard_error"].fillna(0)
    assert (((table["ours"] - committed["ours"]).abs() <= room) | committed["ours"].isna()).all()


def test_one_paper_from_the_command_line(railstate: Command) -> None:
    done = railstate("reproduce", "zou-rap", "--out", "pub")
    assert done.code == 0, done.err
    table = pd.read_csv("pub/published.csv")
    gains = table[table["item"] == "Table I, C corrected"]
    assert len(gains) == 18 and (abs(gains["ours"] - gains["published"].astype(float)) < 5e-4).all()
    assert Path("pub/published.tex").read_text().count(r"\toprule") == 1
    assert "39 cells, 0 verdicts other than expected" in done.out


def test_another_verdict_is_exit_code_1_and_names_the_cell(
        railstate: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (engine.FOLDER / "zou-rap.toml").read_text()
    Path("published").mkdir()
    Path("published/zou-rap.toml").write_text(text.replace("published = 12.0978", "published = 12.2"))
    monkeypatch.setattr(engine, "FOLDER", Path("published"))
    done = railstate("reproduce", "zou-rap", "--out", "pub")
    assert done.code == 1 and "Example 2: mu_1: not reproduced, expected reproduced" in done.out


def test_unknown_paper_and_malformed_file(railstate: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "there are faruqi2019" in railstate("reproduce", "einstein1905").err
    Path("published").mkdir()
    Path("published/a.toml").write_text('title = "a"\n[[items]]\nitem = "T"\ncells = [{ cell = "c", publishd = 1 }]\n')
    monkeypatch.setattr(engine, "FOLDER", Path("published"))
    done = railstate("reproduce")
    assert done.code == 2 and "a.toml: T: c.publishd: unknown key" in done.err
    Path("published/a.toml").write_text('title = "a"\n[[items]]\nitem = "T"\n')
    assert 'a.toml: items: item "T" needs cells' in railstate("reproduce").err
    assert "--runs: must be at least 2" in railstate("reproduce", "--runs", 1).err
