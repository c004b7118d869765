"""A finding of a recording's checks: how bad, about which column, where, and what to do."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, floor
from typing import Literal

import numpy as np

from ..arrays import Array, Index

APART = 30.0
"""s; places nearer in time than this are told as one."""


@dataclass(frozen=True)
class Finding:
    """grade: `impossible` (no train does it) or `odd`. role: of the column at fault. text: what, where, what to do.
    reading: what is impossible of a reference happens to a reading."""

    grade: Literal["impossible", "odd"]
    role: str
    text: str
    reading: bool = False


def spans(time: Array, rows: Index) -> list[tuple[float, float]]:
    """The times of these rows as (from, to) in whole s, those near to each other as one."""
    at = time[rows]
    parts = np.split(at, np.flatnonzero(np.diff(at) > APART) + 1) if len(at) else []
    return [(float(floor(part[0])), float(ceil(part[-1]))) for part in parts]


def leave_out(time: Array, rows: Index) -> str:
    """The options that leave these rows out."""
    found = spans(time, rows)
    shown = " ".join(f"--without {a:g}..{b:g}" for a, b in found[:4])
    return shown + (f" and {len(found) - 4} more such places" if len(found) > 4 else "")
