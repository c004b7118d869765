"""Exact second moments of constant gains: against printed numbers and against simulation."""

from __future__ import annotations

import numpy as np
import pytest
from railstate.estimators.registry import estimator_class
from railstate.estimators.ultimate_bound.gains import read_gain
from railstate.estimators.ultimate_bound.moments import mean_square, measured_fall
from railstate.estimators.ultimate_bound.system import error_system
from railstate.scenarios.errors import Infeasible
from railstate.scenarios.files import load
from railstate.scenarios.randomness import Streams


def test_decay_and_long_run_of_the_printed_gain_against_simulation():
    """N = 1, 2, 3 trains: .874, .937, .969; 2,000 runs within four standard errors of the long run."""
    system = error_system(load("cbtc-csma").setting("uniform").design_model({}, np.zeros((12, 1))))
    K = read_gain("zou2018_gain.csv")
    closed, noise, push = system.A - K @ system.C, K @ system.noise_root, system.E @ system.delta
    for trains, printed in ((1, 0.874), (2, 0.937), (3, 0.969)):
        assert mean_square(system, K, 0.5**trains).decay == pytest.approx(printed, abs=6e-4)
    draw = np.random.default_rng(3)
    for force, name in ((0.0, "noise"), (1.0, "forced")):
        e = np.zeros((12, 2000))
        for _ in range(250):
            came = draw.random(e.shape[1]) < 0.5
            e = np.where(came, closed @ e - noise @ draw.normal(size=e.shape), system.A @ e) + force * push[:, None]
        square = np.square(system.M @ e).sum(axis=0)
        assert abs(square.mean() - getattr(mean_square(system, K, 0.5), name)) < 4 * square.std() / 2000**0.5


def test_a_gain_that_does_not_hold_has_no_long_run():
    system = error_system(load("cbtc-csma").setting("uniform").design_model({}, np.zeros((12, 1))))
    found = mean_square(system, -read_gain("zou2018_gain.csv"))
    assert found.decay > 1 and found.noise is None and found.forced is None


def test_how_fast_the_start_s_error_is_forgotten_is_what_the_moments_say():
    """Without a run: E e e' from the start's own errors through the exact operator and with the noise; 51 steps. Where
    the start has no error, there is nothing to forget."""
    setting = load("cbtc-csma", {"time.steps": 300}, "start-at-zero").setting("start-at-zero")
    world = setting.world(Streams(0, "cbtc-csma", "start-at-zero", tuple(range(200))))
    model, K = setting.design_model({}, world.initial_mean), read_gain("zou2018_gain.csv")
    system = error_system(model)
    closed, noise = system.A - K @ system.C, K @ system.noise_root
    first = world.truth[0] - world.initial_mean
    S, squares = first @ first.T / 200, []
    for _ in range(world.steps):
        squares.append(np.trace(system.M @ S @ system.M.T))
        S = 0.5 * (closed @ S @ closed.T + noise @ noise.T) + 0.5 * system.A @ S @ system.A.T
    excess = np.array(squares) - squares[-1]
    fall = measured_fall(model, K, world)
    assert fall is not None and abs(fall - int((excess <= excess[0] / 100).argmax())) <= 2
    calm = load("cbtc-csma", {"time.steps": 60}, "one-train").setting("one-train")
    world = calm.world(Streams(0, "cbtc-csma", "one-train", (0, 1)))
    assert measured_fall(calm.design_model({}, world.initial_mean), K, world) is None


@pytest.mark.long
def test_decays_of_the_designs_and_what_becomes_of_them_with_the_forces_as_states():
    """Exact decay with 1, 2, 3 trains of the six cars' designs. With walking forces no certificate, with fading ones
    a bound several times as large."""
    setting = load("cbtc-csma").setting("uniform")
    bounds = {}
    for label, decays in (("ultimate-bound", (0.890, 0.945, 0.973)), ("fastest-decay", (0.927, 0.940, 0.967)),
                          ("ultimate-bound-force", ()), ("ultimate-bound-force-walk", None)):
        entry = setting.config.estimators[label]
        model = setting.told(entry.knowledge, entry.augment, np.zeros((12, 1)))
        estimator = estimator_class(entry.plugin, label)(entry.parameters)
        if decays is None:
            with pytest.raises(Infeasible, match="no certificate at theta"):
                estimator.design(model)
            continue
        found = estimator.design(model)
        bounds[label] = found["bound"]
        for trains, decay in enumerate(decays, 1):
            assert mean_square(error_system(model), found["gain"], 0.5**trains).decay == pytest.approx(decay, abs=1e-3)
    assert bounds["ultimate-bound-force"] > 5 * bounds["ultimate-bound"]
