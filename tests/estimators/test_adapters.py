"""Other libraries' filters through the per-run adapters, each equal to the built-in one to 1e-9.

filterpy, Stone-Soup and pykalman as a user would connect them, and what the adapters promise beyond."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime, timedelta

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter as FilterpyKalman
from pykalman import KalmanFilter as PykalmanFilter
from railstate.estimators.adapters import PerRun, PerRunStep, RunModel
from railstate.estimators.interface import Estimator, Status
from railstate.estimators.kalman import ExtendedKalman, Kalman
from railstate.estimators.reference.filterpy import FilterpyCubature, FilterpyExtended, FilterpyUnscented
from railstate.estimators.sigma_point import CubatureKalman, UnscentedKalman
from railstate.scenarios.errors import Unsupported
from railstate.scenarios.files import load
from railstate.scenarios.measurement import untold
from railstate.scenarios.randomness import Streams
from stonesoup.models.control.linear import LinearControlModel
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.transition.linear import LinearGaussianTimeInvariantTransitionModel
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import GaussianState, State
from stonesoup.updater.kalman import KalmanUpdater

from .. import models
from ..models import heard, whole

PRINTED = {"alpha": 1e-3, "beta": 2.0, "kappa": 0.0}
PAIRS: dict[str, tuple[Estimator, Estimator, float]] = {
    "ekf": (FilterpyExtended(), ExtendedKalman(), 1e-9),
    "ukf": (FilterpyUnscented(), UnscentedKalman(), 1e-9),
    "ukf-wide": (FilterpyUnscented({"alpha": 0.7, "beta": 2.0, "kappa": 2.5}),
                 UnscentedKalman({"alpha": 0.7, "beta": 2.0, "kappa": 2.5}), 1e-9),
    "ukf-julier": (FilterpyUnscented({"points": "julier", "kappa": 1.0}),
                   UnscentedKalman({"points": "julier", "kappa": 1.0}), 1e-9),
    "ukf-printed": (FilterpyUnscented(PRINTED), UnscentedKalman(PRINTED), 1e-6),  # weights of 1e6 amplify rounding
    "ckf": (FilterpyCubature(), CubatureKalman(), 1e-9),
}


class FilterpyLinear(PerRun):
    """A user's filterpy KalmanFilter."""

    claims = ("covariance",)

    def make(self, model):
        kf = FilterpyKalman(model.nx, model.ny)
        kf.x, kf.P = model.x0, model.P0
        return kf

    def predict_run(self, kf, model, u, interval):
        drift = model.f(np.zeros(model.nx), u, interval)
        kf.predict(u=drift, B=np.eye(model.nx), F=model.F(kf.x, u, interval), Q=model.Q(kf.x, u, interval))

    def update_run(self, kf, model, y, got):
        kf.update(y, R=model.R[np.ix_(got, got)], H=model.H(kf.x)[got])


class Rows(LinearGaussian):
    """Stone-Soup's linear measurement with any matrix: `mapping` carries the rows."""

    def matrix(self, **kwargs):
        return np.array(self.mapping)

    @property
    def ndim_meas(self):
        return len(self.mapping)


class StoneSoupKalman(PerRun):
    """Stone-Soup's predictor and updater around one state."""

    claims = ("covariance",)

    def make(self, model):
        return {"state": GaussianState(model.x0[:, None], model.P0, timestamp=datetime(2000, 1, 1))}

    def predict_run(self, track, model, u, interval):
        x = np.ravel(track["state"].state_vector).astype(float)
        transition = LinearGaussianTimeInvariantTransitionModel(
            transition_matrix=model.F(x, u, interval), covariance_matrix=model.Q(x, u, interval))
        drift = State(model.f(np.zeros(model.nx), u, interval)[:, None])
        predictor = KalmanPredictor(transition, LinearControlModel(control_matrix=np.eye(model.nx)))
        time = track["state"].timestamp + timedelta(seconds=interval.length)
        track["state"] = predictor.predict(track["state"], timestamp=time, control_input=drift)

    def update_run(self, track, model, y, got):
        rows = model.H(model.x0)[got]
        measured = Rows(ndim_state=model.nx, mapping=rows, noise_covar=model.R[np.ix_(got, got)])
        detection = Detection(y[:, None], timestamp=track["state"].timestamp, measurement_model=measured)
        track["state"] = KalmanUpdater(measured).update(SingleHypothesis(track["state"], detection))

    def read_run(self, track):
        return np.array(track["state"].state_vector, dtype=float), np.array(track["state"].covar, dtype=float)


