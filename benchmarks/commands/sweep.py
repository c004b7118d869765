"""`railstate sweep`: one scenario over a list of values of one key (or a grid of several): rows, a table, plots."""

from __future__ import annotations

import itertools
import json
import os
import shlex
import sys
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
import typer

from ...scenarios.errors import InputError
from ..batch import as_csv, complete
from ..console import print_table
from ..plan import Plan, find, make_plan
from ..runner import Machinery
from ..store import Store
from ..summary import summarise
from .options import Estimators, Jobs, Plugins, Runs, Seed, Sets, overrides, value, words


def sweep(
    scenario: Annotated[str, typer.Argument(help="Built-in name, NAME/VARIANT, or a TOML file.")],
    over: Annotated[list[str], typer.Option(metavar="KEY=V1,V2,..", help="Key and values; twice for a grid.")],
    estimators: Estimators = "",
    runs: Runs = 100,
    seed: Seed = 1,
    jobs: Jobs = 0,
    metric: Annotated[str, typer.Option(help="METRIC:QUANTITY,.. to print and plot; none: the scenario's table.")] = "",
    out: Annotated[str, typer.Option(help="Folder for rows, sweep.csv and plots.")] = "",
    set_: Sets = [],  # noqa: B006
    plugin: Plugins = [],  # noqa: B006
) -> None:
    """Run a scenario (its default variant unless one is named) at each value of a key."""
    axes = [_axis(text) for text in over]
    found, variants = find(scenario, overrides(set_))
    name = scenario if len(variants) == 1 else f"{scenario}/{variants[0]}"
    points: list[tuple[dict[str, Any], Plan]] = []
    for values in itertools.product(*(options for _, options in axes)):
        point = dict(zip((key for key, _ in axes), values, strict=True))
        plan = make_plan([name], only=words(estimators), runs=runs, seed=seed, overrides={**overrides(set_), **point},
                         plugins=plugin)
        points.append((point, plan))
    folder = Path(out or f"results/sweep-{found.name}-{'-'.join(key.replace('.', '_') for key, _ in axes)}")
    command = shlex.join(["railstate", *sys.argv[1:]])
    frames, failures = [], []
    for point, plan in points:
        label = ",".join(f"{key}={_plain(item)}" for key, item in point.items())
        store = complete(plan, folder / label.replace("/", "_"), Machinery(jobs or os.cpu_count() or 1), command,
                         timing=False)
        rows = store.rows()
        summary = summarise(rows)
        for key, item in reversed(point.items()):
            summary.insert(0, key, _plain(item))
        frames.append(summary)
        failures += _failures(rows, label)
        shown = [tuple(pair) for pair in store.manifest()["scenarios"][found.name]["table"]]
    table = pd.concat(frames, ignore_index=True)
    Store(folder).write_text("sweep.csv", as_csv(table))
    wanted = [tuple(item.split(":", 1)) for item in words(metric)] or shown
    keys = [key for key, _ in axes]
    plots = 0
    for pair in wanted:
        part = table[(table["metric"] == pair[0]) & (table["quantity"] == pair[1])] if len(pair) == 2 else table[:0]
        if part.empty:
            if metric:
                known = sorted({f"{a}:{b}" for a, b in zip(table["metric"], table["quantity"], strict=True)})
                raise InputError(f"--metric {':'.join(pair)}: not among the metrics here: {', '.join(known)}")
            continue
        unit = part["unit"].iloc[0]
        cells = part.assign(cell=[f"{m:.4g} ±{s:.2g}" for m, s in zip(part["mean"], part["standard_error"], strict=True)])
        wide = cells.pivot_table(index=keys, columns="estimator", values="cell", aggfunc="first", sort=False)
        wide = wide.reindex(columns=list(dict.fromkeys(table["estimator"]))).reset_index()
        for point, estimator, reason in failures:
            here = wide[keys].astype(str).agg(",".join, axis=1) == ",".join(p.split("=", 1)[1] for p in point.split(","))
            wide[estimator] = wide.get(estimator, pd.Series("", index=wide.index)).astype(object)
            wide.loc[here & wide[estimator].isna(), estimator] = reason
        print_table(f"{name}: {' '.join(pair)} [{unit}]", wide.fillna(""))
        plots += _plot(folder, part, keys[0], f"{pair[0]} {pair[1]}", unit) if len(keys) == 1 else 0
    for point, estimator, reason in failures:
        print(f"{point}: {estimator}: {reason}")
    print(f"{sum(len(f) for f in frames)} summary lines in {folder / 'sweep.csv'}"
          + (f", {plots} plots beside it" if plots else ""))


def _axis(text: str) -> tuple[str, list[Any]]:
    key, equals, values = text.partition("=")
    if not equals or not values:
        raise InputError(f"--over {text}: expected KEY=V1,V2,.., such as channel.trains=1,2,3")
    parsed = value(f"[{values}]")
    return key, parsed if isinstance(parsed, list) else [value(item) for item in values.split(",")]


def _plain(item: Any) -> Any:
    return json.dumps(item) if isinstance(item, list | dict) else item


def _failures(rows: pd.DataFrame, label: str) -> list[tuple[str, str, str]]:
    """(point, estimator, `status: reason`) of estimators without a single good run at this point."""
    out = []
    for estimator, part in rows.groupby("estimator", sort=False):
        if not (part["status"] == "ok").any():
            out.append((label, str(estimator), f"{part['status'].iloc[0]}: {part['reason'].iloc[0]}"))
    return out


def _plot(folder: Path, part: pd.DataFrame, key: str, label: str, unit: str) -> int:
    """Each estimator's mean with its 95 % interval against the swept value."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(5, 3.2), layout="constrained")
    numeric = pd.to_numeric(part[key], errors="coerce").notna().all()
    for estimator, mine in part.groupby("estimator", sort=False):
        x = pd.to_numeric(mine[key]) if numeric else mine[key].astype(str)
        line, = axes.plot(x, mine["mean"], marker="o", markersize=3, label=estimator)
        low, high = (mine["mean"] + sign * 1.96 * mine["standard_error"] for sign in (-1, 1))
        axes.fill_between(x, low, high, color=line.get_color(), alpha=0.2, linewidth=0)
    if part["mean"].min() > 0 and part["mean"].max() / part["mean"].min() > 30:
        axes.set_yscale("log")
    axes.set_xlabel(key)
    axes.set_ylabel(label + ("" if unit == "1" else f" [{unit}]"))
    axes.grid(alpha=0.3)
    axes.legend(fontsize=7, frameon=False)
    for suffix in ("svg", "png"):
        figure.savefig(folder / f"{label.replace(' ', '-')}.{suffix}", dpi=150)
    pyplot.close(figure)
    return 1
