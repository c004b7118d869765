"""The command line on machines as they are: readers that leave, outputs closed or full, imports that take long."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest
from railstate.benchmarks import cli

from ..conftest import Command

START = "from railstate.benchmarks.cli import main; main()"
LIBRARIES = {"pandas", "filterpy", "cvxpy", "matplotlib", "rich", "joblib", "jinja2", "shapely", "pyproj",
             "scipy.linalg", "scipy.special", "scipy.stats", "scipy.optimize", "scipy.sparse"}


@pytest.mark.skipif(sys.platform != "linux", reason="written for a POSIX shell and /dev/full")
@pytest.mark.parametrize(("rest", "code", "said"), [
    ("| head -n 1; exit ${PIPESTATUS[0]}", 141, ""),  # what a shell calls a broken pipe
    (">&-", 0, ""),
    ("> /dev/full", 2, "error: input or output: No space left on device\n"),
], ids=["a reader that leaves", "closed", "full"])
def test_an_output_that_takes_nothing(rest: str, code: int, said: str) -> None:
    done = subprocess.run(["bash", "-c", f'"$0" -c "{START}" list {rest}', sys.executable], capture_output=True,
                          text=True, timeout=120, check=False)
    assert (done.returncode, done.stderr) == (code, said)


@pytest.mark.parametrize(("word", "unused"), [
    ("--help", {"numpy", "pyarrow", "numba", "pydantic", *LIBRARIES}),
    ("--version", {"numpy", "pyarrow", "numba", *LIBRARIES}),
    ("list", LIBRARIES),
], ids=["help", "version", "list"])
def test_what_is_not_needed_is_not_imported(word: str, unused: set[str]) -> None:
    """Quick commands stay quick: they leave alone the libraries whose import takes long."""
    code = f"{START.partition(';')[0]}\nimport sys\ntry:\n main()\nexcept SystemExit as end:\n assert not end.code\n"
    done = subprocess.run([sys.executable, "-c", f"{code}print(*sys.modules, file=sys.stderr)", word],
                          capture_output=True, text=True, timeout=120, check=False)
    loaded = set(done.stderr.split())
    assert done.stdout and "railstate.benchmarks.cli" in loaded and unused & loaded == set()


def test_the_list_of_commands_has_a_whole_line_for_each(railstate: Command) -> None:
    text = railstate("--help").out
    for name, (_, _, line) in cli.COMMANDS.items():
        assert f"  {name:10} {line}\n" in text
        command = cli.load(name)
        assert command.name == name and command.help


@pytest.mark.skipif(sys.platform == "win32", reason="there are no such signals")
def test_a_command_leaves_the_signals_as_they_were(railstate: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that end a process by default end it like Ctrl-C meanwhile, and by default again afterwards."""
    numbers, during = (signal.SIGTERM, signal.SIGHUP), []
    before = [signal.signal(number, signal.SIG_DFL) for number in numbers]
    try:
        monkeypatch.setattr(cli, "version", lambda name: str(during.extend(map(signal.getsignal, numbers))))
        assert railstate("--version").code == 0
        assert during == [signal.default_int_handler] * 2
        assert [signal.getsignal(number) for number in numbers] == [signal.SIG_DFL] * 2
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)
