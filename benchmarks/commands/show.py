"""`railstate list`, `show` and `schema`: what there is to run and what each thing is made of."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Annotated, Any

import typer
from pydantic import BaseModel

from ...scenarios.augmented import Extra
from ...scenarios.errors import InputError
from ...scenarios.files import outline
from ...scenarios.inheritance import comes_from
from ...scenarios.keys import Key, keys_of
from ...scenarios.registry import settings
from ..api.listing import estimator_lines, scenario_lines
from ..planning.catalogue import Catalogue, Described
from ..planning.naming import find_one
from ..planning.plan import check_variants
from ..telling.console import print_table, wrapped
from .options import Plugins, Sets, overrides

BASE = "what it inherits: a built-in scenario, NAME/VARIANT (that variant alone), or the path of a TOML file"
VARIANTS = "named overrides of the tables, one with a `base` over those of another variant; the first is the default"


def list_() -> None:
    """List scenarios with their variants, and estimators with what they need and claim."""
    print_table("Scenarios", [{key: value if isinstance(value, str) else " ".join(value) for key, value in line.items()}
                              for line in scenario_lines()],
                ["A name alone means all its variants but those on request; where one is wanted, the first."])
    print_table("Estimators", [{"estimator": line["estimator"], "about": line["about"],
                                "needs": " ".join(line["needs"]) or "-", "claims": " ".join(line["claims"])}
                               for line in estimator_lines()])


def show(
    name: Annotated[str, typer.Argument(help="A scenario, NAME/VARIANT, a TOML file, or an estimator.")],
    set_: Sets = [],  # noqa: B006
    out: Annotated[str, typer.Option(metavar="DIR", help="A results folder: where an estimator was best, worse, lost "
                                                         "in it.")] = "",
    keys: Annotated[bool, typer.Option("--keys", help="What each key of such a scenario file says, its unit.")] = False,
    plugin: Plugins = [],  # noqa: B006
) -> None:
    """Show a scenario resolved, or an estimator's page: equations, needs, claims, parameters, record in a folder."""
    changes = overrides(set_)
    catalogue = Catalogue(plugin)
    if name in catalogue.names():
        if changes:
            raise InputError(f"--set {next(iter(changes))}: {name} is an estimator; a scenario's keys can be set")
        _show_estimator(catalogue[name], out)
        return
    try:
        scenario, variant = find_one(name, changes)
    except InputError as error:
        if changes:
            raise
        raise InputError(f"{error}\nestimators: {', '.join(catalogue.names())}") from None
    config = scenario.setting(variant).config
    alone = name.endswith(f"/{variant}")
    check_variants(scenario, [variant] if alone else [one for one in scenario.variants if one == variant
                                                        or one not in scenario.requested], catalogue)
    if keys:
        _show_keys(type(config))
        return
    print(f"{scenario.name}/{variant}: {config.title}\nsource: {config.source}")
    if scenario.layers[1:]:
        print(f"base: {' over '.join(layer.where for layer in scenario.layers[-2::-1])}")
    print(f"variants: {', '.join(scenario.variants)}")
    for note in config.notes:
        print(f"note: {note}")
    for key in config.fitted:
        print(f"fitted: {key}")
    rows = []
    for key, value in _flat(config.model_dump(exclude={"name", "title", "source", "notes", "origin", "fitted",
                                                       "estimators"})):
        changed = any(f"{key}.".startswith(f"{one}.") for one in changes)
        where = "/".join(filter(None, comes_from(key, scenario.layers, variant))) or "default"
        rows.append({"key": key, "value": json.dumps(value), "from": "--set" if changed else where,
                     "origin": "" if changed else _origin(key, config.origin)})
    print_table("", rows)
    print_table("", [
        {"estimator": label, "plug-in": entry.plugin, "parameters": json.dumps(entry.parameters) if entry.parameters
         else "", "told differently": json.dumps(entry.knowledge) if entry.knowledge else "",
         "extra states": json.dumps({extra: asked.model_dump(exclude_none=True)
                                     for extra, asked in entry.augment.items()}) if entry.augment else "",
         "runs by default": "yes" if entry.default else "no",
         "origin": config.origin.get(f"estimators.{label}", "")}
        for label, entry in config.estimators.items()])
    offered = scenario.setting(variant).extras({})
    if offered:
        print_table("Extra states that an entry may ask for (augment = { NAME = { kind = .. } })",
                    [_offer(name, extras) for name, extras in offered.items()])


