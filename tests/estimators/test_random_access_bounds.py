"""Gains and bounds of the random access filter against the paper's numbers and against (30) written out.

The paper is Zou, Wang, Han, Zhou, "Recursive Filtering for Time-Varying Systems with Random Access Protocol"."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from railstate.estimators.random_access.bounds import CovarianceBounds, critical_access
from railstate.estimators.random_access.covariance import covariance_sequence
from railstate.estimators.random_access.estimators import RandomAccessFilter
from railstate.scenarios.files import load
from railstate.scenarios.linear.config import LinearConfig
from railstate.scenarios.linear.setting import LinearSystem

from ..linear_plants import PLANTS, bounds_of, example, plant

TABLE_I = np.array([
    [[0.582, -1.476], [1.059, -2.645], [0.216, 0.545]],
    [[0.561, -2.229], [1.055, -4.201], [0.156, -0.435]],
    [[0.534, -1.522], [1.025, -2.967], [0.068, -0.119]],
])


def test_table_one():
    """All 18 gains within their rounding; the printed C misses them by far."""
    gains = np.array(covariance_sequence(example("rap-example-1"), 3)[0])
    assert np.abs(gains - TABLE_I).max() < 5e-4
    printed = np.array(covariance_sequence(example("rap-example-1", "printed"), 3)[0])
    assert np.abs(printed - TABLE_I).max() > 1.5


def test_numbers_of_example_two():
    model = example("rap-example-2")
    bounds = bounds_of(model)
    assert (bounds.q_low, bounds.q_high) == pytest.approx((1.3225, 1.44), abs=1e-12)
    assert (bounds.r_low, bounds.r_high) == pytest.approx((1.0, 4.0), abs=1e-12)
    assert (bounds.c, bounds.c_hat) == pytest.approx((2.8224, 2.8224), abs=5e-5)
    assert (bounds.a_low, bounds.a_high) == pytest.approx((1.0205, 1.0408), abs=5e-5)
    assert bounds.lower == pytest.approx(0.6841, abs=5e-5)
    assert bounds.mu[:2] == pytest.approx([10.24, 12.0978], abs=5e-5)
    assert bounds.uniform is None
    eigenvalues = np.linalg.eigvalsh(covariance_sequence(model, 300)[1])
    assert eigenvalues.min() == pytest.approx(2.505, abs=5e-4)
    assert eigenvalues.max() == pytest.approx(10.24)
    assert 6.6 < eigenvalues[1:].max() < 6.64


def left_side_of_30(model: Any, bounds: CovarianceBounds, sigma: float, m: int, k: int) -> Any:
    """The left side of (30), term by term as printed, with Phi, Theta and products of inverses."""
    linear, nodes, p = model.linear, model.reception.nodes, model.reception.p
    ny, nx = model.ny, model.nx
    Phi = [np.diag([1.0 if j in node else 0.0 for j in range(ny)]) for node in nodes]
    Phi_bar = sum(p_i * F for p_i, F in zip(p, Phi, strict=True))
    total = np.zeros((nx, nx))
    for i in range(k - m + 1, k + 2):
        phi = np.eye(nx)
        for j in range(i, k + 1):
            phi = phi @ np.linalg.inv(linear.A(j))
        C, spread = linear.C(i), linear.C(i) @ linear.Q(i - 1) @ linear.C(i).T
        Theta = sum(p_j * ((F - Phi_bar) @ spread @ (F - Phi_bar) + F @ linear.R(i) @ F)
                    for p_j, F in zip(p, Phi, strict=True))
        inner = sigma * bounds.a_high * bounds.c_hat * (1 - min(p)) ** 2 * np.eye(ny) + Theta
        gamma = (1 + bounds.q_high / bounds.a_low / bounds.lower) ** (i - k - 1)
        total += gamma * phi.T @ C.T @ Phi_bar @ np.linalg.inv(inner) @ Phi_bar @ C @ phi
    return total


@pytest.mark.parametrize("source", ["rap-example-2", *PLANTS])
def test_condition_30_is_the_printed_sum(source):
    model = example(source) if source in ("rap-example-2",) else plant(*PLANTS[source], seed=9).design_model(
        {}, np.zeros((PLANTS[source][0], 1)))
    bounds = bounds_of(model, 12)
    for sigma, m in ((20.0, 2), (90.0, 1), (5.0, 4)):
        condition = bounds.check(sigma, m)
        np.testing.assert_array_equal(condition.steps, range(m, 12))
        for k, least, holds in zip(condition.steps, condition.least, condition.holds, strict=True):
            expected = np.linalg.eigvalsh(left_side_of_30(model, bounds, sigma, m, k))[0]
            assert least == pytest.approx(expected, rel=1e-9, abs=1e-12)
            assert holds == (least >= 1 / sigma)
        assert condition.mu_holds == all(bounds.mu[k] <= sigma for k in range(m + 1))


def test_the_papers_check_of_30_is_not_verified():
    condition = bounds_of(example("rap-example-2")).check(20.0, 2)
    at_10 = condition.least[condition.steps == 10][0]
    assert at_10 == pytest.approx(0.0464, abs=5e-5)
    assert not condition.holds[condition.steps == 10][0]
    assert condition.mu_holds
    assert not condition.verified


def test_the_pair_found_holds_and_is_the_least():
    model = example("rap-example-2")
    bounds = bounds_of(model)
    found = bounds.search()
    assert found is not None
    sigma, m = found
    assert bounds.check(sigma, m).verified
    assert np.linalg.eigvalsh(covariance_sequence(model, 300)[1]).max() <= sigma
    for other in range(1, 21):
        assert not bounds.check(sigma * (1 - 1e-3), other).verified
        assert not (other < m and bounds.check(sigma, other).verified)
    assert bounds.search(sigma_max=sigma * (1 - 1e-3)) is None


def test_design_tells_all_of_it():
    setting = load("rap-example-2").setting("corrected")
    model = setting.design_model({}, np.zeros((2, 1)))
    entry = setting.config.estimators["random-access"]
    told = RandomAccessFilter(entry.parameters).design(model)
    claim = told["claimed (30), (31)"]
    assert (claim["sigma"], claim["m"], claim["verdict"]) == (20.0, 2, "not verified")
    assert claim["least eigenvalue in (30)"] < claim["needed"] == 0.05
    assert told["valid (30), (31)"] == {"least sigma": 26.54, "m": 7}
    assert told["lower bound (21)"] == pytest.approx(0.6841, abs=5e-5)
    assert told["upper bound (26)"]["mu_1"] == pytest.approx(12.0978, abs=5e-5)
    np.testing.assert_allclose(told["gains"]["K_3"], covariance_sequence(model, 3)[0][2])
    with pytest.raises(ValueError, match="sigma and m go together"):
        RandomAccessFilter({"sigma": 20.0})


@pytest.mark.parametrize("source", ["rap-example-1", "rap-example-2", *PLANTS])
def test_the_covariance_keeps_to_theorems_2_and_3(source):
    model = example(source) if source.startswith("rap") else plant(*PLANTS[source], seed=10, steps=40).design_model(
        {}, np.zeros((PLANTS[source][0], 1)))
    bounds = bounds_of(model, 40)
    eigenvalues = np.linalg.eigvalsh(covariance_sequence(model, 40)[1])
    assert bounds.lower > 0
    assert eigenvalues[1:].min() >= bounds.lower
    assert (eigenvalues[:, -1] <= bounds.mu * (1 + 1e-12)).all()


def test_proposition_1_on_a_stable_plant():
    table = plant(1, [[0]]).config.model_dump(exclude_unset=True)
    table["plant"] |= {"A": [[0.8]], "B": [[1.0]], "Q": [[0.5]], "C": [[1.0]], "R": [[1.0]], "P0": [[4.0]]}
    model = LinearSystem(LinearConfig.model_validate(table)).design_model({}, np.zeros((1, 1)))
    bounds = bounds_of(model, 100)
    assert bounds.uniform == pytest.approx(4 * 0.64 + 0.5 / 0.36)
    assert bounds.mu[1:].max() <= bounds.uniform


def test_the_printed_rank_one_b_leaves_no_lower_bound():
    bounds = bounds_of(example("rap-example-2", "printed"))
    assert bounds.lower == 0.0
    assert bounds.search() is None


def test_a_window_outside_the_horizon_is_refused():
    with pytest.raises(ValueError, match=r"m = 1 \.\. 9; got sigma = 20, m = 10"):
        bounds_of(example("rap-example-2"), 10).check(20.0, 10)


@pytest.mark.parametrize(("a", "wanted"), [(1.25, 1 - 1 / 1.25**2), (0.9, 0.0)])
def test_critical_access_of_one_state_is_the_uncertainty_threshold(a: float, wanted: float):
    """1 - 1/a^2 for one state and one node; the covariance itself grows below it and settles above."""
    text = {"plant.A": [[a]], "plant.B": [[1.0]], "plant.C": [[1.0]], "plant.Q": [[1.0]], "plant.R": [[1.0]],
            "plant.x0": [0.0], "plant.P0": [[1.0]], "channel.p": [1.0], "channel.nodes": [[0]]}
    model = load("rap-example-2", text).setting("corrected").design_model({}, np.zeros((1, 1)))
    assert model.linear is not None and model.reception is not None
    found = critical_access(model.linear, model.reception)
    assert found == pytest.approx(wanted, abs=1e-3)
    for share, grows in ((found - 0.02, True), (found + 0.02, False)) if wanted else ():
        P = 1.0
        for _ in range(2000):
            P = a * a * (P - share * P * P / (P + 1)) + 1  # (10), (11) with p = share
        assert (P > 1e6) == grows
