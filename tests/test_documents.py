"""Every command line of the README and of the folders' READMEs works as printed, one after the other.

Only the number of runs is made small where a line gives none; files that a line takes for granted are written first,
Python that the text names among them."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest

from .fresh import Fresh
from .scenarios.test_railway import track, train
from .scenarios.test_recorded import trip

ROOT = Path(__file__).parents[1]
DOCUMENTS = ("README.md", "scenarios/README.md", "estimators/README.md", "benchmarks/README.md")
SET_UP = "python3 -m venv"
TAKES_RUNS = ("run", "sweep", "compare", "reproduce")
EXPECTED = {
    "README.md": ("gentle-pull: all rules kept", "80 rows: 80 ok", "alpha-beta: all rules kept",
                  "speed rmse: ekf is better than alpha-beta"),
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
    for before, block in re.findall(r"([^\n]*)\n\n```python\n(.*?)```", text, re.DOTALL):
        named = re.search(r"`([a-z_]+\.py)`:$", before)
        if named:  # others are excerpts
            (tmp_path / named[1]).write_text(block)
    metro = (ROOT / "scenarios" / "metro" / "ningbo-metro.toml").read_text(encoding="utf-8")
    (tmp_path / "my-metro.toml").write_text(metro.replace('name = "ningbo-metro"', 'name = "my-metro"'))
    (tmp_path / "track.json").write_text(json.dumps(track()))
    (tmp_path / "train.json").write_text(json.dumps(train()))
    trip().to_csv(tmp_path / "trip.csv", index=False)
    commands = [part.strip() for line in lines_of(text) for part in line.split("&&")]
    assert commands
    said = ""
    for command in commands:
        words = shlex.split(command)
        if words[0] == "railstate" and words[1] in TAKES_RUNS and "--runs" not in words:
            words += ["--runs", "2"]
        done = fresh.run(*words)
        assert done.returncode == 0 and "Traceback" not in done.stderr, f"{command}\n{done.stdout}{done.stderr}"
        said += done.stdout
    for words in EXPECTED.get(document, ()):
        assert words in said, f"{words}\n{said}"
