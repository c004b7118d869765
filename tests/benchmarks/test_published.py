"""Published numbers beside rows that are drawn by their names: what is found, accepted and said of every cell, whole.

How a number follows from rows, and how it is judged: `test_reproduce`."""

from __future__ import annotations

import zlib
from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest
from railstate.benchmarks.published import reproduce
from railstate.benchmarks.published.files import papers
from railstate.benchmarks.published.rows import Book
from railstate.benchmarks.published.tables import counts, printed, table


class Drawn(Book):
    """Four hundred runs about 9, the last one lost, whatever is asked for."""

    def values(self, scenario: str, variant: str, estimator: str, metric: str, quantity: str) -> np.ndarray:
        seed = zlib.crc32(" ".join((scenario, variant, estimator, metric, quantity)).encode())
        return np.append(np.random.default_rng(seed).gamma(9.0, 1.0, 399), np.nan)


def test_every_cell_beside_drawn_rows(expected: Callable[[str, str], None], monkeypatch: pytest.MonkeyPatch) -> None:
    """What solvers of convex problems give, to three digits."""
    monkeypatch.setattr(reproduce, "Book", Drawn)
    done = reproduce.reproduce(papers(), pd.DataFrame())
    out = [counts(done).to_string()]
    for line in table(done).itertuples():
        digits = 2 if line.paper == "zou2018" else 7
        numbers = " ".join(f"{number:.{digits}e}" for number in (line.ours, line.standard_error, line.low, line.high))
        out.append(f"{line.paper} {line.cell} {line.reading} {line.stands} {numbers} {line.verdict}")
    for one in (done[0], done[3]):
        for title, frame, notes in printed(one):
            out += [title, frame.to_string(), *notes]
    expected("published", "\n".join(out))
