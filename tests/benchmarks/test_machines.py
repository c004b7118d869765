"""The command line on machines as they are: readers that leave, outputs that are closed or full."""

from __future__ import annotations

import subprocess
import sys

import pytest

START = "from railstate.benchmarks.cli import main; main()"


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
