"""The parts of judging at their edges: critical values by loops over pairs, intervals that just touch a margin, notes.

Also when a study may stop. All is written down here by hand; whole tables: `test_judging.py`, `test_expected.py`."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest
from railstate.benchmarks.judging import claims, family, floors
from railstate.benchmarks.judging import statistics as st
from railstate.benchmarks.judging.comparison import between_estimators, same_rows, speed_ratio
from railstate.benchmarks.judging.family import Draws, Family
from railstate.benchmarks.judging.judged import Judged, _most, _won, notes
from railstate.benchmarks.judging.selection import Aligned, apart, grounds, judged_columns, yardsticks
from railstate.benchmarks.judging.stopping import Precision, Rule, first_runs, rule
from railstate.benchmarks.judging.table import verdicts
from railstate.scenarios.errors import InputError
from scipy.stats import beta

from .test_judging import manifest, rows

NAN, INF, MARGIN = np.nan, np.inf, float(np.log1p(0.01))


@pytest.mark.parametrize("level", [0.05, 0.0125])
def test_the_critical_value_is_that_of_a_loop_over_pairs(level: float) -> None:
    x = np.random.default_rng(2).gamma(2, size=(4, 30))
    x /= x.mean(axis=1, keepdims=True)
    draws, floor, tops = Draws("s/v", 30, level), 0.05, [[], []]
    assert draws.count == (1999 if level == 0.05 else 4999)
    weights, signs = draws.weights, 30 * draws.signs
    assert weights.shape == signs.shape == (draws.count, 30) and set(np.unique(signs)) == {-1.0, 1.0}
    assert np.allclose(weights.sum(axis=1), 1) and np.allclose(30 * weights, np.rint(30 * weights))
    for i in range(4):
        for j in range(i):
            a, b = (x[m] / (weights @ x[m])[:, None] for m in (i, j))
            gap, spread = np.log((weights @ x[i]) / (weights @ x[j])), (weights * (a - b)**2).sum(axis=1)
            tops[0].append(gap**2 / np.maximum(spread / 29, floor**2))
            a, b = np.where(signs > 0, x[i], x[j]), np.where(signs > 0, x[j], x[i])
            gap = np.log(a.mean(axis=1) / b.mean(axis=1))
            spread = ((a / a.mean(axis=1, keepdims=True) - b / b.mean(axis=1, keepdims=True))**2).mean(axis=1)
            tops[1].append(gap**2 / np.maximum(spread / 29, floor**2))
    places = [np.sort(np.max(top, axis=0))[int(np.ceil((1 - level) * (draws.count + 1))) - 1] for top in tops]
    assert family.critical_value(x, draws, floor) == pytest.approx(np.sqrt(max(places)), rel=1e-9)


def test_more_runs_than_blocks_are_averaged(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(family, "BLOCKS", 3)
    draws = Draws("s/v", 7)
    assert draws.blocks(np.array([[1.0, 2, 3, 4, 5, 6, 7]])).tolist() == [[2.0, 4.5, 6.5]]
    assert draws.weights.shape == draws.signs.shape == (1999, 3) and Draws("s/v", 3).blocks(np.eye(3)).sum() == 3


@pytest.mark.parametrize("runs", [150, 900])
def test_how_far_counts_of_lost_runs_differ_by_chance(runs: int) -> None:
    """Few runs by exchange, many by the normal law: the quantile of a sample that is drawn here."""
    flags = np.zeros((3, runs + 50), dtype=bool)
    flags[0, :runs] = True
    flags[1, :runs // 3] = True
    flags[:, runs:runs + 20] = True  # all of them lost: says nothing
    rng = np.random.default_rng(4)
    lots = np.array([rng.permuted(flags[:, :runs], axis=0).sum(axis=1) for _ in range(2000)])
    assert family._range_quantile(flags, "s/v") == pytest.approx(np.quantile(np.ptp(lots, axis=1), 0.95), rel=0.06)
    assert family._range_quantile(flags[:, runs:], "s/v") == 0.0


def pair(low: float, high: float, values: tuple[float, float] = (1.0, 1.0), runs: int = 20,
         tails: tuple[bool, bool] = (False, False)) -> Family:
    ratio, half = (low + high) / 2, (high - low) / 2
    return Family(np.array([[0.0, ratio], [-ratio, 0.0]]), np.full((2, 2), half), np.array(values),
                  np.array([[False, tails[0]], [tails[1], False]]), 2.0, runs)


@pytest.mark.parametrize(("found", "word", "other"), [
    (pair(0.5, 1.5), "worse", "better"), (pair(0.5, 1.5, runs=19), "undecided", "undecided"),
    (pair(0.5, 1.5, tails=(True, False)), "undecided", "undecided"),
    (pair(0.5, 1.5, tails=(False, True)), "worse", "better"), (pair(0.0, 1.0), "undecided", "undecided"),
    (pair(0.001, 0.0095), "tie", "tie"), (pair(0.001, 0.011), "worse", "better"), (pair(-0.0099, 0.0099), "tie", "tie"),
    (pair(-0.0101, 0.0099), "undecided", "undecided"), (pair(-0.0099, 0.0101), "undecided", "undecided"),
    (pair(INF, INF, (0.5, 0.0)), "worse", "better"), (pair(NAN, NAN, (0.0, 0.0)), "tie", "tie")])
def test_a_verdict_by_where_the_interval_lies(found: Family, word: str, other: str) -> None:
    assert (found.verdict(0, 1), found.verdict(1, 0)) == (word, other)


def test_how_many_runs_would_decide() -> None:
    assert pair(-0.125, 0.25).deciding(0, 1) == np.ceil(20 * (0.1875 / 0.0625)**2) == pair(-0.25, 0.125).deciding(1, 0)
    assert pair(-0.1, 0.101).deciding(0, 1) == np.ceil(20 * (0.1005 / (MARGIN - 0.0005))**2)
    assert pair(0.999, 1.001).deciding(0, 1) == 20.0
    assert [claims.runs_for_share([1.0, 0.0], 0.5), claims.runs_for_share([], 0.5)] == [INF, INF]
    assert claims.runs_for_share([1.0], 0.95) == 73  # 1.96^2 0.95 0.05 / 0.05^2
    v = np.array([0.5, 0.7, 0.9])
    assert claims.runs_for_share(v, 0.75) == np.ceil(v.var(ddof=1) * 4.302652729911275**2 / 0.05**2)


def judged(found: Family, a: Any, b: Any, fine: tuple[bool, bool] = (True, True)) -> Judged:
    return Judged([0, 1], found, np.array([a, b], dtype=float), np.array(fine))


def test_what_is_said_against_the_best() -> None:
    a, b = np.linspace(1.0, 2.0, 40), np.linspace(2.0, 3.0, 40)
    made = judged(pair(-1.0, -0.5, (1.0, 2.0)), a, b)
    assert made.best == 0 and made.against_best(0, "ab") == {
        "verdict": "best", "ratio": 1.0, "ratio_low": 1.0, "ratio_high": 1.0, "against": "a", "family": 2,
        "note": "events rarer than 3/n of the runs may not have been seen"}
    said = made.against_best(1, "ab")
    assert [said[name] for name in ("verdict", "against", "family", "eligible", "won")] == ["worse", "a", 2, True, 0.0]
    assert (said["ratio"], said["ratio_low"], said["ratio_high"]) == pytest.approx(np.exp([0.75, 0.5, 1.0]))
    assert np.isnan(said["deciding"]) and said["note"] == "events rarer than 3/n of the runs may not have been seen"
    lost = judged(pair(-0.2, 0.1, (1.0, 2.0)), a, b, (False, True))  # the one of less error lost too many runs
    assert lost.best == 1 and lost.against_best(0, "ab")["verdict"] == "lost"
    assert np.isnan(lost.against_best(0, "ab")["deciding"]) and not lost.against_best(0, "ab")["eligible"]
    assert judged(pair(0.5, 1.0, (2.0, 1.0)), b, a, (False, True)).against_best(0, "ab")["verdict"] == "worse"
    first = judged(pair(0.5, 1.0), a, b)  # of equal values, though the interval says otherwise
    assert first.best == 0 and first.against_best(1, "ab")["verdict"] == "undecided"
    wide = judged(pair(-1.0, -0.5, (1.0, 2.0), tails=(False, True)), a, b).against_best(1, "ab")
    assert wide["verdict"] == "undecided" and wide["note"].startswith("tails differ; events") and wide["deciding"] > 0
    more = judged(pair(-1.0, -0.5, (1.0, 2.0)), b, a).against_best(1, "ab")  # less error in each run, and yet worse
    assert more["won"] == 1.0 and more["note"].startswith("smaller error in 100 % of the runs; ")
    back = judged(pair(-1.0, -0.5, (1.0, 2.0)), b, a).facts(0, 1)
    assert back["won"] == 0.0 and back["note"] == "larger error in 100 % of the runs" and back["verdict"] == "better"
    none = judged(pair(INF, INF, (0.5, 0.0)), a, 0 * a).facts(0, 1)
    assert (none["ratio"], none["ratio_low"], none["ratio_high"], none["verdict"]) == (INF, INF, INF, "worse")
    both = judged(pair(NAN, NAN, (0.0, 0.0)), 0 * a, 0 * a).facts(0, 1)
    assert (both["ratio"], both["ratio_low"], both["won"], both["verdict"]) == (1.0, 1.0, 0.5, "tie")


def test_notes_of_few_runs_and_of_runs_that_carry_much() -> None:
    flat, rare, few = np.ones(300), "events rarer than 3/n of the runs may not have been seen", \
        "under 20 runs there is no verdict"
    assert [notes(flat, n) for n in (19, 20, 199, 200)] == [few, rare, rare, ""]
    assert notes(np.array([5.0, *[2.0] * 9, NAN]), 200) == "one run carries 22 % of the mean"
    assert notes(np.array([5.0, *[2.0] * 8]), 200) == ""  # nine of them: no share is said
    assert notes(np.array([2.5, *[10 / 9] * 9]), 19) == few and notes(np.zeros(20), 200) == ""
    a, b = np.array([1.0, 2.0, NAN, 4.0]), np.array([1.0, 3.0, 5.0, NAN])
    assert _won(a, b) == 0.625 and _won(np.array([NAN]), np.array([NAN])) == 0.5
    rising = np.linspace(1.0, 2.0, 20)
    assert _most(rising, 2 * rising) and not _most(rising, rising) and not _most(rising[:19], 2 * rising[:19])
    assert not _most(rising, np.append(2 * rising[:19], 0.0)) and not _most(rising, np.append(2 * rising[:19], NAN))


@pytest.mark.parametrize(("low", "high", "n", "word"), [
    (-0.1, 0.1, 20, "white"), (-0.1, 0.1, 19, "undecided"), (-0.11, 0.05, 20, "undecided"),
    (0.05, 0.11, 20, "undecided"), (0.11, 0.2, 20, "coloured"), (-0.2, -0.11, 20, "coloured"),
    (0.1, 0.2, 20, "undecided"), (-0.2, -0.1, 20, "undecided")])
def test_white_by_the_interval(low: float, high: float, n: int, word: str) -> None:
    assert claims.white(st.Intervals(*(np.array(v) for v in ((low + high) / 2, low, high, 0.0, n)))) == word


def above(value: float) -> float:
    return float(np.nextafter(value, 9.0))


def below(value: float) -> float:
    return float(np.nextafter(value, -9.0))


@pytest.mark.parametrize(("value", "word"), [
    (1.1, "consistent"), (above(1.1), "too sure"), (0.9, "consistent"), (below(0.9), "too cautious")])
def test_claims_at_their_thresholds(value: float, word: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs that all agree: the interval is the value, to the bit. From 20 runs on there is a verdict."""
    for n, said in ((20, word), (19, "undecided")):
        monkeypatch.setattr(claims, "hall", lambda *_, n=n, **__: st.Intervals(value, value, value, 0.0, n))  # type: ignore
        assert claims.consistency(np.full(n, 7.0)) == claims.Claim(value, value, value, n, said, "")  # type: ignore
        bound = claims.bounded(np.full(n, 7.0), np.array([value, np.nan]))
        assert bound == claims.Bounded(value, value, value, value, n, "kept")
        for limit, found in ((below(value), "broken"), (above(value), "kept")):
            assert getattr(claims.bounded(np.full(n, 7.0), np.array([limit])), "verdict", "") == found
    monkeypatch.setattr(claims, "share", lambda *_: st.Share(0.9, 0.95, 0.99, 5))
    said = claims.consistency(np.append(np.full(19, 2.0), INF), [1.0])
    assert (said.verdict, said.note) == ("undecided",
                                         "singular claim with an error in 1 of 20 runs; few steps carry the mean")
    for low, high, n in ((above(0.95), 0.99, 5), (0.9, below(0.95), 5), (0.9, 0.99, 0)):
        monkeypatch.setattr(claims, "share", lambda *_, found=st.Share(0.9, low, high, n): found)
        assert claims.consistency(np.array([INF])).verdict == "too sure"


