"""The particle filter with densities of its noise: uniform noise against the posterior on a fine grid, and a loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from railstate.estimators.particle import BootstrapParticle
from railstate.scenarios.densities import uniform
from railstate.scenarios.files import load
from railstate.scenarios.model import Linear, linear_model
from railstate.scenarios.registry import setting_of

from ..models import heard, random, whole

A, W, V = 0.9, 0.3, 0.5
"""x+ = A x + w, y = x + v, |w| <= W, |v| <= V, both uniform."""


def model(runs, densities=True):
    one = np.ones((1, 1))
    plain = linear_model(
        Linear(lambda k: A * one, lambda k: np.zeros((1, 0)), lambda k: np.zeros(1), lambda k: one,
               lambda k: W**2 / 3 * one, lambda k: V**2 / 3 * one), states=("x",), measurements=("y",), period=1.0,
        initial_mean=np.zeros((1, runs)), initial_covariance=one[:, :, None])
    return replace(plain, densities=uniform(lambda interval: one[:, :, None], np.array([W]), np.array([V]))
                   if densities else None)


def measured(steps, seed=3):
    draw = np.random.default_rng(seed)
    x, out = draw.normal(), []
    for _ in range(steps):
        x = A * x + draw.uniform(-W, W)
        out.append(x + draw.uniform(-V, V))
    return np.array(out), np.array([k % 4 != 2 for k in range(steps)])


def estimates(runs, particles, parameters=None, densities=True, steps=12):
    """Means (K, runs), variances and the log-likelihoods of what was received, all runs with the same readings."""
    y, got = measured(steps)
    one = model(runs, densities)
    estimator = BootstrapParticle(BootstrapParticle.Parameters(particles=particles, **(parameters or {})))
    estimator.design(one)
    estimator.start(one, runs, random(runs))
    means, variances, likelihood = [], [], np.zeros(runs)
    for k in range(steps):
        estimator.predict(np.zeros((0, runs)), whole(k))
        told = estimator.update(heard(np.full((1, runs), y[k] if got[k] else np.nan), np.full((1, runs), got[k]), k))
        likelihood += told.log_likelihood
        estimate = estimator.estimate()
        means.append(estimate.mean[0].copy())
        variances.append(estimate.covariance[0, 0].copy())
    return np.array(means), np.array(variances), likelihood


def on_a_grid(steps=12):
    """Posterior means, variances and the log-likelihood by numerical integration: prior N(0, 1) on a grid of 1e-3."""
    y, got = measured(steps)
    x = np.arange(-5, 5, 1e-3)
    p = np.exp(-0.5 * x**2)
    p /= p.sum() * 1e-3
    means, variances, likelihood = [], [], 0.0
    for k in range(steps):
        mass = np.concatenate([[0.0], np.cumsum(p) * 1e-3])  # p+(z) = integral of p(x) over |z - A x| <= W, over 2 W
        edges = np.concatenate([x, [x[-1] + 1e-3]]) - 5e-4
        p = (np.interp((x + W) / A, edges, mass) - np.interp((x - W) / A, edges, mass)) / (2 * W)
        if got[k]:
            p = np.where(np.abs(y[k] - x) <= V, p / (2 * V), 0.0)
            likelihood += np.log(p.sum() * 1e-3)
        p /= p.sum() * 1e-3
        mean = (p * x).sum() * 1e-3
        means.append(mean)
        variances.append((p * (x - mean)**2).sum() * 1e-3)
    return np.array(means), np.array(variances), likelihood


def test_uniform_noise_gives_the_posterior_on_a_grid():
    """Mean of 40 filters of 4000 particles each, within four standard errors at every step; Gaussian noise of the same
    moments is elsewhere."""
    means, variances, likelihood = estimates(40, 4000)
    right, spread, evidence = on_a_grid()
    for found, wanted in ((means, right), (variances, spread)):
        error = found.std(axis=1, ddof=1) / 40**0.5
        assert (np.abs(found.mean(axis=1) - wanted) < 4 * error + 1e-4).all()
    assert abs(likelihood.mean() - evidence) < 4 * likelihood.std(ddof=1) / 40**0.5 + 2e-3
    gaussian = estimates(40, 4000, densities=False)[0]
    assert np.abs(gaussian.mean(axis=1) - right).max() > 20 * (gaussian.std(axis=1) / 40**0.5).max()


def test_a_naive_loop_with_the_same_draws():
    """Particle by particle in the test, with the filter's own uniform numbers; never resampled."""
    runs, count, steps = 2, 60, 2
    one, y = model(runs), measured(steps)[0]
    estimator = BootstrapParticle(BootstrapParticle.Parameters(particles=count, resample_below=0.0))
    estimator.start(one, runs, random(runs))
    start, same = estimator._laid_out()[0].copy(), random(runs)
    alive = np.ones((count, runs), dtype=bool)
    same.counted(np.ones(runs, dtype=bool))
    for k in range(steps):
        estimator.predict(np.zeros((0, runs)), whole(k))
        estimator.update(heard(np.full((1, runs), y[k]), np.ones((1, runs), dtype=bool), k))
        z = same.uniform(0.0, 1.0, 1, count)[0]
        for _ in range(2):  # the kernel's own draws of moments and resampling
            same.counted(np.ones(runs, dtype=bool))
        for s in range(runs):
            for i in range(count):
                start[i, s] = A * start[i, s] + W * (2 * z[i, s] - 1)
            alive[:, s] &= np.abs(y[k] - start[:, s]) <= V
    assert np.allclose(estimator._laid_out()[0], start, atol=1e-14) and alive.any(axis=0).all()
    assert np.allclose(estimator._weights.T, alive / alive.sum(axis=0))


