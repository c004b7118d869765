"""`railstate verify DIR`: whether a results folder is what it says it is, without running anything that it holds."""

from __future__ import annotations

from typing import Annotated

import typer

from ..planning.catalogue import Catalogue
from ..running.machinery import machinery
from ..store.folder import Store
from ..studies.verify import verify
from ..telling.console import wrapped
from .options import Jobs, Memory, Plugins, Timeout


def verify_(
    folder: Annotated[str, typer.Argument(metavar="DIR", help="A results folder, whoever's.")],
    rows: Annotated[int, typer.Option(min=0, help="How many of its rows are drawn and computed anew.")] = 50,
    seed: Annotated[int, typer.Option(help="Of the draw.")] = 1,
    plugin: Plugins = [],  # noqa: B006
    jobs: Jobs = 0,
    timeout: Timeout = 900.0,
    memory: Memory = 0.0,
) -> None:
    """Make a folder's tables anew from its rows and compare, compute a sample of its rows anew and compare to the bit.

    Exit code 0 only if all that could be checked agrees; what could not is said, and why."""
    how = machinery(jobs, timeout=timeout, memory=memory)
    found = verify(Store(folder), Catalogue(plugin), how, rows, seed)
    for line in found.checked:
        wrapped(line)
    for line in found.unchecked:
        wrapped(f"not checked: {line}")
    for line in found.wrong:
        wrapped(f"WRONG: {line}")
    print(f"{folder}: " + ("does not agree with itself" if found.wrong else
                           "all that could be checked agrees" if found.checked else "nothing could be checked"))
    if found.wrong or not found.checked:
        raise typer.Exit(1)
