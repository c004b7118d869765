"""Exact second moments of constant gains: against printed numbers and against simulation."""

from __future__ import annotations

import numpy as np
import pytest
from railstate.estimators.ultimate_bound.gains import read_gain
from railstate.estimators.ultimate_bound.moments import mean_square
from railstate.estimators.ultimate_bound.system import error_system
from railstate.scenarios.files import load


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