def _offer(name: str, extras: tuple[Extra, ...]) -> dict[str, str]:
    """An offer's line: its usual numbers, in its unit."""
    first = extras[0]
    usual = {"kind": first.kind, "sd": first.sd, "start_sd": first.start_sd, "mean": first.mean or None,
             "time_constant": first.time_constant, "bound": first.bound, "instead": first.instead or None}
    return {"extra state": name, "states": " ".join(extra.name for extra in extras), "unit": first.unit,
            "enters": first.enters, "usually": json.dumps({k: v for k, v in usual.items() if v is not None})}


def _show_keys(config: type[BaseModel]) -> None:
    """A table for each table of such files."""
    own = [Key("base", "", BASE, "", "none", False), Key("variants", "", VARIANTS, "", "one", False), *keys_of(config)]
    tables: dict[tuple[str, str], list[dict[str, str]]] = {}
    for key in own:
        table, _, _ = key.path.rpartition(".")
        tables.setdefault((table, key.of), []).append({"key": key.path, "what": key.what, "default": key.default})
    for (table, of), lines in tables.items():
        print_table(f"[{table}]{' of ' + of if of else ''}" if table else "The file", lines)


def schema() -> None:
    """Print the JSON schema of scenario files, for editors."""
    definitions: dict[str, Any] = {}
    kinds = []
    for kind, setting in settings().items():
        made = setting.Config.model_json_schema(ref_template="#/$defs/" + kind + ".{model}")
        definitions.update({f"{kind}.{key}": value for key, value in made.pop("$defs", {}).items()})
        made["properties"]["base"] = {"type": "string", "description": BASE}
        made["properties"]["variants"] = {"type": "object", "additionalProperties": {"type": "object"},
                                          "description": VARIANTS}
        whole = made.pop("required")  # a file with a base says what it likes
        definitions[kind] = {**made, "anyOf": [{"required": whole}, {"required": ["name", "base"]}]}
        kinds.append({"$ref": f"#/$defs/{kind}"})
    print(json.dumps({"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "railstate scenario",
                      "anyOf": kinds, "$defs": definitions}, indent=1))


def _show_estimator(found: Described, folder: str) -> None:
    """Its page, with its record in a results folder where one is named."""
    from ..telling.estimators import page

    cells: list[Any] = []
    if folder:
        from ..judging.table import verdicts_of
        from ..store.folder import Store
        from ..telling.rankings import cells_of

        cells = list(cells_of(verdicts_of(Store(folder)), Store(folder).manifest()))
    told = page(found.name, asdict(found), cells)
    print(f"{told.name}: {told.summary}")
    for what, words in told.facts:
        wrapped(f"{what.lower()}: {words}")
    for line in (*told.about, *told.record):
        print()
        wrapped(line, "")
    entered = [f"{line['scenario']} ({', '.join(labels)})" for line, labels in _entered(found.name)]
    print()
    wrapped(f"entered in: {'; '.join(entered) or 'no built-in scenario'}")
    if folder and not told.record:
        print(f"{folder}: has no run of it")
    if found.parameters:
        print_table("Parameters", found.parameters)
    else:
        print("no parameters")


def _entered(plugin: str) -> Iterator[tuple[dict[str, Any], list[str]]]:
    """The scenarios that have entries of an estimator, with the entries."""
    for line in scenario_lines():
        entries = outline(line["scenario"])[0].get("estimators", {})
        labels = [label for label, entry in entries.items() if entry.get("plugin") == plugin]
        if labels:
            yield line, labels


def _origin(key: str, origins: Mapping[str, str]) -> str:
    """What [origin] says of a key, or else of the table it stands in."""
    while key and key not in origins:
        key = key.rpartition(".")[0]
    return origins.get(key, "")


def _flat(table: dict[str, Any], path: str = "") -> list[tuple[str, Any]]:
    out: list[tuple[str, Any]] = []
    for key, value in table.items():
        inner = f"{path}.{key}" if path else key
        out += _flat(value, inner) if isinstance(value, dict) and value else [(inner, value)]
    return out
