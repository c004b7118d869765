"""Scenario files laid over one another: a file over its base, variants over the file, overrides over these.

Which file a key comes from is told in messages and by `railstate show`."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import reduce
from pathlib import Path
from typing import Any, NamedTuple

from .errors import InputError
from .faults import KINDS
from .registry import scenario_files, settings


class Read(NamedTuple):
    """A file as it was read. where: what messages call it. folder: from which it names files of the user's."""

    where: str
    folder: Path
    table: dict[str, Any]


def read(name: str, folder: Path = Path(), asked: str = "") -> Read:
    """A scenario's file, by built-in name or by path from a folder. asked: in whose words, for messages. Raises
    InputError."""
    path = scenario_files().get(name)
    where = name
    if path is None:
        path = folder / name
        where = str(path)
        if not path.exists():
            near = difflib.get_close_matches(name, scenario_files(), 1)
            hint = f" (did you mean {near[0]}?)" if near else ""
            raise InputError(f"{asked}{name}: no such scenario and no such file{hint}; built in: "
                             f"{', '.join(scenario_files())}")
        if path.is_dir():
            raise InputError(f"{asked}{name}: is a directory; a scenario is a TOML file or one of "
                             f"{', '.join(scenario_files())}")
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(f"{where}: not valid TOML: {error}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{where}: cannot be read: {error}") from None
    return Read(where, Path() if where == name and name in scenario_files() else path.parent, table)


def inherited(own: Read, above: tuple[str, ...] = ()) -> tuple[Read, ...]:
    """A file with all that it is laid over by `base`, lowest first: a built-in scenario, a TOML file beside it, or
    NAME/VARIANT, which is that variant alone. above: whose base it is itself. Raises InputError, also where bases lead
    back to themselves."""
    layers, chain = [own], [*above, _place(own)]
    while "base" in layers[0].table:
        top = layers[0]
        base = top.table["base"]
        if not isinstance(base, str) or not base:
            raise InputError(f"{top.where}: base: must be a scenario's name, NAME/VARIANT or the path of a TOML file "
                             f"(got {base!r})")
        name, _, variant = base.rpartition("/")
        if not name or base in scenario_files() or not (name in scenario_files() or name.endswith(".toml")):
            name, variant = base, ""
        below = read(name, top.folder, f"{top.where}: base: ")
        chain.append(_place(below))
        if chain[-1] in chain[:-1]:
            raise InputError(f"{own.where}: base: leads back to itself: {' -> '.join(chain)}")
        below = below._replace(table=_absolute(below))
        layers = [*([below] if not variant else _alone(below, variant, top, tuple(chain[:-1]))), *layers]
    return tuple(layers)


def _place(found: Read) -> str:
    return found.where if found.where in scenario_files() else str(Path(found.where).resolve())


def _alone(found: Read, variant: str, above: Read, chain: tuple[str, ...]) -> list[Read]:
    """One variant of a file as its whole, over all of its bases, as layers."""
    layers = inherited(found, chain)
    _, named = joined(layers)
    if variant not in named:
        raise InputError(f"{above.where}: base: {found.where} has no variant \"{variant}\"; allowed: "
                         f"{', '.join(named)}")
    out = []
    for layer in layers:
        whole = _without(layer.table, "variants", "base")
        for one in lineage(variant, layers):
            whole = _over(whole, _without(variants_of(layer).get(one, {}), "base"))
        out.append(layer._replace(table=_without(whole, "default")))
    return out


def _without(table: Mapping[str, Any], *keys: str) -> dict[str, Any]:
    return {key: value for key, value in table.items() if key not in keys}