@pytest.mark.parametrize("hits", [0, 3, 4, 5, 50, 95, 96, 100])
def test_required_shares_at_their_limits(hits: int) -> None:
    """To the bit; from five of the rarer outcome on the interval is that of the runs' own spread."""
    flags = (np.arange(100) < hits).astype(float)
    found, z, t = st.share(flags), 1.959963984540054, 1.9842169515086827
    if 5 <= hits <= 95:
        p, variance = hits / 100, flags.var(ddof=1) / 100
        size = p * (1 - p) / variance * (z / t) ** 2
        limits = (beta.ppf(0.025, p * size, size - p * size + 1), beta.ppf(0.975, p * size + 1, size - p * size))
    else:
        middle, half = hits / 100 + z * z / 200, z * np.sqrt(hits * (100 - hits) / 1e6 + z * z / 4e4)
        limits = (middle - half) / (1 + z * z / 100), (middle + half) / (1 + z * z / 100)
    assert found == pytest.approx((hits / 100, *np.clip(limits, 0, 1), 100), abs=1e-9)
    for least in (found.low, above(found.low or 0.01), found.high, above(found.high)):
        word = "met" if least <= found.low else "undecided" if least <= found.high else "not met"
        assert claims.requirement(flags, least).verdict == word


def test_until_when() -> None:
    assert rule("decided", 800) == Rule((), 800) and rule(" rmse:x=2% ,nees:y=1e-3", 9) == Rule(
        (Precision("rmse", "x", 0.02, True), Precision("nees", "y", 0.001, False)), 9)
    for text in ("rmse:x=1e", "rmse:x=0", "rmse:x=inf", "x=1", "rmse:x=1%,"):
        with pytest.raises(InputError, match=f"--until {text}: expected decided, or a half interval such as rmse:"):
            rule(text, 9)
    decided, narrow = Rule((), 800), rule("rmse:x=2%,rmse:y=0.5", 150)
    assert (decided.looks, decided.level, narrow.looks, narrow.level) == ([100, 200, 400, 800], 0.0125, [50, 100, 150],
                                                                         0.05)
    assert Rule((), 100).looks == [100] and rule("rmse:x=1%", 50).looks == [50] and Rule((), 7).looks == [7]
    assert decided.reached() == "every verdict is decided"
    assert narrow.reached() == "every half interval is within 2 % of rmse:x, 0.5 of rmse:y"
    assert decided.about() == "looks at 100, 200, 400, 800 runs; intervals of ratios cover 98.8 %"
    assert narrow.about() == "looks at 50, 100, 150 runs"


