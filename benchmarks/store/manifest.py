"""What a results folder must tell about the scenarios and estimators in it, so that tables and report need no code."""

from __future__ import annotations

from typing import Any

from ..estimators.registry import estimators
from .plan import Plan


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
