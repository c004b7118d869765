"""Plug-ins that end everything when they are imported, or share a name: one message each, nothing lost."""

from __future__ import annotations

from pathlib import Path

import pytest

from ..conftest import Command


@pytest.mark.parametrize(("text", "message"), [
    ("import sys; sys.exit(0)", "does not import: SystemExit: 0"),
    ("import os; os._exit(0)", "cannot be imported: the process running it died (exit code 0)"),
    ("raise KeyboardInterrupt", "does not import: KeyboardInterrupt"),
    ("x = 1", "holds no subclass"),
])
def test_an_import_that_ends_everything_is_one_message(railstate: Command, text: str, message: str) -> None:
    Path("odd.py").write_text(text + "\n")
    done = railstate("run", "cart.toml/calm", "--plugin", "odd.py", "--runs", 2)
    assert done.code == 2 and message in done.err and len(done.err.splitlines()) == 1


def test_two_of_one_name_are_refused(railstate: Command) -> None:
    Path("twice.py").write_text(Path("half.py").read_text())
    done = railstate("run", "cart.toml/calm", "--plugin", "half.py", "--plugin", "twice.py", "--runs", 2)
    assert done.code == 2 and "an estimator named half is in" in done.err
