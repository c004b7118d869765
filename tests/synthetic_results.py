"""A results folder made of random numbers with known properties, for tests of figures, report and verdicts.

Three settings in miniature: covariances and sets on a metro train, bounds over a lossy channel, many filters of a
braking parameter. Written through the real store, so that its readers are tested as well."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from railstate.benchmarks.store.folder import Store

RUNS, STEPS, PERIOD = 24, 60, 0.2

METRO = {  # label: (plugin, error factor of position and speed, NEES factor, set?)
    "ekf": ("ekf", 1.0, 1.0, False), "ekf-naive": ("ekf", 4.0, 9.0, False), "ekf-inflated": ("ekf", 1.15, 0.4, False),
    "ukf": ("ukf", 1.0005, 1.0, False), "robust-mean-square": ("robust-mean-square", 1.3, 0.0, False),
    "robust-ellipsoid": ("robust-ellipsoid", 2.5, 0.0, True),
}
CBTC = {"direct": ("direct", 5.0), "kalman": ("kalman", 1.0), "ultimate-bound": ("ultimate-bound", 1.4),
        "fastest-decay": ("fastest-decay", 1.6)}
BRAKING = ("rbpf-static", "rbpf", "rbpf-bootstrap", "sma", "sma-heaviest", "gsma", "gsma-heaviest", "gsma-memoryless",
           "imm-uniform", "imm-third", "imm-sticky", "augmented-kalman", "kalman-known-f")


def write_results(folder: Path, *, keep: bool = True, seed: int = 5) -> Path:
    """Write the folder and return it."""
    rng = np.random.default_rng(seed)
    plans: list[tuple[str, str, str, dict[str, tuple[Any, ...]], dict[str, str]]] = []
    for variant in ("switching", "white", "constant"):
        plans.append(("ningbo-metro", variant, "metro", METRO, {"position": "m", "speed": "m/s"}))
    for variant in ("uniform", "table3"):
        plans.append(("cbtc-csma", variant, "coupled-cars", CBTC, {"position": "m", "speed": "m/s", "weighted": "1"}))
    plans.append(("braking-rate", "paper", "braking", {label: (label, 1 + 0.2 * n) for n, label in enumerate(BRAKING)},
                  {"f": "1", "displacement": "m", "speed": "m/s"}))
    store = Store(folder)
    store.open(_configuration(plans), _description(plans), "railstate run --runs 24 --seed 5")
    timing = []
    for number, (scenario, variant, kind, estimators, units) in enumerate(plans):
        tables: list[dict[str, pa.Table]] = []
        base = {name: rng.gamma(40, 1 / 40, RUNS) for name in units}
        for label, facts in estimators.items():
            tables.append(_estimator(rng, scenario, variant, kind, label, facts, units, base, keep))
            timing.append({"scenario": scenario, "variant": variant, "estimator": label, "design_s": 0.001 * len(label),
                           "latency_us_median": 10.0 + 7 * len(label), "latency_us_p99": 30.0 + 9 * len(label),
                           "samples": 1000, "throughput_ns": 400.0 + len(label),
                           "sampling_period_s": PERIOD})
        if keep:
            tables.append({"kept": _extras(rng, scenario, variant, kind)})
        joined = {name: pa.concat_tables([t[name] for t in tables if name in t], promote_options="default")
                  for name in ("rows", "curves", "kept") if any(name in t for t in tables)}
        store.write_part(f"part-{number}", rows=joined["rows"], curves=joined["curves"],
                         trajectories=joined.get("kept"))
    store.write_text("timing.csv", pd.DataFrame(timing).to_csv(index=False))
    store.finish(rows=len(store.rows()), statuses={})
    return folder


def _configuration(plans: list[Any]) -> dict[str, Any]:
    return {"runs": RUNS, "seed": 5, "keep": 1, "cells": {
        f"{scenario}/{variant}": {"runs": RUNS, "scenario": "0" * 16, "setting": "", "scoring": "", "estimators": {
            label: {"plugin": facts[0], "parameters": {}, "knowledge": {}, "source": ""}
            for label, facts in estimators.items()}}
        for scenario, variant, _, estimators, _ in plans}}


def _description(plans: list[Any]) -> dict[str, Any]:
    scenarios: dict[str, Any] = {}
    for scenario, variant, kind, _, units in plans:
        about = scenarios.setdefault(scenario, {
            "title": f"A miniature of {scenario}", "source": "random numbers", "kind": kind, "period": PERIOD,
            "scored": "update", "shown": {"displacement": ["cm", 100.0]}, "quantities": list(units),
            "table": [["mae" if kind == "braking" else "rmse", name] for name in units]
            + [["nees", "state"], ["coverage", "ellipsoid"], ["headway", "headway-65"], ["violations", "late"]],
            "variants": {}})
        about["variants"][variant] = {"notes": [f"Note on {variant} & <its> numbers."], "fitted": ["plant.mass"],
                                      "title": variant, "period": PERIOD}
    plugins = {facts[0]: facts for _, _, _, estimators, _ in plans for facts in estimators.values()}
    return {"scenarios": scenarios,
            "estimators": {name: {"summary": name, "source": "", "claims": [], "oracle": name == "kalman-known-f"}
                           for name in plugins},
            "replay": {"plugins": [], "cells": {f"{scenario}/{variant}": {
                "where": scenario, "table": {}, "entries": {label: {"plugin": facts[0]}
                                                            for label, facts in estimators.items()}}
                for scenario, variant, _, estimators, _ in plans}}}


def _estimator(rng: np.random.Generator, scenario: str, variant: str, kind: str, label: str, facts: tuple[Any, ...],
               units: dict[str, str], base: dict[str, np.ndarray], keep: bool) -> dict[str, pa.Table]:
    factor = 0.8 if variant == "constant" and label == "robust-mean-square" else facts[1]
    status = ["ok"] * RUNS
    if label == "direct":
        status[3] = "diverged"
    if label == "fastest-decay" and variant == "table3":
        status = ["infeasible"] * RUNS
    bad = np.array([word != "ok" for word in status])
    key = {"scenario": scenario, "variant": variant, "estimator": label}
    rows: dict[str, Any] = {
        **{name: [value] * RUNS for name, value in key.items()}, "run": np.arange(RUNS, dtype=np.int32),
        "status": status, "reason": ["theta = 0.98: <no certificate>" if b else "" for b in bad],
        "exception": [""] * RUNS, "seconds": np.full(RUNS, 1e-4), "steps": np.full(RUNS, STEPS, dtype=np.int32),
        "nees_states": np.zeros(RUNS, dtype=np.int32)}
    noise = 1.0 if label in ("ekf", "ukf") else rng.lognormal(0, 0.03, RUNS)

    def column(name: str, values: np.ndarray) -> None:
        rows[name] = np.where(bad, np.nan, values)

    curves = []
    time = PERIOD * np.arange(STEPS)
    for name, unit in units.items():
        error = base[name] * factor * noise * (0.1 if kind == "metro" else 1.0)
        for metric, scale in (("rmse", 1.0), ("mae", 0.8), ("max", 3.0), ("final", 0.5)):
            column(f"{metric}:{name}:{unit}", scale * error)
        mean = float((error**2).mean()) * (1 + 0.5 * np.sin(time))
        curves.append({**key, "step": np.arange(STEPS), "time": time, "quantity": name, "active": float(RUNS),
                       "squared": mean * RUNS, "fourth": 3 * mean**2 * RUNS,
                       "error": 0.3 * RUNS * np.sqrt(mean)})
    if kind == "metro" and facts[2]:
        column("nees:state:1", facts[2] * rng.chisquare(2 * STEPS, RUNS) / STEPS)
        rows["nees_states"] = np.full(RUNS, 2, dtype=np.int32)
        curves.append({**key, "step": np.arange(STEPS), "time": time, "quantity": "nees", "active": float(RUNS),
                       "squared": facts[2] * rng.chisquare(2 * RUNS, STEPS), "fourth": 0.0, "error": 0.0})
    if kind == "metro" and facts[3]:
        column("coverage:ellipsoid:1", np.where(np.arange(RUNS) == 2, 0.98, 1.0))
        for name, unit in units.items():
            column(f"half-width:{name}:{unit}", 0.6 + 0.01 * base[name])
    if kind == "coupled-cars":
        if label in ("ultimate-bound", "fastest-decay"):
            column("bound:performance:1", np.full(RUNS, 0.6))
            column("mean-square:performance:1", (0.02 if label == "ultimate-bound" else 0.9) * base["weighted"])
        for speed in (65, 97):
            column(f"headway:headway-{speed}:s", 20 + factor * base["position"])
        column("violations:late:1", (np.arange(RUNS) % 4 == 0).astype(float))
    out = {"rows": pa.table(rows),
           "curves": pa.Table.from_pandas(pd.concat([pd.DataFrame(c) for c in curves]), preserve_index=False)}
    if keep and not bad[0]:
        out["kept"] = _kept(rng, key, kind, units, factor)
    return out


def _frame(key: dict[str, str], name: str, truth: Any, estimate: Any, sd: Any = np.nan) -> pd.DataFrame:
    steps = np.arange(STEPS)
    return pd.DataFrame({**key, "run": np.int32(0), "step": steps, "time": PERIOD * steps, "name": name,
                         "truth": truth, "estimate": estimate, "sd": sd})


def _kept(rng: np.random.Generator, key: dict[str, str], kind: str, units: dict[str, str], factor: float) -> pa.Table:
    frames = []
    for name in units:
        truth = np.linspace(1, 0.2, STEPS) if name == "f" else np.linspace(0, 100, STEPS)
        frames.append(_frame(key, name, truth, truth + factor * rng.normal(0, 0.1, STEPS), 0.1))
    if kind == "braking" and "sma" in key["estimator"]:
        frames.append(_frame(key, "diversity", np.nan, rng.integers(2, 11, STEPS).astype(float)))
    return pa.Table.from_pandas(pd.concat(frames), preserve_index=False)


def _extras(rng: np.random.Generator, scenario: str, variant: str, kind: str) -> pa.Table:
    key = {"scenario": scenario, "variant": variant, "estimator": ""}
    extras: dict[str, np.ndarray] = {}
    if kind == "metro":
        extras = {"disturbance": 0.15 * np.sign(np.sin(np.arange(STEPS) / 5)), "reference-speed": np.full(STEPS, 21.0),
                  "gradient": np.repeat([-0.002, 0.005, 0.003], STEPS // 3)}
    if kind == "coupled-cars":
        extras = {"received": (rng.uniform(size=STEPS) < 0.3).astype(float)}
    if kind == "braking":
        extras = {"f": np.linspace(1, 0.2, STEPS)}
    return pa.Table.from_pandas(pd.concat([_frame(key, name, v, np.nan) for name, v in extras.items()]),
                                preserve_index=False)
