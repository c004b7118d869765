"""Every published number under every reading beside rows made by hand: value, error, range and verdict, tables and
document, whole (to renew it: `tests/expected.py`)."""

from __future__ import annotations

import json
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from railstate.benchmarks.published import reproduce, tables
from railstate.benchmarks.published.computed import zou2018
from railstate.benchmarks.published.files import papers
from railstate.benchmarks.telling.console import print_table
from railstate.benchmarks.telling.markup import to_latex, to_markdown

from .test_reproduce import Asked


def test_every_number_under_every_reading(expected: Callable[[str, str], None], capsys: pytest.CaptureFixture[str],
                                          monkeypatch: pytest.MonkeyPatch) -> None:
    """What solves convex problems for seconds is replaced."""
    monkeypatch.setenv("COLUMNS", "120")
    gains = np.random.default_rng(3).normal(size=(12, 12))
    monkeypatch.setattr(reproduce, "Book", lambda rows: Asked())
    monkeypatch.setattr(zou2018, "_certificates", lambda forces: (
        SimpleNamespace(bound=0.5 + len(forces), K=gains), SimpleNamespace(bound=9.0, K=gains)))
    monkeypatch.setattr(zou2018, "corollary2", lambda system, varpi: SimpleNamespace(gamma_bar=0.97))
    done = reproduce.reproduce(papers(), pd.DataFrame())
    out = list[str]()
    for one in done:
        for line in one.lines:
            out.append(" | ".join(map(str, (one.paper.name, line.group, line.cell, line.published, line.unit,
                                            line.printed, line.expected, line.unexpected))))
            out += [f"  {name}: {' '.join(f'{number:.8e}' for number in judged[:4])} {judged.verdict}"
                    for name, judged in line.entries.items()]
        for title, part, notes in list(tables.printed(one))[::3]:
            print_table(title, part, notes)
            if one is done[-1]:
                out += [to_markdown(title, part, notes), to_latex(title, part, notes)]
    print_table("Cells by verdict", tables.counts(done))
    plan = reproduce.plan_for(papers(), 3, 1)
    out += [f"{cell.key} {' '.join(cell.entries)}" for cell in plan.cells]
    some = [one for one in done if one.paper.name in ("faruqi2019", "liu2025")]
    document = json.dumps(tables.document(some[:1], 3, 1), indent=0, ensure_ascii=False)
    expected("published", "\n".join([*out, document, tables.table(some).to_csv(float_format="%.8e"),
                                     capsys.readouterr().out]))
