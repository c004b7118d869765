"""The scenario and the variants that a word of the command line means."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from ...scenarios.errors import InputError
from ...scenarios.files import Scenario, load
from ...scenarios.registry import scenario_files


def find(name: str, overrides: Mapping[str, Any] | None = None) -> tuple[Scenario, tuple[str, ...]]:
    """A scenario and the variants meant: NAME or a path (all that do not run only when asked for), NAME/VARIANT or
    PATH.toml/VARIANT (one), or a pattern of variants such as NAME/protocol-* (all that are called so).

    Of several variants those that cannot take the overrides are left out with a warning."""
    base, _, pattern = name.rpartition("/")
    several = "*" in pattern
    scenario, variant = named(base if several else name, overrides)
    if variant:
        return scenario, (variant,)

    def meant(variant: str) -> bool:
        return fnmatchcase(variant, pattern) if several else variant not in scenario.requested

    for left, why in scenario.unfit.items():
        if meant(left):
            warnings.warn(f"{scenario.where}: variant {left} is left out: {'; '.join(why)}", stacklevel=2)
    chosen = tuple(filter(meant, scenario.variants))
    if not chosen:
        raise InputError(f"{name}: there is no such variant; allowed: "
                         f"{', '.join([*scenario.variants, *scenario.unfit])}")
    return scenario, chosen


def located(name: str) -> str:
    """A scenario's name, or a file's path (with its variant) as it is from any folder."""
    base, _, variant = name.rpartition("/")
    if base.endswith(".toml"):
        return f"{Path(base).resolve()}/{variant}"
    return str(Path(name).resolve()) if name.endswith(".toml") else name


def find_one(name: str, overrides: Mapping[str, Any] | None = None) -> tuple[Scenario, str]:
    """A scenario and one variant: the one named, else the default one. Raises InputError if it is unfit."""
    scenario, variant = named(name, overrides)
    variant = variant or scenario.default
    scenario.setting(variant)
    return scenario, variant


def named(name: str, overrides: Mapping[str, Any] | None) -> tuple[Scenario, str]:
    """The scenario and the variant that a word of the command line names ("": none)."""
    base, _, variant = name.rpartition("/")
    if base and (base in scenario_files() or base.endswith(".toml")):
        scenario = load(base, overrides, variant)
        scenario.setting(variant)
        return scenario, variant
    return load(name, overrides), ""