def lineage(variant: str, layers: tuple[Read, ...]) -> tuple[str, ...]:
    """A variant behind those that it is laid over by a `base` of its own, another variant of the file: the lowest
    first. Raises InputError, also where bases lead back to themselves."""
    found: list[str] = [variant]
    while True:
        said = [one["base"] for layer in layers if "base" in (one := variants_of(layer).get(found[0], {}))]
        if not said:
            return tuple(found)
        where = f"{layers[-1].where}: variants.{found[0]}: base"
        if not any(said[-1] in variants_of(layer) for layer in layers if isinstance(said[-1], str)):
            known = dict.fromkeys(name for layer in layers for name in variants_of(layer))
            raise InputError(f"{where}: must be another variant of this scenario (got {said[-1]!r}); allowed: "
                             f"{', '.join(name for name in known if name not in found)}")
        if said[-1] in found:
            raise InputError(f"{where}: leads back to itself: {' -> '.join([*found[::-1], said[-1]])}")
        found.insert(0, said[-1])


def variants_of(found: Read) -> dict[str, dict[str, Any]]:
    """The variants of a file by name. Raises InputError where they are no tables."""
    named = found.table.get("variants", {})
    if not isinstance(named, dict) or not all(isinstance(value, dict) for value in named.values()) or (
            "variants" in found.table and not named):
        raise InputError(f"{found.where}: variants must be tables such as [variants.NAME]")
    return named


def joined(layers: tuple[Read, ...]) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """The table under all variants, and the variants. A name is a file's own; what a file above says anew has not the
    origin that it had."""
    base: dict[str, Any] = {}
    named: dict[str, dict[str, Any]] = {}
    for layer in layers:
        anew = [key for key, _ in _leaves(layer.table)]
        origin, fitted, own = base.get("origin"), base.get("fitted"), layer.table.get("origin", {})
        if isinstance(origin, dict) and isinstance(own, dict):
            base["origin"] = {key: text for key, text in origin.items() if not _within(key, anew)} | {
                key: f"set in {layer.where}" for key in anew if _within(key, origin) and not _within(key, own)}
        if isinstance(fitted, list):
            base["fitted"] = [key for key in fitted if not _within(str(key), anew)]
        base.pop("name", None)
        base = merge(base, _without(layer.table, "variants", "base"))
        for variant, changes in variants_of(layer).items():
            named[variant] = _over(named.get(variant, {}), _without(changes, "base"))
    return base, {variant: reduce(_over, (named[one] for one in lineage(variant, layers)))
                  for variant in named} or {"default": {}}


