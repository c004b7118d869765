"""The zonotopic filter: it holds every admissible truth, and equals plain loops, run by run."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from railstate.estimators.interface import Status
from railstate.estimators.set_membership.zonotope import ZonotopicFilter
from railstate.scenarios.errors import Unsupported
from railstate.scenarios.model import Bounds, DesignModel, Linear, linear_model

from .. import models
from ..models import heard, part, random, whole

T = 0.5
A = np.array([[1.0, T], [0.0, 0.9]])
G = np.array([[T * T / 2, 0.1], [T, 0.0]])
M, N, W, V = np.array([[0.3], [1.0]]), np.array([[0.0, 1.0]]), np.array([0.3, 0.2]), np.array([1.0, 0.4])
P0 = np.diag([1.0, 0.25])
C = np.array([[1.0, 0.2], [0.0, 1.0]])


def model(runs: int, *, kappa: float = 0.0, **given: Any) -> DesignModel:
    """Two states, two disturbances, two sensors; kappa: the linearisation error A + M Delta kappa N."""
    matrices = (A, np.zeros((2, 0)), np.zeros(2), C, np.zeros((2, 2)), np.diag(V**2) / 3)
    bounds = Bounds(**({"G": G, "w_bar": W, "v_bar": V, "M": M if kappa else None, "N": N if kappa else None,
                        "kappa": lambda x, u, Pi: kappa * np.sqrt(1.0 + Pi[1, 1])} | given))
    return linear_model(Linear(*(lambda k, matrix=matrix: matrix for matrix in matrices)), states=("s", "v"),
                        measurements=("s", "v"), period=T, initial_mean=np.zeros((2, runs)),
                        initial_covariance=P0[:, :, None], bounds=bounds)


def started(told: DesignModel, **parameters: Any) -> ZonotopicFilter:
    estimator, runs = ZonotopicFilter(parameters), told.initial_mean.shape[1]
    estimator.design(told)
    estimator.start(told, runs, random(runs))
    return estimator


def admissible(runs: int, steps: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Truths inside every bound, near its edges in half the runs: x (K, 2, S), y (K, 2, S), received (K, 2, S)."""
    draw = np.random.default_rng(3)
    x = draw.uniform(-1, 1, (2, runs)) * np.array([[1.0], [0.5]])
    xs, ys = [], []
    for k in range(steps):
        w, v = draw.uniform(-1, 1, (2, runs)), draw.uniform(-1, 1, (2, runs))
        w[:, ::2], v[:, ::2] = np.sign(np.sin(0.2 * k + np.arange(w[:, ::2].shape[1]))), np.sign(v[:, ::2])
        w, v = 0.999 * w, 0.999 * v
        x = A @ x + G @ (W[:, None] * w)
        xs.append(x)
        ys.append(C @ x + V[:, None] * v)
    return np.array(xs), np.array(ys), draw.random((steps, 2, runs)) < 0.7


