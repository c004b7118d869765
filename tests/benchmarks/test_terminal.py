"""What the terminal shows of a results folder: widths, letters an output knows, lost entries, a log's lines."""

from __future__ import annotations

import io
import json
import re
import sys
import time

import pandas as pd
import pytest
import rich.progress
from railstate.benchmarks.store.folder import Store
from railstate.benchmarks.telling import console
from railstate.benchmarks.telling.cleaning import Cleaned
from railstate.benchmarks.telling.figures.data import Results
from railstate.benchmarks.telling.marks import ASCII, MARKS
from railstate.benchmarks.telling.results import print_results, print_results_json

from ..synthetic_results import METRO


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


class Terminal(io.StringIO):
    """One that shows colours."""

    def isatty(self) -> bool:
        return True


def test_colours_and_a_bar_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(f"sys.{name}", Cleaned(Terminal()))
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.delenv("NO_COLOR", raising=False)
    text = "[bold]12[/bold] :smile: " + "word " * 50
    assert console.columns() == 200
    console.say(("★ best", "bold green"), f" {text}\x1b[2J")
    monkeypatch.setenv("NO_COLOR", "1")
    console.say(("★ best", "bold green"), f" {text} ")
    assert sys.stdout.getvalue() == f"\x1b[1;32m★ best\x1b[0m {text}\\x1b[2J\n★ best {text}".rstrip() + "\n"  # type: ignore
    monkeypatch.setattr(rich.progress.Task, "elapsed", property(lambda _: 2.0))
    monkeypatch.delenv("NO_COLOR")
    for total in (0, 10):
        with console.progress(total, "rows") as advance:
            advance(4, "cart")
            advance(3, "cart/calm")
        shown = re.sub(r"\x1b\[[\d;?]*[A-Za-z]", "", sys.stderr.getvalue())  # type: ignore[attr-defined]
        last = " ".join(re.sub("[━╸╺]+", "|", shown).split("\r")[-2].split() if total else shown)
        assert last == ("cart/calm | 7/10 rows 4/s 0:00:02 left 0:00:01" if total else "")


@pytest.mark.parametrize(("columns", "most"), [(10, 40), (100, 100), (120, 120), (121, 120)])
def test_columns_of_what_is_no_terminal(columns: int, most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    assert console.columns() == most


def test_one_column_that_is_wider_than_the_terminal(monkeypatch: pytest.MonkeyPatch,
                                                    capsys: pytest.CaptureFixture[str]) -> None:
    """It is cut to what there is, and never under 8 letters; others go beneath, beside the first once more."""
    for width, size in ((20, 15), (13, 8), (9, 8)):
        monkeypatch.setattr(console, "columns", lambda width=width: width)
        console.print_columns(console.Column(["", "a"], [[("abc", "")]]), [
            console.Column(["x" * 30], [[("y" * 30, "")]], right=True), console.Column(["b"], [[("z", "")]])])
        first, second = capsys.readouterr().out.split("\n\n")
        lines = [text.rstrip() for text in first.splitlines()]
        assert lines[:2] == ["", "a    " + "x" * size], lines
        assert lines[2] == "─" * min(width, 3 + console.GAP + size)
        assert "".join("".join(lines[3:]).split()) == "abc" + "y" * 30
        assert max(map(len, lines[3:])) == 3 + console.GAP + size
        assert [text.rstrip() for text in second.splitlines()] == ["", "a    b", "──────", "abc  z"]
