"""The command line. Each command is a function of `commands/`, imported when it is called for: help comes at once.

Exit codes: 0 done, 1 a check failed, 2 the input is wrong, 130 interrupted. This module turns errors into them."""

from __future__ import annotations

import atexit
import gc
import os
import signal
import sys
import threading
import warnings
from collections.abc import Sequence
from importlib import import_module
from importlib.metadata import version
from typing import Annotated, Any, TextIO

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_group

from ..scenarios.errors import InputError, Interrupted
from .isolation.server import worded
from .telling.cleaning import Cleaned, visible

for _library in ("OPENBLAS", "OMP", "MKL"):  # for matrices of a few states threads take longer than they save
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

COMMANDS = {
    "run": ("run", "run", "Run estimators on scenarios and print the tables."),
    "list": ("show", "list_", "List scenarios and estimators."),
    "show": ("show", "show", "Show a scenario resolved, or an estimator's parameters."),
    "replay": ("replay", "replay", "Run one row again and compare it with the stored one."),
    "sweep": ("sweep", "sweep", "Run a scenario at each value of a key."),
    "tune": ("tune", "tune_", "Search an estimator's numbers on training runs."),
    "design": ("design", "design", "Design estimators; print gains and certified bounds."),
    "certify": ("design", "certify", "Put any gain through Theorem 1."),
    "reproduce": ("reproduce", "reproduce", "Set our numbers beside the published ones."),
    "timing": ("timing", "timing", "Measure speed side by side with peers."),
    "report": ("report", "report", "Write DIR/report.html, one self-contained page."),
    "plot": ("report", "plot", "Write the figures as files."),
    "table": ("table", "table", "One table over settings for a paper."),
    "check": ("check", "check", "Check that an estimator keeps the rules of the suite."),
    "inspect": ("inspect", "inspect", "Say what is in a recorded trip, and map it."),
    "compare": ("compare", "compare", "Compare B with A, paired over the same runs."),
    "verify": ("verify", "verify_", "Compute a folder's tables and some of its rows anew."),
    "schema": ("show", "schema", "Print the JSON schema of scenario files, for editors."),
    "new": ("new", "app", "Write a package for an estimator or a scenario."),
}
"""A command's module in `commands/`, its function (or group) there, and its line in the list of all."""


def load(name: str) -> TyperCommand | TyperGroup:
    """A command as its module has it."""
    module, attribute, _ = COMMANDS[name]
    found: Any = getattr(import_module(f".commands.{module}", __package__), attribute)
    holder = typer.Typer(rich_markup_mode=None)
    if isinstance(found, typer.Typer):
        holder.add_typer(found, name=name)
    else:
        holder.command(name)(found)
    return get_group(holder).commands[name]  # pyright: ignore[reportReturnType]


class Named(TyperCommand):
    """A command that is known by its name, and imported when its words are read."""

    def make_context(self, info_name: str | None, args: list[str], *rest: Any, **extra: Any) -> Any:
        return load(str(self.name)).make_context(info_name, args, *rest, **extra)


app = typer.Typer(
    add_completion=False, no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False,
    invoke_without_command=True)
for word, (_, _, line) in COMMANDS.items():
    app.command(word, cls=Named, help=line)(lambda: None)


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
            print(f"warning: {visible(text)}", file=sys.stderr)

    gc.set_threshold(100_000, 50, 100)  # trees of syntax and tables are many objects, no cycles
    atexit.register(gc.freeze)  # who ends need not look for garbage first
    warnings.showwarning = warn
    kept: Sequence[int] = ()
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed: nobody reads it, the work is done all the same
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
    streams = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = map(Cleaned, streams)
    try:
        kept = _end_on_sigterm()
        try:
            app()
        finally:
            _hand_on(streams[0])
    except BrokenPipeError:
        raise SystemExit(141) from None
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
        process = sys.modules.get(f"{__package__}.isolation.process")
        if process is not None:
            process.end_idle()
        sys.stdout, sys.stderr = streams
        for number in kept:
            signal.signal(number, signal.SIG_DFL)


def _hand_on(stream: TextIO) -> None:
    """Write what standard output holds back; what it does not take is dropped: at its end Python would try once more.
    """
    try:
        stream.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
        raise


def _end_on_sigterm() -> Sequence[int]:
    """SIGTERM and a closed terminal end like Ctrl-C: everything started is ended, the line that continues is said. The
    signals that this is new to."""
    found = []
    if threading.current_thread() is threading.main_thread():
        found = [number for number in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(number) == signal.SIG_DFL]
        for number in found:
            signal.signal(number, signal.default_int_handler)
    return found
