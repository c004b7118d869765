"""What robust filters make of one reading, by hand: weights, alarms where they begin, gates that open again."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from railstate.estimators.outliers.base import Reading, ratio_limit
from railstate.estimators.outliers.kernels import correct
from railstate.estimators.outliers.reopening import Memory, Reopening
from railstate.estimators.registry import estimators
from railstate.scenarios.errors import InputError

NAN = np.nan
MODEL: Any = SimpleNamespace(measurements=("a", "b"), ny=2, nx=2)


def reading(residual: list[float], spread: float = 3.0, noise: float = 1.0, element: int = 0, time: Any = 0.0,
            received: list[bool] | None = None) -> Reading:
    n = len(residual)
    return Reading(element, np.array(residual), np.full(n, spread), np.full(n, noise),
                   np.ones(n, dtype=bool) if received is None else np.array(received), time)


def made(plugin: str, parameters: dict[str, Any], runs: int) -> Any:
    found: Any = estimators()[plugin](parameters)
    found.model, found.runs = MODEL, runs
    if plugin in ("gate", "soft-gate"):
        found._memory, found._limit = Memory(found.parameters, MODEL, runs), ratio_limit(0.99)
    return found


def test_where_alarms_begin() -> None:
    noise, weight, alarm = made("huber", {}, 5).weigh(reading([0.0, 2.69, -5.38, 5.39, 53.8]))
    assert noise == pytest.approx([1, 1, 2, 5.39 / 2.69, 20]) and alarm.tolist() == [0, 0, 0, 1, 1]
    assert (weight == 1).all()
    noise, weight, alarm = made("mcc", {}, 4).weigh(reading([0.0, 7.06, 7.07, 200.0]))
    assert noise == pytest.approx([1, math.exp(7.06**2 / 72), math.exp(7.07**2 / 72), 1e12])
    assert alarm.tolist() == [0, 0, 1, 1] and (weight == 1).all()
    for plugin, parameters, residual in (("huber", {"threshold": 1.0}, 2.0),
                                         ("mcc", {"bandwidth": 1.0}, math.sqrt(2 * math.log(2)))):
        noise, _, alarm = made(plugin, parameters, 1).weigh(reading([residual], 0.5, 0.5))
        assert noise.tolist() == [1.0] and alarm.tolist() == [0]  # a weight of one half is no alarm
    noise, weight, alarm = made("student-t", {}, 40).weigh(reading(np.linspace(0, 9, 40).tolist()))
    assert (alarm == (noise > 2)).all() and 3 < alarm.sum() < 37 and (weight == 1).all()
    roth = made("student-t-roth", {}, 3)
    roth._scale, roth._square, roth._count = 1 / 3, np.zeros(3), np.zeros(3)
    noise, weight, alarm = roth.weigh(reading([3.0, 3.01, 9.0], 0.5, 1.5, received=[True, True, False]))
    assert noise.tolist() == [0.5] * 3 and alarm.tolist() == [0, 1, 1] and (weight == 1).all()
    assert roth._square == pytest.approx([9.0, 3.01**2, 0.0]) and roth._count.tolist() == [1, 1, 0]
    learning = made("adaptive-r", {"method": "sage-husa", "rho": 0.5}, 4)
    learning._learned = np.array([[NAN, 2.0, NAN, 4.0], [NAN] * 4])
    noise, weight, alarm = learning.weigh(reading([2.0**0.5 * 3**0.5, 5**0.5, 0.0, 9.0],
                                                  received=[True, True, True, False]))
    assert noise == pytest.approx([2.0, 2.0, 1e-3, 41.0]) and alarm.tolist()[2:] == [0, 1]
    assert learning._learned[0] == pytest.approx([2.0, 2.0, 1e-3, 4.0]) and np.isnan(learning._learned[1]).all()
    learning = made("adaptive-r", {"rho": 0.75, "iterations": 1}, 2)
    learning._learned = np.full((2, 2), NAN)
    noise, _, alarm = learning.weigh(reading([0.0, 12.0]))  # alpha = 2, beta- = 1.5, K = 3/4
    assert noise == pytest.approx([(1.5 + 0.375) / 2, (1.5 + (9 + 0.75) / 2) / 2]) and alarm.tolist() == [0, 1]


def test_soft_and_hard_gates() -> None:
    given = reading([0.0, 5.0, 6.0, 7.0, 20.0])
    noise, weight, alarm = made("gate", {"reopen": "never"}, 5).weigh(given)
    assert weight.tolist() == [1, 1, 0, 0, 0] and alarm.tolist() == [0, 0, 1, 1, 1] and noise.tolist() == [1] * 5
    good, bad = (share * np.exp(-given.residual**2 / 2 / var) / var**0.5 for share, var in ((0.95, 4.0), (0.05, 404.0)))
    beta = good / (good + bad)
    noise, weight, alarm = made("soft-gate", {"reopen": "never"}, 5).weigh(given)
    assert weight == pytest.approx(beta) and alarm.tolist() == (beta < 0.5).tolist() and noise.tolist() == [1] * 5
    assert 0 < alarm.sum() < 5
    open_ = made("soft-gate", {"reopen": "time", "after": 2.0}, 2)
    for time, opened in ((0.0, False), (1.5, False), (2.0, True), (2.5, True)):
        _, weight, alarm = open_.weigh(reading([20.0, 0.0], time=time))
        assert alarm.tolist() == [not opened, False] and (weight[0] == 1.0) == opened and weight[1] > 0.99
    only = made("gate", {"reopen": "never", "sensors": ["b"]}, 2)
    assert [only.weigh(reading([99.0, 0.0], element=j)).weight.tolist() for j in (0, 1)] == [[1, 1], [0, 1]]


def test_the_memory_of_a_gate() -> None:
    """Of a ring of the last residuals those rejected, as many as are needed, as near their median as is asked."""
    memory = Memory(Reopening(memory=4, needed=2, near=1.0), MODEL, 3)
    for residual, outside in (([10.0, 10, 10], [1, 1, 1]), ([0.0, 0, 0], [0, 0, 0]), ([12.0, 12.1, 12], [1, 1, 1])):
        given = reading(residual, noise=1.0, received=[True, True, False])
        assert memory.rejected(given, np.array(outside, dtype=bool)).tolist() == [bool(one) for one in outside]
    np.testing.assert_array_equal(memory.ring[:, 0], [[NAN] * 3, [10, 10, NAN], [NAN] * 3, [12, 12.1, NAN]])
    assert np.isnan(memory.ring[:, 1]).all()
    agreed, mean, count = memory.found(given)
    assert agreed.tolist() == [1, 0, 0] and mean.tolist() == [11, 0, 0] and count.tolist() == [2, 0, 0]
    assert np.isnan(memory.ring[:, 0, 0]).all() and memory.ring[3, 0, 1] == 12.1
    memory.ring[:, 0, 1] = [0.0, 10.0, 10.5, 30.0]
    agreed, mean, count = memory.found(given)
    assert (agreed[1], mean[1], count[1]) == (True, 10.25, 2.0)
    together = Memory(Reopening(reopen="time", after=2.0, together=("b", "a"), sensors=("b", "a")), MODEL, 1)
    assert together.judged == [1, 0] and together.together.tolist() == [[1, 1]] * 2 and together.ring.shape == (0, 2, 1)
    each = Memory(Reopening(reopen="time", sensors=("b",)), MODEL, 1)
    assert each.is_judged.tolist() == [0, 1] and each.together.tolist() == [[1, 0], [0, 1]]
    with pytest.raises(InputError, match=r"^asked: there is no measurement c, d; allowed: a, b$"):
        Memory(Reopening(sensors=("c", "a", "d")), MODEL, 1, "asked")
    for given_, said in (({"needed": 5, "memory": 4}, "needed = 5 cannot be more than memory = 4"),
                         ({"reopen": "time", "together": ("a",), "sensors": ("b",)}, "together must be among sensors")):
        with pytest.raises(ValueError, match=said):
            Reopening(**given_)
    assert Reopening(needed=4, memory=4).needed == 4


def test_where_a_gate_that_opens_goes() -> None:
    """The element of the state that the reading speaks of most, by the mean residual; the other runs stay."""
    gate = made("gate", {"reopen": "median"}, 2)
    gate._memory = SimpleNamespace(parameters=gate.parameters, found=lambda given: (
        np.array([False, True]), np.array([5.0, 6.0]), np.array([3.0, 4.0])))
    MODEL.measurement_jacobian = lambda x, at: np.array([[[9.0], [9.0]], [[0.5], [-2.0]]])
    gate._mean, gate._covariance = np.array([[1.0, 1], [2, 2]]), np.arange(8.0).reshape(2, 2, 2)
    gate.taken(reading([0.0, 0.0], noise=8.0, element=1), None)
    assert gate._mean.tolist() == [[1, 1], [2, 2 - 3]]
    assert gate._covariance[..., 0].tolist() == [[0, 2], [4, 6]]
    assert gate._covariance[..., 1].tolist() == [[1, 0], [0, 7 + 8 / 4 / 4]]


def test_a_reading_whose_innovation_has_no_variance_fails_its_run_alone() -> None:
    """Where it is received and has a weight; the others are corrected, those that failed stay as they are."""
    mean, covariance, failed = np.ones((1, 5)), np.ones((1, 1, 5)), np.zeros(5, dtype=bool)
    variance, weight = np.array([2.0, 0.0, -1.0, np.nan, 0.0]), np.array([1.0, 1.0, 1.0, 1.0, 0.0])
    received = np.array([True, True, False, True, True])
    assert correct(mean, covariance, np.ones((1, 1)), np.ones((1, 5)), np.full(5, 4.0), variance, np.ones(5), weight,
                   received, failed) == 2
    assert failed.tolist() == [False, True, False, True, False]
    assert mean.tolist() == [[3.0, 1.0, 1.0, 1.0, 1.0]] and covariance.tolist() == [[[0.5, 1.0, 1.0, 1.0, 1.0]]]


def test_curvature_is_the_jacobian_s_differences() -> None:
    """Points at 1e-4 of each state to either side, or of 1; half the traces of H_i P and of H_i P H_j P."""
    rng = np.random.default_rng(3)
    half, asked = rng.normal(size=(3, 2, 2)), list[np.ndarray]()
    H, root = half + half.swapaxes(1, 2), rng.normal(size=(2, 2, 4))
    P, x = np.einsum("abs,cbs->acs", root, root), np.array([[0.5, -1.0, 1.25, -3e3], [0.0, 40.0, -0.75, 2.0]])
    estimator: Any = estimators()["ekf-second-order"]({})
    estimator._mean, estimator._covariance, estimator.runs = x, P, 4

    def jacobian(at: np.ndarray) -> np.ndarray:
        asked.append(at)
        return np.einsum("iab,bs->ias", H, at)

    shift, spread = estimator._curvature(jacobian, 3)
    for c in range(2):
        for side, found in ((1, asked[2 * c]), (-1, asked[2 * c + 1])):
            wanted = x.copy()
            wanted[c] += side * 1e-4 * np.maximum(np.abs(x[c]), 1.0)
            np.testing.assert_array_equal(found, wanted)
    np.testing.assert_allclose(shift, 0.5 * np.einsum("iab,bas->is", H, P), rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(spread, 0.5 * np.einsum("iab,bcs,jcd,das->ijs", H, P, H, P), rtol=1e-6, atol=1e-6)
