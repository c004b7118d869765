"""The interface, second edition: time from the runner, noise per run, innovations in turn, told accuracy."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from railstate.benchmarks.running.loop import Loop, Observer
from railstate.benchmarks.scoring.innovations import InnovationScore
from railstate.estimators.interface import Estimate, Estimator, Innovation, misshapen
from railstate.estimators.registry import estimators
from railstate.scenarios.errors import InputError, Unsupported
from railstate.scenarios.measurement import Interval, Measurement, told, untold
from railstate.scenarios.model import DesignModel, Linear
from railstate.scenarios.world import Event, Step, Trajectory
from scipy.stats import chi2, multivariate_normal

from .. import models
from ..models import heard, part, whole

Array = NDArray[np.float64]
GAUSSIAN = ["kalman", "ekf", "ukf", "ckf", "filterpy-ekf", "filterpy-ukf", "filterpy-ckf"]
TELLING = [*GAUSSIAN, "particle", "robust-mean-square"]


def log_likelihood(innovation: Innovation | None, received: NDArray[np.bool_]) -> Array:
    """log p(received | before) of each run (S,)."""
    assert innovation is not None
    if innovation.log_likelihood is not None:
        return innovation.log_likelihood
    assert innovation.residual is not None and innovation.variance is not None
    variance = np.broadcast_to(innovation.variance, received.shape)
    variance = np.where(received, variance, 1.0)
    logs = -0.5 * (innovation.residual**2 / variance + np.log(2 * np.pi * variance))
    return np.where(received, logs, 0.0).sum(axis=0)


class Parts:
    """A world of three steps in which some runs have an event in mid-step. u counts in the whole step's distance."""

    steps, closed_loop = 3, False

    def __init__(self, shares: Array) -> None:
        self.shares, self.runs = shares, len(shares)
        self.initial_mean, self.lengths = np.zeros((1, self.runs)), np.full(3, 2.0)

    def step(self, k: int, mean: Array) -> Step:
        y, nothing = np.zeros((1, self.runs)), np.zeros((1, self.runs), dtype=bool)
        mid = self.shares < 1.0
        events = [Event(1.0, y, nothing)]
        if mid.any():
            events = [Event(self.shares, y, nothing), Event(1.0 - self.shares, y, nothing)]
        return Step(np.full((1, self.runs), 10.0), tuple(events), np.zeros((1, self.runs)),
                    np.ones(self.runs, dtype=bool), number=k + 1, start=2.0 * k, length=2.0)


def varying(runs: int) -> DesignModel:
    """x+ = x + s (length + step it leaves from): what a step adds depends on which it is. Exact for parts of a step."""
    def moved(x: Array, u: Array, interval: Interval) -> Array:
        return x + interval.length * (1.0 + interval.depart) + interval.share * u[0]

    return DesignModel(
        states=("x",), measurements=("x",), period=2.0, transition=moved, measurement=lambda x, step: x * step,
        transition_jacobian=lambda x, u, interval: np.ones((1, 1, 1)),
        measurement_jacobian=lambda x, step: np.full((1, 1, 1), float(step)),
        process_covariance=lambda x, u, interval: np.atleast_1d(interval.length * (1.0 + interval.depart))[None, None],
        measurement_covariance=told(lambda step: np.ones((1, 1, 1))), initial_mean=np.zeros((1, runs)),
        initial_covariance=np.ones((1, 1, 1)))


@pytest.mark.parametrize("name", ["ekf", "ukf", "ckf", "particle", "dead-reckoning", "filterpy-ekf", "filterpy-ukf"])
def test_a_time_varying_model_gets_the_same_matrices_whatever_happens_to_other_runs(name: str) -> None:
    """Alone, beside a run with an event in mid-step, and split itself."""
    def last(shares: list[float]) -> Estimate:
        world = Parts(np.array(shares))
        estimator = estimators()[name]({})
        estimator.start(varying(world.runs), world.runs, models.random(world.runs))
        for _ in Loop(world, estimator, Observer()).steps():
            pass
        return estimator.estimate()

    alone, beside = last([1.0]), last([1.0, 0.4])
    assert np.array_equal(alone.mean[:, 0], beside.mean[:, 0])
    if alone.covariance is not None and beside.covariance is not None:
        assert np.array_equal(alone.covariance[:, :, 0], beside.covariance[:, :, 0])
    if name != "particle":
        assert alone.mean[0, 0] == pytest.approx(2 * (1 + 2 + 3) + 30)
        assert beside.mean[0, 1] == pytest.approx(alone.mean[0, 0])


