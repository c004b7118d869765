"""What a folder holds already and what is asked of it: another configuration is refused, the rest is added.

A row stays while its key does: what the scenario and the entry say, and the code that computes it."""

from __future__ import annotations

import json
import reprlib
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from ...scenarios.errors import InputError
from ..planning.plan import Cell, Plan
from .folder import Store
from .manifest import description, stored_cell

CODE = ("setting", "scoring", "source")
"""Entries of a key that tell of code; the others tell what is asked for."""

OVERWRITTEN = "overwritten"


class Growth(NamedTuple):
    """plan: what is to be there afterwards of the cells that are asked for. configuration, description: the manifest's,
    of the whole folder. stale: (cell, label) whose rows go, with the reason."""

    plan: Plan
    configuration: dict[str, Any]
    description: dict[str, Any]
    stale: dict[tuple[str, str], str]


def grown(store: Store, plan: Plan, overwrite: bool = False) -> Growth:
    """How a folder grows to hold a plan. overwrite: what is asked for replaces what is there of it. Raises InputError
    where the folder is of another configuration and may not be overwritten."""
    if not store.exists:
        return Growth(plan, plan.configuration(), description(plan), {})
    manifest = store.manifest()
    there, asked = manifest["configuration"], json.loads(json.dumps(plan.configuration(), default=str))
    cells = there["cells"]
    stale: dict[tuple[str, str], str] = {}
    differences = list(_differing(there, asked))
    if overwrite and (there["seed"] != asked["seed"] or there["keep"] < asked["keep"]):
        stale = {(key, label): OVERWRITTEN for key, cell in cells.items() for label in cell["estimators"]}
        return Growth(plan, plan.configuration(), description(plan), stale)
    if differences and not overwrite:
        shown = "\n".join(f"  {line}" for line in differences[:8])
        raise InputError(f"{store.folder}: holds results of another configuration; choose another --out, or let "
                         f"--overwrite replace them. What differs (there -> now):\n{shown}")
    if overwrite:
        stale = {(cell.key, label): OVERWRITTEN for cell in plan.cells if cell.key in cells
                 for label in cells[cell.key]["estimators"]
                 if label in cell.entries or cells[cell.key]["scenario"] != asked["cells"][cell.key]["scenario"]}
    whole: list[Cell] = []
    for cell in plan.cells:
        stored = cells.get(cell.key)
        if stored is None:
            whole.append(cell)
            continue
        now = asked["cells"][cell.key]
        moved = [name for name in CODE if name in now and stored[name] != now[name]]
        left_out = [label for label in stored["estimators"] if label not in cell.entries
                    and (cell.key, label) not in stale]
        along = left_out if moved or plan.runs > stored["runs"] else []
        strangers = [label for label in along if stored["estimators"][label]["plugin"] not in plan.catalogue.names()]
        if strangers:
            name = stored["estimators"][strangers[0]]["plugin"]
            how = ("it was given in Python, by value: give it again"
                   if manifest["estimators"][name]["given"] else "name its file with --plugin")
            raise InputError(f"{store.folder}: {cell.key}/{strangers[0]} has to be computed along "
                             f"({'the code changed' if moved else 'all of a cell have the same runs'}) and is not "
                             f"known here: {how}, or choose another --out")
        entries = {**stored_cell(manifest, cell.key, dict.fromkeys(along)).entries, **cell.entries}
        order = [*(label for label in stored["estimators"] if label in entries), *cell.entries]
        whole.append(replace(cell, entries={label: entries[label] for label in dict.fromkeys(order)},
                             runs=stored["runs"]))
        for label in stored["estimators"] if moved else ():
            stale.setdefault((cell.key, label), f"the code of the {' and the '.join(moved)} changed")
    plan = replace(plan, cells=tuple(whole), keep=there["keep"])
    configuration, about = plan.configuration(), description(plan)
    for key, cell in configuration["cells"].items():
        for label, entry in cell["estimators"].items():
            before = cells.get(key, {"estimators": {}})["estimators"].get(label)
            if before and before["source"] != entry["source"]:
                stale.setdefault((key, label), "its code changed")
    merged = _merged(manifest, {"configuration": configuration, **about}, stale)
    return Growth(plan, merged.pop("configuration"), merged, stale)


