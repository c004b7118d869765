"""The yardsticks and the bootstrap particle filter: known answers, a textbook loop, the Kalman filter's limit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from railstate.estimators.baselines import DeadReckoning, Direct, Truth
from railstate.estimators.interface import Estimator, Status
from railstate.estimators.kalman import ExtendedKalman, Kalman
from railstate.estimators.particle import BootstrapParticle
from railstate.scenarios.errors import Unsupported
from railstate.scenarios.measurement import untold
from railstate.scenarios.model import DesignModel, Linear
from railstate.scenarios.normals import normals, uniform

from .. import models
from ..models import Record, heard, whole

C = np.array([[2.0, 0.0], [0.0, -0.5]])


def square(runs: int, c: np.ndarray = C, constant: bool = True) -> DesignModel:
    model = models.linear(runs, nx=2, ny=2)
    part = model.linear
    assert part is not None
    return replace(model, linear=Linear(part.A, part.B, part.h, lambda k: c, part.Q, part.R, constant))


def test_direct_holds_each_element() -> None:
    model = square(3)
    estimator = Direct()
    estimator.start(model, 3, models.random(3))
    expected = model.initial_mean.copy()
    np.testing.assert_array_equal(estimator.estimate().mean, expected)
    y = np.array([[4.0, np.nan, 6.0], [np.nan, np.nan, 1.0]])
    estimator.predict(np.zeros((1, 3)), whole(0, model.period))
    estimator.update(heard(y, ~np.isnan(y)))
    expected[0, 0], expected[:, 2] = 2.0, [3.0, -2.0]
    np.testing.assert_allclose(estimator.estimate().mean, expected, rtol=1e-15)
    np.testing.assert_array_equal(estimator.estimate().mean[:, 1], model.initial_mean[:, 1])
    estimator.update(heard(np.full((2, 3), np.nan), np.zeros((2, 3), dtype=bool)))
    np.testing.assert_allclose(estimator.estimate().mean, expected, rtol=1e-15)


def test_direct_solves_a_mixing_measurement() -> None:
    c = np.array([[1.0, 2.0], [3.0, 4.0]])
    estimator = Direct()
    model, received = square(20, c), np.zeros((2, 20), dtype=bool)
    received[:, 0] = True
    estimator.start(model, 20, models.random(20))
    estimator.update(heard(np.repeat(c @ np.array([[5.0], [-1.0]]), 20, axis=1), received))
    np.testing.assert_allclose(estimator.estimate().mean[:, 0], [5.0, -1.0], rtol=1e-12)
    np.testing.assert_array_equal(estimator.estimate().mean[:, 1:], model.initial_mean[:, 1:])  # nothing was heard


@pytest.mark.parametrize(("model", "why"), [
    (models.linear(1), "2 x 3"),
    (models.coasting(1), "linear"),
    (square(1, np.ones((2, 2))), "singular"),
    (square(1, constant=False), "constant"),
])
def test_direct_says_what_it_lacks(model: DesignModel, why: str) -> None:
    with pytest.raises(Unsupported, match=why):
        Direct.require(model)


def test_dead_reckoning_is_the_model_alone() -> None:
    model = models.coasting(4)
    data = models.record(model, 4, 6)
    means, covariances = models.feed(DeadReckoning(), model, data)
    x = model.initial_mean
    for k in range(6):
        x = model.transition(x, data.u[k], whole(k, model.period))
    np.testing.assert_array_equal(means[-1], x)
    assert covariances is None


def test_truth_is_handed_out_as_revealed() -> None:
    model = models.coasting(3)
    estimator = Truth()
    estimator.start(model, 3, models.random(3))
    np.testing.assert_array_equal(estimator.estimate().mean, model.initial_mean)
    truth = np.arange(9.0).reshape(3, 3)  # two states and a parameter
    estimator.reveal(truth)
    estimator.predict(np.zeros((1, 3)), whole(0, model.period))
    estimator.update(heard(np.zeros((2, 3)), np.ones((2, 3), dtype=bool)))
    np.testing.assert_array_equal(estimator.estimate().mean, truth[:2])
    assert Truth.oracle


def test_particle_filter_equals_a_textbook_loop() -> None:
    """The same random numbers, one run, plain weights. Losses and correlated noise included."""
    runs, steps, count = 3, 12, 60
    model = models.coasting(runs)
    data = models.record(model, runs, steps)
    means, covariances = models.feed(BootstrapParticle({"particles": count, "resample_below": 0.6}), model, data)
    stream = models.random(runs)

    def drawn() -> np.ndarray:
        key, numbers, places = stream.counted()
        out = np.empty((runs, 2 * count))
        for row, run, place in zip(out, numbers, places, strict=True):
            normals(key, place, run, row)
        return np.moveaxis(out.reshape(runs, 2, count), 0, 2)

    noise, offsets = [drawn()], []
    for k in range(steps):
        noise.append(drawn())
        key, *places = stream.counted(data.received[k].any(axis=0))
        offsets.append([uniform(key, place, run) for run, place in zip(*places, strict=True)])
    resampled = 0
    for run in range(runs):
        x = model.initial_mean[:, [run]] + np.linalg.cholesky(model.initial_covariance[:, :, 0]) @ noise[0][:, :, run]
        w, mean = np.full(count, 1 / count), None
        for k in range(steps):
            u = data.u[k][:, [run]]
            mean = (x * w).sum(axis=1)
            q = model.process_covariance(mean[:, None], u, whole(k, model.period))[:, :, 0]
            x = model.transition(x[:, :, None], u, whole(k, model.period))[:, :, 0]
            x = x + np.linalg.cholesky(q) @ noise[k + 1][:, :, run]
            got = np.flatnonzero(data.received[k, :, run])
            innovation = data.y[k, got, run][:, None] - model.measurement(x[:, :, None], k + 1)[got, :, 0]
            inverse = np.linalg.inv(model.measurement_covariance(untold(k + 1, model.ny))[np.ix_(got, got)][:, :, 0])
            w = w * np.exp(-0.5 * np.einsum("ji,jk,ki->i", innovation, inverse, innovation))
            w = w / w.sum()
            mean = (x * w).sum(axis=1)
            np.testing.assert_allclose(means[k, :, run], mean, rtol=0, atol=1e-9)
            np.testing.assert_allclose(covariances[k, :, :, run], (x - mean[:, None]) * w @ (x - mean[:, None]).T,
                                       rtol=0, atol=1e-9)
            if 1 / (w @ w) < 0.6 * count:
                resampled += 1
                x = x[:, np.searchsorted(np.cumsum(w), (np.arange(count) + offsets[k][run]) / count)]
                w = np.full(count, 1 / count)
    assert 5 < resampled < runs * steps


def test_particle_filter_tends_to_the_kalman_filter() -> None:
    """The distance of the means falls as 1 / sqrt(N): 16 times the particles, a quarter of the distance. By the mean
    logarithm of each run's own ratio, to two standard errors: a mean square would be that of a few unlucky runs."""
    runs = 200
    model = models.linear(runs)
    data = models.record(model, runs, 6)
    exact, _ = models.feed(Kalman(), model, data)
    apart = {}
    for count in (250, 4000):
        means, _ = models.feed(BootstrapParticle({"particles": count}), model, data)
        apart[count] = np.linalg.norm((means - exact)[-1], axis=0)
    ratio = np.log(apart[250] / apart[4000])
    assert abs(ratio.mean() - np.log(4)) < 2 * ratio.std(ddof=1) / np.sqrt(runs)


