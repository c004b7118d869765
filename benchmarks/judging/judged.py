"""A family judged: the best, everyone's verdict against it, and what a reader of a verdict must know beside it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...scenarios.arrays import Array, Mask
from . import statistics as st
from .family import LEAST, Family

RARE, CARRIED = 200, 0.2
"""Under RARE runs rare events may be missing; one run carrying more than CARRIED of a mean is said."""
Line = dict[str, Any]


class Judged:
    """A family with its best. members: places in the cell; values (k of the cell, n)."""

    def __init__(self, members: Sequence[int], family: Family, values: Array, fine: Mask) -> None:
        self.members, self.family, self.values = members, family, values
        self.fine = dict(zip(members, fine.tolist(), strict=True))
        self.place = {member: place for place, member in enumerate(members)}
        self.best = min((i for i in members if self.fine[i]), key=lambda i: family.value[self.place[i]])

    def against_best(self, i: int, labels: Sequence[str]) -> Line:
        """The verdict of member i. Who lost more runs than equals would is not eligible: never best, tie or undecided,
        and drawn as lost even where its errors alone are called worse."""
        about = notes(self.values[i], self.family.runs)
        if i == self.best:
            return {"verdict": "best", "ratio": 1.0, "ratio_low": 1.0, "ratio_high": 1.0, "against": labels[i],
                    "family": len(self.members), "note": about}
        facts = self.facts(i, self.best)
        if facts["verdict"] == "better":  # only by its runs: the best has the least value of all that are eligible
            facts["verdict"] = "undecided"
        if not self.fine[i] and facts["verdict"] != "worse":
            facts["verdict"], facts["deciding"] = "lost", np.nan
        return {**facts, "against": labels[self.best], "eligible": self.fine[i],
                "note": "; ".join(filter(None, [facts["note"], about]))}

    def facts(self, i: int, j: int) -> Line:
        """Member i against j: ratio with its simultaneous interval, share of runs won, verdict."""
        a, b = self.place[i], self.place[j]
        word = self.family.verdict(a, b)
        ratio, half = self.family.log_ratio[a, b], self.family.half[a, b]
        if not np.isfinite(ratio):  # one of them has no error, or both
            ratio, half = 0.0 if np.isnan(ratio) else ratio, 0.0
        with np.errstate(over="ignore"):  # of two runs the interval is as good as endless
            found = np.exp([ratio, ratio - half, ratio + half])
        won = _won(self.values[i], self.values[j])
        remarks = []
        if word == "undecided" and (ratio - half > 0 and self.family.tails[a, b]):
            remarks.append("tails differ")
        if (ratio > 0) == (won > 0.5) and won != 0.5 and _most(self.values[i], self.values[j]):
            side = "smaller" if won > 0.5 else "larger"
            remarks.append(f"{side} error in {100 * max(won, 1 - won):.0f} % of the runs")
        return {"ratio": found[0], "ratio_low": found[1], "ratio_high": found[2], "won": won, "verdict": word,
                "family": len(self.members), "note": "; ".join(remarks),
                "deciding": self.family.deciding(a, b) if word == "undecided" and np.isfinite(ratio) else np.nan}


def _won(a: Array, b: Array) -> float:
    """Share of the runs where a is smaller than b; equal runs count half, a lost run is larger than any."""
    a, b = np.nan_to_num(a, nan=np.inf), np.nan_to_num(b, nan=np.inf)
    return float(((a < b) + 0.5 * (a == b)).mean())


def _most(a: Array, b: Array) -> bool:
    """Whether the runs that a wins and those that it loses are not by chance so many (Wilcoxon's test of the logs)."""
    both = np.isfinite(a) & np.isfinite(b) & (a > 0) & (b > 0)
    return bool(both.sum() >= LEAST) and st.signed_rank(np.log(a[both]) - np.log(b[both])) < st.ALPHA


def notes(values: Array, n: int) -> str:
    """What a few runs carry, and what so few cannot have seen."""
    known = st.finite(values)
    out = []
    if known.size >= LEAST // 2 and known.max() > CARRIED * known.sum() > 0:
        out.append(f"one run carries {100 * known.max() / known.sum():.0f} % of the mean")
    if n < LEAST:
        out.append(f"under {LEAST} runs there is no verdict")
    elif n < RARE:
        out.append("events rarer than 3/n of the runs may not have been seen")
    return "; ".join(out)
