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
    if not len(rows):
        return []
    at = time[rows]
    cut = np.flatnonzero(np.diff(at) > APART)
    begins, ends = np.concatenate([[0], cut + 1]), np.concatenate([cut, [len(at) - 1]])
    return [(float(floor(at[a])), float(ceil(at[b]))) for a, b in zip(begins, ends, strict=True)]


def leave_out(time: Array, rows: Index) -> str:
    """The options that leave these rows out."""
    found = spans(time, rows)
    shown = " ".join(f"--without {a:g}..{b:g}" for a, b in found[:4])
    return shown + (f" and {len(found) - 4} more such places" if len(found) > 4 else "")
