"""Small design models shared by the tests: one linear with inputs, one mildly nonlinear, both allowing part steps.

`record` simulates what an estimator is fed; `feed` drives an estimator through it without the runner."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from railstate.estimators.interface import Estimate, Estimator
from railstate.scenarios.measurement import Interval, Measurement, PerRun, told, untold
from railstate.scenarios.model import Bounds, DesignModel, Linear, linear_model
from railstate.scenarios.randomness import RunRandom

Array = NDArray[np.float64]


def whole(k: int, period: float = 1.0) -> Interval:
    """The interval from step k to the next."""
    return part(k, 1.0, period)


def part(k: int, share: PerRun, period: float = 1.0) -> Interval:
    """A share of the interval from step k to the next."""
    return Interval(k + 1, k * period, share * period, share)


def heard(y: Array, received: NDArray[np.bool_], k: int = 0) -> Measurement:
    """The measurement at the end of the interval from step k."""
    return Measurement(y, received, k + 1)


def random(runs: int, name: str = "estimator") -> RunRandom:
    """The streams of runs 0 .. runs - 1."""
    return RunRandom(7, ("test", "default", name), range(runs))


def linear(runs: int, *, correlated: bool = False, nx: int = 3, ny: int = 2) -> DesignModel:
    """A stable random linear system, nx states, ny measurements, one input and a constant drift."""
    draw = np.random.default_rng(5)
    a = draw.normal(size=(nx, nx))
    a *= 0.95 / np.abs(np.linalg.eigvals(a)).max()
    b, h, c = draw.normal(size=(nx, 1)), 0.1 * draw.normal(size=nx), draw.normal(size=(ny, nx))
    root = 0.3 * draw.normal(size=(nx, nx))
    q, r = root @ root.T, np.diag(0.2 + draw.uniform(size=ny))
    if correlated:
        root = draw.normal(size=(ny, ny))
        r = root @ root.T + 0.1 * np.eye(ny)
    return linear_model(
        Linear(*(lambda k, matrix=matrix: matrix for matrix in (a, b, h, c, q, r))),
        states=tuple(f"x{i}" for i in range(nx)), measurements=tuple(f"y{j}" for j in range(ny)), period=1.0,
        initial_mean=random(runs, "truth").normal(nx), initial_covariance=np.eye(nx)[:, :, None],
        performance=np.eye(nx))


def still(runs: int) -> DesignModel:
    """A number that does not move, N(0, 1), measured with variance 1; everything an estimator may need of it."""
    one, zero = np.ones((1, 1)), np.zeros((1, 1))
    parts = (one, np.zeros((1, 1)), np.zeros(1), one, zero, one)
    return linear_model(
        Linear(*(lambda k, matrix=matrix: matrix for matrix in parts)), states=("x",), measurements=("x",), period=1.0,
        initial_mean=np.zeros((1, runs)), initial_covariance=np.ones((1, 1, 1)),
        bounds=Bounds(zero, np.ones(1), np.full(1, np.inf)))


def coasting(runs: int, *, correlated: bool = True) -> DesignModel:
    """A train coasting under quadratic drag, u its acceleration: [position, speed], exact for part steps.

    Measured: its distance from a mast 40 m beside the line (nonlinear) and its speed, with correlated noise."""
    drag, mast, period = 0.02, 40.0, 0.5
    r = np.array([[0.5, 0.1 if correlated else 0.0], [0.1 if correlated else 0.0, 0.2]])[:, :, None]

    def transition(x: Array, u: Array, interval: Interval) -> Array:
        t = interval.length
        position, speed = x
        slowed = speed / (1 + drag * speed * t)
        travelled = np.log1p(drag * speed * t) / drag
        return np.stack([position + travelled + 0.5 * t * t * u[0], slowed + t * u[0]])

    def jacobian(x: Array, u: Array, interval: Interval) -> Array:
        t = interval.length
        factor = 1 + drag * x[1] * t
        one = np.ones_like(factor)
        return np.stack([np.stack([one, t / factor]), np.stack([0 * one, 1 / factor**2])])

    def process(x: Array, u: Array, interval: Interval) -> Array:
        t = np.atleast_1d(interval.length)
        return 0.3 * np.stack([np.stack([t**3 / 3, t**2 / 2]), np.stack([t**2 / 2, t])])

    def measurement(x: Array, step: int) -> Array:
        return np.stack([np.sqrt(x[0] * x[0] + mast * mast), x[1]])

    def measurement_jacobian(x: Array, step: int) -> Array:
        one = np.ones_like(x[0])
        return np.stack([np.stack([x[0] / np.sqrt(x[0] * x[0] + mast * mast), 0 * one]), np.stack([0 * one, one])])

    start = np.array([-30.0, 12.0])[:, None] + random(runs, "truth").normal(2)
    return DesignModel(
        states=("position", "speed"), measurements=("distance", "speed"), period=period, transition=transition,
        measurement=measurement, transition_jacobian=jacobian, measurement_jacobian=measurement_jacobian,
        process_covariance=process, measurement_covariance=told(lambda step: r), initial_mean=start,
        initial_covariance=np.diag([2.0, 1.0])[:, :, None])


@dataclass(frozen=True)
class Record:
    """u (K, 1, S), y (K, ny, S) with NaN where not received (K, ny, S), truth (K, nx, S)."""

    u: Array
    y: Array
    received: NDArray[np.bool_]
    truth: Array

    def only(self, run: int) -> Record:
        """The record of one run."""
        return Record(*(np.ascontiguousarray(a[..., run:run + 1]) for a in
                        (self.u, self.y, self.received, self.truth)))


def record(model: DesignModel, runs: int, steps: int, loss: float = 0.3) -> Record:
    """Simulate the design model itself; each element of each run is lost with probability `loss`."""
    assert model.process_covariance is not None and model.measurement_covariance is not None
    noise, channel = random(runs, "measurement"), random(runs, "channel")
    r = np.linalg.cholesky(model.measurement_covariance(untold(0, model.ny))[:, :, 0])
    root0 = np.linalg.cholesky(model.initial_covariance[:, :, 0])
    x = model.initial_mean + np.stack([(root0[i][:, None] * noise.normal(model.nx)).sum(0) for i in range(model.nx)])
    u, y, received, truth = [], [], [], []
    for k in range(steps):
        u.append(channel.uniform(-1.0, 1.0, 1))
        q = model.process_covariance(x, u[k], whole(k, model.period))
        w, v = noise.normal(model.nx), noise.normal(model.ny)
        x = model.transition(x, u[k], whole(k, model.period))
        x = x + np.stack([(np.linalg.cholesky(q[:, :, 0])[i][:, None] * w).sum(0) for i in range(model.nx)])
        got = channel.uniform(0.0, 1.0, model.ny) >= loss
        value = model.measurement(x, k + 1) + np.stack([(r[j][:, None] * v).sum(0) for j in range(model.ny)])
        y.append(np.where(got, value, np.nan))
        received.append(got)
        truth.append(x)
    return Record(np.stack(u), np.stack(y), np.stack(received), np.stack(truth))


def feed(estimator: Estimator, model: DesignModel, data: Record, shares: tuple[PerRun, ...] = (1.0,),
         each: Callable[[int, Estimate], None] | None = None) -> tuple[Array, Array | None]:
    """Means (K, nx, S) and covariances (K, nx, nx, S or 1) after each update; `shares` of each step's prediction."""
    runs = data.y.shape[2]
    estimator.design(model)
    estimator.start(model, runs, random(runs))
    means, covariances = [], []
    for k in range(len(data.y)):
        for share in shares:
            estimator.predict(data.u[k], part(k, share, model.period))
        estimator.update(Measurement(data.y[k], data.received[k], k + 1))
        estimate = estimator.estimate()
        means.append(estimate.mean.copy())
        if estimate.covariance is not None:
            covariances.append(np.broadcast_to(estimate.covariance, (*estimate.covariance.shape[:2], runs)).copy())
        if each:
            each(k, estimate)
    return np.stack(means), np.stack(covariances) if covariances else None
