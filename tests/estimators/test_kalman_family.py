"""The Kalman family against textbook loops, and the properties every member must have."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from railstate.estimators.interface import Estimator, Status
from railstate.estimators.kalman import ExtendedKalman, Kalman
from railstate.estimators.particle import BootstrapParticle
from railstate.estimators.reference.filterpy import FilterpyCubature, FilterpyExtended, FilterpyUnscented
from railstate.estimators.sigma_point import CubatureKalman, UnscentedKalman
from railstate.scenarios.compiled import Compiled
from railstate.scenarios.measurement import Interval, untold
from railstate.scenarios.model import DesignModel

from .. import models
from ..models import Array, Record, heard, whole

Make = Callable[[], Estimator]
FAMILY: dict[str, Make] = {
    "ekf": ExtendedKalman,
    "ukf": UnscentedKalman,
    "ukf-printed": lambda: UnscentedKalman({"alpha": 1e-3, "beta": 2.0, "kappa": 0.0}),
    "ukf-julier": lambda: UnscentedKalman({"points": "julier", "kappa": 0.5}),
    "ukf-reuse": lambda: UnscentedKalman({"redraw": False}),
    "ckf": CubatureKalman,
}
PLANTS: dict[str, Callable[[int], DesignModel]] = {
    "linear": models.linear,
    "correlated": lambda runs: models.linear(runs, correlated=True, ny=3),
    "coasting": models.coasting,
}


def textbook(make: Make, model: DesignModel, data: Record) -> tuple[Array, Array]:
    """One run, plain matrices: P - K S K', only the rows received, no mask, no batch."""
    estimator = make()
    n, x, p = model.nx, model.initial_mean[:, :1].copy(), model.initial_covariance[:, :, 0]
    means, covariances = [], []
    for k in range(len(data.y)):
        got = np.flatnonzero(data.received[k, :, 0])
        q = model.process_covariance(x, data.u[k], whole(k, model.period))[:, :, 0]
        r = model.measurement_covariance(untold(k + 1, model.ny))[np.ix_(got, got)][:, :, 0]
        if isinstance(estimator, ExtendedKalman):
            f = model.transition_jacobian(x, data.u[k], whole(k, model.period))[:, :, 0]
            x, p = model.transition(x, data.u[k], whole(k, model.period)), f @ p @ f.T + q
            h = model.measurement_jacobian(x, k + 1)[got][:, :, 0]
            s, cross, guess = h @ p @ h.T + r, p @ h.T, model.measurement(x, k + 1)[got]
        else:
            wm, wc, scale = estimator.weights(n)
            moved = model.transition(_points(x, p, scale, len(wm)), data.u[k], whole(k, model.period))[:, :, 0]
            x = (moved @ wm)[:, None]
            p = (moved - x) * wc @ (moved - x).T + q
            cloud = _points(x, p, scale, len(wm)) if estimator.redraw else moved[:, :, None]
            images = model.measurement(cloud, k + 1)[got][:, :, 0]
            guess = (images @ wm)[:, None]
            s = (images - guess) * wc @ (images - guess).T + r
            cross = (cloud[:, :, 0] - x) * wc @ (images - guess).T
        if got.size:
            gain = cross @ np.linalg.inv(s)
            x, p = x + gain @ (data.y[k, got] - guess), p - gain @ s @ gain.T
        means.append(x[:, 0])
        covariances.append(p)
    return np.stack(means), np.stack(covariances)


def _points(x: Array, p: Array, scale: float, count: int) -> Array:
    steps = scale * np.linalg.cholesky(p)
    centre = [np.zeros((len(x), 1))] if count % 2 else []
    return (x + np.hstack([*centre, steps, -steps]))[:, :, None]


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("name", FAMILY)
def test_equals_the_textbook(name: str, plant: str) -> None:
    runs, steps = 4, 40
    model = PLANTS[plant](runs)
    data = models.record(model, runs, steps)
    means, covariances = models.feed(FAMILY[name](), model, data)
    tolerance = 1e-6 if name == "ukf-printed" else 1e-9  # weights of 1e6 amplify either side's rounding
    for run in range(runs):
        single = replace(model, initial_mean=model.initial_mean[:, run:run + 1])
        mean, covariance = textbook(FAMILY[name], single, data.only(run))
        np.testing.assert_allclose(means[:, :, run], mean, rtol=0, atol=tolerance)
        np.testing.assert_allclose(covariances[..., run], covariance, rtol=0, atol=tolerance)


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("name", FAMILY)
def test_batches_are_bit_identical(name: str, plant: str) -> None:
    """Lossless and lossy runs side by side: what is shared in a small batch is not in a large one."""
    runs, steps = 100, 12
    model = PLANTS[plant](runs)
    data = models.record(model, runs, steps)
    received = data.received | (np.arange(runs) % 3 > 0)
    data = replace(data, received=received, y=np.where(received, np.nan_to_num(data.y), np.nan))
    whole = models.feed(FAMILY[name](), model, data)
    for first, size in ((0, 1), (5, 1), (1, 2), (60, 7)):
        part = slice(first, first + size)
        some = Record(*(np.ascontiguousarray(a[..., part]) for a in (data.u, data.y, data.received, data.truth)))
        small = models.feed(FAMILY[name](), replace(model, initial_mean=model.initial_mean[:, part].copy()), some)
        for large, alone in zip(whole, small, strict=True):
            np.testing.assert_array_equal(large[..., part], alone)