def test_steps_whose_particles_have_degenerated_are_counted() -> None:
    """Counted where a measurement leaves 1 / sum w^2 under nx + 1 = 3: often with four particles, never with 3000."""
    runs, count = 5, 4
    model = models.coasting(runs)
    data = models.record(model, runs, 10)
    estimator = BootstrapParticle({"particles": count})
    models.feed(estimator, model, data)
    few = estimator.counters()["degenerate"]
    many = BootstrapParticle({"particles": 3000})
    models.feed(many, model, data)
    assert (few <= 10).all() and few.sum() > 0 and many.counters()["degenerate"].sum() == 0


def test_particle_filter_is_bit_identical_in_any_batch() -> None:
    runs = 30
    model = models.coasting(runs)
    data = models.record(model, runs, 8)
    whole = models.feed(BootstrapParticle({"particles": 40}), model, data)
    for size in (1, 7):
        some = Record(*(np.ascontiguousarray(a[..., :size]) for a in (data.u, data.y, data.received, data.truth)))
        part = models.feed(BootstrapParticle({"particles": 40}),
                           replace(model, initial_mean=model.initial_mean[:, :size].copy()), some)
        for large, small in zip(whole, part, strict=True):
            np.testing.assert_array_equal(large[..., :size], small)


def test_particles_far_from_the_measurement_keep_their_weights() -> None:
    """A measurement 1e4 standard deviations off: plain weights would all be zero, logarithms still tell them apart."""
    model = models.coasting(2)
    estimator = BootstrapParticle({"particles": 50})
    estimator.start(model, 2, models.random(2))
    before = estimator.estimate().mean.copy()
    estimator.update(heard(np.array([[50.0, 50.0], [5000.0, 10.0]]), np.ones((2, 2), dtype=bool)))
    assert not estimator.status.any()
    assert estimator.estimate().mean[1, 0] > before[1, 0] + 1.0


