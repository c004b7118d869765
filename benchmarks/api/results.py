"""A results folder as Python asks for it: rows, verdicts, comparisons, figures, the page.

`railstate compare`, `report` and `plot` are these with options and printing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...scenarios.errors import InputError
from ..judging.table import summary, verdicts_of
from ..store.folder import Store, inside

if TYPE_CHECKING:
    import pandas as pd

    from ..judging.comparison import Comparison
    from ..telling.figures.canvas import Canvas

FORMATS = ("svg", "pdf", "png")


def load(folder: str | Path) -> Results:
    """The results of a folder. Raises InputError where it is none."""
    store = Store(folder)
    store.manifest()
    return Results(store)


class Results:
    """A results folder: rows and what is said of them. Shown in a notebook as its table over settings."""

    def __init__(self, store: Store) -> None:
        self.store = store

    @property
    def folder(self) -> Path:
        return self.store.folder

    @cached_property
    def rows(self) -> pd.DataFrame:
        """A line per scenario, variant, estimator and run; columns `metric:quantity:unit`, in SI units."""
        return self.store.rows()

    def verdicts(self) -> pd.DataFrame:
        """The verdict table: value with its interval, ratio to the best, verdict, of each error, claim and outcome."""
        return verdicts_of(self.store)

    def summary(self) -> pd.DataFrame:
        """Means over the finished runs with their standard errors, and the shares of runs that did not end well."""
        return summary(self.verdicts())

    def timing(self) -> pd.DataFrame | None:
        """Design, latency and throughput by setting and estimator."""
        return self.store.timing()

    def compare(self, a: str | Path | Results, b: str | None = None) -> pd.DataFrame:
        """B against A over the same runs: two estimators of these results, or, with one argument, those of another
        folder (A) against these (B). A line per setting and error: values, ratio with its 95 % interval, verdict.
        Raises InputError."""
        import pandas as pd

        from ..judging.comparison import between_folders

        if isinstance(a, str) and b is not None:
            found = self.comparisons(a, b)
        else:
            found = between_folders(a.store if isinstance(a, Results) else Store(a), self.store).found
        return pd.DataFrame([{
            "setting": each.cell, **({"estimator": each.label} if each.label else {}), "metric": each.b["metric"],
            "quantity": each.b["quantity"], "unit": each.b["unit"], "a": each.a["value"], "b": each.b["value"],
            **{name: each.b.get(name) for name in ("ratio", "ratio_low", "ratio_high", "won", "runs")},
            "verdict": each.verdict} for each in found])

    def comparisons(self, a: str, b: str) -> list[Comparison]:
        """The same as lines of the verdict table. Raises InputError for an estimator that is not there."""
        from ..judging.comparison import between_estimators

        there = list(dict.fromkeys(map(str, self.rows["estimator"])))
        for name in (a, b):
            if name not in there:
                raise InputError(f"{name}: not among these results; allowed: {', '.join(there)}")
        return between_estimators(self.rows, self.store.manifest(), a, b)

    def plot(self, figure: str = "", *, entries: Sequence[str] = (), quantities: Sequence[str] = (),
             width: float = 3.5, run: int = 0) -> Figures:
        """Figures of one kind, of every setting that has it (none: of all kinds); shown in a notebook, `save` writes
        them. entries, quantities: what they show; width: inches; run: which of the kept runs. Raises InputError."""
        from ..telling.figures.catalogue import FIGURES, drawn
        from ..telling.figures.data import load_results

        names = [item.name for item in FIGURES]
        if figure and figure not in names:
            raise InputError(f"--figure {figure}: unknown; allowed: {', '.join(names)}")
        data = load_results(self.folder, run=run, only=quantities, entries=entries, width=72 * width)
        found = {"~".join(filter(None, (item.name, scenario, variant))): canvas
                 for item, scenario, variant, canvas in drawn(data, figure or None)}
        if not found:
            raise InputError(f"{self.folder}: has no data for this figure; settings' own figures and the example run "
                             "need trajectories (railstate run --keep 1)")
        return Figures(found)

    def report(self, path: str | Path | None = None, published: Mapping[str, Any] | None = None) -> Path:
        """Write one self-contained page (None: report.html in the folder) and return its path. published: what
        published.json holds. Raises InputError."""
        from ..telling.report import write_report

        return write_report(self.folder, path, published)

    def __repr__(self) -> str:
        return f"{len(self.rows)} rows in {self.folder}"

    def _repr_html_(self) -> str:
        from ..telling.over_settings import grid, to_html
        from ..telling.rankings import cells_of

        cells = list(cells_of(self.verdicts(), self.store.manifest()))
        return f"{to_html(grid(cells), 'results')}<p>{escape(repr(self))}</p>"


class Figures:
    """Figures by name; a notebook shows them."""

    def __init__(self, drawn: Mapping[str, Canvas]) -> None:
        self.drawn = dict(drawn)

    def __iter__(self) -> Iterator[str]:
        return iter(self.drawn)

    def __len__(self) -> int:
        return len(self.drawn)

    def __repr__(self) -> str:
        return f"{len(self)} figures: {', '.join(self)}"

    def _repr_html_(self) -> str:
        return "".join(f"<figure><figcaption>{escape(name.replace('~', ', '))}</figcaption>{canvas.svg()}</figure>"
                       for name, canvas in self.drawn.items())

    def save(self, folder: str | Path, kind: str = "pdf") -> list[Path]:
        """Write each as FOLDER/NAME.kind (svg, pdf or png); the paths. Raises InputError."""
        if kind not in FORMATS:
            raise InputError(f"--format {kind}: unknown; allowed: {', '.join(FORMATS)}")
        target = Path(folder)
        try:
            target.mkdir(parents=True, exist_ok=True)
            paths = [inside(target, f"{name}.{kind}") for name in self.drawn]
            for path, canvas in zip(paths, self.drawn.values(), strict=True):
                canvas.save(path)
        except OSError as error:
            raise InputError(f"{target}: cannot be written: {error}") from None
        return paths