def test_what_is_missing_until_then() -> None:
    x = np.array([1.0, 1.2, 0.8, 1.1, 0.9])
    frame, about = rows({"a": x**2, "b": (2 * x + [0, 0, 0, 0, 3])**2}), manifest(["a", "b"])
    found = st.rooted(st.hall(np.array([x, 2 * x + [0, 0, 0, 0, 3]])**2, positive=True))
    half = (found.high - found.low) / 2
    said = f"b has rmse x {100 * found.value[1]:.4g} +- {100 * half[1]:.2g} cm"
    wide, near = f"rmse:x={half.max() * 1.001}", f"rmse:x={half.max() * 0.999}"
    assert (rule(wide, 9).missing(frame, about), rule(near, 9).missing(frame, about)) == ("", said)
    share = half[1] / found.value[1]
    assert rule(f"rmse:x={101 * share}%", 9).missing(frame, about) == ""
    assert rule(f"rmse:x={99 * share}%", 9).missing(frame, about) == said
    one = frame[(frame["run"] == 0) | (frame["estimator"] == "a")]  # b with one run: no interval is narrow enough
    assert rule("rmse:x=9", 9).missing(one[one["run"] == 0], about) == "a has rmse x 100 +- nan cm"
    with pytest.raises(InputError, match=r"--until rmse:y: is not measured in s/v; allowed: rmse:x and other columns"):
        rule("rmse:y=1", 9).missing(frame, about)
    assert Rule((), 9).missing(frame, about) == "1 of 2 verdicts are undecided"
    double = rows({"a": np.tile(x, 8)**2, "b": 4 * np.tile(x, 8)**2})
    assert Rule((), 9).missing(double, about) == ""
    some = first_runs(double, "s/v", ["b"], 3)
    assert (some["estimator"].tolist(), some["run"].tolist()) == (["b"] * 3, [0, 1, 2])


