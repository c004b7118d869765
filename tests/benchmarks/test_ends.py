"""How the command line ends, whatever a command raises: exit code and the one message."""

from __future__ import annotations

import errno
import sys
import warnings
from typing import Any

import pytest
from railstate.benchmarks import cli
from railstate.scenarios.errors import InputError, Interrupted


class PacifyFlushWrapper:
    """What the library that reads the options leaves as standard output where its reader has gone."""

    def flush(self) -> None:
        """Nothing is left."""


@pytest.mark.parametrize(("raised", "code", "said"), [
    (None, 0, ""), (SystemExit(0), 0, ""), (SystemExit(1), 1, ""), (SystemExit(2), 2, ""),
    (BrokenPipeError(), 141, ""), (InputError("a\nb"), 2, "error: a\nb\n"),
    (OSError(errno.ENOSPC, "No space", "x/y"), 2, "error: x/y: No space\n"),
    (OSError(errno.ENOSPC, "No space"), 2, "error: input or output: No space\n"),
    (OSError("odd"), 2, "error: input or output: odd\n"),
    (MemoryError("9 GB"), 2, "error: not enough memory (9 GB): fewer steps, or a smaller --batch\n"),
    (Interrupted("3 rows are there"), 130, "3 rows are there\n"), (KeyboardInterrupt(), 130, "")])
def test_what_a_command_raises(raised: BaseException | None, code: int, said: str, monkeypatch: pytest.MonkeyPatch,
                               capsys: pytest.CaptureFixture[str]) -> None:
    def app() -> None:
        if raised is not None:
            raise raised

    monkeypatch.setattr(cli, "app", app)
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    before, ended = (sys.stdout, sys.stderr), 0
    try:
        cli.main()
    except SystemExit as error:
        ended = error.code or 0
    assert (ended, capsys.readouterr().err) == (code, said) and (sys.stdout, sys.stderr) == before


@pytest.mark.parametrize(("code", "ended"), [(1, 141), (2, 2), (0, 0)])
def test_a_reader_that_has_gone_while_the_options_library_wrote(code: int, ended: int,
                                                                monkeypatch: pytest.MonkeyPatch) -> None:
    def app() -> None:
        sys.stdout: Any = PacifyFlushWrapper()
        raise SystemExit(code)

    monkeypatch.setattr(cli, "app", app)
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    with pytest.raises(SystemExit) as caught:
        cli.main()
    assert caught.value.code == ended
