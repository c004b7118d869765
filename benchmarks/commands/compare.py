"""`railstate compare A B`: two estimators over the same runs, or two results folders ("what changed since")."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import Annotated, NamedTuple

import pandas as pd
import typer

from ...estimators.registry import estimator_class
from ...scenarios.errors import InputError, Unsupported
from ...scenarios.randomness import Streams
from ...scenarios.registry import scenario_files
from ..api import runs as api
from ..isolation.process import IMPORT
from ..judging.comparison import Changes, Comparison, between_folders, speed_ratio
from ..planning.catalogue import Catalogue
from ..planning.naming import find
from ..store.folder import Store
from ..telling.console import print_json, print_table, wrapped
from ..telling.sentences import comparison as words
from ..telling.wording import bracket, change, counted, percent, ratio, rough, value_words
from . import options


def compare(
    a: Annotated[str, typer.Argument(metavar="A", help="An estimator (label or plug-in name), or a results folder.")],
    b: Annotated[str, typer.Argument(metavar="B", help="What is compared with A: of the same kind.")],
    scenario: Annotated[list[str] | None, typer.Option(
        help="Scenario, NAME/VARIANT or TOML file; may be repeated. None: the first variant of those listing both.")
    ] = None,
    runs: options.Runs = 100,
    seed: options.Seed = 1,
    jobs: options.Jobs = 0,
    set_: options.Sets = [],  # noqa: B006
    plugin: options.Plugins = [],  # noqa: B006
    out: Annotated[str, typer.Option(help="Results folder of the runs; a finished one is not computed again.")] = "",
    fail_on: Annotated[str, typer.Option(metavar="worse|different|METRIC:QUANTITY>PERCENT%", help=
        "Exit code 1 where B is significantly worse anywhere; for folders, where any row differs; or where an error of "
        "B is shown to be larger by more than this, such as \"rmse:position>5%\". Several: with a comma.")] = "",
    batch: options.Batch = 0,
    backend: options.Backend = "local",
    scheduler: options.Scheduler = "",
    timeout: options.Timeout = 900.0,
    memory: options.Memory = 0.0,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Compare B with A, paired over the same runs: ratio of errors with its interval, runs won, runs lost, speed."""
    limits = [_limit(text) for text in options.names_in(fail_on)]
    show = not (quiet or json)
    folders = [Path(name, "manifest.json").is_file() for name in (a, b)]
    if any(folders):
        if not all(folders):
            wrong = b if folders[0] else a
            raise InputError(f"{wrong}: not a results folder (no manifest.json), and the other one is: compare two "
                             "folders, or two estimators")
        first, second = Store(a), Store(b)
        changes = between_folders(first, second)
        found, speed = changes.found, speed_ratio(first.timing(), second.timing())
        if show:
            _print_rows(changes, a, b)
        different = not changes.identical
    else:
        if a == b:
            raise InputError(f"{a}: an estimator cannot be compared with itself; name two")
        if DIFFERENT in limits:
            raise InputError("--fail-on different: is for two results folders; two estimators always differ")
        different = False
        results = api.run(scenario or _fitting(a, b, seed, Catalogue(plugin)), [a, b], runs=runs, seed=seed, jobs=jobs,
                          overrides=options.overrides(set_), plugins=plugin, folder=out, keep=0, quiet=not show,
                          batch=batch, backend=backend, scheduler=scheduler, timeout=timeout, memory=memory,
                          command=options.command())
        found, timing = results.comparisons(a, b), results.timing()
        speed = {} if timing is None else speed_ratio(*(timing[timing["estimator"] == name].assign(estimator="")
                                                        for name in (a, b)))
        if not found:
            raise InputError(f"{a} and {b} finished no two runs in common: "
                             + (f"`railstate replay` in {results.folder} shows why" if runs > 1 else
                                "--runs: two at least are needed"))
    if show:
        _print_comparisons(found, a, b, speed)
    failed = [text for limit in limits for text in _failures(limit, found, different, a, b)]
    if json:
        print_json({"a": a, "b": b, "identical": not different if any(folders) else None, "failed": failed,
                    "comparisons": [{"cell": each.cell, "estimator": each.label, "verdict": each.verdict, "a": each.a,
                                     "b": each.b} for each in found],
                    "speed": [{"cell": cell, "estimator": label, "ratio": factor}
                              for (cell, label), factor in speed.items()]})
    for text in failed if show else ():
        wrapped(f"FAILED: {text}")
    if failed:
        raise typer.Exit(1)


class Limit(NamedTuple):
    """What a comparison fails on: `worse`, `different`, or an error (metric, quantity) larger by more than a share."""

    word: str
    metric: str = ""
    quantity: str = ""
    share: float = 0.0


WORSE, DIFFERENT = Limit("worse"), Limit("different")


def _limit(text: str) -> Limit:
    """A word of `--fail-on`. Raises InputError."""
    found = re.fullmatch(r"([a-z-]+):([^>\s]+)\s*>\s*(\d+(?:\.\d+)?)\s*%", text)
    if found:
        return Limit("larger", found[1], found[2], float(found[3]) / 100)
    if text not in ("worse", "different"):
        raise InputError(f"--fail-on {text}: expected worse, different, or METRIC:QUANTITY>PERCENT%, such as "
                         "rmse:position>5%")
    return Limit(text)


