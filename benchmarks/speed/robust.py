"""The robust estimators' batched fast form against their convex form, both through the same interface.

The peer is the same class with solver = "cvxpy": a DPP-parametrised problem per step and run, solved by Clarabel."""

from __future__ import annotations

from ..planning.plan import Cell
from .measure import Line, cell_of, contest_of_parts, ours

RUNS, STEPS, PEER_STEPS = 100, 200, 40


def race(repeats: int) -> list[Line]:
    """One line per estimator; the two are compared on the same first steps of one run."""
    lines = []
    for label in ("robust-bounded", "robust-mean-square", "robust-ellipsoid"):
        cell = cell_of("ningbo-metro/switching", label)
        entry = cell.entries[label]
        convex = Cell(cell.scenario, cell.variant, cell.where, cell.table, {label: entry.model_copy(
            update={"parameters": {**entry.parameters, "solver": "cvxpy"}})})
        short, slow = ours(cell, label, 1, PEER_STEPS), ours(convex, label, 1, PEER_STEPS)._replace(
            name="cvxpy, Clarabel")
        lines += contest_of_parts(ours(cell, label, RUNS, STEPS), short, slow, 2, RUNS, repeats)
    return lines
