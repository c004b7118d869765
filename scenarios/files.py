"""Reading scenario files: TOML, variants as named overrides, all mistakes of a file reported at once.

A `Scenario` is the file read; `scenario.setting(variant)` is one variant of it, ready to simulate."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from .errors import InputError, describe
from .faults import Base as Fault
from .inheritance import Read, blamed, inherited, joined, located, merge, paths, read, set_dotted
from .registry import setting_for
from .requirements import check
from .schema import LABEL
from .setting import Setting

MISSING = object()
VARIANT_KEYS = {"title", "default", "notes", "origin", "fitted", "time", "plant", "disturbance", "sensors", "channel",
                "faults", "knowledge", "score", "requirements", "estimators"}


DISPLAY = {"name", "title", "source", "notes", "origin", "fitted", "default", "estimators"}
"""Top-level keys that change no number of a run."""


@dataclass(frozen=True)
class Scenario:
    """A scenario file: `name`, its variants as complete tables, its default (the file's first), where it was read from.

    folder: that of a user's file, from which it names others. unfit: variants that are sound by themselves but cannot
    take the overrides (the number of contending trains, on a channel of another kind), with what is wrong. requested:
    variants that run only when asked for by name. layers: the files it is made of, the base first."""

    name: str
    where: str
    variants: dict[str, dict[str, Any]] = field(repr=False)
    default: str
    unfit: dict[str, list[str]] = field(default_factory=dict)
    folder: Path = Path()
    requested: frozenset[str] = frozenset()
    layers: tuple[Read, ...] = field(default=(), repr=False)

    def setting(self, variant: str) -> Setting[Any]:
        """The setting of one variant. Raises InputError for one that is unknown or unfit."""
        if variant in self.unfit:
            raise InputError("\n".join(f"{self.where}: variants.{variant}: {line}" for line in self.unfit[variant]))
        if variant not in self.variants:
            raise InputError(f"{self.where}: there is no variant \"{variant}\"; allowed: {', '.join(self.variants)}")
        table = self.variants[variant]
        kind = setting_for(table["plant"]["kind"], self.where)
        return kind(kind.Config.model_validate(table))

    def content_hash(self, variant: str) -> str:
        """Hash of what the variant's runs depend on, files of the user's that it names included; not of titles, notes,
        origins or the file's layout, nor of the estimators, which have hashes of their own."""
        table = self.variants[variant]
        content = {key: value for key, value in table.items() if key not in DISPLAY}
        found = hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode())
        for key in setting_for(table["plant"]["kind"], self.where).user_files:
            for path in paths(table["plant"].get(key)):
                for file in sorted(Path(path).rglob("*")) if Path(path).is_dir() else [Path(path)]:
                    found.update(file.read_bytes() if file.is_file() else b"")
        return found.hexdigest()[:16]


def load(name: str, overrides: Mapping[str, Any] | None = None, only: str = "") -> Scenario:
    """A scenario by built-in name or path of a TOML file, with `--set` overrides (dotted key -> value) on every
    variant, or on the one variant that is wanted. Raises InputError with all mistakes of the file."""
    found = read(name)
    return parse(found.table, found.where, overrides, only, found.folder)


def outline(name: str) -> tuple[dict[str, Any], dict[str, bool]]:
    """The default variant's table of a scenario as it is written, not checked, and the variants with whether they run
    unless asked for. Raises InputError for a file that cannot be read."""
    table, named = joined(inherited(read(name)))
    return merge(table, next(iter(named.values()))), {key: changes.get("default", True)
                                                      for key, changes in named.items()}


def parse(table: dict[str, Any], where: str, overrides: Mapping[str, Any] | None = None, only: str = "",
          folder: Path = Path()) -> Scenario:
    """A scenario from its TOML table, laid over its base; `where` stands in the messages, files are named from `folder`
    on. Raises InputError with all mistakes."""
    if not table:
        raise InputError(f"{where}: the file is empty; a scenario needs name, title, [time], [plant], [estimators], or "
                         "name and base")
    layers = inherited(Read(where, folder, table))
    base, named = joined(layers)
    mistakes: list[str] = []
    unfit: dict[str, list[str]] = {}
    refused: InputError | None = None
    variants, configs, without = dict[str, dict[str, Any]](), dict[str, Any](), dict[str, dict[str, Any]]()
    for variant, changes in named.items():
        if not re.fullmatch(LABEL, variant):
            mistakes.append(f"variants: \"{variant}\" is no name; allowed: letters, digits and . _ -")
            continue
        unknown = sorted(set(changes) - VARIANT_KEYS)
        if unknown:
            mistakes.append(f"variants.{variant}: unknown key {', '.join(unknown)}; allowed: "
                            f"{', '.join(sorted(VARIANT_KEYS))}")
            continue
        if not changes and len(named) > 1 and variant != next(iter(named)):
            mistakes.append(f"variants.{variant}: changes nothing; allowed: at least one of "
                            f"{', '.join(sorted(VARIANT_KEYS))}")
        plain = merged = located(merge(base, changes), folder)
        if only and variant != only:
            variants[variant] = plain
            continue
        try:
            for key, value in (overrides or {}).items():
                merged = set_dotted(merged, key, value)
        except InputError as error:  # such as faults of a name that this variant's have not
            refused, unfit[variant], without[variant] = refused or error, [str(error)], plain
            continue
        merged = located(merged, Path.cwd())
        found, configs[variant] = validate(merged, where)
        if found and overrides and not validate(plain, where)[0]:
            unfit[variant], without[variant] = found, plain
            continue
        prefix = f"variants.{variant}: " if changes else ""
        mistakes += [m for m in (f if f in mistakes else prefix + f for f in found) if m not in mistakes]
        variants[variant] = merged
    if refused and (not variants or only in unfit):
        raise refused
    touched = {key.partition(".")[0] for key in overrides or ()}
    if variants and not mistakes:
        mistakes += _strays({**variants, **without}, configs, layers[-1].table, touched)
    if not variants or only in unfit:
        usual = {variant: found for variant, found in unfit.items() if named[variant].get("default", True)}
        mistakes += [f"variants.{variant}: {line}" if named[variant] else line
                     for variant, found in (usual or unfit).items() for line in found]
    if mistakes:
        raise InputError("\n".join(f"{blamed(mistake, layers)}: {mistake}" for mistake in _without_repeats(mistakes)))
    return Scenario(base["name"], where, variants, next(iter(named)), unfit, folder,
                    frozenset(name for name, changes in named.items() if not changes.get("default", True)), layers)


