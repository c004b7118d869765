"""What may be said of rows: small sets with known answers, intervals against scipy, rules at their edges.

The rates at which the rules err are simulated in `test_judging_rates.py`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from railstate.benchmarks.judging import claims, ranks
from railstate.benchmarks.judging import statistics as st
from railstate.benchmarks.judging.family import Draws, compare_all, eligible
from railstate.benchmarks.judging.table import VERDICT_COLUMNS, verdicts
from scipy import stats

SETS = Path(__file__).parent / "verdict_sets"
EXPECTED: dict[str, dict[str, Any]] = json.loads((SETS / "expected.json").read_text(encoding="utf-8"))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(8)


def manifest(labels: list[str], oracles: tuple[str, ...] = (), plugin: str = "") -> dict[str, Any]:
    """As much of a manifest as judging reads: one cell s/v, position judged by its RMSE, shown in cm."""
    return {"scenarios": {"s": {"table": [["rmse", "x"], ["nees", "state"]], "quantities": ["x"],
                                "shown": {"x": ["cm", 100.0]}, "variants": {"v": {}}}},
            "configuration": {"cells": {"s/v": {"estimators": {label: {"plugin": plugin or label}
                                                               for label in labels}}}},
            "estimators": {name: {"oracle": name in oracles} for name in {*labels, plugin}}}


def rows(squares: dict[str, np.ndarray], **columns: dict[str, np.ndarray]) -> pd.DataFrame:
    """Rows of one cell from each estimator's mean squares per run (NaN: lost) and further columns."""
    parts = []
    for label, values in squares.items():
        lost = np.isnan(values)
        parts.append(pd.DataFrame({
            "scenario": "s", "variant": "v", "estimator": label, "run": np.arange(len(values)),
            "status": np.where(lost, "diverged", "ok"), "rmse:x:m": np.sqrt(values),
            **{name.replace("__", ":"): found[label] for name, found in columns.items() if label in found}}))
    return pd.concat(parts, ignore_index=True)


def errors(squares: dict[str, np.ndarray], **kinds: Any) -> pd.DataFrame:
    """The lines of kind error, by estimator."""
    table = verdicts(rows(squares), manifest(list(squares), **kinds))
    assert tuple(table) == VERDICT_COLUMNS
    return table[table["kind"] == "error"].set_index("estimator")


def read(name: str) -> dict[str, np.ndarray]:
    values = np.genfromtxt(SETS / f"{name}.csv", delimiter=",")
    return {f"e{i}": column for i, column in enumerate(np.atleast_2d(values.T))}


@pytest.mark.parametrize("name", [name for name, about in EXPECTED.items() if "verdicts" in about])
def test_sets_with_known_answers(name: str) -> None:
    """Words exactly; limits of the ratio within a tenth of their half width."""
    expected, found = EXPECTED[name], errors(read(name))
    assert found["verdict"].tolist() == expected["verdicts"]
    assert found["lost"].tolist() == expected["lost"]
    assert found["ratio"].to_numpy() == pytest.approx(expected["ratio"], abs=6e-5)
    for low, high, mine in zip(expected["low"], expected["high"], found.itertuples(), strict=True):
        room = 0.1 * np.log(high / low) / 2 + 1e-3
        assert (np.log(mine.ratio_low), np.log(mine.ratio_high)) == pytest.approx(np.log([low, high]), abs=room)


def test_the_quitter_is_never_best_and_drawn_as_lost() -> None:
    found = errors(read("quitter"))
    assert found["eligible"].tolist() == [True, False]
    assert found["value"]["e1"] < found["value"]["e0"]  # over its finished runs
    assert found["runs"].tolist() == [200, 191]
    assert found["against"].unique().tolist() == ["e0"]


def test_the_interval_of_one_rmse_is_halls() -> None:
    values = read("interval_ln1_100")["e0"]
    line = errors({"only": values}).loc["only"]
    assert line[["value", "low", "high"]].tolist() == pytest.approx(EXPECTED["interval_ln1_100"]["value"], rel=1e-9)
    assert (line["verdict"], line["shown_unit"], line["factor"]) == ("best", "cm", 100.0)
    assert line["standard_error"] == pytest.approx(stats.sem(values) / 2 / np.sqrt(values.mean()), rel=1e-12)


