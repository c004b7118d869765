"""What is said of innovations, against a naive loop over steps, runs and elements."""

from __future__ import annotations

from math import log, pi, sqrt

import numpy as np
import pytest
from railstate.benchmarks.scoring.innovations import InnovationScore
from railstate.estimators.interface import Innovation
from railstate.scenarios.measurement import Measurement

STEPS, RUNS, SKIP = 12, 5, 2


@pytest.mark.parametrize("told", [True, False], ids=["told logarithms", "by the residuals"])
@pytest.mark.parametrize("shared", [True, False])
def test_every_number_is_that_of_a_naive_loop(shared: bool, told: bool) -> None:
    rng = np.random.default_rng(3)
    score = InnovationScore(RUNS, STEPS, SKIP)
    nis, elements, likelihood, likely, lag, square, pairs = np.zeros((7, RUNS))
    curve = np.zeros((STEPS, 2))
    last: dict[tuple[int, int], float] = {}
    for k in range(STEPS):
        residual = rng.normal(0, 2, (2, RUNS))
        variance = rng.uniform(0.1, 5, (2, 1 if shared else RUNS))
        received, active = rng.uniform(size=(2, RUNS)) < 0.7, rng.uniform(size=RUNS) < 0.9
        said = np.where(rng.uniform(size=RUNS) < 0.2, np.nan, rng.normal(size=RUNS)) if told else None
        score.add(k, active, Measurement(np.zeros((2, RUNS)), received, k + 1), Innovation(residual, variance, said))
        for s in range(RUNS if k >= SKIP else 0):
            for j in range(2):
                if not (received[j, s] and active[s]):
                    continue
                v = variance[j, 0 if shared else s]
                z = residual[j, s] / sqrt(v)
                nis[s] += z**2
                elements[s] += 1
                curve[k] += z**2, 1
                if not told:
                    likelihood[s] -= 0.5 * (z**2 + log(2 * pi * v))
                    likely[s] += 1
                if (j, s) in last:
                    lag[s] += z * last[j, s]
                    square[s] += (z**2 + last[j, s]**2) / 2
                    pairs[s] += 1
                last[j, s] = z
            count = (received[:, s] & active[s]).sum()
            if said is not None and count and not np.isnan(said[s]):
                likelihood[s] += said[s]
                likely[s] += count
    found = score.finish()
    expected = {"nis": nis / elements, "elements": elements, "whiteness": lag / square, "pairs": pairs,
                "log-likelihood": likelihood / likely}
    assert set(found) == {(name, "innovation") for name in expected}
    for name, values in expected.items():
        np.testing.assert_allclose(found[name, "innovation"], values, rtol=1e-12)
    np.testing.assert_allclose(score.curve, curve, rtol=1e-12)


def test_what_is_not_told_is_not_there() -> None:
    score, received = InnovationScore(1, 3, 0), np.ones((1, 1), dtype=bool)
    assert score.finish() == {}
    score.add(0, np.ones(1, dtype=bool), Measurement(np.zeros((1, 1)), received, 1),
              Innovation(None, None, np.array([-2.0])))
    found = score.finish()
    assert set(found) == {("log-likelihood", "innovation")} and found["log-likelihood", "innovation"] == [-2.0]
