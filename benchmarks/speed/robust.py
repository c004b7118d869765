"""The robust estimators' batched fast form against their convex form, both through the same interface.

The peer is the same class with solver = "cvxpy": a DPP-parametrised problem per step and run, solved by Clarabel."""

from __future__ import annotations

import numpy as np

from ..planning.plan import Cell
from .measure import Row, cell_of, line, ours

RUNS, STEPS, PEER_STEPS = 100, 200, 40


def race(repeats: int) -> list[Row]:
    """One line per estimator; the two are compared on the same first steps of one run."""
    rows = []
    for label in ("robust-bounded", "robust-mean-square", "robust-ellipsoid"):
        cell = cell_of("ningbo-metro/switching", label)
        entry = cell.entries[label]
        convex = Cell(cell.scenario, cell.variant, cell.where, cell.table, {label: entry.model_copy(
            update={"parameters": {**entry.parameters, "solver": "cvxpy"}})})
        mine = ours(cell, label, RUNS, STEPS, repeats).estimator
        short = ours(cell, label, 1, PEER_STEPS, 1).means
        theirs, _, _, last = ours(convex, label, 1, PEER_STEPS, 1)
        rows.append(line(label, RUNS, mine, "cvxpy, Clarabel", theirs, float(np.abs(short - last).max())))
    return rows