def test_without_skewness_the_interval_is_students(rng: np.random.Generator) -> None:
    half = rng.normal(3, 2, 30)
    values = np.concatenate([half, 6 - half])
    found = st.hall(np.append(values, np.nan))
    expected = stats.t.interval(0.95, 59, loc=values.mean(), scale=stats.sem(values))
    assert (found.low, found.high) == pytest.approx(expected, rel=1e-9) and found.n == 60
    assert np.isnan(st.hall(np.ones(1)).low) and st.hall(np.array([])).n == 0
    assert st.hall(np.array([1.0, np.inf, 2.0])).value == np.inf


def test_order_and_company_do_not_matter_where_they_must_not(rng: np.random.Generator) -> None:
    squares = {name: rng.gamma(4, size=60) for name in "abcd"}
    one, other = errors(squares), errors(dict(reversed(squares.items())))
    pd.testing.assert_frame_equal(one, other.loc[one.index], rtol=1e-9)


def test_ties_are_shown_not_assumed(rng: np.random.Generator) -> None:
    base = rng.gamma(20, size=100)
    found = errors({"a": base, "copy": base.copy(), "near": base * rng.uniform(0.999, 1.001, 100)**2,
                    "other": rng.gamma(20, size=100), "double": 4 * base})
    assert found["verdict"].tolist()[1:3] == ["tie", "tie"]
    assert found["verdict"]["other"] == "undecided" and found["verdict"]["double"] == "worse"
    assert found["ratio"]["double"] == pytest.approx(2)
    assert found["deciding"]["other"] > 100 and np.isnan(found["deciding"]["double"])


def test_too_few_runs_give_no_verdict(rng: np.random.Generator) -> None:
    base = rng.gamma(20, size=19)
    found = errors({"a": base, "b": 100 * base})
    assert found["verdict"].tolist() == ["best", "undecided"]
    assert "under 20 runs there is no verdict" in found["note"]["b"]
    assert errors({"a": np.append(base, 1.0), "b": 100 * np.append(base, 1.0)})["verdict"]["b"] == "worse"


def test_no_error_at_all() -> None:
    zero = np.zeros(30)
    found = errors({"a": zero, "b": np.full(30, 1e-32), "c": np.linspace(1e-10, 2e-10, 30)})
    assert found["verdict"].tolist() == ["best", "tie", "worse"]
    assert found["ratio"]["c"] == np.inf and found["ratio"]["b"] == 1


def test_oracles_and_those_without_a_value_stand_apart(rng: np.random.Generator) -> None:
    base = rng.gamma(20, size=50)
    found = errors({"knows": 0.01 * base, "a": base, "gone": np.full(50, np.nan)}, oracles=("knows",))
    assert found["verdict"].tolist() == ["oracle", "best", "lost"]
    assert found["family"]["a"] == 1 and not found["eligible"]["gone"]


def test_better_in_most_runs_and_worse_in_the_mean_square_is_said_as_both(rng: np.random.Generator) -> None:
    base = rng.gamma(20, size=400) / 20
    rare = np.where(np.arange(400) % 40 == 0, 40.0, 0.9 * base)
    found = errors({"steady": base, "gambler": rare}).loc["gambler"]
    assert found["ratio"] > 1.3 and found["won"] > 0.95
    assert "smaller error in 9" in found["note"] and found["verdict"] == "worse"


def test_what_one_run_carries_is_said(rng: np.random.Generator) -> None:
    values = rng.gamma(20, size=100)
    values[3] = 0.5 * values.sum()
    found = errors({"a": values, "b": rng.gamma(20, size=100)})
    assert found["note"]["a"].startswith("one run carries 3")
    assert found["note"]["b"] == "events rarer than 3/n of the runs may not have been seen"


