"""The multiple model filter over design models against a loop written from the textbook, and against the grid's."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from railstate.estimators.interface import Estimator
from railstate.estimators.multiple_model.hypotheses import InteractingModels
from railstate.estimators.multiple_model.imm import InteractingMultipleModel
from railstate.estimators.multiple_model.stacked import power_of
from railstate.estimators.relocation import Relocation
from railstate.scenarios.errors import InputError, Unsupported
from railstate.scenarios.files import load
from railstate.scenarios.measurement import Interval, Measurement
from railstate.scenarios.model import DesignModel, Mode, Modes
from railstate.scenarios.randomness import Streams
from scipy.stats import chi2

from ..models import coasting, heard, whole
from ..recordings import METRO, write_examples

GATE = {"gate": ["gnss"], "level": 0.4, "after": 3.0}
"""Rejects many a good fix, and opens after three seconds."""


def odometry(runs: int = 2, variant: str = "wet-radar") -> tuple[Any, DesignModel]:
    setting = load("odometry").setting(variant)
    world = setting.world(Streams(1, "odometry", variant, range(runs)))
    return world, setting.design_model({}, world.initial_mean)


def textbook(model: DesignModel, world: Any, run: int, steps: int, gated: int = -1
             ) -> tuple[np.ndarray, np.ndarray, list[bool]]:
    """IMM of extended Kalman filters, full matrices, one run: mean (steps, nx), log-likelihood (steps,). Readings of
    element `gated` go through the gate `GATE` first: whether each was rejected."""
    assert model.modes is not None and model.modes.transition is not None
    models, T = [mode.model for mode in model.modes.modes], model.modes.transition
    values, vectors = np.linalg.eigh((T + T.T) / 2) if np.allclose(T, T.T) else np.linalg.eig(T)
    w = model.modes.prior.copy()
    x = [one.initial_mean[:, run:run + 1] for one in models]
    P = [one.initial_covariance[:, :, 0] for one in models]
    means, logs, rejected, since = [], [], [], math.inf
    for k in range(steps):
        step = world.step(k, world.initial_mean)
        gone, total = 0.0, 0.0
        for number, event in enumerate(step.events):
            share = float(np.broadcast_to(event.share, (world.truth.shape[2],))[run])
            interval = Interval(k + 1, step.start + gone * step.length, step.length * share, share)
            if share > 0:
                power = (vectors * values**(interval.length / model.period)) @ np.linalg.inv(vectors)
                mixed = w @ power
                mu = power * w[:, None] / mixed
                means0 = [sum(mu[i, j] * x[i] for i in range(len(w))) for j in range(len(w))]
                P = [sum(mu[i, j] * (P[i] + (x[i] - means0[j]) @ (x[i] - means0[j]).T) for i in range(len(w)))
                     for j in range(len(w))]
                x, w = means0, mixed
            logs_of = np.zeros(len(w))
            for j, one in enumerate(models):
                u = step.u[:, run:run + 1]
                if share > 0:
                    F = one.transition_jacobian(x[j], u, interval)[:, :, 0]
                    Q = one.process_covariance(x[j], u, interval)[:, :, 0]
                    x[j], P[j] = one.transition(x[j], u, interval), F @ P[j] @ F.T + Q
            got = np.flatnonzero(event.received[:, run])
            told = Measurement(event.y[:, run:run + 1], event.received[:, run:run + 1], k + 1, number, 0.0,
                               event.covariance[:, :, [run % event.covariance.shape[2]]])
            if gated in got:  # all modes read it alike: it is the position
                centre = sum(w[j] * x[j][0, 0] for j in range(len(w)))
                spread = sum(w[j] * (P[j][0, 0] + (x[j][0, 0] - centre) ** 2) for j in range(len(w)))
                variance = spread + model.measurement_covariance(told)[gated, gated, 0]
                outside = (event.y[gated, run] - centre) ** 2 > chi2(1).ppf(GATE["level"]) * variance
                now = (k + 1) * model.period
                rejected.append(bool(outside and now - min(since, now) < GATE["after"] - 1e-9))
                since = min(since, now) if outside else math.inf
                got = got[got != gated] if rejected[-1] else got
            for j, one in enumerate(models):
                if len(got):
                    H = one.measurement_jacobian(x[j], k + 1)[got, :, 0]
                    R = one.measurement_covariance(told)[np.ix_(got, got)][:, :, 0]
                    e = event.y[got, run] - one.measurement(x[j], k + 1)[got, 0]
                    S = H @ P[j] @ H.T + R
                    K = P[j] @ H.T @ np.linalg.inv(S)
                    x[j], P[j] = x[j] + (K @ e)[:, None], (np.eye(len(P[j])) - K @ H) @ P[j]
                    logs_of[j] = -0.5 * (e @ np.linalg.solve(S, e) + np.linalg.slogdet(2 * np.pi * S)[1])
            top = logs_of.max()
            w = w * np.exp(logs_of - top)
            total += top + np.log(w.sum())
            w = w / w.sum()
            gone += share
        means.append(sum(w[j] * x[j][:, 0] for j in range(len(w))))
        logs.append(total)
    return np.array(means), np.array(logs), rejected


def follow(estimator: Estimator, model: DesignModel, world: Any, steps: int) -> tuple[np.ndarray, np.ndarray]:
    runs = world.truth.shape[2]
    estimator.design(model)
    estimator.start(model, runs, Streams(1, "odometry", "x", range(runs))("estimator", "x"))
    means, logs = [], []
    for k in range(steps):
        step, gone, log = world.step(k, world.initial_mean), 0.0, np.zeros(runs)
        for number, event in enumerate(step.events):
            estimator.predict(step.u, Interval(k + 1, step.start + gone * step.length, event.share * step.length,
                                                event.share))
            gone = gone + event.share
            found = estimator.update(Measurement(event.y, event.received, k + 1, number,
                                                 step.start + gone * step.length, event.covariance))
            log = log + (found.log_likelihood if found is not None and found.log_likelihood is not None else 0.0)
        means.append(estimator.estimate().mean.copy())
        logs.append(log)
    return np.array(means), np.array(logs)


def recorded(folder: Path) -> tuple[Any, DesignModel]:
    """A recorded trip with wheels and balises, irregular in time, missed counts in it."""
    write_examples(folder)
    table = pd.read_csv(folder / "metro.csv")
    table.loc[60:64, ["wheel_a_m", "wheel_b_m"]] = np.nan
    table.to_csv(folder / "metro.csv", index=False)
    setting = load("recorded-odometry", {
        "plant.recording": str(folder / "metro.csv"), "plant.balises": str(folder / "balises.csv"),
        "plant.map": METRO}).setting("wheels")
    world = setting.world(Streams(1, "recorded-odometry", "wheels", range(2)))
    return world, setting.design_model({}, world.initial_mean)


@pytest.mark.parametrize("kind", ["odometry", "recorded"])
def test_it_is_the_textbook_s_loop(kind: str, tmp_path: Path) -> None:
    """Slip modes over the start, balises and a low stretch: mean and log-likelihood."""
    world, model = odometry() if kind == "odometry" else recorded(tmp_path)
    steps = min(420, world.steps)
    means, logs = follow(InteractingModels(), model, world, steps)
    for run in range(2):
        wanted, wanted_logs, _ = textbook(model, world, run, steps)
        np.testing.assert_allclose(means[:, :, run], wanted, rtol=0, atol=1e-8)
        np.testing.assert_allclose(logs[:, run], wanted_logs, rtol=0, atol=1e-6)


def test_a_gate_before_the_modes() -> None:
    world, model = odometry(2, "gnss-only")
    means, logs = follow(InteractingModels(GATE), model, world, 500)
    for run in range(2):
        wanted, wanted_logs, rejected = textbook(model, world, run, 500, model.measurements.index("gnss"))
        assert 3 < sum(rejected) < len(rejected) - 3
        np.testing.assert_allclose(means[:, :, run], wanted, rtol=0, atol=1e-8)
        np.testing.assert_allclose(logs[:, run], wanted_logs, rtol=0, atol=1e-6)
    with pytest.raises(InputError, match="gate: there is no measurement radar; allowed: wheel-a"):
        follow(InteractingModels({"gate": ["radar"]}), model, world, 1)
    with pytest.raises(ValueError, match="used with a gate only"):
        InteractingModels({"after": 3.0})


def test_on_a_grid_of_linear_models_it_is_the_grid_s_filter() -> None:
    setting = load("braking-rate").setting("paper")
    world = setting.world(Streams(1, "braking-rate", "paper", range(3)))
    model = setting.design_model({}, world.initial_mean)
    grid, general = InteractingMultipleModel({"stay": 0.9}), InteractingModels({"stay": 0.9})
    for estimator in (grid, general):
        estimator.start(model, 3, Streams(1, "braking-rate", "paper", range(3))("estimator", "x"))
    for k in range(15):
        for estimator in (grid, general):
            estimator.predict(world.u[k], whole(k, model.period))
            estimator.update(heard(world.y[k], world.received[k], k))
        np.testing.assert_allclose(general.estimate().mean, grid.estimate().mean, rtol=0, atol=1e-9)


def test_no_batch_and_no_other_run_s_events_change_a_bit() -> None:
    world, model = odometry(3)
    alone, lonely = odometry(1)
    many, _ = follow(InteractingModels(), model, world, 300)
    one, _ = follow(InteractingModels(), lonely, alone, 300)
    np.testing.assert_array_equal(many[:, :, :1], one)


def test_what_a_gate_lets_none_of_through_is_told_alike_in_any_company() -> None:
    """Fixes alone, so that a step's reading may be rejected in one run, in all, or in none."""
    told = []
    for runs in (3, 1):
        world, model = odometry(runs, "gnss-only")
        gnss, estimator, logs = model.measurements.index("gnss"), InteractingModels(GATE), []
        estimator.start(model, runs, Streams(1, "odometry", "x", range(runs))("estimator", "x"))
        for k in range(400):
            step = world.step(k, world.initial_mean)
            estimator.predict(step.u, Interval(k + 1, step.start, step.length, 1.0))
            event = step.events[-1]
            only = np.zeros_like(event.received)
            only[gnss] = event.received[gnss]
            found = estimator.update(Measurement(event.y, only, k + 1, 0, step.start + step.length, event.covariance))
            assert found.log_likelihood is not None
            logs.append([*found.log_likelihood[:1], *only[gnss, :1], *estimator.rejected[gnss, :1]])
        told.append(np.array(logs))
    np.testing.assert_array_equal(*told)
    assert (told[0][told[0][:, 2] == 1][:, 0] == 0.0).all() and 3 < told[0][:, 2].sum() < told[0][:, 1].sum() - 3