def _merged(there: Mapping[str, Any], now: Mapping[str, Any], stale: Mapping[tuple[str, str], str]) -> dict[str, Any]:
    """Configuration and description of both; what is stale and not asked for is gone."""
    cells = dict(there["configuration"]["cells"])
    stored = dict(there["replay"]["cells"])
    for key, cell in now["configuration"]["cells"].items():
        kept = {label: entry for label, entry in cells.get(key, {"estimators": {}})["estimators"].items()
                if (key, label) not in stale}
        cells[key] = {**cell, "estimators": {**kept, **cell["estimators"]}}
        entries = stored.get(key, {"entries": {}})["entries"]
        replay = now["replay"]["cells"][key]
        stored[key] = {**replay, "entries": {**{label: entries[label] for label in kept}, **replay["entries"]}}
    scenarios = {}
    for name, about in now["scenarios"].items():
        before = there["scenarios"].get(name, {"variants": {}})["variants"]
        scenarios[name] = {**about, "variants": {**before, **{
            variant: {**{key: before[variant][key] for key in ("until", "level") if key in before.get(variant, {})
                         and _as_long(there["configuration"]["cells"], cells, f"{name}/{variant}")}, **facts}
            for variant, facts in about["variants"].items()}}}
    return {
        "configuration": {**now["configuration"], "cells": cells, "runs": max(cell["runs"] for cell in cells.values())},
        "scenarios": {**there["scenarios"], **scenarios},
        "estimators": {**there["estimators"], **now["estimators"]},
        "replay": {"plugins": list(dict.fromkeys([*there["replay"]["plugins"], *now["replay"]["plugins"]])),
                   "cells": stored}}


def _as_long(there: Mapping[str, Any], now: Mapping[str, Any], key: str) -> bool:
    """Whether a cell has the runs and the entries that it had: else why it was stopped says nothing any more."""
    return key in there and there[key]["runs"] == now[key]["runs"] and there[key]["estimators"].keys() == now[key][
        "estimators"].keys()


def _differing(there: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """What of the configuration that is asked for is another one there; code aside, which may change."""
    lines = [f"seed: {there['seed']} -> {now['seed']}"] if there["seed"] != now["seed"] else []
    if there["keep"] < now["keep"]:
        lines.append(f"keep: {there['keep']} -> {now['keep']}")
    for key, cell in now["cells"].items():
        stored = there["cells"].get(key)
        if stored is None:
            continue
        if stored["scenario"] != cell["scenario"]:
            lines.append(f"{key}: scenario: {stored['scenario']} -> {cell['scenario']}")
        for label, entry in cell["estimators"].items():
            before = stored["estimators"].get(label)
            if before is not None:
                lines += differing({name: before.get(name) for name in entry if name not in CODE},
                                   {name: value for name, value in entry.items() if name not in CODE},
                                   f"{key}/{label}")
    return lines


def differing(there: Any, now: Any, path: str = "") -> list[str]:
    """Lines `path: there -> now` for what two nested tables have not in common."""
    if isinstance(there, dict) and isinstance(now, dict):
        lines: list[str] = []
        for key in {**there, **now}:
            inner = f"{path}.{key}" if path else key
            if key not in there:
                lines.append(f"{inner}: absent -> given")
            elif key not in now:
                lines.append(f"{inner}: given -> absent")
            else:
                lines += differing(there[key], now[key], inner)
        return lines
    return [] if there == now else [f"{path}: {reprlib.repr(there)} -> {reprlib.repr(now)}"]
