"""The shared statistics against scipy and against hand-worked cases.

Whatever the tables and the report say of a difference goes through these functions."""

from __future__ import annotations

import numpy as np
import pytest
from railstate.benchmarks.judging import ranks
from railstate.benchmarks.judging import statistics as st
from scipy import stats


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(8)


def test_pooled_rmse_is_the_root_of_the_pooled_mean_square(rng: np.random.Generator) -> None:
    sample = np.sqrt(rng.chisquare(40, (4000, 100)) / 40)
    pooled = np.array([st.pooled_rmse(row) for row in sample])
    assert pooled[0, 0] == pytest.approx(np.sqrt(np.mean(sample[0] ** 2)), rel=1e-14)
    spread = pooled[:, 0].std(ddof=1)
    assert np.median(pooled[:, 1]) == pytest.approx(spread, rel=4 / np.sqrt(2 * 4000))
    assert st.pooled_rmse([0.0, 0.0, 0.0]) == (0.0, 0.0)


def test_mean_and_interval_agree_with_scipy_and_leave_missing_runs_out(rng: np.random.Generator) -> None:
    values = rng.normal(3, 2, 30)
    mean, error = st.mean_se(np.append(values, np.nan))
    assert error == pytest.approx(stats.sem(values), rel=1e-13)
    low, high = stats.t.interval(0.95, 29, loc=mean, scale=error)
    assert st.mean_interval([*values, np.nan]) == pytest.approx((mean, low, high, 30), rel=1e-12)
    assert np.isnan(st.mean_interval([1.0]).low)
    assert st.mean_interval([]).n == 0


@pytest.mark.parametrize(("successes", "n"), [(0, 10), (10, 10), (3, 100), (1, 1), (499, 500)])
def test_wilson_agrees_with_scipy(successes: int, n: int) -> None:
    expected = stats.binomtest(successes, n).proportion_ci(0.95, method="wilson")
    found = st.wilson(successes, n)
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high), abs=1e-12)
    assert np.isnan(st.wilson(0, 0).value)


def test_chi_square_interval_is_that_of_the_bar_shalom_test() -> None:
    low, high = st.chi_square_interval(50, 2)
    assert (low * 100, high * 100) == pytest.approx(stats.chi2.interval(0.95, 100), rel=1e-12)


def test_anees_interval_covers_although_steps_are_correlated(rng: np.random.Generator) -> None:
    covered = 0
    for _ in range(400):
        slow = rng.standard_normal((30, 4, 2)).repeat(25, axis=1)
        covered += st.anees((slow**2).sum(-1).mean(1), 2).low <= 1 <= st.anees((slow**2).sum(-1).mean(1), 2).high
    assert abs(covered / 400 - 0.95) < 4 * np.sqrt(0.95 * 0.05 / 400)


@pytest.mark.parametrize(("scale", "expected"), [(1.0, "consistent"), (1.6, "too sure"), (0.6, "too cautious")])
def test_consistency_names_the_side(rng: np.random.Generator, scale: float, expected: str) -> None:
    assert st.consistency(scale * rng.chisquare(80, 100) / 40, 2) == expected
    assert st.consistency([2.0], 2) == "unknown"


def test_wilcoxon_agrees_with_scipy_exact_and_with_ties_and_zeros(rng: np.random.Generator) -> None:
    small = rng.normal(0.4, 1, 20)
    assert st.wilcoxon(small) == pytest.approx(stats.wilcoxon(small, method="exact").pvalue, rel=1e-12)
    tied = np.round(rng.normal(0.3, 1, 80), 1)
    assert (tied == 0).any()
    expected = stats.wilcoxon(tied, zero_method="pratt", method="approx").pvalue
    assert st.wilcoxon(tied) == pytest.approx(expected, rel=1e-12)
    assert st.wilcoxon(np.zeros(9)) == 1.0