def test_the_interval_says_which_step_and_which_time_it_is() -> None:
    seen: list[Any] = []

    class Notes(estimators()["dead-reckoning"]):
        def predict(self, u: Array, interval: Interval) -> None:
            seen.append(interval.of_run(0))

        def update(self, measurement: Measurement) -> None:
            seen.append((measurement.step, measurement.event, float(np.max(measurement.time))))

    world = Parts(np.array([0.25]))
    notes = Notes({})
    notes.start(varying(1), 1, models.random(1))
    assert [step.number for step in Loop(world, notes, Observer()).steps()] == [1, 2, 3]
    first, at_first, second, at_second = seen[4:8]
    assert (first.step, first.depart, first.start, float(first.length), float(first.share)) == (2, 1, 2.0, 0.5, 0.25)
    assert (float(second.start), float(second.length), float(second.share)) == (2.5, 1.5, 0.75)
    assert at_first == (2, 0, 2.5) and at_second == (2, 1, 4.0)


def test_a_world_that_measures_at_the_start_counts_from_zero() -> None:
    zeros = np.zeros((3, 1, 2))
    world = Trajectory(zeros, zeros, zeros, zeros > 0, np.ones((3, 2), dtype=bool), np.array([0.0, 0.5, 2.0]),
                       np.zeros((1, 2)))
    steps = [world.step(k, world.initial_mean) for k in range(3)]
    assert [(step.number, step.start, step.length, step.events[0].share) for step in steps] == [
        (0, 0.0, 0.0, 0.0), (1, 0.0, 0.5, 1.0), (2, 0.5, 2.0, 1.0)]


@pytest.mark.parametrize("name", ["kalman", "ekf", "ukf", "ckf", "filterpy-ekf", "filterpy-ukf", "robust-mean-square",
                                  "particle"])
def test_noise_per_run_is_each_run_s_own(name: str) -> None:
    """P0 = 1, R = 1, 100, 1e4: P = R/(1 + R), which a shared R would make .5 three times."""
    R = np.array([1.0, 1e2, 1e4])
    model = models.still(3)
    if name == "robust-mean-square":
        model = replace(model, performance=np.eye(1))
    estimator = estimators()[name]({"particles": 200_000} if name == "particle" else {})
    estimator.design(model)
    estimator.start(model, 3, models.random(3))
    estimator.update(Measurement(np.zeros((1, 3)), np.ones((1, 3), dtype=bool), 0, covariance=R[None, None]))
    estimate = estimator.estimate()
    found = estimate.bound if estimate.covariance is None else estimate.covariance[0, 0]
    assert found == pytest.approx(R / (1 + R), rel=1e-2 if name == "particle" else 1e-9)


