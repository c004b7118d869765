"""`railstate report` and `railstate plot`: the page and the figures of a results folder, from its files alone."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from ...scenarios.errors import InputError
from .options import names_in

PUBLISHED = "results/published/published.json"


def report(
    folder: Annotated[str, typer.Argument(metavar="DIR", help="A results folder (railstate run --out DIR).")],
    out: Annotated[str, typer.Option(metavar="FILE.html", help="Where to write (default: DIR/report.html).")] = "",
    published: Annotated[str, typer.Option(
        metavar="FILE.json", help="Published numbers to show, as `railstate reproduce` writes them; none: those of "
        "results/published, where it is here.")] = PUBLISHED,
) -> None:
    """Write DIR/report.html: one self-contained page with verdicts, tables and figures."""
    from ..telling.report import write_report

    path = write_report(folder, out, _published(published))
    print(f"{path} ({path.stat().st_size / 1e6:.1f} MB)")


def _published(path: str) -> dict[str, Any] | None:
    """What published.json holds; None where there is none at the usual place. Raises InputError."""
    if not path or (path == PUBLISHED and not Path(path).is_file()):
        return None
    try:
        found = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"--published {path}: cannot be read: {error}") from None
    if not isinstance(found, dict) or "papers" not in found:
        raise InputError(f"--published {path}: has no papers; expected the published.json of railstate reproduce")
    return found


def plot(
    folder: Annotated[str, typer.Argument(metavar="DIR", help="A results folder (railstate run --out DIR).")],
    figure: Annotated[str, typer.Option(help="Only this figure; an unknown name lists them all.")] = "",
    entries: Annotated[str, typer.Option("--entries", "--estimators", "-e", metavar="A,B",
                                         help="Only these estimators.")] = "",
    quantities: Annotated[str, typer.Option("--quantities", "--quantity", metavar="A,B",
                                            help="Only these quantities in figures of errors.")] = "",
    width: Annotated[float, typer.Option(min=2.0, max=12.0, help="Width in inches; 3.5: a paper's column.")] = 3.5,
    run: Annotated[int, typer.Option(min=0, help="Which of the kept runs figures of one run show, from 0 on.")] = 0,
    format_: Annotated[str, typer.Option("--format", help="svg, pdf or png.")] = "pdf",
    out: Annotated[str, typer.Option(help="Where to write (default: DIR/figures).")] = "",
) -> None:
    """Write the figures as files. Lines differ in dashes and markers as well, so that they survive grey."""
    from ..api.results import load
    from ..store.folder import within

    figures = load(folder).plot(figure, entries=names_in(entries), quantities=names_in(quantities), width=width,
                                run=run)
    target = out or str(within(Path(folder), "figures"))
    print(f"{len(figures.save(target, format_))} figures in {target}")
