"""`railstate sweep`: one scenario over a list of values of one key (or a grid of several): rows, a table, plots."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
import typer

from ...estimators.interface import Estimator
from ...estimators.registry import estimator_class
from ...scenarios.errors import Infeasible, InputError, Unsupported
from ...scenarios.randomness import Streams
from ...scenarios.registry import setting_of
from ..judging.table import framed, verdicts_of
from ..planning.naming import find_one
from ..planning.plan import Plan, make_plan, own
from ..running.drive import prepare
from ..running.machinery import machinery
from ..store.folder import Store
from ..studies.complete import complete
from ..telling.cleaning import csv
from ..telling.console import print_table
from ..telling.marks import MARKS
from ..telling.markup import to_markdown
from ..telling.rankings import records
from ..telling.report.sweep import DESCRIPTION, VALUES, Arranged, Sweep
from ..telling.wording import bracket, number, plus_minus, ratio, value_words
from . import options as use


def sweep(
    scenario: Annotated[str, typer.Argument(help="Built-in name, NAME/VARIANT, or a TOML file.")],
    over: Annotated[list[str], typer.Option(metavar="KEY=V1,V2,..", help="Key and values; twice for a grid.")],
    estimators: use.Estimators = "",
    runs: use.Runs = 100,
    seed: use.Seed = 1,
    jobs: use.Jobs = 0,
    metric: Annotated[str, typer.Option(help="METRIC:QUANTITY,.. to print and plot; none: the scenario's table.")] = "",
    out: Annotated[str, typer.Option(help="Folder for rows, sweep.csv and plots.")] = "",
    set_: use.Sets = [],  # noqa: B006
    plugin: use.Plugins = [],  # noqa: B006
    line: use.Line = "",
    train: use.Train = "",
    recording: use.Recording = [],  # noqa: B006
    map_: use.Map = "",
    quality: use.Quality = "",
    missing: use.Missing = "",
    track: use.Track = "",
    balises: use.Balises = "",
    from_: use.From = None,
    to: use.To = None,
    without: use.Without = [],  # noqa: B006
    batch: use.Batch = 0,
    backend: use.Backend = "local",
    scheduler: use.Scheduler = "",
    timeout: use.Timeout = 900.0,
    memory: use.Memory = 0.0,
) -> None:
    """Run a scenario (its default variant unless one is named) at each value of a key; its requirements go into one
    table over all of them."""
    axes: dict[str, list[Any]] = {}
    for key, values in map(_axis, over):
        axes.setdefault(key, []).extend(item for item in values if item not in axes.get(key, []))
    fixed = {**use.overrides(set_), **use.files(line, train, recording),
             **use.meaning(map_, quality, missing, track, balises, from_, to, without)}
    points = [dict(zip(axes, values, strict=True)) for values in itertools.product(*axes.values())]
    found, variant = find_one(scenario, {**fixed, **points[0]})  # a key that is fixed may need one that is swept
    name = scenario if scenario.endswith(f"/{variant}") else f"{scenario}/{variant}"
    folder = Path(out or f"results/sweep-{found.name}-{'-'.join(key.replace('.', '_') for key in axes)}")
    plans = [make_plan([name], only=use.labels(estimators), runs=runs, seed=seed, overrides={**fixed, **point},
                       plugins=plugin) for point in points]
    how = machinery(jobs, batch, backend, scheduler, timeout, memory)
    command = use.command()
    summaries: list[pd.DataFrame] = []
    reasons: dict[tuple[str, ...], dict[str, str]] = {}
    shown: list[tuple[str, str]] = []
    for point, plan in zip(points, plans, strict=True):
        label = ",".join(f"{key}={_plain(item)}" for key, item in point.items())
        store = complete(plan, folder / label.replace("/", "_"), how, command, timing=False)
        rows = store.rows()
        summary, designed = verdicts_of(store), _design_seconds(plan)
        summary = pd.concat([summary, designed]) if len(designed) else summary
        for key, item in reversed(point.items()):
            summary.insert(0, key, pd.Series(_plain(item), summary.index, dtype=object))  # 1 beside 2.5 stays 1
        summaries.append(summary)
        reasons[tuple(_plain(item) for item in point.values())] = _reasons(rows)
        shown = [(a, b) for a, b in store.manifest()["scenarios"][found.name]["table"]]
    names = list(dict.fromkeys(estimator for point in reasons.values() for estimator in point))
    table = pd.concat(summaries, ignore_index=True)
    told = Sweep(name, list(axes), _wanted(metric, table) or shown, names, runs, seed,
                 {" | ".join(map(str, point)): why for point, why in reasons.items()}, command)
    Store(folder).write_text(VALUES, csv(table))
    Store(folder).write_text(DESCRIPTION, told.written())
    plots = 0
    for pair in told.shown:
        part = told.part(table, *pair)
        if not part.empty:
            unit = part["shown_unit"].iloc[0]
            print_table(bracket(f"{name}: {' '.join(pair)}", unit), _grid(told, told.measured(part), [], plus_minus),
                        ["± is half of the 95 % interval."], len(axes))
            canvas = told.figure(part)
            if canvas:
                for suffix in ("svg", "png"):
                    canvas.save(folder / f"{'-'.join(pair)}.{suffix}")
                plots += 1
    _requirements(Store(folder), told, table)
    for line in _broken(table, list(axes)):
        print(line)
    print(f"{len(table)} summary lines in {folder / VALUES}" + (f", {plots} plots beside it" if plots else "")
          + f"; railstate report {folder} makes a page of it")


def _design_seconds(plan: Plan) -> pd.DataFrame:
    """Lines of what the plan's own estimators' designs took to solve (of one from the cache when it was fresh)."""
    found: list[dict[str, Any]] = []
    for cell in plan.cells:
        setting = setting_of(cell.table, cell.key)
        start = setting.world(Streams(plan.seed, cell.scenario, cell.variant, (0,))).initial_mean
        for label, entry in cell.entries.items():
            cls = estimator_class(entry.plugin, label) if own(cell, label) else Estimator
            if cls.design is Estimator.design:
                continue
            with suppress(Infeasible, Unsupported):
                estimator, model = prepare(setting, cls, entry.parameters, entry.knowledge, start,
                                           augment=entry.augment)
                seconds = estimator.design(model).get("design_s")
                if seconds is not None:
                    found.append({"scenario": cell.scenario, "variant": cell.variant, "estimator": label,
                                  "kind": "value", "metric": "design", "quantity": "seconds", "unit": "s",
                                  "shown_unit": "s", "factor": 1.0, "value": seconds, "low": seconds, "high": seconds,
                                  "runs": 1})
    return framed(found)


def _broken(table: pd.DataFrame, keys: list[str]) -> Iterator[str]:
    """Where a certified bound or a claimed set is exceeded, and where runs are lost."""
    for line in records(table):
        at = f"at {', '.join(f'{key} = {line[key]}' for key in keys)}: {line['estimator']}: "
        if line["kind"] == "claim" and line["verdict"] == "broken":
            yield at + (f"measured mean square {number(line['value'])} is {ratio(line['ratio'])} times its certified "
                        "bound" if line["metric"] == "bound" else f"its claimed set does not hold: {line['note']}")
        elif line["metric"] == "lost" and line["lost"]:
            yield at + f"{line['lost']} of {line['runs']} runs lost"


def _wanted(metric: str, table: pd.DataFrame) -> list[tuple[str, str]]:
    """The metrics asked for. Raises InputError for one that is not there."""
    known = sorted({f"{a}:{b}" for a, b in zip(table["metric"], table["quantity"], strict=True)})
    for item in use.names_in(metric):
        if item not in known:
            raise InputError(f"--metric {item}: not among the metrics here: {', '.join(known)}")
    return [(a, b) for a, _, b in (item.partition(":") for item in use.names_in(metric))]


def _grid(told: Sweep, arranged: Arranged, ahead: list[str], cell: Callable[[Mapping[str, Any]], str]) -> pd.DataFrame:
    """A line per swept point, a column per estimator: its cell, or why there is none."""
    labels_here = told.told_of(arranged) if ahead else told.estimators
    return pd.DataFrame([
        {**dict(zip([*ahead, *told.keys], point, strict=True)),
         **{label: cell(lines[label]) if label in lines else told.why(point, label) for label in labels_here}}
        for point, lines in arranged])


def _requirements(store: Store, told: Sweep, table: pd.DataFrame) -> None:
    """Print which estimator meets which requirement at which point, and write it: requirements.md with sizes of errors,
    requirements.csv with a line for each of them."""
    arranged = told.requirements(table)
    if not arranged:
        return

    def words(line: Mapping[str, Any]) -> str:
        return f"{MARKS[line['verdict']].sign} {value_words(line)}".strip()

    title = f"{told.name}: which estimator keeps what"
    notes = ["✓ met, ✗ not met, ? undecided; the share of runs or time that keep it, its 95 % interval."]
    print_table(title, _grid(told, arranged, ["requirement"], words),
                [*notes, "A verdict alone may mislead: sizes of errors and widths of claims are in requirements.md."],
                1 + len(told.keys))
    store.write_text("requirements.md", to_markdown(title, _grid(
        told, arranged, ["requirement"], lambda line: f"{words(line)}; {line['note']}"), notes))
    columns = {"estimator": "estimator", "quantity": "requirement", "against": "asked", "verdict": "verdict",
               "value": "share", "low": "low", "high": "high", "runs": "runs", "deciding": "deciding", "note": "sizes"}
    part = table[table["kind"] == "requirement"]
    store.write_text("requirements.csv", csv(part[[*told.keys, *columns]].rename(columns=columns)))


def _axis(text: str) -> tuple[str, list[Any]]:
    key, _, values = text.partition("=")
    if not key or not values:
        raise InputError(f"--over {text}: expected KEY=V1,V2,.., such as channel.trains=1,2,3")
    parsed = use.value(f"[{values}]")
    listed = parsed if isinstance(parsed, list) else [use.value(item) for item in values.split(",")]
    return key, [item for place, item in enumerate(listed) if item not in listed[:place]]


def _plain(item: Any) -> Any:
    return json.dumps(item) if isinstance(item, list | dict) else item


def _reasons(rows: pd.DataFrame) -> dict[str, str]:
    """Estimator -> why it has no number at this point (status and reason), empty where it has one."""
    out: dict[str, str] = {}
    for estimator, part in rows.groupby("estimator", sort=False):
        good = (part["status"] == "ok").any()
        out[str(estimator)] = "" if good else f"{part['status'].iloc[0]}: {part['reason'].iloc[0]}"
    return out