def test_powers_of_a_transition_matrix() -> None:
    T = np.kron(np.array([[0.99, 0.01], [0.3, 0.7]]), np.array([[0.9, 0.1], [0.2, 0.8]]))
    power = power_of(T)
    parts = power(np.array([0.25, 0.0, 1.0]))
    np.testing.assert_allclose(np.linalg.matrix_power(parts[:, :, 0], 4), T, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(parts[:, :, 1], np.eye(4))
    np.testing.assert_array_equal(parts[:, :, 2], T)
    np.testing.assert_array_equal(power(1.0), T[:, :, None])
    np.testing.assert_array_equal(power(np.zeros(2)), np.dstack([np.eye(4)] * 2))
    for p in (1.5, 2.0):
        np.testing.assert_allclose(power(p)[:, :, 0] @ power(3.0 - p)[:, :, 0], T @ T @ T, atol=1e-12)
    with pytest.raises(ValueError, match="no powers"):
        power_of(np.array([[0.0, 1.0], [1.0, 0.0]]))


def test_modes_may_differ_in_anything() -> None:
    """Two motions: the filter finds the one that holds."""
    world, model = odometry(2, "dry")
    assert model.modes is not None
    base = model.modes.modes[0].model

    def fast(x: np.ndarray, u: np.ndarray, interval: Interval) -> np.ndarray:
        return base.transition(x, u + 0.5 * np.eye(len(u))[:, :1], interval)

    modes = Modes((Mode("as told", base), Mode("pushed", replace(base, transition=fast))), np.array([0.5, 0.5]),
                  np.array([[0.99, 0.01], [0.01, 0.99]]))
    estimator = InteractingModels()
    follow(estimator, replace(model, modes=modes), world, 400)
    assert (estimator.weight[0] > 0.9).all()


def test_relocation_takes_over_what_is_measured() -> None:
    setting = load("odometry").setting("wet")
    world = setting.world(Streams(1, "odometry", "wet", range(2)))
    model = setting.design_model({"motion": "wheel-b"}, world.initial_mean)
    means, _ = follow(estimator := Relocation(), model, world, 1200)
    for run in range(2):
        place, counted, claim = 0.0, 0.0, 0.0
        for k in range(1200):
            events = world.readings.get(k, [])
            increment = world.u[k, 4, run]
            counted += increment
            for runs, share, balises in events:
                if run in runs:
                    i = list(runs).index(run)
                    place, counted = world.passages.told[balises[i], run], (1 - share[i]) * increment
                    claim = world.balise_variance[balises[i]]
            assert means[k, 0, run] == pytest.approx(place + counted, abs=1e-8)
        assert estimator.estimate().covariance[0, 0, run] == pytest.approx(claim + (0.00577 * counted) ** 2)
    with pytest.raises(Unsupported, match="not among"):
        Relocation({"by": ["beacon"]}).design(model)


def test_a_chain_without_a_root_is_no_estimator_at_all() -> None:
    model = coasting(2)

    def turning(stay: float) -> DesignModel:
        chain = np.array([[stay, 1 - stay], [1 - stay, stay]])
        return replace(model, modes=Modes((Mode("a", model), Mode("b", model)), np.array([0.5, 0.5]), chain))

    assert InteractingModels().design(turning(0.6)) == {"modes": 2}
    with pytest.raises(Unsupported, match="has no powers that are transition matrices"):
        InteractingModels().design(turning(0.4))
