"""The page of a sweep: which estimator keeps which requirement at which point, and each metric over the swept keys.

From the sweep's own two files, sweep.json (what was swept) and sweep.csv (the verdicts at each point)."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from markupsafe import Markup
from pydantic import BaseModel, TypeAdapter, ValidationError

from ....scenarios.errors import InputError, describe
from ...judging.table import TEXTS, VERDICT_COLUMNS
from ..cleaning import one_line
from ..figures.axes import Style
from ..figures.canvas import Canvas
from ..figures.data import assign_styles
from ..figures.swept import over_key
from ..marks import Line, drawn, shade
from ..rankings import records
from ..wording import bracket, counted, number, percent, plus_minus, ratio_of
from .sections import Entry, Table, chip

DESCRIPTION = "sweep.json"
VALUES = "sweep.csv"
Arranged = list[tuple[tuple[str, ...], dict[str, Line]]]
"""A table's lines: what each begins with, and each estimator's line of the verdict table there."""


@dataclass(frozen=True)
class Sweep:
    """A sweep as it is told. name: scenario and variant; keys swept; shown: (metric, quantity) to be told; estimators
    in order; lost: at a point ("a | b" of its values), why an estimator has no number; command: that made it."""

    name: str
    keys: list[str]
    shown: list[tuple[str, str]]
    estimators: list[str]
    runs: int
    seed: int
    lost: dict[str, dict[str, str]]
    command: str

    def written(self) -> str:
        """The text of sweep.json."""
        return json.dumps(asdict(self), indent=1) + "\n"

    def styles(self) -> dict[str, Style]:
        """How its estimators look in all its figures."""
        return assign_styles([self.estimators])

    def points(self) -> list[tuple[str, ...]]:
        """The swept values, as text, in order."""
        return [tuple(point.split(" | ")) for point in self.lost]

    def part(self, table: pd.DataFrame, metric: str, quantity: str) -> pd.DataFrame:
        """The lines of a metric that have a value."""
        return table[(table["metric"] == metric) & (table["quantity"] == quantity) & (table["runs"] > 0)
                     & table["kind"].isin(["error", "value", "share"])]

    def figure(self, part: pd.DataFrame) -> Canvas | None:
        """A metric over the key; None where several were swept."""
        if part.empty or len(self.keys) > 1:
            return None
        metric, quantity, unit = (str(part[name].iloc[0]) for name in ("metric", "quantity", "shown_unit"))
        return over_key(part, self.keys[0], bracket(f"{metric} {quantity}", unit), self.styles())


    def requirements(self, table: pd.DataFrame) -> Arranged:
        """((requirement with what is asked, *point), the line of each estimator), requirement by requirement."""
        asked = [{**line, "requirement": f"{line['quantity']}, {100 * float(line['against']):g} %"}
                 for line in records(table[table["kind"] == "requirement"])]
        names = sorted({line["requirement"] for line in asked})
        return self._arranged(asked, ["requirement", *self.keys], [(name, *point) for name in names
                                                                   for point in self.points()])

    def measured(self, part: pd.DataFrame) -> Arranged:
        """(point, the line of each estimator) of one metric."""
        return self._arranged(records(part), self.keys, self.points())

    def _arranged(self, lines: list[dict[str, Any]], keys: list[str], points: list[tuple[str, ...]]) -> Arranged:
        found: dict[tuple[str, ...], dict[str, Line]] = {point: {} for point in points}
        for line in lines:
            found.get(tuple(str(line[key]) for key in keys), {})[line["estimator"]] = line
        return list(found.items())

    def why(self, point: tuple[str, ...], label: str) -> str:
        """Why an estimator has no number at a point (whatever stands before it); empty where it has one."""
        return self.lost.get(" | ".join(point[len(point) - len(self.keys):]), {}).get(label, "")

    def told_of(self, arranged: Arranged) -> list[str]:
        """The estimators that have a line somewhere, in order."""
        return [label for label in self.estimators if any(label in lines for _, lines in arranged)]


_SWEEP = TypeAdapter(Sweep)


def is_sweep(folder: str | Path) -> bool:
    """Whether a folder is a sweep's."""
    return (Path(folder) / DESCRIPTION).is_file()