def test_what_is_compared_with_what() -> None:
    entry = {"plugin": "ekf"}
    about: dict[str, Any] = {"configuration": {"cells": {
        "s/v": {"estimators": {"a": {"plugin": "odd"}, "b": {"plugin": "ukf"},
                               "c": {"plugin": "ukf", "late": "as-new"}}},
        "s/w": {"estimators": {"d": {"plugin": "ukf"}, "e": entry}}, "z/v": {"estimators": {"f": entry}},
        "s2/v": {"estimators": {"g": {"plugin": "needy"}}}}},
        "estimators": {"odd": {"oracle": True}, "ukf": {"smoother": False}, "ekf": {"smoother": True},
                       "needy": {"needs": ["reception"], "oracle": False}}}
    assert yardsticks(about, "s") == ["b", "c", "d"] and yardsticks(about, "z") == ["f"]
    assert yardsticks(about, "s2") == []
    assert apart(about, "s", "v") == {"a": "oracle"} and apart(about, "s", "w") == {"e": "smoother"}
    assert grounds(about, "s", "v") == {"a": "covariance", "b": "covariance", "c": "as-new"}
    assert grounds(about, "s2", "v") == {"g": "guarantee"}
    frame = pd.DataFrame({"mae:y:m": [1.0], "rmse:x:m": [1.0], "mae:x:m": [2.0], "rmse:y:m": [NAN], "nees:x:1": [1.0]})
    table = {"table": [["nees", "x"], ["rmse", "y"], ["mae", "x"], ["mae", "y"], ["rmse", "x"], ["max", "z"]]}
    assert judged_columns(frame, table) == [("mae:x:m", "mae", "x", "m"), ("mae:y:m", "mae", "y", "m")]


