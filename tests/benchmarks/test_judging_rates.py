"""How often the rules err: simulated studies with a fixed seed, held against their levels with their Monte Carlo error.

Long: some minutes each; `--long` draws them."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest
from railstate.benchmarks.judging import statistics as st
from railstate.benchmarks.judging.family import Draws, Family, compare_all, eligible
from railstate.benchmarks.judging.table import verdicts
from railstate.benchmarks.store.folder import Store

from ..conftest import Command
from .test_judging import manifest

STUDIES = 2000
Sample = Callable[[np.random.Generator, int, int], np.ndarray]


def chi50(rng: np.random.Generator, k: int, n: int) -> np.ndarray:
    """Mean squares of 50 degrees of freedom, most of them shared by all."""
    return (rng.chisquare(40, n) + rng.chisquare(10, (k, n))) / 50


def lognormal(sigma: float, shared: float = 0.8) -> Sample:
    """Mean squares whose logs have this standard deviation, correlated over the estimators."""
    def draw(rng: np.random.Generator, k: int, n: int) -> np.ndarray:
        z = np.sqrt(shared) * rng.standard_normal(n) + np.sqrt(1 - shared) * rng.standard_normal((k, n))
        return np.exp(sigma * z - sigma**2 / 2)
    return draw


def unlike(rng: np.random.Generator, k: int, n: int) -> np.ndarray:
    """Two of equal RMSE and other spread."""
    z = np.sqrt(0.8) * rng.standard_normal(n) + np.sqrt(0.2) * rng.standard_normal((2, n))
    return np.exp(np.array([[1.0], [0.3]]) * z - np.array([[0.5], [0.045]]))


def judged(m: np.ndarray, name: str) -> tuple[Family, int]:
    found = compare_all(m, Draws(name, m.shape[1]), 0.5)
    return found, int(np.argmin(found.value))


def accused(sample: Sample, k: int, n: int, studies: int = STUDIES) -> float:
    """Share of studies in which anybody is called worse than the best."""
    rng, hits = np.random.default_rng([k, n]), 0
    for study in range(studies):
        found, best = judged(sample(rng, k, n), f"study {study}")
        hits += any(found.verdict(i, best) == "worse" for i in range(len(found.value)) if i != best)
    return hits / studies


def level(studies: int, share: float = 0.05) -> float:
    """A level and two standard errors of so many studies."""
    return share + 2 * float(np.sqrt(share * (1 - share) / studies))


@pytest.mark.long
@pytest.mark.parametrize("n", [20, 100])
@pytest.mark.parametrize("k", [4, 12, 24])
@pytest.mark.parametrize("sample", [chi50, lognormal(0.5), lognormal(1.0)], ids=["chi50", "ln.5", "ln1"])
def test_equals_are_accused_in_no_more_than_the_level(sample: Sample, k: int, n: int) -> None:
    share = accused(sample, k, n)
    print(f"P(any worse | all equal), k {k}, n {n}: {100 * share:.2f} %")
    assert share <= level(STUDIES)


@pytest.mark.long
def test_equal_rmse_of_other_spread_is_no_difference() -> None:
    share = accused(unlike, 2, 100)
    print(f"equal RMSE, other spread, n 100: {100 * share:.2f} %")
    assert share <= level(STUDIES)


@pytest.mark.long
@pytest.mark.parametrize(("sample", "n", "ratio"), [
    (chi50, 20, 1.066), (lognormal(0.5), 20, 1.22), (lognormal(1.0), 20, 2.19), (chi50, 100, 1.022),
    (lognormal(0.5), 100, 1.062), (lognormal(1.0), 100, 1.21), (chi50, 1000, 1.006), (lognormal(0.5), 1000, 1.018),
    (lognormal(1.0), 1000, 1.051)])
def test_power(sample: Sample, n: int, ratio: float) -> None:
    """One of twelve has this ratio of RMSE to the others and a tenth of (ratio - 1) more: found in 90 % of studies."""
    rng, studies, hits = np.random.default_rng(n), 300, 0
    for study in range(studies):
        m = sample(rng, 12, n)
        m[5] *= (1 + 1.1 * (ratio - 1)) ** 2
        found, best = judged(m, f"study {study}")
        hits += found.verdict(5, best) == "worse"
    print(f"n {n}, ratio {ratio}: found in {100 * hits / studies:.1f} %")
    assert hits / studies >= 0.9 - 2 * np.sqrt(0.09 / studies)


@pytest.mark.long
def test_near_copies_do_not_hide_a_rival_that_is_an_eighth_worse(railstate: Command) -> None:
    """Where the model is nearly linear ekf, ukf and ckf all but agree, the naive ones too: least errors of a ratio of
    theirs must not set the whole cell's critical value."""
    assert railstate("run", "ningbo-metro/gaussian", "--runs", 20, "--out", "all").code == 0
    table = Store("all").verdicts()
    assert table is not None
    mine = table[(table["metric"] == "rmse") & (table["quantity"] == "position")
                 & (table["estimator"] == "robust-mean-square")].iloc[0]
    assert 1.1 < mine["ratio"] < 1.2 and mine["verdict"] == "worse"


def coverage(sample: Sample, n: int, studies: int) -> float:
    """Share of studies whose 95 % interval of the RMSE holds 1, the truth of all samples here."""
    found = st.rooted(st.hall(sample(np.random.default_rng(n), studies, n), positive=True))
    return float(((found.low <= 1) & (found.high >= 1)).mean())


@pytest.mark.parametrize(("sample", "n", "least"), [
    (lognormal(0.5, 0.0), 100, 0.935), (lognormal(1.0, 0.0), 100, 0.93), (lognormal(1.0, 0.0), 20, 0.90),
    (lambda rng, k, n: rng.chisquare(2, (k, n)) / 2, 20, 0.935)], ids=["ln.5", "ln1", "ln1, 20", "chi2, 20"])
def test_the_interval_of_the_rmse_covers(sample: Sample, n: int, least: float) -> None:
    found = coverage(sample, n, 20000)
    print(f"coverage, n {n}: {100 * found:.2f} %")
    assert found >= least


@pytest.mark.long
def test_equal_estimators_that_each_lose_a_twentieth_are_not_accused() -> None:
    rng, studies, hits = np.random.default_rng(3), 600, 0
    for study in range(studies):
        lost = rng.uniform(size=(6, 100)) < 0.05
        hits += not eligible(lost, f"study {study}").all()
    print(f"accused of unreliability: {100 * hits / studies:.2f} %")
    assert hits / studies <= level(studies)


@pytest.mark.long
def test_a_million_rows_are_judged_in_ten_seconds_of_processor_time() -> None:
    rng, k, n = np.random.default_rng(4), 10, 100_000
    parts = [pd.DataFrame({"scenario": "s", "variant": "v", "estimator": f"e{i}", "run": np.arange(n), "status": "ok",
                           **{f"{metric}:x:m": rng.gamma(4, size=n) for metric in ("rmse", "mae", "max", "final")}})
             for i in range(k)]
    rows = pd.concat(parts, ignore_index=True)
    begun = time.process_time()
    table = verdicts(rows, manifest([f"e{i}" for i in range(k)]))
    taken = time.process_time() - begun
    print(f"1e6 rows: {taken:.1f} s")
    assert len(table) and taken < 10
