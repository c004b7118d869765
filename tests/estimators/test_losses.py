"""The mean covariance under lost packets: Sinopoli's plant a = 1.25, q = r = 1, and the command that shows it."""

from __future__ import annotations

import numpy as np
import pytest
from railstate.estimators.random_access.losses import losses
from railstate.scenarios.files import load

from ..conftest import Command

PLANT = '''name = "scalar"
title = "a scalar plant that runs away"
time = { period = 1.0, steps = 50 }
plant = { kind = "linear", A = [[1.25]], B = [[1]], C = [[1]], Q = [[1]], R = [[1]], x0 = [0], P0 = [[1]] }
channel = { kind = "gilbert-elliott", p_good_bad = 0.1, p_bad_good = 0.3 }
estimators.kalman = { plugin = "kalman" }
'''


@pytest.mark.parametrize(("p", "mean"), [(0.38, 47.48), (0.40, 24.08), (0.5, 7.35), (0.7, 3.382), (0.9, 2.3336),
                                         (0.36, np.inf), (0.2, np.inf)])
def test_a_scalar_plant(p, mean, tmp_path):
    (tmp_path / "scalar.toml").write_text(PLANT)
    found = losses(load(str(tmp_path / "scalar.toml")).setting("default").design_model({}, np.zeros((1, 1))), p)
    if mean == np.inf:
        assert found.lower == found.mean == found.upper == np.inf
        return
    assert found.mean is not None and found.error is not None
    assert abs(found.mean - mean) < 4 * found.error + 5e-4 * mean
    assert found.error < 2e-3 * mean
    # V = a^2 V + q - p a^2 V^2 / (V + r): a quadratic in V
    a2 = 1.25**2
    roots = np.roots([1 - a2 + p * a2, 1 - a2 - 1, -1.0])
    np.testing.assert_allclose([found.lower, found.upper], [1 / (1 - (1 - p) * a2), roots.max()], rtol=1e-6)
    assert found.lower <= found.mean <= found.upper


def test_the_command_draws_it(railstate: Command):
    railstate.folder.joinpath("scalar.toml").write_text(PLANT)
    done = railstate("design", "scalar.toml", "--losses", "0.3,0.5,0.7", "--plot", "losses.svg")
    assert done.code == 0, done.err
    assert "1 - 1/rho^2 = 0.36" in done.out and "(1 - p_bad_good) rho^2 = 1.094, so the mean is infinite" in done.out
    assert "infinite" in done.out and "E P by renewal" in railstate.folder.joinpath("losses.svg").read_text()
    assert railstate("design", "scalar.toml", "--losses", "1.5").code == 2
    bent = railstate("design", "ningbo-metro", "--losses", "0.5")
    assert bent.code == 2 and "needs a linear plant that does not change with time" in bent.err