def test_two_of_a_folder_and_rows_to_the_bit() -> None:
    x = np.linspace(1.0, 2.0, 30)
    frame = pd.concat([rows({"a": x, "b": 4 * x, "c": x}), rows({"a": x}).assign(variant="w")], ignore_index=True)
    about = manifest(["a", "b", "c"])
    about["scenarios"]["s"]["variants"]["w"] = {}
    (found,) = between_estimators(frame, about, "a", "b")
    assert (found.cell, found.label, found.verdict, found.lost) == ("s/v", "", "worse", False)
    assert (found.a["estimator"], found.a["verdict"], found.b["against"], found.b["ratio"]) == (
        "a", "reference", "a", pytest.approx(2.0))
    assert between_estimators(frame[frame["run"] == 0], about, "a", "b") == []
    first = pd.DataFrame({"x": [1.0, NAN, 3.0, 4.0], "seconds": 1.0, "exception": "", "side": "a",
                          "more": [1.0, NAN, NAN, NAN]})
    second = pd.DataFrame({"x": [1.0, NAN, 3.0, 5.0], "seconds": 2.0, "exception": "e", "side": "b"})
    assert same_rows(first, second).tolist() == same_rows(second, first).tolist() == [False, True, True, False]
    timing = pd.DataFrame({"scenario": "s", "variant": "v", "estimator": ["a", "b"], "throughput_ns": [2.0, NAN]})
    assert speed_ratio(timing, timing.assign(throughput_ns=[3.0, 1.0])) == {("s/v", "a"): 1.5}
    assert speed_ratio(None, timing) == speed_ratio(timing, None) == {}