def _failures(limit: Limit, found: list[Comparison], different: bool, a: str, b: str) -> list[str]:
    """What of a limit is exceeded. An error is larger by more than a share where the whole interval of its ratio lies
    beyond it, so that chance fails a comparison in 5 % of the cases at most; what is lost is worse. Raises InputError
    where nothing compared has that error."""
    if limit == DIFFERENT:
        return [f"rows of {b} differ from those of {a}"] if different else []
    if limit == WORSE:
        return [words(each, a, b) for each in found if each.verdict == "worse"]
    mine = [each for each in found if (each.b["metric"], each.b["quantity"]) == (limit.metric, limit.quantity)]
    known = sorted({f"{each.b['metric']}:{each.b['quantity']}" for each in found if not each.lost})
    if known and not mine:
        raise InputError(f"--fail-on {limit.metric}:{limit.quantity}: not among what is compared: {', '.join(known)}")
    lost = [each for each in found if each.lost and each.verdict == "worse"]
    return [words(each, a, b) for each in [*mine, *lost] if each.lost or each.b["ratio_low"] > 1 + limit.share]


def _fitting(a: str, b: str, seed: int, catalogue: Catalogue) -> list[str]:
    """NAME/VARIANT of the built-in scenarios whose first variant lists both; else of the shortest that both can work
    with. Raises InputError."""
    listed, possible = [], []
    for name in scenario_files():
        scenario = find(name)[0]
        setting = scenario.setting(scenario.default)
        entries = setting.config.estimators
        if getattr(setting, "needs_file", ""):
            continue
        if a in entries and b in entries:
            listed.append(f"{name}/{scenario.default}")
        elif all(label in entries or label in catalogue.names() for label in (a, b)):
            plugins = [entries[label].plugin if label in entries else label for label in (a, b)]
            possible.append((setting.config.time.steps, f"{name}/{scenario.default}", plugins))
    for _, name, plugins in [] if listed else sorted(possible):
        if all(_works(name, plugin, seed, catalogue) for plugin in plugins):
            return [name]
    if not listed:
        raise InputError(f"no built-in scenario knows both {a} and {b}; name one with --scenario. Installed "
                         f"estimators: {', '.join(catalogue.names())}")
    return listed


def _works(name: str, plugin: str, seed: int, catalogue: Catalogue) -> bool:
    """Whether an estimator can work with a scenario, and would estimate the parameter that it is about."""
    if catalogue.own(plugin):
        return _works_here(name, plugin, seed)
    with catalogue.process(plugin, IMPORT) as process:
        return process.call(_works_here, name, plugin, seed) is True


def _works_here(name: str, plugin: str, seed: int) -> bool:
    scenario, variants = find(name)
    setting, cls = scenario.setting(variants[0]), estimator_class(plugin, name)
    model = setting.design_model({}, setting.world(Streams(seed, name, "", (0,))).initial_mean)
    try:
        cls.require(model)
    except Unsupported:
        return False
    return model.modes is None or "modes" in cls.needs


def _print_rows(changes: Changes, a: str, b: str) -> None:
    for note in changes.notes:
        print(note)
    print_table(f"rows of {a} and {b}", pd.DataFrame([
        {"cell": item.cell, "estimator": item.label, "in both": item.common, "bit-identical": item.identical,
         "differ": item.common - item.identical, "only in A": item.only_a, "only in B": item.only_b}
        for item in changes.alike]))
    common, same = sum(item.common for item in changes.alike), sum(item.identical for item in changes.alike)
    only = [sum(getattr(item, side) for item in changes.alike) for side in ("only_a", "only_b")]
    print(f"{same} of {counted(common, 'common row')} bit-identical"
          + (f"; {only[0]} only in {a}, {only[1]} only in {b}" if any(only) else ""))


def _print_comparisons(found: list[Comparison], a: str, b: str, speed: dict[tuple[str, str], float]) -> None:
    if found:
        print_table(f"{b} (B) against {a} (A), paired", pd.DataFrame([_line(each) for each in found]),
                    ["A, B: ± is half of the 95 % interval. B / A: ratio over the same runs, a lost run counted as the "
                     "largest error of either, with its 95 % interval; the verdict follows it."])
    for each in found:
        wrapped(words(each, a, b))
    for (cell, label), factor in speed.items():
        if any(each.cell == cell and each.label == label for each in found):
            times = f"{rough(max(factor, 1 / factor))} times {'slower' if factor > 1 else 'faster'} than"
            if 0.95 < factor < 1.05:
                times = "as fast as"
            print(f"{cell}{'/' + label if label else ''}: {b} is {times} {a} (time per run and step)")
    if found:
        number_of = Counter(each.verdict for each in found)
        counts = [f"{word} in {number_of[word]}" for word in ("better", "worse", "tie", "undecided")]
        print(f"{b} against {a}: {', '.join(counts)} of {counted(len(found), 'comparison')}")


def _line(each: Comparison) -> dict[str, str]:
    line = each.b
    out = {"cell": each.cell, **({"estimator": each.label} if each.label else {})}
    if each.lost:
        shares = [percent(side["value"]) for side in (each.a, line)]
        return {**out, "what": "runs lost", "A": shares[0], "B": shares[1], "B / A": "", "95 % interval": "",
                "change": "", "B lower in": "", "runs": str(line["runs"]), "B is": each.verdict}
    return {**out, "what": bracket(f"{line['metric']} {line['quantity']}", line["shown_unit"]),
            "A": value_words(each.a), "B": value_words(line), "B / A": ratio(line["ratio"]),
            "95 % interval": f"{ratio(line['ratio_low'])} .. {ratio(line['ratio_high'])}", "change": change(line),
            "B lower in": percent(line["won"]), "runs": str(line["runs"]), "B is": each.verdict}