def test_yardsticks_are_set_beside_everyone(rng: np.random.Generator) -> None:
    base = rng.gamma(20, size=50)
    about = manifest(["ekf", "mine"])
    about["estimators"] = {"ekf": {"oracle": False}, "mine": {"oracle": False}}
    table = verdicts(rows({"ekf": base, "mine": 0.5 * base}), about)
    line = table[table["kind"] == "yardstick"].iloc[0]
    assert (line["estimator"], line["against"], line["verdict"]) == ("mine", "ekf", "better")
    assert line["ratio"] == pytest.approx(np.sqrt(0.5))


# -- claims ----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("scale", "runs", "expected"), [
    (1.0, 100, "consistent"), (1.6, 100, "too sure"), (0.6, 100, "too cautious"), (1.0, 12, "undecided"),
    (1.92, 5, "undecided"), (1.12, 40, "undecided")])
def test_consistent_means_within_a_tenth_of_1(rng: np.random.Generator, scale: float, runs: int, expected: str) -> None:
    assert claims.consistency(scale * rng.chisquare(80, runs) / 80).verdict == expected


def test_a_singular_claim_with_an_error_is_too_sure_and_one_step_rules_nothing(rng: np.random.Generator) -> None:
    endless = claims.consistency(np.full(30, np.inf), np.zeros(30))
    assert (endless.value, endless.verdict) == (np.inf, "too sure")
    once = rng.chisquare(80, 100) / 80
    once[7] = np.inf
    found = claims.consistency(once, rng.binomial(400, 0.95, 100) / 400)
    assert (found.value, found.verdict) == (np.inf, "undecided")
    assert found.note == "singular claim with an error in 1 of 100 runs; few steps carry the mean"


def test_anees_median_and_share_inside_stand_in_one_line(rng: np.random.Generator) -> None:
    n = 60
    table = verdicts(rows({"a": rng.gamma(20, size=n)}, nees__state__1={"a": 2 * rng.chisquare(200, n) / 200},
                          nees_states={"a": np.full(n, 2)}, inside__state__1={"a": rng.binomial(200, 0.95, n) / 200},
                          **{"nees-median__state__1": {"a": rng.uniform(0.9, 1.1, n)}}), manifest(["a"]))
    line = table[table["kind"] == "consistency"].iloc[0]
    assert line["verdict"] == "consistent" and abs(line["median"] - 1) < 0.1 and abs(line["inside"] - 0.95) < 0.02


def test_a_bound_is_kept_broken_or_undecided(rng: np.random.Generator) -> None:
    measured = rng.gamma(20, size=50) / 20
    words = [getattr(claims.bounded(measured, np.full(50, bound)), "verdict", None) for bound in (2.0, 1.0, 0.5)]
    assert words == ["kept", "undecided", "broken"]
    assert claims.bounded(measured, np.full(50, np.nan)) is None


def test_shares(rng: np.random.Generator) -> None:
    """Wilson over runs at the edge, Korn and Graubard's interval elsewhere; of events it is about Clopper-Pearson's."""
    for hits, n in ((0, 10), (10, 10), (3, 100), (1, 1), (499, 500)):
        flags = np.arange(n) < hits
        expected = stats.binomtest(hits, n).proportion_ci(0.95, method="wilson")
        assert st.share(flags)[1:3] == pytest.approx((expected.low, expected.high), abs=1e-12)
    flags = np.arange(1000) < 300
    expected = stats.binomtest(300, 1000).proportion_ci(0.95, method="exact")
    assert st.share(flags)[1:3] == pytest.approx((expected.low, expected.high), abs=1e-3)
    parts = np.clip(rng.normal(0.5, 0.05, 100), 0, 1)
    low, high = stats.t.interval(0.95, 99, loc=parts.mean(), scale=stats.sem(parts))
    assert st.share(parts)[1:3] == pytest.approx((low, high), abs=2e-3)
    p, n = parts.mean(), len(parts)  # Korn and Graubard (1998): Clopper and Pearson's limits at the effective size
    size = p * (1 - p) / (parts.var(ddof=1) / n) * (stats.norm.ppf(0.975) / stats.t.ppf(0.975, n - 1)) ** 2
    assert st.share(parts)[1:3] == pytest.approx((stats.beta.ppf(0.025, p * size, size - p * size + 1),
                                                  stats.beta.ppf(0.975, p * size + 1, size - p * size)), rel=1e-9)
    assert np.isnan(st.share([]).value)


