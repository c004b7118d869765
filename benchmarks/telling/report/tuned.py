"""Tuned entries of a scenario on the page: what they reached on the runs they were searched on, and on this folder's.

The training values are those frozen in the scenario file, the others of the verdict table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from ..marks import Line
from ..rankings import Cell
from ..wording import bracket, metric_name, number, plus_minus
from .sections import Entry, Table

CAPTION = ("Tuned entries: the error on the training runs of their search and on the runs of this page (test). A fixed "
           "entry's error differs between the two sets as well: what is left of the gap without that of the entry that "
           "it was before is what tuning adds. ± is half of the 95 % interval of the test alone.")


class Gap(NamedTuple):
    """Test error over training error, less 1, of a tuned entry and of the entry it was before (None: not run here)."""

    tuned: float
    fixed: float | None

    @property
    def added(self) -> float | None:
        return None if self.fixed is None else self.tuned - self.fixed


def tuned_table(cells: Sequence[Cell]) -> Table | None:
    """A line for each metric of each tuned entry of the variant that it was tuned on; None where there is none."""
    lines: list[tuple[str, list[Entry]]] = []
    for cell in cells:
        for label, entry in cell.entries.items():
            record = entry.get("tuned")
            if not record or record["variant"] != cell.variant:
                continue
            for name, (train, untuned) in record["train"].items():
                line = _line(cell, name, label)
                if line is None or not train:
                    continue
                before = _line(cell, name, record["untuned"])
                gap = Gap(line["value"] / train - 1, None if before is None or not untuned else
                          before["value"] / untuned - 1)
                lines.append((cell.variant, _entries(cell, label, record, line, train, gap)))
    if not lines:
        return None
    heads = [("entry", "entry", False), ("was", "was", False), ("differs by", "differs by", False),
             ("error", "error", False), ("train", "train", True), ("test", "test|low|high", True),
             ("test over train", "gap", True), ("the same, before", "fixed gap", True), ("tuning adds", "added", True)]
    origins = {f"{label}: {text}": None for cell in cells for label in cell.entries
               if cell.entries[label].get("tuned") and (text := cell.origin.get(f"estimators.{label}"))}
    return Table(list(heads), lines, CAPTION, list(origins))


def _line(cell: Cell, name: str, label: str) -> Line | None:
    metric, _, quantity = name.partition(":")
    return next((line for line in cell.of("error", metric, quantity) if line["estimator"] == label and line["runs"]),
                None)


def _entries(cell: Cell, label: str, record: Mapping[str, Any], line: Line, train: float, gap: Gap) -> list[Entry]:
    factor = line["factor"]
    return [
        Entry(label), Entry(record["untuned"]), Entry(cell.told(label).removeprefix("tuned: ")),
        Entry(bracket(f"{metric_name(line['metric'])} {line['quantity']}", line["shown_unit"])),
        Entry(number(train * factor, 4), f"{train * factor:.6g}", True),
        Entry(plus_minus(line), "|".join(f"{line[key] * factor:.6g}" for key in ("value", "low", "high")), True),
        *(Entry("") if share is None else Entry(f"{share:+.1%}".replace("-", "−"), f"{share:.6g}", True)
          for share in (gap.tuned, gap.fixed, gap.added))]
