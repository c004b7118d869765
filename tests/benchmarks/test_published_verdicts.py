"""Where a printed number's verdict turns as it moves away from ours: thresholds to the bit, one run's numbers by
formulas of the test's own."""

from __future__ import annotations

import numpy as np
import pytest
from railstate.benchmarks.published.files import Trial
from railstate.benchmarks.published.rows import Found
from railstate.benchmarks.published.verdicts import judge, together

from .test_reproduce import cell


@pytest.mark.parametrize(("changes", "found", "turns", "room"), [
    ({"absolute": 1.0}, Found(1.0, 0.125), (0.625, 1.375), 1.0),
    ({"trials": 4}, Found(1.0, 0.125, 1.0), (0.625, 1.375), 1.0),
    ({"trials": 16, "absolute": 0.25}, Found(1.0, 0.0625, 0.5), (0.3125, 0.6875), 0.5),
    ({"absolute": 0.5}, Found(1.0), (0.5, 0.5), 0.5),
])
def test_where_verdicts_turn(changes: dict[str, object], found: Found, turns: tuple[float, float], room: float) -> None:
    """At three standard errors on either side of what is accepted, to the bit; a claim at two."""
    for away, verdict in ((turns[0], "reproduced"), (np.nextafter(turns[1], 9.0) + 1e-9, "not reproduced"),
                          *([(turns[0] + 1e-9, "undecided"), (turns[1], "undecided")] if found.error else [])):
        for sign in (1, -1):
            judged = judge(cell(published=1.0 + sign * away, **changes), found)
            assert (judged.verdict, *judged[2:4]) == (verdict, 1 - room, 1 + room)
            assert judged[:2] == (1.0, found.error) or (not found.error and np.isnan(judged.error))


@pytest.mark.parametrize(("at", "verdict"), [(1.25, "reproduced"), (1.2499, "undecided"), (0.75, "undecided"),
                                             (0.7499, "not reproduced")])
def test_where_claims_turn(at: float, verdict: str) -> None:
    for bound, range_, value in (({"at_most": at}, (-np.inf, at), 1.0), ({"at_least": -at}, (-at, np.inf), -1.0)):
        assert judge(cell(published="<", **bound), Found(value, 0.125)) == (value, 0.125, *range_, verdict)


@pytest.mark.parametrize("n", [80, 400])
def test_where_a_number_of_one_run_turns(n: int) -> None:
    """Wilson's interval of the share of runs at least as far out, on the nearer side, about a fortieth."""
    z, runs = 1.959963984540054, np.arange(float(n))
    runs[n // 2:] += 1.0  # an even number of runs and a gap: no symmetry about a run
    seen = set[str]()
    for printed in np.r_[-3:25:0.5, n - 25:n + 3:0.5]:
        judged = judge(cell(published=float(printed), trials=1, absolute=0.5), Found(7.0, 0.5, 1.0, runs))
        share = min(np.sum(runs <= printed + 0.5), np.sum(runs >= printed - 0.5)) / n
        middle, half = share + z * z / (2 * n), z * np.sqrt(share * (1 - share) / n + (z / (2 * n)) ** 2)
        least, most = ((middle + sign * half) / (1 + z * z / n) for sign in (-1, 1))
        assert judged.verdict == ("reproduced" if least > 0.025 else "not reproduced" if most < 0.025 else "undecided")
        assert judged[2:4] == pytest.approx((0.025 * (n - 1) - 0.5, 0.975 * (n - 1) + 1.5))
        seen.add(judged.verdict)
    assert len(seen) == (3 if n == 400 else 2)  # none of 80 does not show that it is less than a fortieth


@pytest.mark.parametrize(("n", "away"), [(18, 0.0), (19, 0.0), (19, 9.0), (60, 3.0), (80, 9.0), (300, 2.1), (300, 2.6)])
def test_numbers_of_one_run_by_hand(n: int, away: float) -> None:
    """Three numbers, rounded to halves; ties with the print count as beyond it; one run that has no value is no run."""
    drawn = np.random.default_rng(4).normal(size=(3, n + 1)) * [[1.0], [3.0], [0.1]]
    drawn[1, 0], printed = np.nan, [away, -3 * away, 0.1]
    judged = together(Trial(expected="fitted", rounding=0.5), [cell(published=v, agrees="fitted") for v in printed],
                      [Found(0, 0, 1, row) for row in drawn])
    pool = np.rint(2 * np.column_stack([drawn[:, 1:], printed]))
    shifted = pool - pool.mean(axis=1)[:, None]
    inverse = np.linalg.inv(np.cov(pool) + np.diag([1 / 12] * 3))
    squared = [one @ inverse @ one for one in shifted.T]
    beyond = sum(one > squared[-1] - 1e-6 for one in squared[:-1])
    z, p = 1.959963984540054, beyond / n
    half = z * np.sqrt(p * (1 - p) / n + (z / (2 * n)) ** 2)
    least, most = ((p + z * z / (2 * n) + sign * half) / (1 + z * z / n) for sign in (-1, 1))
    word = "undecided" if n == 18 or least <= 0.05 <= most else "fitted" if least > 0.05 else "not reproduced"
    assert judged and judged == pytest.approx((p, np.sqrt(p * (1 - p) / n), 0.05, 1.0, word))
    assert word == {(18, 0.0): "undecided", (19, 0.0): "fitted", (19, 9.0): "undecided", (60, 3.0): "undecided",
                    (80, 9.0): "not reproduced", (300, 2.1): "undecided", (300, 2.6): "not reproduced"}[n, away]


def test_numbers_of_other_runs_are_not_judged_together() -> None:
    """One alone, one that there is no number for, one that is exact, runs of another count."""
    trial, cells, some = Trial(expected="fitted", rounding=0.5), [cell()] * 2, Found(0, 0, 1, np.arange(30.0))
    for found in ([some], [some, None], [some, Found(1.0)], [some, Found(0, 0, 1, np.arange(29.0))]):
        assert together(trial, cells[:len(found)], found) is None
    assert together(trial, cells, [some, Found(0, 0, 1, np.arange(30.0) ** 2)]) is not None