def test_paired_agrees_with_scipy_and_drops_incomplete_pairs(rng: np.random.Generator) -> None:
    a, b = rng.normal(1.1, 0.1, 60), rng.normal(1.0, 0.1, 60)
    found = st.paired(np.append(a, [np.nan, 5.0]), np.append(b, [1.0, np.nan]))
    interval = stats.ttest_rel(a, b).confidence_interval(0.95)
    assert (found.low, found.high) == pytest.approx((interval.low, interval.high), rel=1e-10)
    assert found.n == 60
    assert found.won == (a < b).mean()
    assert found.relative == pytest.approx(a.mean() / b.mean() - 1)
    assert st.paired([1.0, 2.0], [1.0, 3.0]).won == 0.75
    assert st.paired([np.nan], [1.0]).n == 0


def test_holm_by_hand_and_as_a_bound_of_bonferroni(rng: np.random.Generator) -> None:
    assert st.holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert st.holm([0.5, np.nan, 0.9])[0] == 1.0
    p = rng.uniform(size=12)
    adjusted = np.array(st.holm(p.tolist()))
    assert (adjusted <= np.minimum(12 * p, 1) + 1e-15).all()
    assert (adjusted >= p).all()
    assert min(adjusted) == min(1.0, 12 * p.min())


def test_verdict_needs_significance_an_interval_and_a_difference_that_matters(rng: np.random.Generator) -> None:
    base = rng.normal(1, 0.2, 100)
    assert st.verdict(st.paired(base * 1.2, base), 1e-6) == "worse"
    assert st.verdict(st.paired(base * 0.8, base), 1e-6) == "better"
    assert st.verdict(st.paired(base * 1.2, base), 0.2) == "tie"
    assert st.verdict(st.paired(base * 1.005, base), 1e-9) == "tie"
    assert st.verdict(st.paired(base, base), 1.0) == "tie"


@pytest.mark.parametrize(("runs", "comparisons", "expected"), [
    (5, 1, "too few runs"), (6, 1, "worse"), (6, 11, "too few runs"), (9, 11, "worse")])
def test_what_no_outcome_could_resolve_is_no_tie(rng: np.random.Generator, runs: int, comparisons: int,
                                                 expected: str) -> None:
    """2 / 2^n is the least p of n runs: every run says the same, and yet nothing can be said."""
    base = rng.normal(1, 0.01, runs)
    found = st.paired(base * 2, base)
    assert found.p == pytest.approx(2.0 ** (1 - runs))
    assert st.verdict(found, min(1.0, comparisons * found.p), comparisons) == expected


def test_false_alarms_of_the_whole_rule_stay_under_the_level(rng: np.random.Generator) -> None:
    alarms = 0
    for _ in range(600):
        base = rng.gamma(4, size=40)
        rivals = [base * rng.lognormal(-0.02, 0.2, 40) for _ in range(4)]
        found = [st.paired(rival, base) for rival in rivals]
        adjusted = st.holm([each.p for each in found])
        alarms += any(st.verdict(f, p) != "tie" for f, p in zip(found, adjusted, strict=True))
    assert alarms / 600 < 0.05 + 4 * np.sqrt(0.05 * 0.95 / 600)


def test_friedman_ranks_and_p_agree_with_scipy(rng: np.random.Generator) -> None:
    errors = rng.gamma(4, size=(50, 4)) * np.array([1, 1.2, 1.5, 1.5])
    found = ranks.friedman(np.vstack([errors, [np.nan, 1, 1, 1]]))
    assert found.n == 50
    assert found.p == pytest.approx(stats.friedmanchisquare(*errors.T).pvalue, rel=1e-12)
    assert found.mean == pytest.approx(stats.rankdata(errors, axis=1).mean(0))
    assert found.mean.sum() == pytest.approx(10)


def test_cliques_join_the_equal_and_part_the_different(rng: np.random.Generator) -> None:
    base = rng.gamma(20, size=(200, 1))
    noise = rng.lognormal(0, 0.1, (200, 4))
    found = ranks.friedman(base * noise * np.array([[2.0, 1.0, 2.0, 1.0]]))
    assert sorted(tuple(sorted(clique)) for clique in found.cliques) == [(0, 2), (1, 3)]
    twins = ranks.friedman(np.column_stack([base[:, 0], base[:, 0] * 1.001, base[:, 0] * 3]))
    assert [sorted(clique) for clique in twins.cliques] == [[0, 1]]
    assert ranks.friedman(np.ones((1, 3))).cliques == []