@pytest.mark.parametrize("n", [1, 2, 20, 37, 100])
@pytest.mark.parametrize("coarse", [False, True])
def test_signed_rank_is_that_of_scipy(n: int, coarse: bool) -> None:
    gaps = np.random.default_rng(n).normal(0.2, 1.0, n)
    gaps = np.round(4 * gaps) / 4 + (n < 3) if coarse else gaps  # ties and zeros
    expected = stats.wilcoxon(gaps, method="asymptotic").pvalue
    assert st.signed_rank([*gaps, np.nan]) == pytest.approx(expected, rel=1e-12)
    assert st.signed_rank(-gaps) == pytest.approx(expected, rel=1e-12)
    assert st.signed_rank(0 * gaps) == 1.0


def test_pooled_rmse_of_few_runs() -> None:
    assert st.pooled_rmse([3.0, 4.0, np.nan]) == pytest.approx((12.5**0.5, 3.5 / (2 * 12.5**0.5)))
    assert st.pooled_rmse([0.0, 0.0]) == (0.0, 0.0)
    for one, expected in (([2.0], (2.0, np.nan)), ([0.0], (0.0, np.nan)), ([], (np.nan, np.nan))):
        np.testing.assert_array_equal(st.pooled_rmse(one), expected)


def test_requirements_are_met_not_met_or_undecided() -> None:
    assert claims.requirement(np.ones(72), 0.95).verdict == "undecided"
    assert claims.requirement(np.ones(72), 0.95).deciding == 73
    assert claims.requirement(np.ones(73), 0.95).verdict == "met"
    assert claims.requirement(np.arange(100) < 50, 0.95).verdict == "not met"
    open_ = claims.requirement(np.arange(100) < 93, 0.95)
    assert open_.verdict == "undecided" and 100 < open_.deciding < 1e4


# -- reliability, ranks ----------------------------------------------------------------------------------------------
def test_who_loses_more_than_equals_would_is_out_and_a_single_accident_is_nothing() -> None:
    lost = np.zeros((4, 200), dtype=bool)
    lost[1, :9] = lost[2, 50:52] = True
    assert eligible(lost, "cell").tolist() == [True, False, True, True]
    accident = np.zeros((2, 1000), dtype=bool)
    accident[0, 17] = True
    assert eligible(accident, "cell").all()
    together = np.zeros((3, 50), dtype=bool)
    together[:, :40] = True
    assert eligible(together, "cell").all()


def test_one_accident_in_a_thousand_does_not_dethrone_a_better_filter(rng: np.random.Generator) -> None:
    base = rng.gamma(20, size=1000)
    good = base.copy()
    good[17] = np.nan
    found = errors({"good": good, "other": 1.44 * base})
    assert found["verdict"].tolist() == ["best", "worse"]


def test_friedman_ranks_and_p_agree_with_scipy(rng: np.random.Generator) -> None:
    grid = rng.gamma(4, size=(50, 4)) * np.array([1, 1.2, 1.5, 1.5])
    found = ranks.friedman(grid)
    assert found.p == pytest.approx(stats.friedmanchisquare(*grid.T).pvalue, rel=1e-12)
    assert found.mean == pytest.approx(stats.rankdata(grid, axis=1).mean(0))
    # Demsar 2006, table 5: q = 2.569 of four at 5 %
    assert found.difference == pytest.approx(2.569 * np.sqrt(4 * 5 / (6 * 50)), rel=1e-3)


