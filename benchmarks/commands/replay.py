"""`railstate replay ROW`: run one row again, show its numbers, and its traceback if it failed.

Nothing that a results folder names is run: plug-ins come from the command line, with the stored source hash."""

from __future__ import annotations

from typing import Annotated, Any

import pandas as pd
import typer

from ...scenarios.errors import InputError
from ..planning.catalogue import Catalogue
from ..planning.plan import Plan, make_plan
from ..running.machinery import machinery
from ..running.runner import apart
from ..scoring.columns import metric_columns
from ..store.folder import Store
from ..store.manifest import stored_plan
from .options import Memory, Plugins, Timeout


def replay(
    row: Annotated[str, typer.Argument(metavar="SCENARIO/VARIANT/ESTIMATOR/RUN")],
    out: Annotated[str, typer.Option(help="The results folder the row stands in.")] = "",
    seed: Annotated[int, typer.Option(help="Root seed, where no folder is given.")] = 1,
    plugin: Plugins = [],  # noqa: B006
    timeout: Timeout = 900.0,
    memory: Memory = 0.0,
) -> None:
    """Run one row again, in a process of its own; with --out compare it with the stored one."""
    parts = row.rsplit("/", 3)
    if len(parts) != 4 or not parts[3].isdecimal() or len(parts[3]) > 9:
        raise InputError(f"{row}: expected SCENARIO/VARIANT/ESTIMATOR/RUN, such as ningbo-metro/switching/ekf/17")
    scenario, variant, label, number = parts
    if out:
        plan = stored_plan(Store(out).manifest(), Catalogue(plugin))
    else:
        plan = make_plan([f"{scenario}/{variant}"], only=[label], seed=seed, plugins=plugin)
    cells = {cell.key: cell for cell in plan.cells}
    # a file's own name is its scenario's only in a folder
    cell = cells.get(f"{scenario}/{variant}") if out or len(plan.cells) != 1 else plan.cells[0]
    if cell is None or label not in cell.entries:
        known = ", ".join(f"{key}/{name}" for key, item in cells.items() for name in item.entries)
        raise InputError(f"{row}: {out or 'the scenario'} holds no such estimator; it holds {known}")
    if out:
        _same_source(plan, out, cell.key, label)
    how = machinery(1, timeout=timeout, memory=memory)
    again = apart([plan.task(cell, (label,), (int(number),))], how).to_pandas()
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
        print(f"  {_compared(again, found, stored, out)}")


def _same_source(plan: Plan, out: str, key: str, label: str) -> None:
    """Raises InputError where a plug-in is not at hand with the source that made the row."""
    cell = Store(out).manifest()["configuration"]["cells"][key]
    entry = next(cell.entries[label] for cell in plan.cells if cell.key == key)
    name, stored = entry.plugin, cell["estimators"][label]["source"]
    if name not in plan.catalogue.names():
        how = ("was given in Python, by value; only who gave it can run it again"
               if Store(out).manifest()["estimators"][name]["given"] else
               "is not the suite's own; name its file: --plugin FILE.py")
        raise InputError(f"{out}: {label} is the plug-in {name}, which {how}")
    if plan.catalogue.own(name):
        return
    if plan.catalogue.source(name) != stored:
        raise InputError(f"{out}: {label} was made by a plug-in {name} of another source ({stored}; here "
                         f"{plan.catalogue.source(name)}); replay needs the same one: --plugin FILE.py")


def _compared(again: pd.DataFrame, found: pd.Series[Any], stored: pd.DataFrame, out: str) -> str:
    if stored.empty:
        return f"{out} has no such row yet"
    before = stored.iloc[0]
    same = before["status"] == found["status"] and all(
        name in before and (before[name] == found[name] or (pd.isna(before[name]) and pd.isna(found[name])))
        for name, *_ in metric_columns(again))
    if not same:
        return f"DIFFERS from the row in {out}" + (
            "" if before["status"] == "ok" else f", which is {before['status']}: {before['reason']}")
    return f"bit-identical to the row in {out}" if found["status"] in ("ok", "diverged") else (
        f"{found['status']} like the row in {out}")
