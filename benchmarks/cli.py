"""The command line. Each command is a function of `commands/`; this module assembles them and turns errors into exits.

Exit codes: 0 done, 1 a check failed, 2 the input is wrong, 130 interrupted."""

from __future__ import annotations

import sys
import warnings

import typer

from ..scenarios.errors import InputError
from .batch import Interrupted
from .commands.check import check
from .commands.compare import compare
from .commands.design import certify, design
from .commands.new import app as new
from .commands.replay import replay
from .commands.report import plot, report
from .commands.reproduce import reproduce
from .commands.run import run
from .commands.show import list_, schema, show
from .commands.sweep import sweep
from .commands.timing import timing

app = typer.Typer(
    add_completion=False, no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False,
    help="Compare estimators of a train's state on the same simulated truths.")
for function, name in (
        (run, "run"), (list_, "list"), (show, "show"), (replay, "replay"), (sweep, "sweep"), (design, "design"),
        (certify, "certify"), (reproduce, "reproduce"), (timing, "timing"), (report, "report"), (plot, "plot"),
        (check, "check"), (compare, "compare"), (schema, "schema")):
    app.command(name)(function)
app.add_typer(new, name="new")


def main() -> None:
    """Entry point of the console script."""
    warnings.showwarning = lambda message, *_: print(f"warning: {message}", file=sys.stderr)
    try:
        app()
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    except Interrupted as error:
        print(error, file=sys.stderr)
        raise SystemExit(130) from None
    except KeyboardInterrupt:
        raise SystemExit(130) from None
    except BrokenPipeError:
        sys.stderr.close()
        raise SystemExit(0) from None