class PykalmanStep(PerRunStep):
    """pykalman's filter_update, which predicts and corrects in one call."""

    claims = ("covariance",)

    def make(self, model):
        kf, belief = PykalmanFilter(n_dim_state=model.nx, n_dim_obs=model.ny), [model.x0, model.P0]

        def step(y, u):
            x, got = belief[0], np.flatnonzero(~np.isnan(y))
            rows = got if len(got) else np.arange(model.ny)  # observation None: predict only
            belief[:] = kf.filter_update(
                *belief, y[got] if len(got) else None, transition_matrix=model.F(x, u),
                transition_covariance=model.Q(x, u), transition_offset=model.f(np.zeros(model.nx), u),
                observation_matrix=model.H(x)[rows], observation_offset=np.zeros(len(rows)),
                observation_covariance=model.R[np.ix_(rows, rows)])
            return belief[0], belief[1]

        return step


@pytest.mark.parametrize("plant", ["linear", "coasting"])
@pytest.mark.parametrize("name", PAIRS)
def test_filterpy_equals_ours(name: str, plant: str) -> None:
    theirs, ours, tolerance = PAIRS[name]
    model = models.linear(3, correlated=True, ny=3) if plant == "linear" else models.coasting(3)
    data = models.record(model, 3, 50)
    mean, covariance = models.feed(theirs, model, data)
    expected, its_covariance = models.feed(ours, model, data)
    assert not theirs.status.any()
    np.testing.assert_allclose(mean, expected, rtol=0, atol=tolerance)
    np.testing.assert_allclose(covariance, its_covariance, rtol=0, atol=tolerance)


METRO = load("ningbo-metro")


@pytest.mark.parametrize("variant", METRO.variants)
@pytest.mark.parametrize("name", ["ekf", "ukf", "ckf"])
def test_filterpy_equals_ours_on_the_metro(name: str, variant: str) -> None:
    """Every disturbance variant, one run through the first two hundred steps: start, traction, cruise."""
    theirs, ours, tolerance = PAIRS[name]
    setting = METRO.setting(variant)
    world = setting.world(Streams(1, "ningbo-metro", variant, (0,)))
    model = setting.design_model({}, world.initial_mean)
    for estimator in (theirs, ours):
        estimator.start(model, 1, models.random(1))
    for k in range(200):
        step = world.step(k, world.initial_mean)
        for estimator in (theirs, ours):
            for event in step.events:
                estimator.predict(step.u, models.part(k, event.share, step.length))
                estimator.update(heard(event.y, event.received, k))
        np.testing.assert_allclose(theirs.estimate().mean, ours.estimate().mean, rtol=0, atol=tolerance)


@pytest.mark.parametrize("name", PAIRS)
def test_filterpy_far_from_the_origin_and_in_part_steps(name: str) -> None:
    """Two thousand metres out, part steps per run, and two measurements without a step between them."""
    theirs, ours, tolerance = PAIRS[name]
    model = models.coasting(2)
    model = replace(model, initial_mean=model.initial_mean + np.array([[2000.0], [0.0]]))
    data = models.record(model, 2, 20)
    for estimator in (theirs, ours):
        estimator.start(model, 2, models.random(2))
    for k in range(20):
        for estimator in (theirs, ours):
            for share in (np.array([0.3, 0.6]), np.array([0.7, 0.4])):
                estimator.predict(data.u[k], models.part(k, share, model.period))
                estimator.update(heard(data.y[k], data.received[k], k))
            estimator.update(heard(data.y[k], data.received[k], k))
        np.testing.assert_allclose(theirs.estimate().mean, ours.estimate().mean, rtol=0, atol=max(tolerance, 1e-9))
        np.testing.assert_allclose(theirs.estimate().covariance, ours.estimate().covariance, rtol=0, atol=tolerance)


