"""filterpy's extended, unscented and cubature Kalman filters behind the per-run adapter: the check of ours.

Where filterpy as it stands would be another filter (see each class), it is set right from outside. Its sigma points
need a positive definite covariance: where the start is known exactly, these runs fail and say so, where ours go on."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import model_validator

from ...scenarios.arrays import Array
from ...scenarios.measurement import Interval
from ..adapters import Indices, PerRun, RunModel
from ..kalman import ExtendedKalman
from ..sigma_point import CubatureKalman, UnscentedKalman

SOURCE = "filterpy, R. Labbe, https://github.com/rlabbe/filterpy"


class FilterpyFilter(PerRun):
    """What the three share: the log-likelihood from filterpy's own innovation y and its covariance S."""

    source = SOURCE
    claims = ("covariance",)
    honours = ("covariance",)

    def likelihood_run(self, filter: Any, y: Array, got: Indices) -> float:
        from scipy.stats import multivariate_normal

        return float(multivariate_normal.logpdf(filter.y.ravel(), cov=filter.S))


class FilterpyExtended(FilterpyFilter):
    """filterpy's EKF. It has no transition function: its covariance prediction is used, the mean is set to f(x, u)."""

    family = "EKF, Kalman"
    summary = "reference: filterpy's extended Kalman filter, one object per run"
    needs = ExtendedKalman.needs

    def make(self, model: RunModel) -> Any:
        from filterpy.kalman import ExtendedKalmanFilter

        filter = ExtendedKalmanFilter(model.nx, model.ny)
        filter.x, filter.P = model.x0, model.P0
        return filter

    def predict_run(self, filter: Any, model: RunModel, u: Array, interval: Interval) -> None:
        filter.F, filter.Q = model.F(filter.x, u, interval), model.Q(filter.x, u, interval)
        moved = model.f(filter.x, u, interval)
        filter.predict()
        filter.x = moved

    def update_run(self, filter: Any, model: RunModel, y: Array, got: Indices) -> None:
        filter.update(y, lambda x: model.H(x)[got], lambda x: model.h(x)[got], R=model.R[np.ix_(got, got)])


class FilterpyUnscented(FilterpyFilter):
    """filterpy's UKF with its van der Merwe or Julier points, which it redraws for the update.

    It draws them in predict alone, so a measurement without a step before it draws them here."""

    class Parameters(UnscentedKalman.Parameters):
        @model_validator(mode="after")
        def _redrawn(self) -> FilterpyUnscented.Parameters:
            """filterpy knows no other way."""
            if not self.redraw:
                raise ValueError("redraw = false: filterpy always redraws the points; only ukf can reuse them")
            return self

    family = "UKF, CKF"
    summary = "reference: filterpy's unscented Kalman filter, one object per run"
    needs = UnscentedKalman.needs

    def make(self, model: RunModel) -> Any:
        from filterpy.kalman import JulierSigmaPoints, MerweScaledSigmaPoints, UnscentedKalmanFilter

        p, n = self.parameters, model.nx
        kappa = p.kappa_for(n)
        points = (JulierSigmaPoints(n, kappa) if p.points == "julier"
                  else MerweScaledSigmaPoints(n, p.alpha, p.beta, kappa))
        filter: Any = UnscentedKalmanFilter(n, model.ny, 1.0, model.h, model.f, points)
        filter.x, filter.P = model.x0, model.P0
        filter.drawn = False
        return filter

    def predict_run(self, filter: Any, model: RunModel, u: Array, interval: Interval) -> None:
        filter.Q = model.Q(filter.x, u, interval)
        filter.predict(fx=lambda x, dt: model.f(x, u, interval))
        filter.drawn = True

    def update_run(self, filter: Any, model: RunModel, y: Array, got: Indices) -> None:
        if not filter.drawn:
            filter.sigmas_f = filter.points_fn.sigma_points(filter.x, filter.P)
        filter.update(y, R=model.R[np.ix_(got, got)], hx=lambda x: model.h(x)[got])
        filter.drawn = False


class FilterpyCubature(FilterpyFilter):
    """filterpy's CKF, with two repairs. It reuses the propagated points in its update, which do not carry Q: they are
    drawn anew before each update. It takes covariances as differences of squares, which loses digits far from the
    origin: the filter lives in coordinates around its latest estimate (`filter.centre`), its own x being zero."""

    family = "UKF, CKF"
    summary = "reference: filterpy's cubature Kalman filter, points redrawn, one object per run"
    needs = CubatureKalman.needs

    def make(self, model: RunModel) -> Any:
        from filterpy.kalman import CubatureKalmanFilter

        filter: Any = CubatureKalmanFilter(model.nx, model.ny, 1.0, model.h, model.f)
        filter.x, filter.P, filter.centre = np.zeros((model.nx, 1)), model.P0, model.x0
        return filter

    def predict_run(self, filter: Any, model: RunModel, u: Array, interval: Interval) -> None:
        centre = filter.centre
        moved = model.f(centre, u, interval)
        filter.Q = model.Q(centre, u, interval)
        filter.fx = lambda x, dt: model.f(centre + x, u, interval) - moved
        filter.predict()
        self._recentre(filter, moved)

    def update_run(self, filter: Any, model: RunModel, y: Array, got: Indices) -> None:
        from filterpy.kalman import spherical_radial_sigmas

        centre = filter.centre
        guess = model.h(centre)[got]
        filter.hx = lambda x: model.h(centre + x)[got] - guess
        filter.sigmas_f = spherical_radial_sigmas(filter.x, filter.P)
        filter.sigmas_h = np.zeros((2 * model.nx, len(got)))
        filter.update((y - guess)[:, None], R=model.R[np.ix_(got, got)])
        self._recentre(filter, centre)

    def read_run(self, filter: Any) -> tuple[Array, Array | None]:
        return filter.centre, filter.P

    @staticmethod
    def _recentre(filter: Any, centre: Array) -> None:
        """Move the filter's mean, which is relative to `centre`, into the new centre."""
        filter.centre = centre + filter.x.ravel()
        filter.x = np.zeros((len(centre), 1))
