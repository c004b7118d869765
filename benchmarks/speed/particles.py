"""RBPF, SMA and GSMA, factorised and full, against a numpy loop over particles that does the same algorithm.

The loop is `estimators/reference/particle_loop.py`, one run at a time, from the same random streams."""

from __future__ import annotations

from typing import Any

from ...estimators.reference.particle_loop import particle_loop
from ...estimators.registry import estimators
from ...scenarios.arrays import Array
from ...scenarios.randomness import Streams
from ..planning.plan import Cell
from .measure import Line, cell_of, contest_of_parts, ours, peer, recorded

RUNS, STEPS, PEER_STEPS = 200, 150, 30


def race(repeats: int) -> list[Line]:
    """A line per estimator and form. Both filters see the same run; the peer's is cut short."""
    lines = []
    for label in ("rbpf", "sma", "gsma"):
        cell = cell_of("braking-rate/paper", label)
        for form in ("factorised", "full"):
            here = with_form(cell, label, form)
            mine, short = ours(here, label, RUNS, STEPS), ours(here, label, 1, PEER_STEPS)
            slow = peer("numpy loop over particles", _Loop(cell, label).run)
            lines += contest_of_parts(mine._replace(name=f"{label}, {form}"), short, slow, 4, RUNS, repeats)
    return lines


def with_form(cell: Cell, label: str, form: str) -> Cell:
    """The cell with the estimator's `form` set."""
    entry = cell.entries[label]
    return Cell(cell.scenario, cell.variant, cell.where, cell.table, {label: entry.model_copy(
        update={"parameters": {**entry.parameters, "form": form}})})


class _Loop:
    """The peer on run 0."""

    def __init__(self, cell: Cell, label: str) -> None:
        entry, setting = cell.entries[label], cell.setting()
        self.world = recorded(cell, 1)
        self.model = setting.design_model(entry.knowledge, self.world.initial_mean)
        self.estimator: Any = estimators()[entry.plugin](entry.parameters)
        self.streams, self.label = Streams(1, cell.scenario, cell.variant, (0,)), label

    def run(self) -> tuple[int, Array]:
        """One pass over the first steps; returns their number and the last mean."""
        mean, _, _ = particle_loop(self.estimator, self.model, self.world.u[:PEER_STEPS, :, 0],
                                   self.world.y[:PEER_STEPS, :, 0], self.streams("estimator", self.label))
        return PEER_STEPS, mean[-1]
