"""Tables, figures and page of results that are poor: everything lost, one run, one estimator, few columns, and numbers
that are very small or large; beside committed text."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from railstate.benchmarks.store.folder import Store
from railstate.benchmarks.telling.figures.catalogue import drawn
from railstate.benchmarks.telling.figures.data import load_results
from railstate.benchmarks.telling.report.page import render
from railstate.benchmarks.telling.results import print_results

from ..expected import figure, page
from ..synthetic_results import write_results
from .test_expected import MACHINE


def lost(rows: pd.DataFrame, numbers: list[str]) -> pd.DataFrame:
    return rows.assign(status="failed", reason="no <run> ended", **dict.fromkeys(numbers, np.nan))


def poor(number: int, rows: pd.DataFrame) -> pd.DataFrame:
    """The rows of one variant after the other."""
    numbers = [name for name in rows.columns if ":" in name]
    first = rows["estimator"].iloc[0]
    return [lambda: lost(rows, numbers), lambda: rows[rows["run"] == 7],
            lambda: rows[rows["estimator"] == "robust-ellipsoid"],
            lambda: rows.drop(columns=[name for name in numbers if "rmse:position" not in name]),
            lambda: rows.assign(**{name: 1e-9 * rows[name] for name in numbers}),
            lambda: pd.concat([lost(rows[rows["estimator"] == first], numbers), rows[rows["estimator"] != first].assign(
                **{name: 1e9 * rows[name] for name in numbers})])][number]()


def test_poor_results(tmp_path: Path, expected: Callable[[str, str], None], capsys: pytest.CaptureFixture[str],
                      monkeypatch: pytest.MonkeyPatch) -> None:
    folder = write_results(tmp_path / "poor")
    for number, path in enumerate(sorted((folder / "rows").glob("*.parquet"))):
        poor(number, pd.read_parquet(path)).to_parquet(path, index=False)
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.chdir(tmp_path)
    print_results(Store("poor"))
    out = [capsys.readouterr().out]
    found = load_results(folder)
    for one, scenario, variant, canvas in drawn(found):
        text = figure(canvas.svg())
        out.append(f"{one.name} {scenario}/{variant} {text.count(chr(10))} {sha256(text.encode()).hexdigest()[:12]}")
    made = page(render(replace(found, folder=Path("DIR"), manifest={**found.manifest, **MACHINE})))
    out.append(re.sub(r"<[^>]*>", " ", made.partition("<main>")[2].partition('id="provenance"')[0]))
    text = re.sub(r"(?m)^(text|path|circle|g|use|rect|svg|line) .*\n", "", "\n".join(out))
    expected("poor", re.sub(r"[ \t]+", " ", text))
