"""B against A over the same runs: two estimators of one results folder, or all estimators of two folders.

Everything is made from rows alone; `commands/compare.py` prints it. Differences are B - A, and `better` means B is."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from ...scenarios.arrays import Array
from ..scoring.columns import IDENTITY, shown_unit
from ..store.folder import Store
from . import statistics as st
from .verdicts import by_run, cells, judged_columns

FINISHED = "finished"
"""Name of the contest over how many runs end well, where the two differ in that."""
UNREPEATABLE = ("seconds", "exception")
"""Columns that may differ between two runs of the same thing: measured time, and tracebacks with their line numbers."""
TRUTH = ("time", "plant", "disturbance", "sensors", "channel", "score")
"""Tables of a scenario that decide the truths and how they are scored; pairs need them to be the same."""


class Comparison(NamedTuple):
    """B against A in one quantity of one cell. a, b: their shown values over the paired runs."""

    cell: str
    label: str
    metric: str
    quantity: str
    unit: str
    factor: float
    a: float
    b: float
    found: st.Paired
    p: float
    verdict: st.Difference


@dataclass(frozen=True)
class _Pair:
    """Values of A and B per run (NaN where there is none), before the correction over all pairs."""

    cell: str
    label: str
    metric: str
    quantity: str
    unit: str
    factor: float
    a: Array
    b: Array


def between_estimators(rows: pd.DataFrame, manifest: Mapping[str, Any], a: str, b: str) -> list[Comparison]:
    """Contests of two labels in every cell of a folder's rows."""
    pairs: list[_Pair] = []
    for scenario, variant, part in cells(rows):
        both = part[part["estimator"].isin([a, b])]
        if both["estimator"].nunique() == 2:
            pairs += _pairs(f"{scenario}/{variant}", "", both, manifest["scenarios"][scenario], a, b)
    return _decided(pairs)


def between_folders(a: Store, b: Store) -> Changes:
    """What changed between two folders."""
    rows = {"a": a.rows(), "b": b.rows()}
    manifests = {"a": a.manifest(), "b": b.manifest()}
    merged = pd.concat([frame.assign(side=side) for side, frame in rows.items()], ignore_index=True)
    alike: list[Alike] = []
    pairs: list[_Pair] = []
    notes = list(_settings(manifests["a"], manifests["b"]))
    for (scenario, variant, label), part in merged.groupby(list(IDENTITY[:3]), sort=False):
        cell = f"{scenario}/{variant}"
        left, right = (part[part["side"] == side].set_index("run").sort_index() for side in "ab")
        common = left.index.intersection(right.index)
        same = _same(left.loc[common], right.loc[common])
        alike.append(Alike(cell, str(label), len(common), int(same.sum()), len(left) - len(common),
                           len(right) - len(common)))
        if len(common) and not same.all():
            reason = _other_truths(manifests["a"], manifests["b"], cell)
            if reason:
                notes.append(f"{cell}: {reason}: these are not the same runs, nothing is compared")
                continue
            both = part[part["run"].isin(common)].assign(estimator=lambda frame: frame["side"])
            pairs += _pairs(cell, str(label), both, manifests["b"]["scenarios"][scenario], "a", "b")
    return Changes(alike, _decided(pairs), list(dict.fromkeys(notes)))


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
    """Rows compared, contests of those that differ, and what else is to be said."""

    alike: list[Alike]
    contests: list[Comparison]
    notes: list[str]

    @property
    def identical(self) -> bool:
        return all(item.common == item.identical and not item.only_a and not item.only_b for item in self.alike)


def _pairs(cell: str, label: str, part: pd.DataFrame, about: Mapping[str, Any], a: str, b: str) -> Iterator[_Pair]:
    """The pairs of one cell: an error for each quantity, and the share of runs that end well where they differ."""
    for column, metric, quantity, unit in judged_columns(part, about):
        values = by_run(part, column)
        name, factor = shown_unit(about, metric, quantity, unit)
        yield _Pair(cell, label, metric, quantity, name, factor, values[a], values[b])
    lost = by_run(part.assign(lost=(part["status"] != "ok").astype(float)), "lost")
    if (lost[a] != lost[b]).any():
        yield _Pair(cell, label, FINISHED, "runs", "", 1.0, lost[a], lost[b])


def _decided(pairs: list[_Pair]) -> list[Comparison]:
    """Tests with Holm's correction over all of them, and verdicts. Pairs without two common runs have none."""
    found = [(pair, st.paired(pair.b, pair.a)) for pair in pairs]
    found = [(pair, each) for pair, each in found if each.n > 1]
    values = [_sign_test(pair) if pair.metric == FINISHED else each.p for pair, each in found]
    out: list[Comparison] = []
    for (pair, each), p in zip(found, st.holm(values), strict=True):
        if pair.metric == FINISHED:
            verdict: st.Difference = "tie" if p >= st.ALPHA else "better" if each.difference < 0 else "worse"
        else:
            verdict = st.verdict(each, p, len(found))
        both = np.isfinite(pair.a) & np.isfinite(pair.b)
        a, b = (st.pooled_rmse(side[both])[0] if pair.metric == "rmse" else float(side[both].mean())
                for side in (pair.a, pair.b))
        out.append(Comparison(pair.cell, pair.label, pair.metric, pair.quantity, pair.unit, pair.factor, a, b, each, p,
                           verdict))
    return out


def _sign_test(pair: _Pair) -> float:
    """Two-sided exact p that runs only B lost and runs only A lost are equally likely."""
    from scipy.stats import binomtest

    worse, better = int((pair.b > pair.a).sum()), int((pair.b < pair.a).sum())
    return float(binomtest(worse, worse + better).pvalue) if worse + better else 1.0


def speed_ratio(a: pd.DataFrame | None, b: pd.DataFrame | None) -> dict[tuple[str, str], float]:
    """(cell, label) -> B's time per run and step over A's, from timing tables whose `estimator` agrees."""
    if a is None or b is None:
        return {}
    joined = a.merge(b, on=list(IDENTITY[:3]), suffixes=("_a", "_b"))
    ratio = joined["throughput_ns_b"] / joined["throughput_ns_a"]
    return {(f"{scenario}/{variant}", str(label)): float(value) for scenario, variant, label, value in
            zip(joined["scenario"], joined["variant"], joined["estimator"], ratio, strict=True) if np.isfinite(value)}


def _same(a: pd.DataFrame, b: pd.DataFrame) -> np.ndarray:
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