def test_the_least_error_beside_an_error() -> None:
    errors, least = np.tile([2.0, 4.0, NAN, 3.0], 5), np.tile([1.0, 2.0, 5.0, 1.0], 5)
    frame = rows({"a": errors**2, "b": 0 * errors}, floor__x__m={"a": least, "b": least})
    aligned = Aligned(frame)
    line = {"metric": "rmse", "quantity": "x", "unit": "m", "value": 3.0, "note": "n"}
    assert floors.floored(line, aligned, 0, "floor") == {**line, "floor": 2**0.5, "floor_kind": "floor",
                                                         "efficiency": 2**0.5 / 3}
    assert floors.floored({**line, "value": 1e-9}, aligned, 0, "floor") == {**line, "value": 1e-9, "floor": 2**0.5,
                                                                          "floor_kind": "floor"}
    for kind, changes in (("", {}), ("floor", {"metric": "mae"}), ("floor", {"quantity": "y"})):
        assert floors.floored({**line, **changes}, aligned, 0, kind) == {**line, **changes}
    gap = (least**2 - errors**2)[~np.isnan(errors)]
    assert floors.beneath(errors, least) == pytest.approx(gap.mean() / (gap.std(ddof=1) / 15**0.5))
    assert floors.beneath(errors[:1], least[:1]) == floors.beneath(np.ones(3), 2 * np.ones(3)) == 0.0
    under = np.tile([0.99, 1.0, 0.98], 10)
    low = Aligned(rows({"a": under**2}, floor__x__m={"a": np.ones(30) + np.tile([0.0, 1e-3], 15)}))
    assert floors.floored({**line, "value": 1.0}, low, 0, "floor")["note"] == f"n; {floors.UNDER_NOTE}"
    assert floors.floored({**line, "value": 1.0}, low, 0, "linear optimum")["note"] == "n"
    found = list(floors.floor_lines(aligned))
    assert [(column[1], label) for column, label, _ in found] == [("floor", "a"), ("efficiency", "a"), ("floor", "b")]
    whole, error = (st.rooted(st.hall(v**2, positive=True)) for v in (least, errors))
    assert found[0][2] == {"value": 2**0.5, "low": whole.low, "high": whole.high, "standard_error": whole.error,
                           "runs": 20}
    assert found[1][2] == pytest.approx({
        "value": 2**0.5 / error.value, "low": 2**0.5 / error.high, "high": 2**0.5 / error.low, "runs": 20,
        "standard_error": 2**0.5 / error.value * error.error / error.value})
    few = list(floors.floor_lines(Aligned(frame[frame["run"] < 4])))  # their interval begins at 0
    assert few[1][2]["high"] == INF and few[1][2]["low"] > 0


def test_requirements_of_which_a_folder_has_no_column_have_no_line() -> None:
    about = manifest(["a"])
    about["scenarios"]["s"]["variants"]["v"] = {"requirements": [
        {"name": name, "per": per, "accept": 0.9, "form": "stop"} for name, per in (
            ("gone", "runs"), ("kept", "runs"), ("inside", "time"))]}
    frame = rows({"a": np.append(np.ones(39), NAN)}, kept__kept__1={"a": np.append(np.ones(39), NAN)},
                 inside__inside__1={"a": np.append(np.full(39, 0.95), NAN)})
    found = verdicts(frame, about)
    found = found[found["kind"] == "requirement"]
    assert found[["metric", "quantity", "against", "runs"]].to_numpy().tolist() == [
        ["kept", "kept", "0.9", 40], ["inside", "inside", "0.9", 40]]
    assert found["value"].tolist() == [0.975, pytest.approx(0.95 * 39 / 40)]  # a lost run has kept nothing