def validate(table: dict[str, Any], where: str) -> tuple[list[str], Any]:
    """The mistakes of one resolved variant, each `path: what is wrong; what is allowed`, and what it says, checked;
    None where it cannot be."""
    plant = table.get("plant")
    if not isinstance(plant, dict) or not isinstance(plant.get("kind"), str):
        return ["plant.kind: missing; it names the plant, such as kind = \"metro\""], None
    try:
        kind = setting_for(plant["kind"], where)
    except InputError as error:
        return [str(error).removeprefix(f"{where}: ")], None
    try:
        setting = kind(kind.Config.model_validate(table))
    except ValidationError as error:
        return describe(error, kind.Config, table=table), None
    known = [item.name for item in setting.quantities()]
    mistakes = _unfit_faults(setting)
    mistakes += [f"score.divergence.{name}: no such quantity; allowed: {', '.join(known)}"
                for name in setting.config.score.divergence if name not in known]
    single = [item.name for item in setting.quantities() if len(item.components) == 1]
    mistakes += check(setting.config.requirements, single, setting.references)
    for label, entry in setting.config.estimators.items():
        try:
            setting.resolve_knowledge(entry.knowledge)
        except ValidationError as error:
            mistakes += describe(error, type(setting.config.knowledge), f"estimators.{label}.knowledge")
            continue
        try:
            setting.chosen(entry.knowledge, entry.augment)
        except InputError as error:
            mistakes.append(f"estimators.{label}.{error}")
    return mistakes, setting.config


def _unfit_faults(setting: Setting[Any]) -> list[str]:
    """The mistakes of [[faults]] entries that do not fit their setting."""
    if not setting.config.faults or (setting.needs_file and not file_given(setting)):
        return []
    sensing = setting.sensing()
    if sensing is None:
        return ["faults: this setting does not say what its sensors are, and takes none"]
    mistakes = []
    for fault in setting.config.faults:
        assert isinstance(fault, Fault)
        try:
            fault.check(sensing, setting.following)
        except ValueError as error:
            mistakes.append(f"faults.{fault.label}: {error}")
    return mistakes


def file_given(setting: Setting[Any]) -> bool:
    """Whether a setting has the file of the user's without which nothing can run."""
    found: Any = setting.config
    for part in setting.needs_file.split("."):
        found = getattr(found, part)
    return found is not None


def _strays(variants: Mapping[str, dict[str, Any]], configs: Mapping[str, Any], own: Mapping[str, Any],
            touched: Collection[str]) -> list[str]:
    """Paths of [origin] and `fitted` that lead to nothing in any of the variants (those that cannot take the overrides
    as they are without); not those into a table overridden, nor those of a base, of which there may be less left.
    configs: what is checked already; own: the file's own table."""
    tables = [own, *own.get("variants", {}).values()]
    left = [(key, path) for key in ("origin", "fitted") for path in sorted(
        {path for table in tables for path in table.get(key, ())}) if path.partition(".")[0] not in touched]
    for variant, table in variants.items():
        if not left:
            break
        try:
            config = configs.get(variant) or setting_for(table["plant"]["kind"], "").Config.model_validate(table)
        except ValidationError:  # of a variant that nobody asked for
            return []
        left = [(key, path) for key, path in left if not _names_a_key(path, config)]
    return [f"{key}.{path}: names no key of this scenario" for key, path in left]


def _names_a_key(path: str, config: Any) -> bool:
    """Whether a dotted path leads to something in a resolved scenario."""
    for part in path.split("."):
        if isinstance(config, BaseModel):
            config = getattr(config, part, MISSING)
        elif isinstance(config, tuple):
            config = next((entry for entry in config if getattr(entry, "label", None) == part), MISSING)
        else:
            config = config.get(part, MISSING) if isinstance(config, dict) else MISSING
        if config is MISSING:
            return False
    return True


def _without_repeats(mistakes: list[str]) -> list[str]:
    """A mistake of the base file shows once, not once per variant."""
    bare = [m.split(": ", 1)[1] if m.startswith("variants.") else m for m in mistakes]
    return [m for i, m in enumerate(mistakes) if bare[i] not in bare[:i]]
