"""The bound on how far da/dv changes, against force curves sampled densely: any curve, speed and width; and where rails
are low by rule."""

from __future__ import annotations

import numpy as np
import pytest
from railstate.scenarios.railway.adhesion import Adhesion
from railstate.scenarios.railway.curvature import SLOWEST, pieces, slope_change
from railstate.scenarios.railway.dynamics import Forces

CURVES = {
    "constant power": (12.0, 0.0, 0.0, 0.0, 0.0),
    "polynomial": (0.0, 6.616, -0.2075, 0.002428, -1.001e-5),
    "both": (8.0, 0.4, -0.01, 1e-4, -6e-7),
    "none left at speed": (0.0, 1.4, -0.02, 0.0, 0.0),
    "level": (0.0, 1.0, 0.0, 0.0, 0.0),
}


def acceleration(v: np.ndarray, u: float, top: float, curve: tuple[float, ...]) -> np.ndarray:
    """On level track, m/s^2, from the definition."""
    V = 3.6 * v
    W = np.maximum(V, 0.1)
    left = np.clip(curve[0] / W + curve[1] + curve[2] * W + curve[3] * W**2 + curve[4] * W**3, 0, 1)
    return u * top * left - (0.02 + 6e-4 * V + 1.7e-5 * V**2)


@pytest.mark.parametrize("name", CURVES)
def test_bound_of_the_slope_s_change(name: str) -> None:
    curve, other = CURVES[name], CURVES["both"]
    forces = Forces(1.1, *curve, 0.9, *other, 0.02, 6e-4, 1.7e-5)
    curves, random = pieces(forces), np.random.default_rng(1)
    n = 200
    v, e = random.uniform(0.5, 30, n), random.choice([0.05, 0.4, 3.0], n)
    u = random.uniform(0.05, 1, n) * random.choice([-1, 1], n)
    Pi, out = np.zeros((2, 2, n)), np.empty(n)
    Pi[1, 1] = e**2
    slope_change(v, u, Pi, 0.2, forces, curves, out)
    for r in range(n):
        mine = (1.1, curve) if u[r] > 0 else (0.9, other)

        def slope(at: np.ndarray, r: int = r, mine: tuple[float, tuple[float, ...]] = mine) -> np.ndarray:
            d = 1e-6
            return (acceleration(at + d, u[r], *mine) - acceleration(at - d, u[r], *mine)) / (2 * d)

        ends = v[r] + e[r] * np.linspace(-1, 1, 2001)
        sampled = 0.2 * np.abs(slope(ends) - slope(v[[r]])).max()
        assert sampled - 1e-7 <= out[r] <= sampled * (1 + 5e-3) + 1e-6, (v[r], e[r], u[r])


@pytest.mark.parametrize("name", CURVES)
def test_pieces_of_a_curve(name: str) -> None:
    """Edges where it is 0 or 1, and between them which pieces follow it, by going along it."""
    curve = CURVES[name]
    found = pieces(Forces(1.1, *curve, 0.9, *CURVES["both"], 0.02, 6e-4, 1.7e-5))
    V = np.linspace(SLOWEST, 400.0, 400_001)
    share = curve[0] / V + curve[1] + curve[2] * V + curve[3] * V**2 + curve[4] * V**3
    bends = (share > 0) & (share < 1)
    change = np.flatnonzero((bends[1:] != bends[:-1]) | ((share[1:] > 0) != (share[:-1] > 0)))
    np.testing.assert_allclose(found.drive, [SLOWEST, *V[change]], atol=2e-3)
    places = [V[0] / 2, *((a + b) / 2 for a, b in zip(found.drive[:-1], found.drive[1:], strict=True)), 399.9]
    assert found.drive_bends.tolist() == [False, *(bool(bends[np.searchsorted(V, place)]) for place in places[1:])]
    other = pieces(Forces(1.1, *CURVES["none left at speed"], 0.9, *curve, 0.02, 6e-4, 1.7e-5))
    assert np.array_equal(other.brake, found.drive) and np.array_equal(other.brake_bends, found.drive_bends)


@pytest.mark.parametrize(("stops", "low"), [
    ([0.0, 1000.0, 2000.0, 3000.0], [[30, 220], [590, 830], [2030, 2220], [2590, 2830]]),
    ([0.0, 1000.0, 2000.0], [[30, 220], [1030, 1220], [1590, 1830]]),
    ([0.0, 410.0], [[30, 220]]), ([0.0, 410.5], [[30, 220], [0.5, 240.5]]), ([0.0, 220.0], []),
    ([0.0, 220.5, 1000.0], [[30, 220], [250.5, 440.5], [590, 830]])])
def test_low_stretches_by_rule(stops: list[float], low: list[list[float]]) -> None:
    """In turn before a stop, the last always, and after it, where there is room between it and the next."""
    assert Adhesion(low="stops").stretches(stops) == low
    assert Adhesion(low=[[1.0, 2.0]]).stretches(stops) == [[1.0, 2.0]] and Adhesion().stretches(stops) == []
