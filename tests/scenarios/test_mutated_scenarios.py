"""Scenario files with mistakes drawn by seeds: one message or a run, no traceback; what `show` accepts `run` accepts.

Mistakes are made in the table (keys gone, odd, of another type) and in the text (lines gone, twice, letters changed).
"""

from __future__ import annotations

import copy
import json
import math
import random
import resource
import tomllib
import traceback
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from railstate.scenarios.registry import scenario_files

from ..conftest import SCENARIO, Command
from ..recordings import METRO, metro, tram

CHEAP = ("ekf", "kalman", "dead-reckoning", "ukf", "direct", "imm", "random-access", "fixed-gain", "particle", "gate",
         "fixed-lag", "truth", "ekf-naive", "kalman-exact", "fixed-interval", "rts", "interval", "huber")
TRAM = {"time": "t_s", "position": "s_gnss_m", "speed": "v_kmh", "odometer": "odo_m"}
WHEELS = {role: column for role, column in METRO.items() if role != "balise"}
ODD: tuple[Any, ...] = (-1, 0, 1, 2, 3, 0.5, -0.5, 1e-300, 1e300, 10**30, math.nan, math.inf, -math.inf, True, False,
                        "", "odd", "kind", "../../x", "x\n\x1b[31m", "é" * 200, [], {}, [[]], [0.0], [1, 2, 3],
                        [[1, 2], [3]], {"a": 1}, {"kind": "odd"}, [{"kind": "odd"}], ["a"])
TEXTS = ("2020-01-01", "[" * 3000, "0x", "'", "[[plant]]", "= 3", "\x00", "a.b.c = 1", "[plant]", "1e400", "\ufeff",
         '"""', "{a = 1}", "kind = 'odd'", "base = 'odd'", "base = 'ningbo-metro/white'", "[variants.x]", "\\")


