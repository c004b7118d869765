"""When a study may stop: at looks of doubling size, by the width of intervals or once every verdict is said.

Stopping on Hall's interval's width leaves its coverage as it is; verdicts looked at several times share their level."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd

from ...scenarios.errors import InputError
from ..scoring.columns import metric_columns, shown_unit
from .selection import ERRORS, FLOORS, Aligned
from .statistics import ALPHA
from .table import averaged, verdicts

DECIDED = "decided"
FIRST = {True: 100, False: 50}
"""Runs of the first look: until decided, or until a precision."""


@dataclass(frozen=True)
class Precision:
    """Half of a 95 % interval that is asked for: `half` in the metric's SI unit, or of the value where relative."""

    metric: str
    quantity: str
    half: float
    relative: bool

    @property
    def words(self) -> str:
        """`1 % of rmse:position`, `0.002 of rmse:position`."""
        size = f"{100 * self.half:g} %" if self.relative else f"{self.half:g}"
        return f"{size} of {self.metric}:{self.quantity}"


@dataclass(frozen=True)
class Rule:
    """Until when runs are added, at most `most` of them. precisions: none, until decided."""

    precisions: tuple[Precision, ...]
    most: int

    @property
    def looks(self) -> list[int]:
        """Numbers of runs at which it is looked."""
        size, out = FIRST[not self.precisions], []
        while size < self.most:
            out.append(size)
            size *= 2
        return [*out, self.most]

    @property
    def level(self) -> float:
        """Level of the verdicts: shared between the looks where verdicts are what is looked at."""
        return ALPHA if self.precisions else ALPHA / len(self.looks)

    def missing(self, rows: pd.DataFrame, manifest: Mapping[str, Any]) -> str:
        """What of one cell's rows is not there yet, in words; empty: all that is asked for is. Raises InputError for a
        metric that they do not have."""
        if self.precisions:
            return next(filter(None, (_width(one, rows, manifest) for one in self.precisions)), "")
        table = verdicts(rows, at_level(manifest, self.level))
        open_ = table[(table["kind"] == "error") & (table["verdict"] == "undecided")]
        return f"{len(open_)} of {(table['kind'] == 'error').sum()} verdicts are undecided" if len(open_) else ""

    def reached(self) -> str:
        """What is said once nothing is missing."""
        return (f"every half interval is within {', '.join(one.words for one in self.precisions)}" if self.precisions
                else "every verdict is decided")

    def about(self) -> str:
        """What a reader of the intervals has to know."""
        looks = f"looks at {', '.join(map(str, self.looks))} runs"
        return looks if self.precisions else f"{looks}; intervals of ratios cover {100 * (1 - self.level):.3g} %"


def rule(text: str, most: int) -> Rule:
    """`decided`, or `METRIC:QUANTITY=HALF` with a half interval in per cent of the value or in the metric's own unit,
    several by commas. Raises InputError."""
    if text == DECIDED:
        return Rule((), most)
    found = []
    for part in text.split(","):
        match = re.fullmatch(r"\s*([\w-]+):([\w.-]+)=([0-9.eE+-]+)\s*(%?)\s*", part)
        try:
            half = float(match[3]) if match else 0.0
        except ValueError:
            half = 0.0
        if match is None or not 0 < half < float("inf"):
            raise InputError(f"--until {text}: expected decided, or a half interval such as rmse:position=1% or "
                             "rmse:position=0.002")
        found.append(Precision(match[1], match[2], half / 100 if match[4] else half, bool(match[4])))
    return Rule(tuple(found), most)


def at_level(manifest: Mapping[str, Any], level: float) -> dict[str, Any]:
    """A manifest by which verdicts are of that level."""
    return {**manifest, "scenarios": {name: {**about, "variants": {
        variant: {**facts, "level": level} for variant, facts in about["variants"].items()}}
        for name, about in manifest["scenarios"].items()}}


def _width(asked: Precision, rows: pd.DataFrame, manifest: Mapping[str, Any]) -> str:
    """The entry of a cell whose half interval is too wide, widest first; empty where there is none."""
    columns = [column for column in metric_columns(rows)
               if column[1:3] == (asked.metric, asked.quantity) and column[1] not in FLOORS]
    if not columns:
        known = sorted({f"{metric}:{quantity}" for _, metric, quantity, _ in metric_columns(rows) if metric in ERRORS})
        raise InputError(f"--until {asked.metric}:{asked.quantity}: is not measured in {_cell(rows)}; allowed: "
                         f"{', '.join(known)} and other columns of the rows")
    name, metric, quantity, unit = columns[0]
    aligned = Aligned(rows)
    found = averaged(aligned.values(name), metric)[2]
    half = (found.high - found.low) / 2
    over = half / (abs(found.value) if asked.relative else 1.0) / asked.half
    some = [i for i in range(len(over)) if found.n[i] and (over[i] > 1 or found.n[i] < 2)]
    if not some:
        return ""
    worst = max(some, key=lambda i: float(over[i]) if over[i] == over[i] else float("inf"))
    shown, factor = shown_unit(manifest["scenarios"][str(rows["scenario"].iloc[0])], metric, quantity, unit)
    return (f"{aligned.labels[worst]} has {metric} {quantity} {found.value[worst] * factor:.4g} "
            f"+- {half[worst] * factor:.2g} {shown}".rstrip())


def _cell(rows: pd.DataFrame) -> str:
    return f"{rows['scenario'].iloc[0]}/{rows['variant'].iloc[0]}"


def first_runs(rows: pd.DataFrame, key: str, labels: Sequence[str], runs: int) -> pd.DataFrame:
    """The rows of the first runs of a cell."""
    scenario, variant = key.split("/")
    return rows[(rows["scenario"] == scenario) & (rows["variant"] == variant) & (rows["run"] < runs)
                & rows["estimator"].isin(labels)].dropna(axis=1, how="all")
