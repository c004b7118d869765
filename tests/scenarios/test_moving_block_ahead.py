"""What lies ahead of the two trains of moving-block: their stops and tags, and the laws by which one follows the other.

Each against a loop or numbers worked out by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from railstate.scenarios.files import load
from railstate.scenarios.moving_block.control import Control, follow_acceleration
from railstate.scenarios.moving_block.trains import TwoTrains
from railstate.scenarios.randomness import Streams

from .test_moving_block_parts import LAW_P, LAW_R, TRACK


def by_hand(gap: float, leader: float, follower: float, c: Control) -> float:
    """Free beyond (23); full braking within the least gap; else (29), harder where law R needs it to stop in time."""
    least, hardest = c.safe_gap + c.margin, c.limit * c.braking
    if gap > least + follower**2 / (2 * c.braking) + c.reserve * follower * c.period:
        return c.follow
    if gap <= least:
        return -hardest if c.restoring else -c.braking
    braking = c.braking * (follower - leader) / follower if follower else 0.0
    needed = follower**2 / 2 / max(gap - least - follower * c.period / 2, 0.0005)
    if c.restoring and needed > c.braking:
        return -min(max(needed, braking), hardest)
    return -min(max(braking, -c.follow), hardest)


@pytest.mark.parametrize("law", [LAW_P, LAW_R, LAW_R._replace(follow=0.2, limit=1.0, reserve=0.0)])
def test_laws_wherever_the_trains_are(law: Control) -> None:
    least = law.safe_gap + law.margin
    gaps = [-0.1, 0.0, least, *(least + np.geomspace(1e-4, 0.6, 40)), 2.0]
    for leader in (0.0, 0.05, 0.4, 1.2, 3.0):
        for follower in (0.0, 0.03, 0.05, 0.3, 0.8, 1.2):
            found = [follow_acceleration(float(gap), leader, follower, law) for gap in gaps]
            np.testing.assert_allclose(found, [by_hand(gap, leader, follower, law) for gap in gaps], rtol=1e-12)


def test_stops_and_tags_ahead() -> None:
    """None within the tolerance of the start, none at or before the main stop; beyond the last stop it stays there."""
    trains = SimpleNamespace(laps=1, stops=[[0, 1], [2], [0]], start=[0.75, 0.7, -1.0], stop_tolerance=0.25)
    config: Any = SimpleNamespace(plant=SimpleNamespace(track=SimpleNamespace(stations=4), trains=trains),
                                  sensors=SimpleNamespace(tags=SimpleNamespace(count=4)))
    assert TwoTrains._stops(config, 4.0).tolist() == [
        [4, 5, 8, 9, 12, 13], [2, 6, 10, 14, 14, 14], [4, 8, 12, 12, 12, 12]]
    quarter = TRACK.length / 4
    met, x, y = TwoTrains._tags(config, TRACK, np.array([[0.5 * quarter] * 3, [-quarter] * 3]), 6)
    np.testing.assert_allclose(met / quarter, [np.arange(6) + 1.5, np.arange(6) - 0.5], rtol=1e-12)
    for train in range(2):
        np.testing.assert_allclose([x[train], y[train]], TRACK.points(met[train])[:2], rtol=1e-12)
    for starts in ([1.0, 0.2], [4.0, 0.1], [0.3, -4.5]):
        setting = load("moving-block", {"plant.trains.start": starts}).setting("law-p")
        world = setting.world(Streams(1, "moving-block", "law-p", range(1)))
        assert ((world.tag_s[:, 0] - starts) < TRACK.length / 12).all() and world.tag_s.shape == (2, 60)


def test_what_a_run_comes_to() -> None:
    """Errors of each train and their mean, the gap, and laps, NaN where one was not ended."""
    setting = load("moving-block", {"plant.trains.laps": 2}).setting("law-p")
    squared, least = np.array([[4.0, 0], [9, 0], [36, 0], [1, 0]]), 0.27 - np.array([1.2e-9, 0.8e-9])
    records = SimpleNamespace(squared=squared, counted=np.array([[4, 0], [1, 0], [9, 0], [1, 0]]), gap_least=least,
                              gap_sum=np.array([6.0, 9.0]), driven=np.array([4, 3]))
    world: Any = SimpleNamespace(records=records, lap_times=np.array([[10.0, 12.0], [14.0, np.nan]]))
    rmse = {"x": 1.5, "y": 2.0, "x-a": 1.0, "y-a": 3.0, "x-b": 2.0, "y-b": 1.0}
    expected = {**{("rmse-per-train", name, "m"): [value, 0.0] for name, value in rmse.items()},
                ("mean", "gap", "m"): [1.5, 3.0], ("min", "gap", "m"): least, ("violations", "gap", "1"): [1.0, 0.0],
                ("mean", "lap", "s"): [6.0, np.nan], ("unfinished", "lap", "1"): [0.0, 1.0]}
    found = setting.outcomes(world, {})
    assert list(found) == list(expected)
    for key, values in expected.items():
        np.testing.assert_array_equal(found[key], values)