def test_a_run_without_likelihood_fails_alone() -> None:
    model = models.coasting(3)
    data = models.record(model, 3, 5, loss=0.0)
    estimator = BootstrapParticle({"particles": 50})
    healthy, _ = models.feed(estimator, model, data)
    data.y[2, 0, 1] = np.inf
    means, _ = models.feed(estimator, model, data)
    assert estimator.status.tolist() == [0, int(Status.failed), 0]
    assert all("likelihood" in why for why in estimator.reasons.values())
    np.testing.assert_array_equal(means[:, :, [0, 2]], healthy[:, :, [0, 2]])
    assert np.isnan(means[2:, :, 1]).all()


def test_particle_covariances_are_positive() -> None:
    model = models.coasting(10)
    _, covariances = models.feed(BootstrapParticle(), model, models.record(model, 10, 20))
    np.testing.assert_array_equal(covariances, covariances.swapaxes(1, 2))
    assert np.linalg.eigvalsh(np.moveaxis(covariances, 3, 1)).min() > 0


@pytest.mark.parametrize("estimator", [Direct(), DeadReckoning(), ExtendedKalman(), BootstrapParticle()])
def test_inputs_are_not_modified(estimator: Estimator) -> None:
    model = square(3)
    data = models.record(models.linear(3, nx=2, ny=2), 3, 4)
    arrays = (data.u, data.y, data.received, model.initial_mean, model.initial_covariance)
    before = [array.copy() for array in arrays]
    models.feed(estimator, model, data)
    for array, old in zip(arrays, before, strict=True):
        np.testing.assert_array_equal(array, old)


def test_particles_survive_a_measurement_of_the_state_itself() -> None:
    """A model whose measurement returns the very array it is given: nothing of the filter's is overwritten."""
    model = replace(models.coasting(3), measurement=lambda x, k: x)
    data = models.record(model, 3, 6)
    copying = replace(model, measurement=lambda x, k: x.copy())
    copied, _ = models.feed(BootstrapParticle({"particles": 40}), copying, data)
    means, _ = models.feed(BootstrapParticle({"particles": 40}), model, data)
    np.testing.assert_array_equal(means, copied)
