"""A results folder as the figures and the report want it: cells with their rows, curves, kept trajectories, styles.

Read once; nothing here computes an estimate or a statistic."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ....scenarios.arrays import Array
from ....scenarios.errors import InputError
from ....scenarios.registry import setting_of
from ....scenarios.setting import Setting
from ...judging.selection import Aligned, Column
from ...judging.table import verdicts_of
from ...scoring.columns import shown_unit
from ...store.folder import Store
from ..rankings import Cell, cells_of
from .axes import DASHES, MARKERS, Style
from .canvas import COLOURS, WIDTH

CROWD = 8
"""From more curves than these on a panel shows bands no more, and not every entry's curve."""


@dataclass(frozen=True)
class Curve:
    """Sums over the runs at each step: time (K,), number of runs, sum of squares, of their squares, of errors, of
    the least mean squares possible (NaN or empty: not known)."""

    time: Array
    active: Array
    squared: Array
    fourth: Array
    error: Array
    floor: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True)
class Kept:
    """One kept trajectory of one named quantity: time (K,), truth, estimate, claimed standard deviation."""

    time: Array
    truth: Array
    estimate: Array
    sd: Array


@dataclass(frozen=True)
class CellResults(Cell):
    """One variant of one scenario with its runs. table: the scenario's. curves: by (estimator, quantity). kept: by
    (estimator, name) of one kept run (the first), estimator "" for the truth's own. only: quantities that figures of
    errors are to show. width: of figures, in points."""

    table: Mapping[str, Any]
    rows: pd.DataFrame
    curves: Mapping[tuple[str, str], Curve]
    kept: Mapping[tuple[str, str], Kept]
    styles: Mapping[str, Style]
    only: tuple[str, ...] = ()
    width: float = WIDTH

    def chosen(self, names: Sequence[str], most: int) -> list[str]:
        """The quantities a figure shows: those asked for, else the first `most`."""
        return [name for name in names if name in self.only] if self.only else list(names[:most])

    def apart(self, labels: Sequence[str]) -> list[str]:
        """Those whose curves lie over one another in a panel: all that were asked for; else, where they are more than
        `CROWD`, of each family the one that errs least, by the first quantity that is judged."""
        if len(labels) <= CROWD or not self.judged or set(self.ran) < set(self.entries):
            return list(labels)
        _, metric, quantity, _ = self.judged[0]
        best: dict[str, tuple[float, str]] = {}
        for label in labels:
            error = next((float(line["value"]) for line in self.of("error", metric, quantity)
                          if line["estimator"] == label and np.isfinite(line["value"])), np.inf)
            family = self.families.get(label, "Other")
            best[family] = min(best.get(family, (np.inf, label)), (error, label), key=lambda found: found[0])
        shown = {label for _, label in best.values()}
        return [label for label in labels if label in shown]

    @property
    def ran(self) -> list[str]:
        """Its estimators in the order of the rows."""
        return [str(label) for label in self.rows["estimator"].unique()]

    def styled(self, labels: Sequence[str]) -> list[tuple[str, Style]]:
        """Estimators with their looks, for a legend."""
        return [(label, self.styles[label]) for label in labels]

    @property
    def period(self) -> float:
        return float(self.about["variants"][self.variant]["period"])

    @cached_property
    def setting(self) -> Setting[Any]:
        """The variant's setting, made anew from the manifest. Raises InputError where its plug-in is not installed."""
        return setting_of(self.table, self.key)

    @cached_property
    def judged(self) -> list[Column]:
        """The error columns that are judged, one per quantity."""
        found = dict.fromkeys((line["metric"], line["quantity"], line["unit"]) for line in self.of("error"))
        return [(":".join(names), *names) for names in found]

    def values(self, column: str) -> dict[str, Array]:
        """A column of the rows per estimator, aligned by run."""
        return dict(zip(self._aligned.labels, self._aligned.values(column), strict=True))

    @cached_property
    def _aligned(self) -> Aligned:
        return Aligned(self.rows)

    def unit(self, metric: str, quantity: str, unit: str) -> tuple[str, float]:
        """Shown unit and factor."""
        return shown_unit(self.about, metric, quantity, unit)

    def quantity_units(self) -> dict[str, tuple[str, float]]:
        """Shown unit and factor of every scored quantity's error."""
        found: dict[str, tuple[str, float]] = {}
        for name in self.rows.columns:
            metric, _, rest = name.partition(":")
            quantity, _, unit = rest.partition(":")
            if metric == "rmse" and quantity in self.about["quantities"]:
                found[quantity] = self.unit("rmse", quantity, unit)
        return found


@dataclass(frozen=True)
class Results:
    """A results folder: manifest, all rows, and the cells of each scenario (the first is its default variant)."""

    folder: Path
    manifest: Mapping[str, Any]
    rows: pd.DataFrame
    verdicts: pd.DataFrame
    scenarios: Mapping[str, Sequence[CellResults]]
    styles: Mapping[str, Style]


