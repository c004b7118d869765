"""Challengers against rivals over the variants of a scenario."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from . import statistics as st
from .verdicts import Column, by_run, cells, judged_columns


@dataclass(frozen=True)
class Contest:
    """A challenger against a rival in one quantity of one variant."""

    variant: str
    verdict: st.Difference
    found: st.Paired


def contests(rows: pd.DataFrame, challenger: str, rivals: Collection[str],
             columns: Collection[Column]) -> dict[tuple[str, str], list[Contest]]:
    """(rival, quantity) -> one contest per variant of one scenario's rows, Holm-corrected over all of them."""
    found: list[tuple[str, str, str, st.Paired]] = []
    for _, variant, part in cells(rows):
        for column, _, quantity, _ in columns:
            errors = by_run(part, column)
            for rival in rivals:
                if challenger in errors and rival in errors:
                    pair = st.paired(errors[challenger], errors[rival])
                    if pair.n > 1:
                        found.append((rival, quantity, variant, pair))
    out: dict[tuple[str, str], list[Contest]] = {}
    for (rival, quantity, variant, pair), p in zip(found, st.holm([item[3].p for item in found]), strict=True):
        out.setdefault((rival, quantity), []).append(Contest(variant, st.verdict(pair, p, len(found)), pair))
    return out
KALMAN_PLUGINS = ("kalman", "ekf", "ukf", "ckf")


def robust_contests(rows: pd.DataFrame, manifest: Mapping[str, Any],
                    scenario: str) -> dict[str, dict[tuple[str, str], list[Contest]]]:
    """Each robust estimator of a scenario against every tuning of its first Kalman-type filter (matched, naive,
    inflated): challenger -> contests. Empty where a scenario does not have both."""
    mine = rows[rows["scenario"] == scenario]
    plugins: dict[str, str] = {}
    for key, cell in manifest["configuration"]["cells"].items():
        if key.rpartition("/")[0] == scenario:
            plugins.update({label: entry["plugin"] for label, entry in cell["estimators"].items()})
    challengers = [label for label, plugin in plugins.items() if plugin.startswith("robust-")]
    filters = [plugin for plugin in plugins.values() if plugin in KALMAN_PLUGINS]
    rivals = [label for label, plugin in plugins.items() if filters and plugin == filters[0]]
    columns = judged_columns(mine, manifest["scenarios"][scenario])
    return {label: contests(mine, label, rivals, columns) for label in challengers} if rivals else {}