@pytest.mark.parametrize("name", GAUSSIAN)
@pytest.mark.parametrize("correlated", [False, True])
def test_log_likelihood_is_that_of_the_joint_gaussian(name: str, correlated: bool) -> None:
    """Of all that a run has received, missing elements, several events and told accuracy included."""
    runs, steps = 4, 5
    model = models.linear(runs, correlated=correlated)
    data, linear = models.record(model, runs, steps), model.linear
    assert linear is not None
    draw = np.random.default_rng(2)
    says = np.where(draw.uniform(size=(steps, 2, 1, runs)) < 0.5, draw.uniform(0.1, 3.0, (steps, 2, 1, runs)), np.nan)
    covariances = np.where(np.eye(2, dtype=bool)[..., None], says, np.where(np.isnan(says + says.swapaxes(1, 2)),
                                                                         np.nan, 0.0))
    estimator = estimators()[name]({})
    estimator.design(model)
    estimator.start(model, runs, models.random(runs))
    total = np.zeros(runs)
    for k in range(steps):
        estimator.predict(data.u[k], whole(k))
        innovation = estimator.update(Measurement(data.y[k], data.received[k], k + 1, covariance=covariances[k]))
        total += log_likelihood(innovation, data.received[k])
    A, B, h, C, Q, R = (getattr(linear, part)(0) for part in "ABhCQR")
    for run in range(runs):
        n = len(A)
        mean, P, means, blocks = model.initial_mean[:, run], model.initial_covariance[:, :, 0], [], []
        gains: list[Array] = []
        for k in range(steps):
            mean, P = A @ mean + B @ data.u[k, :, run] + h, A @ P @ A.T + Q
            means.append(C @ mean)
            blocks.append(P)
            gains.append(A)
        big = np.zeros((steps * 2, steps * 2))
        for i in range(steps):
            carried = blocks[i]
            for j in range(i, steps):
                big[2 * i:2 * i + 2, 2 * j:2 * j + 2] = C @ carried @ C.T
                big[2 * j:2 * j + 2, 2 * i:2 * i + 2] = big[2 * i:2 * i + 2, 2 * j:2 * j + 2].T
                carried = carried @ A.T
            own = np.where(np.isnan(covariances[i, :, :, run]), R, covariances[i, :, :, run])
            big[2 * i:2 * i + 2, 2 * i:2 * i + 2] += own
        got = np.flatnonzero(data.received[:, :, run].ravel())
        expected = multivariate_normal(np.concatenate(means)[got], big[np.ix_(got, got)]).logpdf(
            data.y[:, :, run].ravel()[got])
        assert total[run] == pytest.approx(expected, rel=1e-10, abs=1e-10), n


@pytest.mark.parametrize("name", sorted(set(estimators()) - {"fixed-gain"}))
def test_who_cannot_use_told_accuracy_refuses_before_the_run(name: str) -> None:
    cls = estimators()[name]
    model = replace(models.coasting(2), tells=("distance",))
    complete = all(getattr(model, needed) is not None for needed in cls.needs)
    if "covariance" in cls.honours or not complete:
        return
    with pytest.raises(Unsupported, match="sensors tell"):
        cls.require(model)


def test_an_ended_run_hears_nothing_any_more() -> None:
    runs = 2
    zeros = np.zeros((4, 1, runs))
    active = np.array([[True, True], [True, True], [True, False], [True, False]])
    world = Trajectory(zeros, zeros, zeros + 1.0, np.ones_like(zeros, dtype=bool), active, np.ones(4),
                       np.zeros((1, runs)))
    heard_by: list[Any] = []

    class Notes(estimators()["dead-reckoning"]):
        def update(self, measurement: Measurement) -> None:
            heard_by.append(measurement.received[0].tolist())

    notes = Notes({})
    notes.start(varying(runs), runs, models.random(runs))
    for _ in Loop(world, notes, Observer()).steps():
        pass
    assert heard_by == [[True, True], [True, True], [True, False], [True, False]]


def test_scenarios_of_the_first_edition_are_told_what_to_write() -> None:
    zeros = np.zeros((2, 1, 1))
    with pytest.raises(InputError, match="lengths=portions \\* period"):
        Trajectory(zeros, zeros, zeros, zeros > 0, zeros[:, 0] == 0, portions=np.ones(2), initial_mean=np.zeros((1, 1)))
    with pytest.raises(InputError, match="write transition\\(x, u, interval\\)"):
        replace(varying(1), transition=lambda x, u, k, portion: x)

    class Old(Parts):
        def step(self, k: int, mean: Array) -> Step:
            new = super().step(k, mean)
            return Step(new.u, new.events, new.truth, new.active)

    estimator = estimators()["dead-reckoning"]({})
    estimator.start(varying(1), 1, models.random(1))
    with pytest.raises(InputError, match="number="):
        Loop(Old(np.ones(1)), estimator, Observer()).step(0)


def test_heard_and_part_say_the_same_as_the_runner() -> None:
    assert part(3, 0.5, 2.0) == Interval(4, 6.0, 1.0, 0.5) and whole(0).whole
    assert heard(np.zeros((1, 1)), np.ones((1, 1), dtype=bool), 2).step == 3
    assert isinstance(models.linear(1).linear, Linear) and issubclass(estimators()["ekf"], Estimator)