def load(folder: str | Path) -> tuple[Sweep, pd.DataFrame]:
    """What a sweep's folder holds. Raises InputError naming the file that is not what a sweep writes."""
    path = Path(folder) / DESCRIPTION
    try:
        sweep = _SWEEP.validate_json(path.read_bytes())
        if not sweep.keys or {len(point) for point in sweep.points()} != {len(sweep.keys)}:
            raise ValueError(f"has points of other keys than {', '.join(sweep.keys)}")
        path = Path(folder) / VALUES
        if path.exists() and not path.is_file():
            raise ValueError("is no file")
        table = pd.read_csv(path, keep_default_na=False, na_values=[""], dtype={
            **dict.fromkeys(VERDICT_COLUMNS, float), **dict.fromkeys((*TEXTS, *sweep.keys), str), "eligible": bool})
        missing = [name for name in (*VERDICT_COLUMNS, *sweep.keys) if name not in table]
        if missing:
            raise ValueError(f"has no column {', '.join(missing)}")
        pd.to_numeric(table["against"][table["kind"] == "requirement"])
    except ValidationError as error:
        raise InputError(f"{path}: not as railstate sweep writes it: {describe(error, BaseModel)[0]}") from None
    except (OSError, ValueError, TypeError, KeyError, RecursionError) as error:
        raise InputError(f"{path}: not as railstate sweep writes it: {one_line(error)[:300]}") from None
    return sweep, table.fillna(dict.fromkeys(TEXTS, ""))


def tables(sweep: Sweep, table: pd.DataFrame) -> list[tuple[str, str, Table, Markup | str]]:
    """(name, what its first column is, table, figure or nothing): requirements first, then each metric shown."""
    found: list[tuple[str, str, Table, Markup | str]] = []
    asked = sweep.requirements(table)
    if asked:
        found.append(("who keeps what", "requirement", _requirements(sweep, asked), ""))
    for metric, quantity in sweep.shown:
        part = sweep.part(table, metric, quantity)
        if not part.empty:
            canvas, unit = sweep.figure(part), str(part["shown_unit"].iloc[0])
            caption = (bracket(f"{metric} of {quantity}", unit) + " at each point, half of the 95 % interval, verdict "
                       "among the estimators of that point.")
            found.append((f"{metric} {quantity}", sweep.keys[0],
                          _over(sweep, sweep.measured(part), _measured, caption),
                          Markup(canvas.svg(inline=True)) if canvas else ""))
    return found


def _requirements(sweep: Sweep, asked: Arranged) -> Table:
    table = _over(sweep, asked, _kept, "Share of the runs (or of the time) that keep each "
                  "requirement, and whether that meets what is asked; under it 95th percentiles "
                  "over the runs of what counts there: a verdict alone may mislead.")
    met = {label: sum(lines[label]["verdict"] == "met" for _, lines in asked if label in lines)
           for label in sweep.estimators}
    best = [label for label, count in met.items() if count == max(met.values()) and count]
    if best:
        table.notes.append(f"Met most often, in {counted(max(met.values()), 'case')} of {len(asked)}: "
                           f"{', '.join(best)}.")
    return table


def _over(sweep: Sweep, arranged: Arranged, entry: Callable[[Line], Entry], caption: str) -> Table:
    """A line a point, a column an estimator; what stands before the keys names the line."""
    labels, ahead = sweep.told_of(arranged), len(arranged[0][0]) - len(sweep.keys)
    heads: list[tuple[Markup | str, str, bool]] = [(key, key, False) for key in [*sweep.keys[1 - ahead:], *labels]]
    return Table(heads, [(point[0], [*(Entry(value, value) for value in point[1:]), *(
        entry(lines[label]) if label in lines else Entry(Markup("<small>{}</small>").format(sweep.why(point, label)))
        for label in labels)]) for point, lines in arranged], caption)


def _kept(line: Mapping[str, Any]) -> Entry:
    interval = f"[{number(100 * line['low'])}, {number(100 * line['high'])}] %"
    said = Markup("{} {}<small>{}</small>").format(chip(line["verdict"], percent(line["value"])), interval,
                                                   line["note"].removeprefix("P95 over runs: "))
    return Entry(said, f"{line['value']:.6g}")


def _measured(line: Line) -> Entry:
    verdict = drawn(line) if line["kind"] == "error" else ""
    mark = chip(verdict, ratio_of(line) if verdict in ("worse", "undecided", "tie", "best") else "", shade(line))
    return Entry(Markup("{} {}").format(plus_minus(line), mark if verdict else ""),
                 f"{line['value'] * line['factor']:.6g}")