def toml(value: Any) -> str:
    """A value as TOML writes it."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(key)} = {toml(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list):
        return f"[{', '.join(map(toml, value))}]"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return json.dumps(value, ensure_ascii=False) if isinstance(value, bool | str | int | float) else str(value)


def written(table: dict[str, Any]) -> str:
    return "".join(f"{json.dumps(key)} = {toml(item)}\n" for key, item in table.items())


def tables() -> dict[str, dict[str, Any]]:
    """Small scenarios of every kind: the built-in ones with few steps, variants and cheap estimators."""
    found = {"cart": tomllib.loads(SCENARIO.replace('plugin = "half"', 'plugin = "kalman"')),
             "over": tomllib.loads('name = "over"\nbase = "cart.toml"\n[channel]\np = 0.5\n[variants.calm.plant]\n'
                                   'R = [[2.0]]\n[estimators.ekf]\nplugin = "ekf"\n')}
    for name, path in scenario_files().items():
        table = tomllib.loads(path.read_text())
        few = name in ("odometry", "ningbo-metro", "recorded-odometry")
        entries = [key for key, entry in table["estimators"].items() if entry["plugin"] in CHEAP][:1 if few else 3]
        variants = list(table.pop("variants", {}).items())
        for part in (table, *(changes for _, changes in variants)):
            if "estimators" in part:
                part["estimators"] = {key: part["estimators"][key] for key in entries if key in part["estimators"]}
            part.pop("origin", None)
            part.pop("fitted", None)
        if variants:
            table["variants"] = dict(variants[:1] if few else [variants[0], variants[-1]])
        table["time"]["steps"] = 400 if "recorded" in name else min(table["time"]["steps"], 60)
        if "recorded" in name:
            table["plant"] |= {"recording": f"{name}.csv", "map": WHEELS if "odometry" in name else TRAM}
        found[name] = table
    return found


def _spots(found: Any, numbers: bool = False) -> list[tuple[Any, Any]]:
    """(container, key) of all that is in nested data; of numbers alone."""
    keys = list(found) if isinstance(found, dict) else list(range(len(found)))
    own = [(found, key) for key in keys if not numbers or type(found[key]) in (int, float)]
    return own + [spot for key in keys if isinstance(found[key], dict | list) for spot in _spots(found[key], numbers)]


def mutated(rng: random.Random, table: dict[str, Any]) -> str:
    """The text of the scenario with one to three mistakes."""
    table = copy.deepcopy(table)
    for _ in range(rng.choice([1, 1, 1, 2, 3])):
        where, key = rng.choice(_spots(table))
        value, action = where[key], rng.randrange(7)
        if rng.random() < 0.6:
            where, key = rng.choice(_spots(table, numbers=True))
            where[key] = rng.choice([-1, 0, 0.001, 0.5, 0.9, 1.01, 1.5, 2, 10, 1e6]) * where[key]
            if isinstance(where[key], float) and rng.random() < 0.5 and abs(where[key]) < 1e5:
                where[key] = round(where[key])
            continue
        if action == 0:
            del where[key]
        elif action == 1 and isinstance(where, dict):
            where[rng.choice(["odd", "", "a b", "kind", "x\n", str(key) + "s"])] = where.pop(key)
        elif action == 2:
            where[key] = rng.choice([str(value), [value], {"a": value}])
        elif action == 3 and isinstance(value, list) and value:
            where[key] = rng.choice([value[:-1], value + value[-1:], value[0], [value], value[::-1]])
        elif action == 4 and isinstance(where, list):
            where.insert(rng.randrange(len(where) + 1), rng.choice(ODD))
        else:
            where[key] = copy.deepcopy(rng.choice(ODD))
    text = written(table)
    if rng.random() < 0.15:
        lines = text.splitlines()
        place, action = rng.randrange(len(lines)), rng.randrange(5)
        if action == 0:
            lines.append(lines[place])
        elif action == 1:
            lines.insert(place, rng.choice(TEXTS))
        elif action == 2:
            at = rng.randrange(len(lines[place]) + 1)
            lines[place] = lines[place][:at] + rng.choice([*TEXTS, "", " ", "9", "-", "]", '"']) + lines[place][at + 1:]
        elif action == 3:
            lines = lines[:place]
        else:
            key = lines[place].partition("=")[0]
            lines[place] = f"{key}= {rng.choice(TEXTS)}"
        text = "\n".join(lines) + "\n"
    return text


def told(railstate: Command, *words: Any) -> tuple[int, str]:
    """Exit code and what was said on standard error, with a traceback where one got out."""
    try:
        done = railstate(*words)
        return done.code, done.err
    except Exception:
        return -1, traceback.format_exc()


@pytest.mark.parametrize("number", [8, pytest.param(1000, marks=pytest.mark.long)])
def test_mutated_files_end_in_one_message_or_run(railstate: Command, number: int) -> None:
    sound = tables()
    tram().to_csv("recorded.csv", index=False)
    metro().to_csv("recorded-odometry.csv", index=False)
    Path("cart.toml").write_text(SCENARIO.replace('plugin = "half"', 'plugin = "kalman"'))
    limits = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (12 << 30, limits[1]))
    wrong: list[str] = []
    ended: Counter[str] = Counter()
    try:
        for seed in range(number):
            rng = random.Random(seed)
            name = rng.choice(list(sound))
            Path("file.toml").write_text(mutated(rng, sound[name]), encoding="utf-8")
            shown, err = told(railstate, "show", "file.toml")
            if shown not in (0, 2) or "Traceback" in err or (shown == 2 and not 0 < len(err) < 20_000):
                wrong.append(f"seed {seed}, {name}: show {shown}: {err[-1500:]}")
            ran, err = told(railstate, "run", "file.toml", "--runs", 1, "--jobs", 1, "--out", f"out{seed}", "--quiet")
            ended[f"show {shown}, run {ran}"] += 1
            loose = "there is no estimator" in err  # who may come with --plugin
            if ran not in (0, 2) or "Traceback" in err or (shown == 0 and ran != 0 and not loose):
                wrong.append(f"seed {seed}, {name}: show {shown}, run {ran}: {err[-1500:]}")
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, limits)
    assert not wrong, "\n\n".join(wrong)
    if number >= 100:
        assert ended["show 0, run 0"] > 0.2 * number and ended["show 2, run 2"] > 0.1 * number