def test_the_particle_filter_s_likelihood_is_the_kalman_filter_s_up_to_its_particles() -> None:
    """200,000 particles; the standard error of a step's log-likelihood is under 1 % of one."""
    runs, steps = 3, 3
    model = models.linear(runs)
    data = models.record(model, runs, steps)
    found = []
    for name, parameters in (("kalman", {}), ("particle", {"particles": 200_000})):
        estimator = estimators()[name](parameters)
        estimator.start(model, runs, models.random(runs))
        logs = []
        for k in range(steps):
            estimator.predict(data.u[k], whole(k))
            innovation = estimator.update(heard(data.y[k], data.received[k], k))
            logs.append(log_likelihood(innovation, data.received[k]).copy())
        found.append(np.array(logs))
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=0.03)


@pytest.mark.long
def test_nis_of_a_matched_filter_lies_in_its_interval() -> None:
    """2,000 studies of 40 steps: 95 +- 1 % of the mean NIS and of the whiteness lie within."""
    runs = 2000
    model = models.linear(runs)
    data = models.record(model, runs, 40)
    kalman, score = estimators()["kalman"]({}), InnovationScore(runs, 40, 0)
    kalman.start(model, runs, models.random(runs))
    for k in range(40):
        kalman.predict(data.u[k], whole(k))
        measurement = heard(data.y[k], data.received[k], k)
        innovation = kalman.update(measurement)
        assert innovation is not None
        score.add(k, np.ones(runs, dtype=bool), measurement, innovation)
    said = score.finish()
    n, nis = said["elements", "innovation"], said["nis", "innovation"]
    low, high = (chi2.ppf(share, n) / n for share in (0.025, 0.975))  # Bar-Shalom, Li, Kirubarajan, section 5.4
    assert np.mean((low <= nis) & (nis <= high)) == pytest.approx(0.95, abs=0.01)
    pairs, whiteness = said["pairs", "innovation"], said["whiteness", "innovation"]
    assert np.mean(np.abs(whiteness) <= 1.96 / np.sqrt(pairs)) == pytest.approx(0.95, abs=0.01)


def test_noise_as_it_is_told_is_inflated_where_asked() -> None:
    own = np.diag([4.0, 9.0])[:, :, None]
    said = np.full((2, 2, 3), np.nan)
    said[0, 0, 1] = 1.0
    plain, partly = untold(1, 2), untold(1, 2)._replace(covariance=said)
    for factor in (1.0, 2.5):
        covariance = told(lambda step: step * own, factor)
        np.testing.assert_array_equal(covariance(plain), factor * own)
        np.testing.assert_array_equal(covariance(partly)[:, :, 1], factor * np.diag([1.0, 9.0]))
        np.testing.assert_array_equal(covariance(partly)[:, :, 0], factor * own[:, :, 0])


def test_every_parameter_says_what_it_is() -> None:
    silent = [f"{name}.{key}" for name, cls in estimators().items() for key, told in cls.Parameters.model_fields.items()
              if not told.description]
    assert not silent


@pytest.mark.parametrize(("share", "whole"), [
    (1.0, True), (0.5, False), (np.array(1.0), True), (np.ones(3), True), (np.array([1.0, 0.5]), False)])
def test_a_whole_step_is_whole_for_every_run(share: Any, whole: bool) -> None:
    interval = Interval(3, 2.0, 0.5 * share, share)
    assert interval.whole is whole and interval.depart == 2 and interval.moving(np.size(share)).all()


@pytest.mark.parametrize(("mean", "covariance"), [
    (np.zeros((2, 3), dtype=np.float32), None), (np.zeros((3, 2)), None), (np.zeros((2, 4), dtype=np.float32), None),
    (np.zeros((2, 3)), np.zeros((2, 2, 3), dtype=np.float32)), (np.zeros((2, 3)), np.zeros((2, 3, 3)))])
def test_arrays_of_another_shape_or_another_type_are_malformed(mean: Array, covariance: Array | None) -> None:
    assert "float64 of shape" in (misshapen(Estimate(mean, covariance=covariance), 2, 3, 0) or "")
    assert misshapen(Estimate(np.zeros((2, 3)), covariance=np.zeros((2, 2, 3))), 2, 3, 0) is None