def follow(estimator: ZonotopicFilter, ys: np.ndarray, received: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    out, u = [], np.zeros((0, ys.shape[2]))
    for k, (y, got) in enumerate(zip(ys, received, strict=True)):
        for measured in (False, True):
            if measured:
                estimator.update(heard(np.where(got, y, np.nan), got, k))
            else:
                estimator.predict(u, whole(k, T))
            estimate = estimator.estimate()
            assert estimate.ellipsoid is not None
            out.append((estimate.mean.copy(), estimate.ellipsoid.copy()))
    return out


@pytest.mark.parametrize("tight", [True, False])
@pytest.mark.parametrize("order", [1, 3, 10])
def test_holds_every_admissible_truth_before_and_after_readings(order: int, tight: bool) -> None:
    xs, ys, received = admissible(60, 60)
    estimator = started(model(60), order=order, tight=tight)
    for i, (mean, Pi) in enumerate(follow(estimator, ys, received)):
        e = (xs[i // 2] - mean).T[:, :, None]
        assert (np.moveaxis(e, 1, 2) @ np.linalg.solve(np.moveaxis(Pi, 2, 0), e)).max() <= 1 + 1e-9
        assert_array_equal(Pi, Pi.swapaxes(0, 1))
    assert not estimator.status.any() and 0.5 < estimator.inconsistency.max() <= 1 + 1e-12


Sets = list[tuple[np.ndarray, np.ndarray]]


def naive(y: np.ndarray, received: np.ndarray, order: int, kappa: float, tight: bool) -> Sets:
    """One run, generators sorted, the short ones boxed: all readings at once by the gain of least |H|_F, or tight."""
    x, H, out = np.zeros(2), np.sqrt(P0), []

    def sizes() -> np.ndarray:
        return np.linalg.norm(H / np.abs(H).sum(axis=1, keepdims=True), axis=0)

    def reduced() -> np.ndarray:
        if H.shape[1] <= 2 * order:
            return H
        by = np.argsort(-sizes())
        return np.hstack([H[:, by[:2 * order - 2]], np.diag(np.abs(H[:, by[2 * order - 2:]]).sum(axis=1))])

    def ellipsoid() -> np.ndarray:
        size, some = sizes(), sizes() > 0.0
        return size.sum() * (H[:, some] / size[some]) @ H[:, some].T

    for row, got in zip(y, received, strict=True):
        growth = kappa * np.sqrt(1.0 + ellipsoid()[1, 1])
        H = reduced()
        H = np.hstack([A @ H, M * growth * np.abs(N @ H).sum(), G * W] if kappa else [A @ H, G * W])
        x = A @ x
        out.append((x, ellipsoid()))
        if tight and got.any():
            H = reduced()
            for j in np.flatnonzero(got):
                c, reach = C[j], np.abs(C[j] @ H).sum()
                ends = np.clip([row[j] - c @ x - V[j], row[j] - c @ x + V[j]], -reach, reach)
                middle, half = ends.mean(), np.ptp(ends) / 2
                gains = [H @ H.T @ c / (c @ H @ H.T @ c + extra) for extra in (half**2, 0.0)]
                gains.append(c / (c @ c))
                cuts = [np.column_stack([H - np.outer(gain, c @ H), half * gain]) for gain in gains]
                sizes_of = [np.abs(cut).sum(axis=1).prod() for cut in cuts]
                best = int(np.argmin(sizes_of))
                if sizes_of[best] < (1 - 1e-9) * np.abs(H).sum(axis=1).prod():
                    x, H = x + gains[best] * middle, cuts[best]
        elif got.any():
            H, c, R = reduced(), C[got], np.diag(V[got])
            K = H @ H.T @ c.T @ np.linalg.inv(c @ H @ H.T @ c.T + R @ R)
            x, H = x + K @ (row[got] - c @ x), np.hstack([(np.eye(2) - K @ c) @ H, K @ R])
        out.append((x, ellipsoid()))
    return out


@pytest.mark.parametrize("tight", [True, False])
@pytest.mark.parametrize(("order", "kappa"), [(1, 0.0), (4, 0.0), (10, 0.05)])
def test_equals_a_plain_loop(order: int, kappa: float, tight: bool) -> None:
    _, ys, received = admissible(4, 40)
    together = follow(started(model(4, kappa=kappa), order=order, tight=tight), ys, received)
    for run in range(4):
        alone = naive(ys[:, :, run], received[:, :, run], order, kappa, tight)
        for (mean, Pi), (x, shape) in zip(together, alone, strict=True):
            assert_allclose(mean[:, run], x, rtol=0, atol=1e-10)
            assert_allclose(Pi[:, :, run], shape, rtol=1e-9, atol=1e-10)


def test_bits_do_not_depend_on_the_batch() -> None:
    _, ys, received = admissible(12, 30)
    together = follow(started(model(12, kappa=0.05)), ys, received)
    for first, last in ((0, 1), (3, 8)):
        few = follow(started(model(last - first, kappa=0.05)), ys[..., first:last], received[..., first:last])
        for many, some in zip(together, few, strict=True):
            for whole_batch, own in zip(many, some, strict=True):
                assert_array_equal(whole_batch[..., first:last], own)


@pytest.mark.parametrize("bounded", [True, False])
def test_a_run_that_stays_does_not_change_and_parts_need_their_bounds(bounded: bool) -> None:
    gain = np.array([[0.125], [0.5]])
    told = replace(models.coasting(3), bounds=Bounds(
        gain, np.ones(1), np.ones(2), part=(lambda interval: gain[:, :, None] * interval.share) if bounded else None))
    estimator = started(told)
    estimator.predict(np.zeros((1, 3)), whole(0, T))
    before = estimator.estimate().mean.copy(), np.array(estimator.estimate().ellipsoid)
    estimator.predict(np.zeros((1, 3)), part(1, np.array([0.0, 0.5, 1.0]), T))
    after = estimator.estimate()
    assert_array_equal(after.mean[:, 0], before[0][:, 0])
    assert_array_equal(np.asarray(after.ellipsoid)[..., 0], before[1][..., 0])
    assert (after.mean[0, 1:] > before[0][0, 1:]).all()
    assert estimator.status.tolist() == [Status.ok, Status.ok if bounded else Status.infeasible, Status.ok]


@pytest.mark.parametrize("tight", [True, False])
def test_a_reading_against_the_bounds_is_told_and_stands_alone(tight: bool) -> None:
    estimator = started(model(1), tight=tight)
    estimator.update(heard(np.array([[np.nan], [5.0]]), np.array([[False], [True]])))
    assert estimator.extremes()["inconsistency"][0] == pytest.approx(5.0 / 0.9)
    estimate = estimator.estimate()
    assert_allclose(estimate.mean[:, 0], [0.0, 5.0])
    # The box of half-widths 1 and .4 in its ellipsoid of least product of axes.
    assert_allclose(np.asarray(estimate.ellipsoid)[:, :, 0], 2 * np.diag([1.0, 0.16]))


def test_tight_cuts_keep_to_the_box_of_the_worst_cases() -> None:
    """A number that does not move: what agrees with all readings is known; averaging knows no more than one does."""
    still = linear_model(Linear(*(lambda k, a=a: a for a in (np.eye(1), np.zeros((1, 0)), np.zeros(1), np.eye(1),
                                                             np.zeros((1, 1)), np.eye(1)))),
                         states=("s",), measurements=("s",), period=T, initial_mean=np.zeros((1, 3)),
                         initial_covariance=np.full((1, 1, 1), 9.0),
                         bounds=Bounds(np.zeros((1, 1)), np.ones(1), np.ones(1)))
    ys = np.random.default_rng(2).uniform(-1, 1, (20, 1, 3))
    mean, Pi = follow(started(still), ys, np.ones(ys.shape, bool))[-1]
    low, high = ys.max(axis=0) - 1.0, ys.min(axis=0) + 1.0
    assert_allclose(mean, 0.5 * (low + high), atol=1e-10)
    assert_allclose(np.sqrt(Pi[0]), 0.5 * (high - low), atol=1e-10)
    assert (np.sqrt(follow(started(still, tight=False), ys, np.ones(ys.shape, bool))[-1][1]) > 0.9).all()


def test_bounds_must_be_finite_and_numbers_stay_so() -> None:
    for given in ({"w_bar": np.array([np.inf, 1.0])}, {"v_bar": np.full(2, np.inf)}):
        with pytest.raises(Unsupported, match="finite"):
            started(model(1, **given))
    one_sensor = started(model(1, v_bar=np.array([1.0, np.inf])))
    one_sensor.update(heard(np.array([[np.nan], [5.0]]), np.array([[False], [True]])))
    assert (one_sensor.estimate().mean == 0.0).all()
    told = model(2, kappa=0.1)
    assert told.bounds is not None
    told = replace(told, bounds=replace(told.bounds, kappa=lambda x, u, Pi: np.array([0.1, np.inf])))
    estimator = started(told)
    estimator.predict(np.zeros((0, 2)), whole(0, T))
    assert estimator.status.tolist() == [Status.ok, Status.failed] and "not finite" in estimator.reasons[1]
