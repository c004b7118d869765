"""B against A over the same runs: two estimators of one results folder, or all estimators of two folders.

Made from rows alone, by the rules of the verdict table with each pair a family of its own; `better` means B is."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from ..scoring.columns import IDENTITY
from ..store.folder import Store
from .selection import Aligned, cells, judged_columns
from .table import Cell, Line

UNREPEATABLE = ("seconds", "exception")
"""Columns that may differ between two runs of the same thing: measured time, and tracebacks with their line numbers."""
TRUTH = ("time", "plant", "disturbance", "sensors", "channel", "faults", "score")
"""Tables of a scenario that decide the truths and how they are scored; pairs need them to be the same."""


class Comparison(NamedTuple):
    """B against A in one quantity of one cell: two lines of the verdict table, b's with the ratio and the verdict.
    label: the estimator, where two folders are compared."""

    cell: str
    label: str
    a: Line
    b: Line

    @property
    def verdict(self) -> str:
        return str(self.b["verdict"])

    @property
    def lost(self) -> bool:
        """Whether it is about runs that did not end well, not about an error."""
        return self.b["kind"] == "reliability"


def between_estimators(rows: pd.DataFrame, manifest: Mapping[str, Any], a: str, b: str) -> list[Comparison]:
    """Comparisons of two labels in every cell of a folder's rows."""
    found: list[Comparison] = []
    for scenario, variant, part in cells(rows):
        both = part[part["estimator"].isin([a, b])]
        if both["estimator"].nunique() == 2:
            found += _compared(f"{scenario}/{variant}", "", both, manifest["scenarios"][scenario], a, b)
    return found


def between_folders(a: Store, b: Store) -> Changes:
    """What changed between two folders."""
    rows = {"a": a.rows(), "b": b.rows()}
    manifests = {"a": a.manifest(), "b": b.manifest()}
    # copied: rows have a block for each column, of which pandas warns where one more is put in
    merged = pd.concat([frame.copy().assign(side=side) for side, frame in rows.items()], ignore_index=True)
    alike: list[Alike] = []
    found: list[Comparison] = []
    notes = list(_settings(manifests["a"], manifests["b"]))
    for (scenario, variant, label), part in merged.groupby(list(IDENTITY[:3]), sort=False):
        cell = f"{scenario}/{variant}"
        left, right = (part[part["side"] == side].set_index("run").sort_index() for side in "ab")
        common = left.index.intersection(right.index)
        same = same_rows(left.loc[common], right.loc[common])
        alike.append(Alike(cell, str(label), len(common), int(same.sum()), len(left) - len(common),
                           len(right) - len(common)))
        if len(common) and not same.all():
            reason = _other_truths(manifests["a"], manifests["b"], cell)
            if reason:
                notes.append(f"{cell}: {reason}: these are not the same runs, nothing is compared")
                continue
            both = part.assign(estimator=lambda frame: frame["side"])
            found += _compared(cell, str(label), both, manifests["b"]["scenarios"][scenario], "a", "b")
    return Changes(alike, found, list(dict.fromkeys(notes)))


class Alike(NamedTuple):
    """How many rows of one estimator in one cell both folders have, are the same to the bit, or only one has."""

    cell: str
    label: str
    common: int
    identical: int
    only_a: int
    only_b: int


@dataclass(frozen=True)
class Changes:
    """Rows compared, comparisons of those that differ, and what else is to be said."""

    alike: list[Alike]
    found: list[Comparison]
    notes: list[str]

    @property
    def identical(self) -> bool:
        return all(item.common == item.identical and not item.only_a and not item.only_b for item in self.alike)


def _compared(key: str, label: str, part: pd.DataFrame, about: Mapping[str, Any], a: str, b: str) -> list[Comparison]:
    """The comparisons of one cell: an error for each quantity, and the runs lost where they differ. None without two
    common runs."""
    cell = Cell(f"{key}/{label}" if label else key, Aligned(part), about, {}, {})
    if cell.n < 2:
        return []
    return [Comparison(key, label, *pair) for pair in cell.duels(judged_columns(part, about), a, b)]


def speed_ratio(a: pd.DataFrame | None, b: pd.DataFrame | None) -> dict[tuple[str, str], float]:
    """(cell, label) -> B's time per run and step over A's, from timing tables whose `estimator` agrees."""
    if a is None or b is None:
        return {}
    joined = a.merge(b, on=list(IDENTITY[:3]), suffixes=("_a", "_b"))
    ratio = joined["throughput_ns_b"] / joined["throughput_ns_a"]
    return {(f"{scenario}/{variant}", str(label)): float(value) for scenario, variant, label, value in
            zip(joined["scenario"], joined["variant"], joined["estimator"], ratio, strict=True) if np.isfinite(value)}


def same_rows(a: pd.DataFrame, b: pd.DataFrame) -> np.ndarray:
    """Which rows (same index) are equal in every bit that can be repeated. A column one side lacks is missing there."""
    columns = [name for name in {**dict.fromkeys(a.columns), **dict.fromkeys(b.columns)}
               if name not in (*UNREPEATABLE, "side")]
    left, right = a.reindex(columns=columns), b.reindex(columns=columns)
    return ((left == right) | (left.isna() & right.isna())).all(axis=1).to_numpy()


def _settings(a: Mapping[str, Any], b: Mapping[str, Any]) -> Iterator[str]:
    """What differs between two manifests, one line each."""
    if a["railstate"] != b["railstate"]:
        yield f"railstate: {a['railstate']} -> {b['railstate']}"
    for key in ("seed", "runs"):
        if a["configuration"][key] != b["configuration"][key]:
            yield f"{key}: {a['configuration'][key]} -> {b['configuration'][key]}"
    for key in ("processor", "python", "git_commit"):
        if a["environment"].get(key) != b["environment"].get(key):
            yield f"{key}: {a['environment'].get(key)} -> {b['environment'].get(key)}"
    for name, version in a["environment"]["packages"].items():
        other = b["environment"]["packages"].get(name)
        if version != other:
            yield f"{name}: {version} -> {other}"
    for key, cell in a["configuration"]["cells"].items():
        other = b["configuration"]["cells"].get(key, {"scenario": None, "estimators": {}})
        if other["scenario"] not in (None, cell["scenario"]):
            yield f"{key}: the scenario's content changed"
        for label, entry in cell["estimators"].items():
            now = other["estimators"].get(label)
            changed = [what for what in entry if now and entry[what] != now[what]]
            if changed:
                yield f"{key}/{label}: {', '.join(changed)} changed"


def _other_truths(a: Mapping[str, Any], b: Mapping[str, Any], cell: str) -> str:
    """Why the truths of a cell differ between two folders; empty where they do not."""
    if a["configuration"]["seed"] != b["configuration"]["seed"]:
        return "the seed changed"
    tables = [manifest["replay"]["cells"][cell]["table"] for manifest in (a, b)]
    changed = [name for name in TRUTH if tables[0].get(name) != tables[1].get(name)]
    return f"[{'], ['.join(changed)}] of the scenario changed" if changed else ""
