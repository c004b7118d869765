"""Assembling the report from a results folder: head, one section a scenario, tables, figures, one HTML file.

Everything comes from the rows, curves, kept runs, timing and manifest; no run is computed again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from importlib.resources import files
from pathlib import Path

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from ....scenarios.errors import InputError
from ...judging.claims import TOLERANCE
from ...judging.family import LEAST, MARGIN
from ...store.folder import write_whole
from ..figures.axes import Style, draw_marker
from ..figures.canvas import DARK, LIGHT, Canvas
from ..figures.catalogue import FIGURES, Figure, of_scenario
from ..figures.data import CellResults, Results, load_results
from ..paragraphs import paragraph
from ..sayings import caption, robust_contests
from ..wording import counted, notes_of
from .table import Failure, Table, contest_table, failures, table


@dataclass(frozen=True)
class Drawn:
    """A figure ready for the page."""

    name: str
    title: str
    caption: str
    svg: Markup


@dataclass(frozen=True)
class Variant:
    """What the page shows of one variant."""

    name: str
    title: str
    notes: list[str]
    runs: int
    table: Table
    failures: list[Failure]
    figures: list[Drawn]


@dataclass(frozen=True)
class Section:
    """What the page shows of one scenario. headline: its robust estimators against its Kalman filters."""

    name: str
    title: str
    source: str
    words: list[str]
    headline: Table
    figures: list[Drawn]
    variants: list[Variant]
    missing: str


def write_report(folder: str | Path, out: str | Path | None = None) -> Path:
    """Write `out` (None: report.html in the folder) and return its path. Raises InputError where the folder holds no
    results or the page cannot be written."""
    path = Path(out) if out else Path(folder) / "report.html"
    page = render(load_results(folder))
    try:
        write_whole(path, page)
    except OSError as error:
        hint = "" if out else "; --out FILE.html writes it elsewhere"
        raise InputError(f"{path}: cannot be written: {error.strerror}{hint}") from None
    return path


def render(results: Results) -> str:
    """The page's HTML."""
    here = files("railstate.benchmarks.telling.report")
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    template = environment.from_string(here.joinpath("page.jinja").read_text(encoding="utf-8"))
    colours = {name: "".join(f"--{key}:{value};" for key, value in palette.items())
               for name, palette in (("light", LIGHT), ("dark", DARK))}
    return template.render(
        css=Markup(here.joinpath("page.css").read_text(encoding="utf-8")),
        script=Markup(here.joinpath("page.js").read_text(encoding="utf-8")),
        light=Markup(colours["light"]), dark=Markup(colours["dark"]), facts=facts(results),
        sections=[section(results, name, cells) for name, cells in results.scenarios.items()],
        chips={label: chip(style) for label, style in results.styles.items()}, margin=f"{100 * MARGIN:g} %",
        tolerance=f"{100 * TOLERANCE:g} %", least=LEAST)


def facts(results: Results) -> list[tuple[str, str]]:
    """(what, value) lines of the page's head."""
    manifest = results.manifest
    configuration, environment = manifest["configuration"], manifest["environment"]
    packages: Mapping[str, str] = environment["packages"]
    statuses = results.rows["status"].value_counts()
    commit = environment["git_commit"]
    version = f"railstate {manifest['railstate']}"
    if commit:
        version += f", commit {commit[:10]}" + (" with uncommitted changes" if environment["git_dirty"] else "")
    return [
        ("Run", f"{counted(len(configuration['cells']), 'scenario variant')}, {configuration['runs']} runs each, "
                f"seed {configuration['seed']}"),
        ("Rows", f"{len(results.rows)}: " + ", ".join(f"{n} {status}" for status, n in statuses.items())),
        ("When", _period(manifest["started"], manifest["finished"])),
        ("Where", f"{environment['processor']}, {counted(environment['cores'], 'core')}, {environment['platform']}"),
        ("Versions", f"{version}; Python {environment['python']}, "
                     + ", ".join(f"{name} {number}" for name, number in packages.items())),
        ("Run again", manifest["command"]),
    ]


def _period(started: str, finished: str | None) -> str:
    begin = datetime.fromisoformat(started)
    text = f"{begin:%Y-%m-%d %H:%M} UTC"
    if not finished:
        return f"{text}, not finished"
    seconds = (datetime.fromisoformat(finished) - begin).total_seconds()
    return f"{text}, took {seconds / 60:.0f} min" if seconds >= 120 else f"{text}, took {seconds:.0f} s"


def section(results: Results, name: str, cells: Sequence[CellResults]) -> Section:
    """A scenario's part of the page."""
    by_variant: dict[str, list[Drawn]] = {cell.variant: [] for cell in cells}
    whole: list[Drawn] = []
    for figure in FIGURES:
        for variant, canvas in of_scenario(figure, cells):
            (by_variant[variant] if variant else whole).append(_drawn(figure, canvas))
    about = cells[0].about
    kept = any(cell.kept for cell in cells)
    return Section(
        name, about["title"], about["source"], paragraph(results.verdicts, name),
        contest_table(robust_contests(results.verdicts, name)), whole,
        [Variant(cell.variant, about["variants"][cell.variant]["title"],
                 [caption(cell.lines("error"), cell.runs), *notes_of(about["variants"][cell.variant])],
                 cell.runs, table(cell), failures(cell, str(results.folder)), by_variant[cell.variant])
         for cell in cells],
        "" if kept else "Example runs are not shown: this run kept no trajectories (railstate run --keep 1).")


def _drawn(figure: Figure, canvas: Canvas) -> Drawn:
    return Drawn(figure.name, figure.title, figure.caption, Markup(canvas.svg(inline=True)))


def chip(style: Style) -> Markup:
    """A small sample of an estimator's line and marker."""
    canvas = Canvas(10, "", width=20)
    canvas.path([(0, 5), (20, 5)], stroke=style.colour, width=1.6, dash=style.dash)
    draw_marker(canvas, 10, 5, style, 2.8)
    return Markup(canvas.svg(inline=True).replace('role="img" aria-label=""', 'class="chip" aria-hidden="true"'))