@pytest.mark.parametrize("adapter", [FilterpyLinear, StoneSoupKalman, PykalmanStep])
def test_users_filters_equal_the_built_in_kalman(adapter: type[Estimator]) -> None:
    model = models.linear(3, correlated=True, ny=3)
    data = models.record(model, 3, 25)
    expected, its_covariance = models.feed(Kalman(), model, data)
    theirs = adapter()
    mean, covariance = models.feed(theirs, model, data)
    assert not theirs.status.any(), theirs.reasons
    np.testing.assert_allclose(mean, expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(covariance, its_covariance, rtol=0, atol=1e-9)


class Fragile(PerRun):
    """Predict and update as they come with any object: claims nothing, and breaks on a large measurement."""

    def make(self, model):
        class Follower:
            x = model.x0

            def predict(self, u):
                self.x = model.f(self.x, u)

            def update(self, y):
                if y[1] > 1e6:
                    raise ArithmeticError("too fast for me")
                self.x = np.array([self.x[0], y[1]])

        return Follower()


def test_a_filter_that_raises_costs_its_run_alone() -> None:
    model = models.coasting(4)
    data = models.record(model, 4, 6, loss=0.0)
    healthy, _ = models.feed(Fragile(), model, data)
    data.y[2, 1, 1] = 1e7
    estimator = Fragile()
    means, covariances = models.feed(estimator, model, data)
    assert covariances is None
    assert estimator.status.tolist() == [0, int(Status.failed), 0, 0]
    assert set(estimator.reasons.values()) == {"ArithmeticError: too fast for me"}
    np.testing.assert_array_equal(means[:, :, [0, 2, 3]], healthy[:, :, [0, 2, 3]])
    assert np.isnan(means[2:, :, 1]).all() and np.isfinite(means[:2]).all()


class Noisy(PerRunStep):
    """A step function that claims only a mean, with noise of its own run's stream."""

    def make(self, model):
        return lambda y, u: model.x0 + model.random.normal(size=model.nx)


def test_step_functions_draw_from_their_own_run() -> None:
    model = models.coasting(5)
    data = models.record(model, 5, 3)
    means, _ = models.feed(Noisy(), model, data)
    one, _ = models.feed(Noisy(), replace(model, initial_mean=model.initial_mean[:, :1]), data.only(0))
    np.testing.assert_array_equal(means[:, :, :1], one)
    assert len(np.unique(means)) == means.size


def test_step_functions_refuse_part_steps() -> None:
    model = models.coasting(2)
    estimator = Noisy()
    estimator.start(model, 2, models.random(2))
    with pytest.raises(Unsupported, match="part steps"):
        estimator.predict(np.zeros((1, 2)), models.part(0, np.array([0.5, 1.0])))


def test_a_missing_part_of_the_design_model_is_named() -> None:
    model = replace(models.coasting(2), transition_jacobian=None)
    with pytest.raises(Unsupported, match="transition_jacobian"):
        FilterpyExtended.require(model)
    estimator = FilterpyLinear()
    estimator.start(model, 2, models.random(2))
    estimator.predict(np.zeros((1, 2)), whole(0, model.period))
    assert (estimator.status == Status.failed).all() and all("Jacobian" in why for why in estimator.reasons.values())


def test_filterpy_parameters_are_checked() -> None:
    with pytest.raises(ValueError, match="always redraws"):
        FilterpyUnscented({"redraw": False})


def test_between_a_step_and_its_measurement_the_prediction_stands() -> None:
    model = models.linear(2, correlated=True)

    class Kept(PerRunStep):
        claims = ("covariance",)

        def make(self, model):
            return lambda y, u: (model.x0, model.P0)

    estimator, u = Kept(), np.array([[0.3, -0.2]])
    estimator.start(model, 2, models.random(2))
    estimator.predict(u, whole(0))
    F, Q = model.linear.A(0), model.linear.Q(0)
    found = estimator.estimate()
    np.testing.assert_allclose(found.mean, model.transition(model.initial_mean, u, whole(0)), rtol=1e-12)
    for run in range(2):
        np.testing.assert_allclose(found.covariance[:, :, run], F @ model.initial_covariance[:, :, 0] @ F.T + Q,
                                   rtol=1e-12)


def test_a_run_s_model_before_anything_has_happened() -> None:
    """`make` may ask it: over the first interval, and for the R of a measurement that tells nothing."""
    model, u = models.coasting(2), np.array([0.4])
    one = RunModel(model, 1, models.random(2))
    assert one.interval == whole(0, model.period) and one.step == 0
    first = model.transition(model.initial_mean[:, 1:], u[:, None], whole(0, model.period))
    np.testing.assert_array_equal(one.f(one.x0, u), first[:, 0])
    np.testing.assert_array_equal(one.R, model.measurement_covariance(untold(0, model.ny))[:, :, 0])
    asked = untold(3, 2)
    assert asked.y.shape == asked.received.shape == (2, 1) and asked.received.all() and asked[2:] == (3, 0, 0.0, None)