def test_ranks_of_equals_and_of_two() -> None:
    """Equals everywhere share a rank, and no test of theirs can doubt it; of two there is no test."""
    found = ranks.friedman(np.repeat([[1.0], [2.0], [np.inf]], 3, axis=1))
    assert (found.mean.tolist(), found.p, found.cliques, found.n) == ([2.0] * 3, 1.0, [(0, 1, 2)], 3)
    assert ranks.friedman(np.ones((4, 2))).p == 1.0
    assert ranks.friedman(np.tile([3.0, 1.0, 2.0], (50, 1))).cliques == []  # each alone
    assert np.isnan(ranks.friedman(np.array([[1.0, 2.0], [2.0, 1.0]])).p)


def test_cliques_join_the_near_and_settings_are_the_blocks(rng: np.random.Generator) -> None:
    grid = rng.gamma(20, size=(200, 1)) * rng.lognormal(0, 0.1, (200, 4)) * np.array([[2.0, 1.0, 2.0, 1.0]])
    found = ranks.friedman(grid)
    assert sorted(tuple(sorted(clique)) for clique in found.cliques) == [(0, 2), (1, 3)]
    table = pd.DataFrame([{"kind": "error", "quantity": "x", "scenario": "s", "variant": v, "estimator": e,
                           "verdict": "", "eligible": ok, "value": value}
                          for v, row in {"u": [1, 2, 3], "w": [1, 2, 0.5]}.items()
                          for e, value, ok in zip("abc", row, [True, True, False], strict=True)])
    labels, ranked = ranks.over_settings(table, "x") or ([], None)
    assert labels == ["a", "b", "c"] and ranked is not None and ranked.n == 2
    assert ranked.mean.tolist() == [1, 2, 3]  # c loses runs: last, whatever its error
    assert ranked.cliques == [(0, 1, 2)]  # two settings tell nobody apart


def test_equal_estimators_are_told_apart_over_settings_no_more_often_than_the_level(rng: np.random.Generator) -> None:
    studies, apart = 400, 0
    for _ in range(studies):
        found = ranks.friedman(rng.gamma(4, size=(10, 6)))
        apart += not any(len(clique) == 6 for clique in found.cliques)
    assert apart / studies < 0.05 + 2 * np.sqrt(0.05 * 0.95 / studies)


def test_chi_square_interval_is_that_of_the_bar_shalom_test() -> None:
    low, high = st.chi_square_interval(50, 2)
    assert (low * 100, high * 100) == pytest.approx(stats.chi2.interval(0.95, 100), rel=1e-12)


def test_a_family_of_one_and_of_one_run() -> None:
    assert compare_all(np.ones((1, 30)), Draws("k", 30), 0.5).critical == np.inf
    assert compare_all(np.ones((2, 1)), Draws("k", 1), 0.5).verdict(0, 1) == "undecided"


def test_what_a_channel_takes_the_ground_from_is_not_certified(rng: np.random.Generator) -> None:
    """A filter that takes late packets for fresh ones, one that rests on independent draws, one that just filters: the
    reason and what was measured stand beside."""
    labels = ["fresh", "draws", "filter"]
    nees = {label: rng.chisquare(40, 60) / 40 for label in labels}
    about = manifest(labels)
    about["configuration"]["cells"]["s/v"]["estimators"]["fresh"]["late"] = "as-new"
    about["estimators"]["draws"]["needs"] = ["reception"]
    frame = rows({label: np.ones(60) for label in labels}, nees__state__1=nees,
                 nees_states={label: np.ones(60) for label in labels})
    for reasons, certain in (({}, {*labels}), ({"as-new": "late"}, {"draws", "filter"}),
                             ({"guarantee": "turns"}, {"fresh", "filter"}),
                             ({"covariance": "old"}, {"fresh", "draws"})):
        about["scenarios"]["s"]["variants"]["v"] = {"uncertified": reasons}
        found = verdicts(frame, about)
        found = found[found["kind"] == "consistency"].set_index("estimator")
        assert set(found.index[found["verdict"] != "not certified"]) == certain
        assert found["value"].to_list() == pytest.approx([nees[label].mean() for label in labels])
        for reason in reasons.values():
            told = found.loc[[label for label in labels if label not in certain], "note"]
            assert told.str.startswith(f"{reason}; measured: ").all()
