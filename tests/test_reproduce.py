"""`railstate reproduce`: verdicts follow the evidence, the exit code the verdicts; the committed table is whole."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from railstate.benchmarks import reproduce as engine
from railstate.benchmarks.reproduce import Book, Published, judge, papers

from .conftest import Command

COMMITTED = Path(__file__).parents[1] / "results" / "published" / "published.csv"
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
    ({"published": 1.10, "single_run": True}, "reproduced"),  # 2 s.d. of single runs more
    ({"published": 1.25, "single_run": True}, "not reproduced"),
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
    assert judge(cell(**changes), Book(ROWS))[1] == verdict


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
    assert tuple(table.columns) == engine.COLUMNS
    expected = [(paper.name, item.item, item.cell, item.expected) for paper in papers() for item in paper.cells]
    assert list(table[["paper", "item", "cell", "expected"]].itertuples(index=False, name=None)) == expected
    assert (table["verdict"] == table["expected"]).all()


def test_one_paper_from_the_command_line(railstate: Command) -> None:
    done = railstate("reproduce", "zou-rap", "--out", "pub")
    assert done.code == 0, done.err
    table = pd.read_csv("pub/published.csv")
    committed = pd.read_csv(COMMITTED)
    pd.testing.assert_frame_equal(table, committed[committed["paper"] == "zou-rap"].reset_index(drop=True), rtol=1e-5)
    gains = table[table["item"] == "Table I, C corrected"]
    assert len(gains) == 18 and (abs(gains["ours"] - gains["published"].astype(float)) < 5e-4).all()
    assert Path("pub/published.tex").read_text().count(r"\toprule") == 1
    assert "31 cells, 0 verdicts other than expected" in done.out


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
