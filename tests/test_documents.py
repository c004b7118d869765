"""Every command line of the README and of the folders' READMEs works as printed, one after the other, and its Python.

Only the number of runs is made small where a line gives none, and one job does where it asks for no more; files that a
line takes for granted are written first, Python that the text names among them."""

from __future__ import annotations

import ast
import json
import re
import shlex
from pathlib import Path

import pandas as pd
import pytest

from .fresh import Fresh
from .scenarios.test_recorded import trip

ROOT = Path(__file__).parents[1]
DOCUMENTS = ("README.md", "scenarios/README.md", "estimators/README.md", "benchmarks/README.md")
SET_UP = "python3 -m venv"
TAKES_RUNS = ("run", "sweep", "compare", "reproduce")
EXPECTED = {
    "README.md": ("gentle-pull: all rules kept", "80 rows: 80 ok", "alpha-beta: all rules kept",
                  "speed rmse: ekf is better than alpha-beta", "worse"),
    "estimators/README.md": ("ekf: all rules kept", "gentle-pull: all rules kept"),
    "benchmarks/README.md": ("40 rows: 40 ok", "52 cells")}
"""What the commands of a document say."""


def lines_of(text: str) -> list[str]:
    """The command lines of a document, set-up aside."""
    return [line for block in re.findall(r"```sh\n(.*?)```", text, re.DOTALL) for line in block.splitlines()
            if line and not line.startswith(SET_UP)]


@pytest.mark.parametrize("document", DOCUMENTS)
def test_every_command_works_as_printed(document: str, tmp_path: Path) -> None:
    text = (ROOT / document).read_text(encoding="utf-8")
    fresh = Fresh(tmp_path / "environment", tmp_path)
    scripts = []
    for before, kind, block in re.findall(r"([^\n]*)\n\n```(python|toml)\n(.*?)```", text, re.DOTALL):
        named = re.search(r"`([a-z_-]+\.(?:py|toml))`:$", before)
        if named:
            (tmp_path / named[1]).write_text(block)
        elif kind == "python" and document == "README.md":  # in the others: excerpts
            scripts.append(block)
    metro = (ROOT / "scenarios" / "metro" / "ningbo-metro.toml").read_text(encoding="utf-8")
    (tmp_path / "my-metro.toml").write_text(metro.replace('name = "ningbo-metro"', 'name = "my-metro"'))
    trip().to_csv(tmp_path / "trip.csv", index=False)
    commands = [part.strip() for line in lines_of(text) for part in line.split("&&")]
    assert commands
    said = ""
    for command in commands:
        words = shlex.split(command)
        if words[0] == "railstate" and words[1] in TAKES_RUNS and "--runs" not in words:
            words += ["--runs", "2"]
        if words[0] == "railstate" and words[1] in TAKES_RUNS and "--jobs" not in words:
            words += ["--jobs", "1"]
        done = fresh.railstate(*words[1:]) if words[0] == "railstate" else fresh.run(*words)
        assert done.returncode == 0 and "Traceback" not in done.stderr, f"{command}\n{done.stdout}{done.stderr}"
        said += done.stdout
    for script in scripts:
        done = fresh.run(fresh.python, "-c", script)
        assert done.returncode == 0, f"{script}\n{done.stdout}{done.stderr}"
        said += done.stdout
    for words in EXPECTED.get(document, ()):
        assert words in said, f"{words}\n{said}"


def test_the_notebook_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Cell by cell, what a cell ends in shown as a notebook would."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "__main__"}
    cells = json.loads((ROOT / "benchmarks" / "own_filter.ipynb").read_text(encoding="utf-8"))["cells"]
    shown = []
    for cell in cells:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == [] and cell["execution_count"] is None
            tree = ast.parse("".join(cell["source"]))
            last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
            exec(compile(tree, "cell", "exec"), names)
            if isinstance(last, ast.Expr):
                shown.append(eval(compile(ast.Expression(last.value), "cell", "eval"), names))
    compared, figures, page = shown[-3:]
    assert isinstance(compared, pd.DataFrame) and set(compared["verdict"]) <= {"worse", "better", "undecided", "tie"}
    assert "<svg" in figures._repr_html_() and "pull" in shown[-4]._repr_html_() and page.stat().st_size > 20_000
