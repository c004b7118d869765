"""results/published/coverage.md: every row names the command that shows it, and the command is one.

All of them are run when asked for (`pytest --long all`); otherwise what they name is looked up."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import typer
from railstate.benchmarks.cli import app
from railstate.benchmarks.commands.options import labels, names_in, overrides
from railstate.benchmarks.planning.catalogue import Catalogue
from railstate.benchmarks.planning.naming import find, find_one
from railstate.benchmarks.published.files import papers
from railstate.benchmarks.telling.figures.catalogue import FIGURES
from railstate.estimators.ultimate_bound.gains import read_gain

from ..conftest import Command

PAGE = Path(__file__).parents[2] / "results" / "published" / "coverage.md"
ROWS = [tuple(cell.strip() for cell in line.strip().strip("|").split(" | "))
        for line in PAGE.read_text(encoding="utf-8").splitlines()
        if line.startswith("| ") and not line.startswith(("| what", "| ---"))]
COMMANDS = typer.main.get_command(app)


def commands(row: tuple[str, ...]) -> list[list[str]]:
    """The command lines of a row, in their order."""
    return [shlex.split(text)[1:] for text in re.findall(r"`(railstate [^`]*)`", row[1])]


def parsed(words: list[str]) -> dict[str, Any]:
    """The parameters of a command line. Raises click's UsageError."""
    command = COMMANDS.commands[words[0]]  # pyright: ignore[reportAttributeAccessIssue]
    return {**command.make_context(words[0], words[1:]).params, "command": words[0]}


def test_the_page_has_every_paper_and_no_row_without_a_command() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert [line.split()[1].rstrip(":") for line in text.splitlines() if line.startswith("## ")] == [
        "zou2018", "zou-rap", "zheng2015", "liu2025", "faruqi2019"]
    for paper in papers():
        assert f"`railstate reproduce {paper.name}`" in text and f"{paper.authors} ({paper.year})" in text
    assert len(ROWS) > 70
    for row in ROWS:
        assert len(row) == 3 and all(row) and commands(row), row


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0][:50])
def test_what_a_row_names_is_there(row: tuple[str, ...]) -> None:
    known: set[str] = set()
    for words in commands(row):
        given = parsed(words)
        asked = given.get("scenarios") or given.get("scenario") or given.get("name")
        asked = [asked] if isinstance(asked, str) else asked
        told = overrides([*(given.get("set_") or []), *(one.split(",")[0] for one in given.get("over") or [])])
        for name in asked if given["command"] in ("run", "sweep", "design", "certify", "compare", "show") else ():
            one = find_one(name, told) if given["command"] == "sweep" else None
            scenario, variants = (one[0], [one[1]]) if one else find(name, told)
            for variant in variants:
                setting = scenario.setting(variant)
                known |= {item.name for item in setting.quantities()}
                named = labels(given.get("estimators", ""))
                named += [given["a"], given["b"]] if given["command"] == "compare" else []
                assert set(named) <= {*setting.config.estimators, *Catalogue().names()}, words
        if given["command"] == "reproduce":
            assert given["papers"] and papers(given["papers"])
        if given["command"] == "certify":
            assert read_gain(given["gain"]).size
        if given["command"] == "plot":
            assert given["figure"] in {figure.name for figure in FIGURES}
            assert set(names_in(given["quantities"])) <= known, words


@pytest.mark.long
@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0][:50])
def test_every_command_of_the_page_works(row: tuple[str, ...], railstate: Command) -> None:
    for words in commands(row):
        few = ["--runs", "4"] if words[0] == "reproduce" else []
        done = railstate(*words, *few)
        assert done.code == 0 and "Traceback" not in done.err, f"{words}\n{done.out[-2000:]}{done.err}"
