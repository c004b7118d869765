"""A stranger's results folder, checked: its tables made anew from its rows, a drawn sample of its rows computed anew.

Nothing that the folder holds is run: estimators are the suite's own, or plug-ins that are given and have the stored
source hash."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from ...scenarios.errors import InputError
from ..judging.comparison import same_rows
from ..judging.table import verdicts
from ..planning.catalogue import Catalogue
from ..planning.plan import Plan, Task
from ..running.machinery import Machinery
from ..running.runner import apart
from ..scoring.columns import IDENTITY
from ..store.folder import Store
from ..store.growth import CODE
from ..store.manifest import stored_plan
from ..store.provenance import environment, other_versions
from ..telling.cleaning import csv
from .complete import texts

OTHER = "their scenario, as the manifest tells it, is not the one that its hash there tells of"


@dataclass
class Verified:
    """What came of it. checked: a line of what agrees; wrong: what does not; unchecked: what could not be, and why."""

    checked: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    unchecked: list[str] = field(default_factory=list)


def verify(store: Store, catalogue: Catalogue, machinery: Machinery, count: int, seed: int) -> Verified:
    """Check a folder; count: of rows to compute anew, drawn by seed. Raises InputError where it cannot be read."""
    manifest, rows, found = store.manifest(), store.rows(), Verified()
    plan = stored_plan(manifest, catalogue)
    _complete(manifest, rows, found)
    _files(store, manifest, rows, found)
    known = {(key, label): why for key, label, why in _unknown(plan, manifest)}
    able = ~pd.Series(list(zip(rows["scenario"] + "/" + rows["variant"], rows["estimator"], strict=True))).isin(known)
    reasons: dict[str, int] = {}
    for (key, label), why in known.items():
        scenario, variant = key.split("/")
        held = ((rows["scenario"] == scenario) & (rows["variant"] == variant) & (rows["estimator"] == label)).sum()
        reasons[why] = reasons.get(why, 0) + int(held)
    for why, n in reasons.items():
        (found.wrong if why == OTHER else found.unchecked).append(f"{n} rows: {why}")
    places = np.flatnonzero(able.to_numpy())
    chosen = np.sort(np.random.default_rng(seed).choice(places, min(count, len(places)), replace=False))
    if chosen.size:
        _rows(plan, manifest, rows.iloc[chosen].reset_index(drop=True), machinery, found)
    return found


def _complete(manifest: dict[str, Any], rows: pd.DataFrame, found: Verified) -> None:
    """Whether there is a row of each run that the manifest tells of, and what it tells is of one piece."""
    missing = 0
    held = rows.groupby(list(IDENTITY[:3]))["run"].nunique().to_dict()
    for key, cell in manifest["configuration"]["cells"].items():
        missing += sum(cell["runs"] - held.get((*key.split("/"), label), 0) for label in cell["estimators"])
    (found.wrong if missing else found.checked).append(
        f"rows: {missing} of those that the manifest tells of are missing" if missing else
        f"rows: all {len(rows)} that the manifest tells of are there")


def _files(store: Store, manifest: dict[str, Any], rows: pd.DataFrame, found: Verified) -> None:
    """The verdict table and all that is rendered from it, made anew."""
    table = verdicts(rows, manifest)
    wanted = dict(texts(table, rows, manifest, store.timing()))
    wrong = []
    for name, text in wanted.items():
        try:
            if not (store.folder / name).is_file():
                raise FileNotFoundError
            if (store.folder / name).read_text(encoding="utf-8") != text:
                wrong.append(name)
        except (OSError, UnicodeDecodeError):
            wrong.append(f"{name} (cannot be read)")
    written = store.verdicts()
    if written is not None and csv(written) != wanted["verdicts.csv"]:
        wrong.append("verdicts.parquet")
    if wrong:
        found.wrong.append(f"tables: {len(wrong)} of {len(wanted) + 1} files are not what the rows give: "
                           f"{', '.join(wrong[:5])}" + (" .." if len(wrong) > 5 else ""))
    else:
        found.checked.append(f"tables: {len(wanted) + 1} files are what the rows give")


def _unknown(plan: Plan, manifest: dict[str, Any]) -> Iterator[tuple[str, str, str]]:
    """(cell, label, why) of entries whose rows cannot be computed anew."""
    names = plan.catalogue.names()
    for cell in plan.cells:
        stored = manifest["configuration"]["cells"][cell.key]
        present = {label: entry for label, entry in cell.entries.items() if entry.plugin in names}
        for label in [one for one in cell.entries if one not in present]:
            yield cell.key, label, f"{cell.entries[label].plugin} is not known here: give its file with --plugin"
        try:
            now = replace(plan, cells=(replace(cell, entries=present),)).configuration()["cells"][cell.key]
        except InputError as error:
            for label in present:
                yield cell.key, label, f"its scenario is not one here: {str(error).splitlines()[0]}"
            continue
        moved = [name for name in CODE if name in now and now[name] != stored[name]]
        other = stored["scenario"] != now["scenario"]
        for label in present:
            if other and not moved:
                yield cell.key, label, OTHER
            elif moved:
                yield cell.key, label, f"other code of the {' and the '.join(moved)} here"
            elif now["estimators"][label]["source"] != stored["estimators"][label]["source"]:
                yield cell.key, label, f"other code of {cell.entries[label].plugin} here"


def _rows(plan: Plan, manifest: dict[str, Any], sample: pd.DataFrame, machinery: Machinery, found: Verified) -> None:
    """A sample of rows, computed anew and compared in every column but the time it took."""
    cells = {cell.key: cell for cell in plan.cells}
    tasks: list[Task] = []
    for (scenario, variant, label), part in sample.groupby(list(IDENTITY[:3]), sort=False):
        tasks.append(plan.task(cells[f"{scenario}/{variant}"], (str(label),), tuple(map(int, part["run"]))))
    again = apart(tasks, machinery).to_pandas()
    index = list(IDENTITY)
    there, here = (frame.set_index(index).sort_index() for frame in (sample, again))
    same = same_rows(there, here.reindex(there.index))
    differ = ["/".join(map(str, place)) for place in there.index[~same]]
    if not differ:
        found.checked.append(f"sample: {len(sample)} of the rows, drawn and computed anew, are bit-identical")
        return
    mine, other = environment(), list(other_versions(manifest["environment"]))
    if manifest["environment"].get("processor") != mine["processor"]:
        other.append(f"processor {manifest['environment'].get('processor')} -> {mine['processor']}")
    shown = f"{', '.join(differ[:5])}" + (" .." if len(differ) > 5 else "")
    if other:
        found.unchecked.append(f"{len(differ)} of {len(sample)} rows computed anew differ ({shown}), which may come "
                               f"from {'; '.join(other)}")
    else:
        found.wrong.append(f"sample: {len(differ)} of {len(sample)} rows computed anew differ: {shown}")
