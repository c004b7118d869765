"""What `compare` prints and fails on, of comparisons made by hand: tables, sentences, speeds, limits to the bit."""

from __future__ import annotations

from typing import Any

import pytest
from railstate.benchmarks.commands import compare
from railstate.benchmarks.commands.compare import DIFFERENT, WORSE, Limit
from railstate.benchmarks.judging.comparison import Alike, Changes, Comparison
from railstate.scenarios.errors import InputError

from .test_worded import line, ratio


def pair(label: str, verdict: str, value: float, low: float, high: float, **facts: Any) -> Comparison:
    """Of 40 runs, B's error `value` times A's of 1 cm."""
    return Comparison("s/v", label, line("a", 0.01, 0.0012, verdict="reference"), line(
        "b", 0.01 * value, 0.002, **ratio(value, low, high, verdict), won=0.375, **facts))


def losing(verdict: str, a: float, b: float) -> Comparison:
    return Comparison("s/v", "", *(line(label, share, kind="reliability", metric="lost", quantity="runs",
                                        verdict=verdict) for label, share in (("a", a), ("b", b))))


def test_what_is_printed(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    found = [pair("ekf", "worse", 1.5, 1.25, 1.75), pair("ukf", "tie", 1.001, 0.999, 1.002, note="odd"),
             pair("ckf", "undecided", 0.9, 0.75, 1.1, deciding=320.0), losing("better", 0.25, 0.0)]
    speed = {("s/v", "ekf"): 2.0, ("s/v", "ukf"): 0.25, ("s/v", "ckf"): 1.04, ("s/v", ""): 1.05, ("s/v", "none"): 3.0,
             ("s/w", "ekf"): 3.0}
    compare._print_comparisons(found, "A", "B", speed)
    said = [" ".join(text.split()) for text in capsys.readouterr().out.splitlines()]
    assert said[0] == "B (B) against A (A), paired"
    assert said[-9:] == [
        "s/v/ekf: position rmse: B is worse than A, +50 % [+25, +75], with the lower error in 38 % of the runs",
        "s/v/ukf: position rmse: a tie within 1 %, B +0.1 % [−0.1, +0.2] against A; odd",
        "s/v/ckf: position rmse: undecided, B −10 % [−25, +10] against A; about 320 runs would decide",
        "s/v: B ends well in 100 % of the runs, A in 75 % (40 runs)",
        "s/v/ekf: B is 2.0 times slower than A (time per run and step)",
        "s/v/ukf: B is 4.0 times faster than A (time per run and step)",
        "s/v/ckf: B is as fast as A (time per run and step)",
        "s/v: B is 1.1 times slower than A (time per run and step)",
        "B against A: better in 1, worse in 1, tie in 1, undecided in 1 of 4 comparisons"]
    assert [list(compare._line(each).values()) for each in found] == [
        ["s/v", "ekf", "rmse position [cm]", "1.00 ± 0.12", "1.50 ± 0.20", "1.50", "1.25 .. 1.75", "+50 %", "38 %",
         "40", "worse"],
        ["s/v", "ukf", "rmse position [cm]", "1.00 ± 0.12", "1.00 ± 0.20", "1.00", "1.00 .. 1.00", "+0.1 %", "38 %",
         "40", "tie"],
        ["s/v", "ckf", "rmse position [cm]", "1.00 ± 0.12", "0.90 ± 0.20", "0.90", "0.75 .. 1.10", "−10 %", "38 %",
         "40", "undecided"],
        ["s/v", "runs lost", "25 %", "0 %", "", "", "", "", "40", "better"]]
    assert list(compare._line(found[0])) == ["cell", "estimator", "what", "A", "B", "B / A", "95 % interval", "change",
                                             "B lower in", "runs", "B is"]
    compare._print_comparisons([], "A", "B", speed)
    assert capsys.readouterr().out == ""


def test_rows_of_two_folders(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    alike = [Alike("s/v", "a", 5, 4, 1, 0), Alike("s/w", "b", 1, 1, 2, 7)]
    compare._print_rows(Changes(alike, [], ["seed: 1 -> 2", "odd"]), "A", "B")
    said = [" ".join(text.split()) for text in capsys.readouterr().out.splitlines()]
    assert said[:3] == ["seed: 1 -> 2", "odd", "rows of A and B"] and said[-4:] == [
        "s/v a 5 4 1 1 0", "s/w b 1 1 0 2 7", "", "5 of 6 common rows bit-identical; 3 only in A, 7 only in B"]
    for left, right, words in ((0, 1, "; 0 only in A, 1 only in B"), (1, 0, "; 1 only in A, 0 only in B"), (0, 0, "")):
        changes = Changes([Alike("s/v", "a", 1, 1, left, right)], [], [])
        assert changes.identical == (left == right)
        compare._print_rows(changes, "A", "B")
        assert capsys.readouterr().out.splitlines()[-1] == f"1 of 1 common row bit-identical{words}"
    assert not Changes([Alike("s/v", "a", 2, 1, 0, 0)], [], []).identical


def test_what_it_fails_on() -> None:
    for text, limit in (("worse", WORSE), ("different", DIFFERENT), ("rmse:x>5%", Limit("larger", "rmse", "x", 0.05)),
                        ("sum-squared:x_1 > 12.5 %", Limit("larger", "sum-squared", "x_1", 0.125))):
        assert compare._limit(text) == limit
    for text in ("rmse:x>5", "rmse>5%", "RMSE:x>5%", "rmse:x>-5%", "better", "rmse:x>.5%", "rmse:x>5%!"):
        with pytest.raises(InputError) as caught:
            compare._limit(text)
        assert str(caught.value) == (f"--fail-on {text}: expected worse, different, or METRIC:QUANTITY>PERCENT%, such "
                                     "as rmse:position>5%")
    worse, better = pair("", "worse", 1.5, 1.25, 1.75), pair("", "better", 0.5, 0.25, 0.75)
    lost, speed = losing("worse", 0.0, 0.5), pair("", "worse", 3.0, 2.0, 4.0, quantity="speed")
    said = {id(each): compare.words(each, "A", "B") for each in (worse, better, lost, speed)}
    found = [worse, better, speed, lost]

    def failures(limit: Limit, different: bool = False, of: list[Comparison] = found) -> list[str]:
        return compare._failures(limit, of, different, "A", "B")

    assert failures(WORSE) == [said[id(each)] for each in (worse, speed, lost)]
    assert failures(DIFFERENT, True) == ["rows of B differ from those of A"] and failures(DIFFERENT) == []
    assert failures(Limit("larger", "rmse", "position", 0.25)) == [said[id(lost)]]  # it reaches 25 %, not beyond
    under = 0.25 - 2.0**-52
    assert failures(Limit("larger", "rmse", "position", under)) == [said[id(worse)], said[id(lost)]]
    assert failures(Limit("larger", "rmse", "position", 0.3), of=[worse, losing("better", 0.5, 0.0)]) == []
    assert failures(Limit("larger", "mae", "x", 0.1), of=[lost]) == [said[id(lost)]]  # nothing else to go by
    for limit in (Limit("larger", "mae", "position", 0.1), Limit("larger", "rmse", "height", 0.1)):
        with pytest.raises(InputError) as caught:
            failures(limit)
        assert str(caught.value) == (f"--fail-on {limit.metric}:{limit.quantity}: not among what is compared: "
                                     "rmse:position, rmse:speed")
