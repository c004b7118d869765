"""The command line. Each command is a function of `commands/`; this module assembles them and turns errors into exits.

Exit codes: 0 done, 1 a check failed, 2 the input is wrong, 130 interrupted."""

from __future__ import annotations

import os
import signal
import sys
import threading
import warnings
from collections.abc import Sequence
from importlib.metadata import version
from typing import Annotated

import typer

from ..scenarios.errors import InputError
from .commands.check import check
from .commands.compare import compare
from .commands.design import certify, design
from .commands.inspect import inspect
from .commands.new import app as new
from .commands.replay import replay
from .commands.report import plot, report
from .commands.reproduce import reproduce
from .commands.run import run
from .commands.show import list_, schema, show
from .commands.sweep import sweep
from .commands.table import table
from .commands.timing import timing
from .commands.tune import tune_
from .commands.verify import verify_
from .isolation.process import end_idle
from .isolation.server import worded
from .studies.complete import Interrupted

app = typer.Typer(
    add_completion=False, no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False,
    invoke_without_command=True)
for function, name in (
        (run, "run"), (list_, "list"), (show, "show"), (replay, "replay"), (sweep, "sweep"), (tune_, "tune"),
        (design, "design"), (certify, "certify"), (reproduce, "reproduce"), (timing, "timing"), (report, "report"),
        (plot, "plot"), (table, "table"), (check, "check"), (inspect, "inspect"), (compare, "compare"),
        (verify_, "verify"), (schema, "schema")):
    app.command(name)(function)
app.add_typer(new, name="new")


@app.callback()
def options(version_: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False) -> None:
    """Compare estimators of a train's state on the same simulated truths."""
    if version_:
        print(f"railstate {version('railstate')}")
        raise typer.Exit


def main() -> None:
    """Entry point of the console script."""
    said: set[str] = set()

    def warn(message: Warning | str, category: type[Warning], file: str, line: int, *_: object) -> None:
        text = worded(str(message), category, file, line)
        if text not in said:  # once, from however many processes
            said.add(text)
            print(f"warning: {text}", file=sys.stderr)

    warnings.showwarning = warn
    kept: Sequence[int] = ()
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed: nobody reads it, the work is done all the same
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
    try:
        kept = _end_on_sigterm()
        app()
    except SystemExit as ended:
        if ended.code == 1 and type(sys.stdout).__name__ == "PacifyFlushWrapper":  # the reader has gone (`| head`)
            raise SystemExit(141) from None
        raise
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    except OSError as error:  # a place that cannot be read or written
        print(f"error: {error.filename or 'input or output'}: {error.strerror or error}", file=sys.stderr)
        raise SystemExit(2) from None
    except MemoryError as error:
        print(f"error: not enough memory ({error}): fewer steps, or a smaller --batch", file=sys.stderr)
        raise SystemExit(2) from None
    except Interrupted as error:
        print(error, file=sys.stderr)
        raise SystemExit(130) from None
    except KeyboardInterrupt:
        raise SystemExit(130) from None
    finally:
        end_idle()
        for number in kept:
            signal.signal(number, signal.SIG_DFL)


def _end_on_sigterm() -> Sequence[int]:
    """SIGTERM and a closed terminal end like Ctrl-C: everything started is ended, the line that continues is said. The
    signals that this is new to."""
    found = []
    if threading.current_thread() is threading.main_thread():
        found = [number for number in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(number) == signal.SIG_DFL]
        for number in found:
            signal.signal(number, signal.default_int_handler)
    return found