def load_results(folder: str | Path, *, run: int = 0, only: Sequence[str] = (), entries: Sequence[str] = (),
                 width: float = WIDTH) -> Results:
    """Read a results folder. run: which of the kept runs figures of one run show, from 0 on; only, entries: the
    quantities and estimators they show (none: as many as fit); width: theirs, in points. Raises InputError where it is
    none, is damaged or holds no rows, or where these are not in it."""
    store = Store(folder)
    manifest, rows = store.manifest(), store.rows()
    known = sorted({name for about in manifest["scenarios"].values() for name in about["quantities"]})
    labels = [str(label) for label in rows["estimator"].unique()]
    for flag, wanted, there in (("--quantities", only, known), ("--entries", entries, labels)):
        if unknown := [name for name in wanted if name not in there]:
            raise InputError(f"{flag} {unknown[0]}: not in this folder; allowed: {', '.join(there)}")
    curves, kept, verdicts = _curves(store.curves()), _kept(store.trajectories(), run), verdicts_of(store)
    if entries:
        rows = rows[rows["estimator"].isin(entries)]
        verdicts = verdicts[verdicts["estimator"].isin(entries)]
    styles = assign_styles([[label for label in cell["estimators"] if not entries or label in entries]
                            for cell in manifest["configuration"]["cells"].values()])
    parts = {(str(a), str(b)): part for (a, b), part in rows.groupby(["scenario", "variant"], sort=False)}
    scenarios: dict[str, list[CellResults]] = {}
    for cell in cells_of(verdicts, manifest, store.timing()):
        key = cell.scenario, cell.variant
        if key not in parts:
            raise InputError(f"{store.folder}: verdicts.parquet tells of {cell.key}, and no rows are there; remove it")
        scenarios.setdefault(cell.scenario, []).append(CellResults(
            **{part.name: getattr(cell, part.name) for part in fields(cell)},
            table=manifest["replay"]["cells"][cell.key]["table"],
            rows=parts[key].dropna(axis=1, how="all").reset_index(drop=True),
            curves=curves.get(key, {}), kept=kept.get(key, {}), styles=styles, only=tuple(only), width=width))
    return Results(store.folder, manifest, rows, verdicts, scenarios, styles)


def assign_styles(groups: Sequence[Sequence[str]]) -> dict[str, Style]:
    """One style per label for the whole run. groups: the labels that appear together.

    Each label takes the first place that none of its companions has: colours, dashes and markers go round in their own
    time, so that labels seen together differ in dash or marker as well, and survive grey; up to eight differ in colour.
    Estimators that never appear together may look alike."""
    companions: dict[str, set[str]] = {}
    for group in groups:
        for label in group:
            companions.setdefault(label, set()).update(group)
    chosen: dict[str, int] = {}
    for label, others in companions.items():
        near = {chosen[other] for other in others if other in chosen}
        chosen[label] = next(place for place in itertools.count() if place not in near)
    return {label: Style(f"c{n % COLOURS}", DASHES[n % len(DASHES)], MARKERS[(n + n // len(DASHES)) % len(MARKERS)])
            for label, n in chosen.items()}


def _curves(frame: pd.DataFrame) -> dict[tuple[str, str], dict[tuple[str, str], Curve]]:
    return {cell: {key: Curve(*columns) for key, columns in parts.items()} for cell, parts in
            _split(frame, "quantity", ("time", "active", "squared", "fourth", "error", "floor")).items()}


def _kept(frame: pd.DataFrame | None, run: int) -> dict[tuple[str, str], dict[tuple[str, str], Kept]]:
    kept = [] if frame is None else sorted(frame["run"].unique().tolist())
    if run and run >= len(kept):
        raise InputError(f"--run {run}: {len(kept)} runs are kept, counted from 0 (railstate run --keep)")
    if frame is None:
        return {}
    first = frame.loc[frame["run"] == kept[run]]
    return {cell: {key: Kept(*columns) for key, columns in parts.items()} for cell, parts in
            _split(first, "name", ("time", "truth", "estimate", "sd")).items()}


def _split(frame: pd.DataFrame, name: str, columns: Sequence[str]) -> dict[
        tuple[str, str], dict[tuple[str, str], list[Array]]]:
    """Columns as arrays ordered by step: by (scenario, variant), then by (estimator, the column `name`)."""
    coded = [pd.factorize(frame[key]) for key in ("scenario", "variant", "estimator", name)]
    codes = np.array([code for code, _ in coded]).reshape(4, len(frame))
    order = np.lexsort((frame["step"].to_numpy(), *codes[::-1]))
    codes = codes[:, order]
    values = [frame[column].to_numpy(dtype=float)[order] for column in columns]
    edges = np.flatnonzero(np.r_[True, (np.diff(codes, axis=1) != 0).any(axis=0), True]) if len(frame) else []
    out: dict[tuple[str, str], dict[tuple[str, str], list[Array]]] = {}
    for begin, end in itertools.pairwise(edges):
        names = [str(known[code]) for (_, known), code in zip(coded, codes[:, begin], strict=True)]
        out.setdefault((names[0], names[1]), {})[names[2], names[3]] = [column[begin:end] for column in values]
    return out
