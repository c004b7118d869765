"""What a results folder knows of its plan, its estimators and the machine; and the plan made anew from it."""

from __future__ import annotations

import os
import platform
import reprlib
import subprocess
import sys
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from ...estimators.registry import estimators
from ...scenarios.schema import EstimatorEntry
from ..planning.plan import Cell, Plan


def stored_plan(manifest: Mapping[str, Any]) -> Plan:
    """The plan a results folder was made from. Raises InputError."""
    configuration, saved = manifest["configuration"], manifest["replay"]
    cells = []
    for key, item in saved["cells"].items():
        scenario, variant = key.split("/")
        cells.append(Cell(scenario, variant, item["where"], item["table"], {
            label: EstimatorEntry.model_validate(entry) for label, entry in item["entries"].items()}))
    return Plan(tuple(cells), configuration["runs"], configuration["seed"], configuration["keep"],
                tuple(saved["plugins"]))


def description(plan: Plan) -> dict[str, Any]:
    """The manifest's `scenarios`, `estimators` and `replay` entries."""
    scenarios: dict[str, Any] = {}
    for cell in plan.cells:
        setting = cell.setting()
        config = setting.config
        about = scenarios.setdefault(cell.scenario, {
            "title": config.title, "source": config.source, "kind": setting.kind,
            "scored": config.score.at,
            "shown": {**setting.shown, **{item.name: item.shown for item in setting.quantities() if item.shown}},
            "quantities": [item.name for item in setting.quantities()], "table": setting.table(), "variants": {}})
        about["variants"][cell.variant] = {"notes": setting.notes, "fitted": config.fitted, "title": config.title,
                                           "period": setting.sampling_period}
    plugins = {entry.plugin: estimators()[entry.plugin] for cell in plan.cells for entry in cell.entries.values()}
    return {
        "scenarios": scenarios,
        "estimators": {name: {"summary": cls.summary, "source": cls.source, "claims": cls.claims, "oracle": cls.oracle}
                       for name, cls in plugins.items()},
        "replay": {"plugins": plan.plugins, "cells": {
            cell.key: {"where": cell.where, "table": dict(cell.table),
                       "entries": {label: entry.model_dump() for label, entry in cell.entries.items()}}
            for cell in plan.cells}},
    }
PACKAGES = ("numpy", "scipy", "numba", "filterpy", "cvxpy", "clarabel", "pandas", "pyarrow", "joblib", "pydantic")
MANIFEST = {"railstate": str, "command": str, "configuration": dict, "scenarios": dict, "estimators": dict,
            "replay": dict, "environment": dict, "started": str}
"""What every manifest has."""


def environment() -> dict[str, Any]:
    """Versions, processor and git state of this installation."""
    here = Path(__file__).resolve().parent

    def git(*words: str) -> str | None:
        try:
            return subprocess.run(["git", *words], cwd=here, capture_output=True, text=True, check=True,
                                  timeout=10).stdout.strip()
        except (OSError, subprocess.SubprocessError):
            return None

    status = git("status", "--porcelain", "--untracked-files=no")
    return {"python": sys.version.split()[0], "platform": platform.platform(terse=True), "processor": _processor(),
            "cores": os.cpu_count(), "packages": {name: version(name) for name in PACKAGES},
            "git_commit": git("rev-parse", "HEAD"), "git_dirty": None if status is None else bool(status)}


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def differing(there: Any, now: Any, path: str = "") -> list[str]:
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