def _over(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """The changes of a variant over those of its base, or over its own in a base of the file: what both say of
    [[faults]] by name stays that, since the entries meant stand in the table under both."""
    faults, changed = below.get("faults", {}), above.get("faults")
    if not isinstance(faults, dict) or not isinstance(changed, dict):
        return merge(below, above)
    return {**merge(below, {key: value for key, value in above.items() if key != "faults"}),
            "faults": merge(faults, changed)}


def _within(key: str, others: Iterable[str]) -> bool:
    """Whether a dotted key is one of others, or lies within one."""
    return any(other == key or key.startswith(f"{other}.") for other in others)


def _leaves(table: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted keys and values of a table, those of variants, origins and the like aside."""
    for key, value in table.items():
        if not path and key in ("name", "variants", "origin", "fitted", "base"):
            continue
        inner = f"{path}.{key}" if path else key
        if isinstance(value, dict) and value:
            yield from _leaves(value, inner)
        else:
            yield inner, value


def comes_from(key: str, layers: tuple[Read, ...], variant: str = "") -> tuple[str, str]:
    """Which file says a key, and in which of its variants ("": in none); empty where none does."""
    for named in (*lineage(variant, layers)[::-1], "") if variant else ("",):
        for layer in reversed(layers):
            table = variants_of(layer).get(named, {}) if named else layer.table
            if any(_within(key, [there]) or _within(there, [key]) for there, _ in _leaves(table)):
                return layer.where, named
    return "", ""


def blamed(mistake: str, layers: tuple[Read, ...]) -> str:
    """The file that a mistake is in, behind the file that it was read for."""
    own, variant, path = layers[-1].where, "", mistake.partition(": ")[0]
    if path.startswith("variants."):
        variant, path = path.removeprefix("variants."), mistake.split(": ")[1]
    found, _ = comes_from(path, layers, variant)
    return own if found in ("", own) else f"{own}: base {found}"


def written(where: str) -> list[str]:
    """What a scenario's file and its bases say, by name or path. Raises InputError."""
    return [repr(layer.table) for layer in inherited(read(where))]


def _absolute(found: Read) -> dict[str, Any]:
    """A base's table with the user's files that it names by their full paths."""
    table = located(found.table, found.folder)
    plant = table.get("plant")
    kind = plant.get("kind") if isinstance(plant, dict) else None
    variants = {name: {**changes, "plant": {"kind": kind, **changes["plant"]}} if isinstance(changes.get("plant"), dict)
                else changes for name, changes in variants_of(found).items()}
    return {**table, "variants": {name: located(changes, found.folder) for name, changes in variants.items()}
            } if variants else table


def merge(base: dict[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """`base` with `changes` on top, tables merged key by key; a table whose `kind` changes is replaced whole. A table
    `faults` changes the entries of [[faults]] by their names or kinds."""
    out = dict(base)
    for key, value in changes.items():
        old = out.get(key)
        if key == "faults" and isinstance(value, dict):
            entries = old if isinstance(old, list) else []
            for label, inner in value.items():
                entries = with_entry(entries, label, lambda entry, inner=inner: merge(entry, inner))
            out[key] = entries
        elif (isinstance(old, dict) and isinstance(value, dict)
              and value.get("kind", old.get("kind")) == old.get("kind")):
            out[key] = merge(old, value)
        else:
            out[key] = value
    return out


def set_dotted(table: dict[str, Any], key: str, value: Any, above: str = "") -> dict[str, Any]:
    """`table` with one dotted key set (`channel.trains`). Another `kind` of a table replaces the whole of it, as in a
    variant. above: where the table stands, for the message."""
    head, _, rest = key.partition(".")
    if not rest:
        return {"kind": value} if head == "kind" and table.get("kind", value) != value else {**table, head: value}
    inner = table.get(head, {})
    if head == "faults" and not above:
        label, _, rest = rest.partition(".")
        if not rest:
            raise InputError(f"--set {key}: names no key of a fault, such as faults.outliers.share")
        entries = inner if isinstance(inner, list) else []
        return {**table, head: with_entry(entries, label,
                                          lambda entry: set_dotted(entry, rest, value, f"faults.{label}."))}
    if not isinstance(inner, dict):
        raise InputError(f"--set {above}{key}: {above}{head} is not a table")
    return {**table, head: set_dotted(inner, rest, value, f"{above}{head}.")}


def with_entry(entries: list[dict[str, Any]], label: str,
               change: Callable[[dict[str, Any]], dict[str, Any]]) -> list[dict[str, Any]]:
    """The [[faults]] with the one of this name or kind changed; a kind that is not among them yet is appended. Raises
    InputError where two entries are meant, or none."""
    meant = [i for i, entry in enumerate(entries) if label == entry.get("name", entry.get("kind"))]
    if len(meant) > 1:
        raise InputError(f"faults.{label}: two entries are called so: give each a name of its own")
    if not meant and label not in KINDS:
        known = [str(entry.get("name", entry.get("kind"))) for entry in entries]
        raise InputError(f"faults.{label}: no such entry and no such kind; allowed: "
                         f"{', '.join(dict.fromkeys([*known, *KINDS]))}")
    place = meant[0] if meant else len(entries)
    changed = change(entries[place] if meant else {"kind": label})
    return [*entries[:place], changed, *entries[place + 1:]]


def located(table: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The table with the user's files that it names as paths from here on."""
    plant = table.get("plant")
    kind = settings().get(str(plant.get("kind"))) if isinstance(plant, dict) else None
    if kind is None or not isinstance(plant, dict):
        return table
    named: dict[str, Any] = {}
    for key in kind.user_files:
        found = [str((folder / path).resolve()) for path in paths(plant.get(key))]
        if found:
            named[key] = found if isinstance(plant[key], list) else found[0]
    return {**table, "plant": {**plant, **named}}


def paths(value: Any) -> list[str]:
    """The paths that a key of [plant] names: one, a list of them, or none (a table)."""
    return [value] if isinstance(value, str) else [path for path in value if isinstance(path, str)] if isinstance(
        value, list) else []