def test_roughening_spreads_the_particles_and_leaves_the_estimate():
    """Resampled each time, K = .2: states differ that were copies; the mean of that step is the unroughened one's."""
    plain, *_ = estimates(3, 50, {"resample_below": 1.0}, steps=1)
    rough, *_ = estimates(3, 50, {"resample_below": 1.0, "roughening": 0.2}, steps=1)
    assert np.array_equal(plain, rough)
    one = model(2)
    sets = []
    for roughening in (0.0, 0.2):
        estimator = BootstrapParticle(BootstrapParticle.Parameters(particles=50, resample_below=1.0,
                                                                   roughening=roughening))
        estimator.start(one, 2, random(2))
        estimator.update(heard(np.full((1, 2), 0.1), np.array([[True, False]]), 0))
        sets.append([len(np.unique(estimator._particles[s, 0])) for s in range(2)])
    assert sets[0][0] < 50 and sets[1] == [50, 50] and sets[0][1] == 50


def test_uniform_densities_element_by_element():
    """With gains that differ from run to run; a residual at its bound can be."""
    draw = np.random.default_rng(2)
    gains, w_bar, v_bar = draw.normal(size=(2, 3, 4)), np.array([0.5, 1.0, 2.0]), np.array([0.25, 3.0])
    found = uniform(lambda interval: gains, w_bar, v_bar)
    assert found.drawn == 3
    for between in ((), (5,), (5, 2)):
        z = draw.uniform(size=(3, *between, 4))
        made = found.process(z, whole(0))
        assert made.shape == (2, *between, 4)
        for i, *place in np.ndindex(made.shape):
            wanted = sum(gains[i, j, place[-1]] * w_bar[j] * (2 * z[(j, *place)] - 1) for j in range(3))
            assert made[(i, *place)] == pytest.approx(wanted, rel=1e-13)
    v = np.array([[0.25, -0.25, 0.26, -0.26, 0.0], [3.0, 3.1, 0.0, 9.0, 9.0]])
    received = np.array([[1, 1, 1, 0, 0], [1, 0, 1, 1, 0]], dtype=bool)
    assert found.log_measurement(v, heard(v, received)) == pytest.approx(
        [-np.log(0.5) - np.log(6.0), -np.log(0.5), -np.inf, -np.inf, 0.0])
    with pytest.raises(ValueError, match="shorter"):
        found.log_measurement(v, heard(v, received[:1]))


def test_the_metro_tells_its_bounds_as_densities():
    """A whole step's noise is within the bounds and has the moments of Q; residuals out of them are impossible."""
    table = dict(load("ningbo-metro").variants["white"])
    setting = setting_of(table, "ningbo-metro")
    told = setting.design_model({"densities": "uniform"}, np.array([[0.0], [10.0]]))
    assert setting.design_model({}, np.zeros((2, 1))).densities is None and told.densities is not None
    interval = whole(0, told.period)
    noise = told.densities.process(np.random.default_rng(1).uniform(size=(1, 200_000, 1)), interval)[:, :, 0]
    assert np.abs(noise).max(axis=1) == pytest.approx([0.003, 0.03], rel=1e-3)
    Q = told.process_covariance(told.initial_mean, np.zeros((1, 1)), interval)[:, :, 0]
    assert np.cov(noise) == pytest.approx(Q, rel=0.02)
    v = np.array([[0.5, 1.1, 0.5], [0.1, 0.1, 0.3]])[:, :, None]
    measurement = heard(np.zeros((2, 1)), np.array([[True], [True]]))
    density = told.densities.log_measurement(v, measurement)[:, 0]
    assert density[0] == pytest.approx(-np.log(2.0 * 0.4)) and np.isneginf(density[1:]).all()
    half = heard(np.zeros((2, 1)), np.array([[True], [False]]))
    assert told.densities.log_measurement(v, half)[2, 0] == pytest.approx(-np.log(2.0))
