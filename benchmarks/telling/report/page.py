"""Assembling the report from a results folder: overview, a section a scenario, published numbers, provenance; one file.

Everything comes from the verdict table, rows, curves, kept runs, timing and manifest; no run is computed again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup

from ....scenarios.errors import InputError
from ...judging.claims import TOLERANCE
from ...judging.family import LEAST, MARGIN
from ...store.folder import write_whole
from ..cleaning import visible
from ..figures.canvas import DARK, LIGHT
from ..figures.data import Results, load_results
from ..marks import MARKS
from ..rankings import Cell
from ..sentences import over_all, required
from ..wording import counted
from . import sweep
from .matrix import anchor, families_in_words, matrix
from .published import Paper, papers, sentence
from .sections import chip, section
from .tuned import tuned_table


def write_report(folder: str | Path, out: str | Path | None = None, published: Mapping[str, Any] | None = None
                 ) -> Path:
    """Write `out` (None: report.html in the folder) and return its path. published: what published.json
    holds, where there is one. Raises InputError where the folder holds no results or the page cannot be written."""
    path = Path(out) if out else Path(folder) / "report.html"
    page = render_sweep(folder) if sweep.is_sweep(folder) else render(load_results(folder), published)
    try:
        write_whole(path, page)
    except OSError as error:
        hint = "" if out else "; --out FILE.html writes it elsewhere"
        raise InputError(f"{path}: cannot be written: {error.strerror}{hint}") from None
    return path


def render(results: Results, published: Mapping[str, Any] | None = None) -> str:
    """The page's HTML."""
    cells = [cell for found in results.scenarios.values() for cell in found]
    view = matrix(cells)
    told = papers(published) if published is not None else []
    return laid_out(
        "page.jinja", head=headline(results), matrix=view, marks=MARKS,
        words=_first_words(cells, int(results.manifest["configuration"]["runs"]), told),
        families=families_in_words(cells, results.manifest["estimators"], view.families),
        sections=[section(results, name, found) for name, found in results.scenarios.items()],
        tuned={name: tuned_table(found) for name, found in results.scenarios.items()},
        published=told, facts=facts(results))


def render_sweep(folder: str | Path) -> str:
    """The HTML of a sweep's page."""
    swept, table = sweep.load(folder)
    over = " and ".join(swept.keys)
    return laid_out("sweep.jinja", sweep=swept, tables=sweep.tables(swept, table),
                    question=f"{swept.name}: which estimator at which {over}?",
                    head=f"{counted(len(swept.lost), 'point')}, {len(swept.estimators)} estimators, "
                         f"{swept.runs} runs each, seed {swept.seed} · railstate")


def laid_out(name: str, **parts: Any) -> str:
    """A page by its template, with the looks that all pages share."""
    def text(file: str) -> str:
        return here.joinpath(file).read_text(encoding="utf-8")

    here = files("railstate.benchmarks.telling.report")
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
                              loader=FunctionLoader(text))
    environment.filters["nbsp"] = lambda text: str(text).replace(" %", "\u202f%").replace(" ±", "\u00a0±")
    light, dark = (Markup("".join(f"--{key}:{value};" for key, value in palette.items() if key[1:].isdigit()))
                   for palette in (LIGHT, DARK))
    environment.globals["chip"] = chip
    page = environment.get_template(name).render(css=Markup(text("page.css")), script=Markup(text("page.js")),
                                                 light=light, dark=dark, **parts)
    return visible(page)


def _first_words(cells: Sequence[Cell], runs: int, told: list[Paper]) -> list[tuple[str, str]]:
    """(sentence, the id that it leads to) of the first paragraph: comparisons, lost runs and claims, requirements,
    published numbers."""
    asked = next((cell for cell in cells if cell.requirements), None)
    words = [(line, "") for line in over_all(cells, runs)]
    if asked:
        words.append((required(cells), anchor(asked.scenario)))
    if said := sentence(told):
        words.append((said, "published"))
    return words


def headline(results: Results) -> str:
    """`31 settings, 37 entries, 20 runs each, seed 1, 5,300 rows, 5,300 ok · railstate 0.1.0 · 2026-11-25`."""
    configuration = results.manifest["configuration"]
    entries = {label for cell in configuration["cells"].values() for label in cell["estimators"]}
    statuses = results.rows["status"].value_counts()
    kinds = ", ".join(f"{n:,} {status}" for status, n in statuses.items())
    return (f"{counted(len(configuration['cells']), 'setting')}, {len(entries)} entries, {configuration['runs']} runs "
            f"each, seed {configuration['seed']}, {counted(len(results.rows), 'row')}: {kinds} · railstate "
            f"{results.manifest['railstate']} · {datetime.fromisoformat(results.manifest['started']):%Y-%m-%d}")


def facts(results: Results) -> list[tuple[str, str]]:
    """(what, value) lines of the provenance."""
    manifest = results.manifest
    environment = manifest["environment"]
    packages: Mapping[str, str] = environment["packages"]
    statuses = results.rows["status"].value_counts()
    commit = environment["git_commit"]
    version = f"railstate {manifest['railstate']}"
    if commit:
        version += f", commit {commit[:10]}" + (" with uncommitted changes" if environment["git_dirty"] else "")
    return [
        ("Run again", manifest["command"]),
        ("Rows", f"{len(results.rows)}: " + ", ".join(f"{n} {status}" for status, n in statuses.items())),
        ("When", _period(manifest["started"], manifest["finished"])),
        ("Version", version),
        ("Where", f"{environment['processor']}, {counted(environment['cores'], 'core')}, {environment['platform']}"),
        ("Packages", f"Python {environment['python']}, " + ", ".join(f"{name} {n}" for name, n in packages.items())),
        ("Verdicts", "Of rows alone, once, in verdicts.csv. All entries of a setting see the same truths and the same "
         "measurements. A ratio's interval holds for all pairs of a setting's entries at once; a lost run counts as "
         f"the largest error. worse: the interval lies above 1 and reaches 1 + {MARGIN:g}; tie: it lies within 1 ± "
         f"{MARGIN:g}; else undecided. Under {LEAST} runs there is no verdict. Who loses more runs than equals "
         f"would is never the best. A covariance claim is consistent where the ANEES' interval lies within 1 ± "
         f"{TOLERANCE:g}; beside it stand the median over the steps (1 is right) and the share of steps inside the "
         "95 % ellipsoid."),
        ("Verify", f"railstate verify {results.folder} makes the tables anew from the rows, and a sample of the rows; "
         f"railstate replay SETTING/ENTRY/RUN --out {results.folder} computes one; railstate compare {results.folder} "
         "OTHER tells what differs from another folder, to the bit."),
    ]


def _period(started: str, finished: str | None) -> str:
    begin = datetime.fromisoformat(started)
    text = f"{begin:%Y-%m-%d %H:%M} UTC"
    if not finished:
        return f"{text}, not finished"
    seconds = (datetime.fromisoformat(finished) - begin).total_seconds()
    return f"{text}, took {seconds / 60:.0f} min" if seconds >= 120 else f"{text}, took {seconds:.0f} s"
