"""`railstate replay ROW`: run one row again, show its numbers, and its traceback if it failed."""

from __future__ import annotations

from typing import Annotated

import pandas as pd
import typer

from ...scenarios.errors import InputError
from ..planning.plan import Task, make_plan
from ..running.execute import execute
from ..scoring.columns import metric_columns
from ..store.folder import Store
from ..store.manifest import stored_plan


def replay(
    row: Annotated[str, typer.Argument(metavar="SCENARIO/VARIANT/ESTIMATOR/RUN")],
    out: Annotated[str, typer.Option(help="The results folder the row stands in.")] = "",
    seed: Annotated[int, typer.Option(help="Root seed, where no folder is given.")] = 1,
) -> None:
    """Run one row again; with --out compare it with the stored one."""
    parts = row.rsplit("/", 3)
    if len(parts) != 4 or not parts[3].isdecimal() or len(parts[3]) > 9:
        raise InputError(f"{row}: expected SCENARIO/VARIANT/ESTIMATOR/RUN, such as ningbo-metro/switching/ekf/17")
    scenario, variant, label, number = parts
    plan = stored_plan(Store(out).manifest()) if out else make_plan([f"{scenario}/{variant}"], only=[label], seed=seed)
    cells = {cell.key: cell for cell in plan.cells}
    cell = cells.get(f"{scenario}/{variant}")
    if cell is None or label not in cell.entries:
        known = ", ".join(f"{key}/{name}" for key, item in cells.items() for name in item.entries)
        raise InputError(f"{row}: {out or 'the scenario'} holds no such estimator; it holds {known}")
    again = execute(Task(cell, (label,), (int(number),), plan.seed, 0, plan.plugins)).rows.to_pandas()
    found = again.iloc[0]
    print(f"{row}: {found['status']}" + (f": {found['reason']}" if found["reason"] else ""))
    for column, metric, quantity, unit in metric_columns(again):
        print(f"  {metric:>12} {quantity:<16} {found[column]:.17g} {unit}")
    if found["exception"]:
        print(found["exception"])
    if out:
        rows = Store(out).rows()
        stored = rows[(rows["scenario"] == scenario) & (rows["variant"] == variant) & (rows["estimator"] == label)
                      & (rows["run"] == int(number))]
        if stored.empty:
            print(f"  {out} has no such row yet")
        else:
            before = stored.iloc[0]
            same = before["status"] == found["status"] and all(
                name in before and (before[name] == found[name] or (pd.isna(before[name]) and pd.isna(found[name])))
                for name, *_ in metric_columns(again))
            print(f"  {'bit-identical to' if same else 'DIFFERS from'} the row in {out}")