@pytest.mark.parametrize("name", FAMILY)
@pytest.mark.parametrize(("plant", "runs"), [("wide", 300), ("wide, correlated", 300), ("coasting", 2100)])
def test_runs_beyond_a_tile_are_as_any(name: str, plant: str, runs: int) -> None:
    """Of 16 states 128 runs are a tile, of 2 states 1024. One of the second tile and of the third are lost in the last
    prediction."""
    wide = {"nx": 16, "ny": 3, "correlated": plant != "wide"}
    model = models.coasting(runs) if plant == "coasting" else models.linear(runs, **wide)
    data, gone = models.record(model, runs, 3), np.isin(np.arange(runs), [runs // 2, runs - 1])

    def followed(part: slice) -> list[Array]:
        def process(x: Array, u: Array, interval: Interval) -> Array:
            assert model.process_covariance is not None
            q = model.process_covariance(x, u, interval)
            return q - 50.0 * np.eye(model.nx)[:, :, None] * (gone[part] & (interval.depart == 2))

        estimator = FAMILY[name]()
        some = Record(*(np.ascontiguousarray(a[..., part]) for a in (data.u, data.y, data.received, data.truth)))
        own = replace(model, initial_mean=model.initial_mean[:, part].copy(), process_covariance=process)
        means, covariances = models.feed(estimator, own, some)
        assert covariances is not None
        return [means, covariances, estimator.status]

    whole, thirds = followed(slice(None)), [slice(i * runs // 3, (i + 1) * runs // 3) for i in range(3)]
    for all_, parts in zip(whole, zip(*map(followed, thirds), strict=True), strict=True):
        np.testing.assert_array_equal(all_, np.concatenate(parts, axis=-1))
    assert np.flatnonzero(whole[2]).tolist() == np.flatnonzero(gone).tolist()


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("name", FAMILY)
def test_covariances_stay_symmetric_and_positive(name: str, plant: str) -> None:
    model = PLANTS[plant](20)
    data = models.record(model, 20, 60)
    estimator = FAMILY[name]()
    _, covariances = models.feed(estimator, model, data)
    np.testing.assert_array_equal(covariances, covariances.swapaxes(1, 2))
    assert np.linalg.eigvalsh(np.moveaxis(covariances, 3, 1)).min() > 0
    assert not estimator.status.any()


def test_the_family_agrees_on_a_linear_model() -> None:
    model = models.linear(5)
    data = models.record(model, 5, 30)
    reference, covariance = models.feed(Kalman(), model, data)
    for name, make in FAMILY.items():
        if name in ("ukf-printed", "ukf-reuse"):
            continue  # the one is rougher in floating point, the other another filter: its points lack Q
        means, covariances = models.feed(make(), model, data)
        np.testing.assert_allclose(means, reference, rtol=0, atol=1e-9)
        np.testing.assert_allclose(covariances, covariance, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ["ukf", "ckf", "ekf"])
def test_compiled_and_linear_models_are_as_any_other(name: str) -> None:
    """The same model as machine code and in Python, its measurement known to be linear and not: the same estimates."""
    model = models.linear(70, correlated=True, ny=3)
    assert isinstance(model.transition, Compiled) and model.linear_measurement
    data = models.record(model, 70, 12)
    means, covariances = models.feed(FAMILY[name](), model, data)
    plain = replace(model, transition=lambda x, u, interval: model.transition(x, u, interval))
    for other in (plain, replace(plain, linear_measurement=False)):
        found, spread = models.feed(FAMILY[name](), other, data)
        np.testing.assert_allclose(found, means, rtol=0, atol=1e-12 * np.abs(means).max())
        np.testing.assert_allclose(spread, covariances, rtol=0, atol=1e-12 * np.abs(covariances).max())
    with pytest.raises(ValueError, match="1 inputs, not 2"):
        model.transition(model.initial_mean, np.zeros((2, 70)), whole(0, model.period))


def test_covariance_is_shared_until_runs_differ() -> None:
    model = models.linear(6)
    data = models.record(model, 6, 8, loss=0.0)
    data.received[3] = False
    data.received[5, 0, 2] = False
    widths = []
    models.feed(Kalman(), model, data, each=lambda k, estimate: widths.append(estimate.covariance.shape[2]))
    assert widths == [1, 1, 1, 1, 1, 6, 6, 6]


@pytest.mark.parametrize("name", FAMILY)
@pytest.mark.parametrize("per_run", [False, True])
def test_part_steps_add_up(name: str, per_run: bool) -> None:
    """0.3 and then 0.7 of a step of pure integration equal one step."""
    model = _integrating(6)
    data = models.record(model, 6, 10)
    whole, covariance = models.feed(FAMILY[name](), model, data)
    shares = (np.full(6, 0.3), np.full(6, 0.7)) if per_run else (0.3, 0.7)
    parts, split = models.feed(FAMILY[name](), model, data, shares)
    tolerance = 1e-6 if name == "ukf-printed" else 1e-9
    if name != "ukf-reuse":  # whose update knows of the last part's Q only
        np.testing.assert_allclose(parts, whole, rtol=0, atol=tolerance)
        np.testing.assert_allclose(split, covariance, rtol=0, atol=tolerance)
    assert np.isfinite(parts).all()


def _integrating(runs: int) -> DesignModel:
    """Constant speed with white acceleration noise, whose discretisation is consistent under splitting."""
    model = models.coasting(runs)

    def transition(x: Array, u: Array, interval: Interval) -> Array:
        return np.stack([x[0] + interval.length * x[1], x[1] + 0 * interval.length])

    def jacobian(x: Array, u: Array, interval: Interval) -> Array:
        t = np.atleast_1d(interval.length)
        return np.stack([np.stack([t**0, t]), np.stack([0 * t, t**0])])

    return replace(model, transition=transition, transition_jacobian=jacobian)


@pytest.mark.parametrize("name", FAMILY)
def test_a_lost_run_is_marked_and_alone(name: str) -> None:
    """One run's process noise turns negative definite: that run fails, the others do not notice."""
    model = models.coasting(5)
    data = models.record(model, 5, 10, loss=0.0)
    healthy, _ = models.feed(FAMILY[name](), model, data)

    def process(x: Array, u: Array, interval: Interval) -> Array:
        q = np.repeat(model.process_covariance(x, u, interval), 5, axis=2)
        q[:, :, 2] -= 50.0 * np.eye(2) * (interval.depart == 4)
        return q

    estimator = FAMILY[name]()
    means, _ = models.feed(estimator, replace(model, process_covariance=process), data)
    assert estimator.status.tolist() == [0, 0, int(Status.failed), 0, 0]
    assert all("positive definite" in why for why in estimator.reasons.values())
    others = [0, 1, 3, 4]
    np.testing.assert_array_equal(means[:, :, others], healthy[:, :, others])
    assert np.isnan(means[-1, :, 2]).all()


@pytest.mark.parametrize("name", FAMILY)
def test_nothing_received_is_pure_prediction(name: str) -> None:
    model = models.coasting(3)
    data = models.record(model, 3, 5, loss=1.0)
    estimator = FAMILY[name]()
    before = []
    estimator.start(model, 3, models.random(3))
    for k in range(5):
        estimator.predict(data.u[k], whole(k, model.period))
        before = [part.copy() for part in (estimator.estimate().mean, estimator.estimate().covariance)]
        estimator.update(heard(data.y[k], data.received[k], k))
        np.testing.assert_array_equal(estimator.estimate().mean, before[0])
        np.testing.assert_array_equal(estimator.estimate().covariance, before[1])


@pytest.mark.parametrize("name", [name for name in FAMILY if name != "ukf-printed"])
def test_a_known_start_has_no_covariance(name: str) -> None:
    """P0 = 0 is allowed: the truth known at the start is no failure."""
    model = replace(models.coasting(3), initial_covariance=np.zeros((2, 2, 1)))
    estimator = FAMILY[name]()
    means, _ = models.feed(estimator, model, models.record(models.coasting(3), 3, 5))
    assert np.isfinite(means).all() and not estimator.status.any()


@pytest.mark.parametrize("estimator", [*(make() for make in FAMILY.values()), BootstrapParticle({"particles": 20}),
                                       FilterpyExtended(), FilterpyUnscented(), FilterpyCubature()])
def test_a_run_that_stands_still_keeps_its_bits(estimator: Estimator) -> None:
    """Portion 0 and nothing received: other runs' events change nothing of it, its random stream included."""
    model = models.coasting(3)
    data = models.record(model, 3, 6)
    still, nobody = np.array([0.5, 0.0, 0.2]), np.array([[True, False, True]] * 2)

    def run(extra: bool) -> list[Array]:
        estimator.start(model, 3, models.random(3))
        out = []
        for k in range(6):
            estimator.predict(data.u[k], whole(k, model.period))
            if extra:
                estimator.predict(data.u[k], models.part(k, still, model.period))
            estimator.update(heard(data.y[k], data.received[k], k))
            if extra:
                estimator.predict(data.u[k], models.part(k, still, model.period))
                estimator.update(heard(np.where(nobody, 1.0, np.nan), nobody, k))
            estimate = estimator.estimate()
            assert estimate.covariance is not None
            out += [estimate.mean[:, 1].copy(), estimate.covariance[:, :, -2].copy()]
        return out

    for alone, together in zip(run(False), run(True), strict=True):
        np.testing.assert_array_equal(alone, together)
