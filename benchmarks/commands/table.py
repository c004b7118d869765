"""`railstate table`: one table over the settings of a results folder, for a paper, a page or a spreadsheet."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ...scenarios.errors import InputError
from ..judging.table import verdicts_of
from ..store.folder import Store
from .options import names_in, written


def table(
    folder: Annotated[str, typer.Argument(metavar="DIR", help="A results folder (railstate run --out DIR).")],
    scenarios: Annotated[str, typer.Option(metavar="A,B/VARIANT", help="Settings; none: all.")] = "",
    estimators: Annotated[str, typer.Option("--estimators", "--entries", "-e", metavar="A,B",
                                            help="Entries, in this order; none: all.")] = "",
    quantities: Annotated[str, typer.Option(metavar="A,B", help="Quantities; none: all.")] = "",
    format_: Annotated[str, typer.Option("--format", help="tex, md, csv or html.")] = "tex",
    out: Annotated[str, typer.Option(metavar="FILE", help="Where to write; none: print.")] = "",
) -> None:
    """One table over settings: errors, the least in bold with what ties, signs, ratios, a caption with the rest."""
    from ..telling.over_settings import WRITERS, grid
    from ..telling.rankings import cells_of
    from ..telling.report.matrix import anchor

    if format_ not in WRITERS:
        raise InputError(f"--format {format_}: unknown; allowed: {', '.join(WRITERS)}")
    store = Store(folder)
    made = grid(list(cells_of(verdicts_of(store), store.manifest())), names_in(scenarios), names_in(estimators),
                names_in(quantities))
    name = anchor(*dict.fromkeys(cell.scenario for cell in made.cells)) if len(made.cells) < 12 else "settings"
    text = WRITERS[format_](made, name)
    if not out:
        print(text, end="")
        return
    with written("--out", out):
        Path(out).write_text(text, encoding="utf-8")
    print(out)
