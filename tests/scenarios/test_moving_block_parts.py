"""The pieces of the moving-block setting, each against its closed form: track, motion model, braking, laws, blocks."""

from __future__ import annotations

import math

import numpy as np
import pytest
from railstate.scenarios.errors import InputError
from railstate.scenarios.files import load
from railstate.scenarios.measurement import Interval, untold
from railstate.scenarios.moving_block.control import (
    Control,
    authority_end,
    follow_acceleration,
    next_speed,
    speed_for_stop,
)
from railstate.scenarios.moving_block.motion import reading
from railstate.scenarios.moving_block.track import StadiumTrack
from railstate.scenarios.randomness import Streams

from ..models import part, whole

TRACK = StadiumTrack(straight=0.9, radius=0.5)
LAW_P = Control(restoring=False, braking=1.6, limit=1.5, follow=1.6 * (math.sqrt(5) - 1) / 2, safe_gap=0.27, margin=0.0,
                reserve=2.0, fixed=False, top_speed=1.2, period=0.05)
LAW_R = LAW_P._replace(restoring=True, braking=2.0, follow=2.0 * (math.sqrt(5) - 1) / 2, margin=0.03)


def everywhere() -> np.ndarray:
    """Arc lengths of one lap, the joints of straights and arcs and their neighbours among them."""
    joints = np.array([0.45, 0.45 + math.pi / 2, 1.35 + math.pi / 2, 1.35 + math.pi])
    near = np.concatenate([joints + d for d in (-1e-9, 0.0, 1e-9)])
    return np.sort(np.concatenate([np.linspace(0, TRACK.length, 4001)[:-1], near]))


def test_track_round_trip_and_length() -> None:
    s = everywhere()
    assert TRACK.length == pytest.approx(4.9416, abs=5e-5)
    for lap in (-1, 0, 2):
        x, y, _ = TRACK.points(s + lap * TRACK.length)
        off = TRACK.arc_lengths(x, y) - s
        off -= TRACK.length * np.round(off / TRACK.length)
        assert np.abs(off).max() < 1e-11  # 1e-9 cm


def test_heading_is_the_direction_of_travel() -> None:
    s = np.linspace(0, TRACK.length, 997)
    (x0, y0, _), (x1, y1, _), (_, _, heading) = TRACK.points(s - 1e-6), TRACK.points(s + 1e-6), TRACK.points(s)
    np.testing.assert_allclose((x1 - x0) / 2e-6, np.cos(heading), atol=2e-6)
    np.testing.assert_allclose((y1 - y0) / 2e-6, np.sin(heading), atol=2e-6)


def test_projection_is_the_nearest_point() -> None:
    draw = np.random.default_rng(1)
    s = draw.uniform(0, TRACK.length, 200)
    x, y, heading = TRACK.points(s)
    aside = draw.uniform(-0.1, 0.1, 200)
    x, y = x - aside * np.sin(heading), y + aside * np.cos(heading)
    grid = np.linspace(0, TRACK.length, 40001)
    gx, gy, _ = TRACK.points(grid)
    nearest = grid[np.argmin((gx[:, None] - x) ** 2 + (gy[:, None] - y) ** 2, axis=0)]
    off = TRACK.arc_lengths(x, y) - nearest
    off -= TRACK.length * np.round(off / TRACK.length)
    assert np.abs(off).max() < 1e-4  # half the grid's spacing, and a little


def some_states(runs: int) -> tuple[np.ndarray, np.ndarray]:
    """States (4, S) near the track, away from the joints, and distances (2, S)."""
    draw = np.random.default_rng(2)
    s = draw.choice([0.2, 1.2, 2.4, 4.0, 4.7], (2, runs)) + draw.uniform(-0.1, 0.1, (2, runs))
    x, y, _ = TRACK.points(s)
    state = np.stack([x[0], y[0], x[1], y[1]]) + draw.normal(0, 0.02, (4, runs))
    return state, draw.uniform(0, 0.06, (2, runs))


def test_jacobian_matches_differences() -> None:
    state, u = some_states(40)
    jacobian = TRACK.jacobian(state, u, part(0, 0.7))
    for j in range(4):
        h = np.zeros((4, 1))
        h[j] = 1e-6
        numeric = (TRACK.transition(state + h, u, part(0, 0.7)) - TRACK.transition(state - h, u, part(0, 0.7))) / 2e-6
        np.testing.assert_allclose(jacobian[:, j], numeric, atol=1e-8)


def test_jacobian_of_ways_from_straights_into_arcs() -> None:
    """The curvature is that of the midpoint, all around the track."""
    draw, runs = np.random.default_rng(5), 400
    x, y, _ = TRACK.points(np.tile(np.arange(runs) * TRACK.length / runs, (2, 1)))
    state = np.stack([x[0], y[0], x[1], y[1]]) + draw.normal(0, 0.02, (4, runs))
    u = draw.uniform(0.2, 1.5, (2, runs))
    ahead, behind = ([TRACK.transition(state + h, u, whole(0)) for h in way * np.eye(4)[:, :, None]]
                     for way in (1e-6, -1e-6))
    numeric = (np.stack(ahead, axis=1) - np.stack(behind, axis=1)) / 2e-6
    off = np.abs(TRACK.jacobian(state, u, whole(0)) - numeric).max(axis=(0, 1))
    assert off.max() < 1e-7


@pytest.mark.parametrize("longest", [0.06, 0.5, 3.0, 30.0])
def test_motion_has_the_heading_of_the_midpoint(longest: float) -> None:
    """Every point and way, joints and ways of several laps among them, against the map there and back."""
    draw = np.random.default_rng(3)
    evenly = np.tile(np.arange(200) * TRACK.length / 200, (2, 1))
    s = np.concatenate([draw.uniform(0, TRACK.length, (2, 400)), evenly], axis=1)
    x, y, _ = TRACK.points(s)
    state = np.stack([x[0], y[0], x[1], y[1]]) + np.where(np.arange(600) < 400, draw.normal(0, 0.05, (4, 600)), 0.0)
    u, share = draw.uniform(-longest / 4, longest, (2, 600)), draw.choice([0.0, 0.3, 1.0], 600)
    moved = TRACK.transition(state, u, part(0, share))
    for train in range(2):
        x, y, distance = state[2 * train], state[2 * train + 1], u[train] * share
        _, _, heading = TRACK.points(TRACK.arc_lengths(x, y) + distance / 2)
        naive = np.stack([x + distance * np.cos(heading), y + distance * np.sin(heading)])
        np.testing.assert_allclose(moved[2 * train:2 * train + 2], naive, rtol=0, atol=1e-13 * max(1.0, longest))


def test_no_travel_is_the_identity_to_the_last_bit() -> None:
    state, u = some_states(7)
    share = np.array([0.0, 1.0, 0.0, 0.5, 0.0, 0.0, 1.0])
    moved, jacobian = TRACK.transition(state, u, part(0, share)), TRACK.jacobian(state, u, part(0, share))
    still = share == 0
    assert np.array_equal(moved[:, still], state[:, still])
    assert np.array_equal(jacobian[:, :, still], np.repeat(np.eye(4)[:, :, None], still.sum(), axis=2))
    assert np.array_equal(moved[:, share == 1], TRACK.transition(state, u, whole(0))[:, share == 1])


def test_points_between_states_and_runs_move_like_states() -> None:
    state, u = some_states(5)
    points = np.stack([state, state + 0.01, state - 0.02], axis=1)
    moved = TRACK.transition(points, u, whole(0))
    for n in range(3):
        assert np.array_equal(moved[:, n], TRACK.transition(points[:, n], u, whole(0)))


def test_midpoint_heading_stays_on_the_track() -> None:
    """A lap in steps D: within D a^3 / 6, a = D / 2R, for each step on the arcs and D^2 / 8R for each of the four
    joints; the printed Euler step is off by D^2 / 2R for each step on the arcs, less what its own drift corrects."""
    state = np.repeat(np.array([0.5, 0.0])[None], 2, axis=0).reshape(4, 1)
    u = np.full((2, 1), 0.06)
    euler = state[:2, 0].copy()
    travelled = 0.0
    while travelled < TRACK.length - 0.06:
        state = TRACK.transition(state, u, whole(0))
        _, _, heading = TRACK.points(TRACK.arc_lengths(euler[:1], euler[1:]))
        euler += 0.06 * np.array([math.cos(heading[0]), math.sin(heading[0])])
        travelled += 0.06

    def aside(x: float, y: float) -> float:
        px, py, _ = TRACK.points(TRACK.arc_lengths(np.array([x]), np.array([y])))
        return math.hypot(x - px[0], y - py[0])

    bound = math.pi / 0.06 * 0.06 * 0.06**3 / 6 + 4 * 0.06**2 / 4
    assert aside(state[0, 0], state[1, 0]) < bound
    assert aside(euler[0], euler[1]) > 10 * bound


@pytest.mark.parametrize("speed", [0.05, 0.4, 1.2])
def test_braking_for_a_stop(speed: float) -> None:
    """From any distance a train can still stop in, it stops within half a millimetre, never harder than beta."""
    for excess in (0.0, 0.003, 0.1, 0.5):
        distance, v = speed * speed / 3.2 + speed * 0.05 + excess, speed
        for _ in range(400):
            after = min(speed_for_stop(distance, v, 1.6, 0.05), v + 1.6 * 0.05)
            assert after >= v - 1.6 * 0.05 - 1e-9
            distance -= (v + after) / 2 * 0.05
            v = after
        assert v < 1e-6
        # The last step's (v + v') dt / 2, with nothing left of the distance, is what it can overrun by.
        assert -5e-4 < distance < 1e-6


def test_speed_for_stop_solves_its_equation() -> None:
    v = speed_for_stop(0.3, 0.8, 1.6, 0.05)
    assert v * v / 3.2 + (v + 0.8) / 2 * 0.05 == pytest.approx(0.3, abs=1e-12)
    assert speed_for_stop(0.01, 0.8, 1.6, 0.05) == 0.0


def test_law_p() -> None:
    """Eqs. (23), (27), (29) with k_acc = +1; the follower at 0.8 m/s needs 0.27 + 0.2 + 0.08 m."""
    assert follow_acceleration(0.5501, 0.0, 0.8, LAW_P) == pytest.approx(0.6180339887 * 1.6)
    assert follow_acceleration(0.5499, 0.4, 0.8, LAW_P) == pytest.approx(-0.8)
    assert follow_acceleration(0.5499, 0.0, 0.8, LAW_P) == pytest.approx(-1.6)
    assert follow_acceleration(0.5499, 1.2, 0.8, LAW_P) == pytest.approx(0.8)
    assert follow_acceleration(0.5499, 1.6, 0.8, LAW_P) == pytest.approx(LAW_P.follow)
    assert follow_acceleration(0.27, 1.2, 0.8, LAW_P) == -1.6


def test_law_r_restores_the_gap() -> None:
    """Where beta does not stop the follower in time, law R asks for what does; law P only matches speeds."""
    room = 0.40 - 0.30 - 0.8 * 0.025
    required = 0.8**2 / (2 * room)
    assert required > 3.0
    assert follow_acceleration(0.40, 0.8, 0.8, LAW_R) == -3.0
    assert follow_acceleration(0.47, 0.8, 0.8, LAW_R) == pytest.approx(-0.64 / (2 * 0.15))
    assert follow_acceleration(0.47, 0.8, 0.8, LAW_P) == 0.0
    assert follow_acceleration(0.29, 1.2, 0.8, LAW_R) == -3.0


@pytest.mark.parametrize("law", [LAW_P, LAW_R])
def test_who_stands_and_knows_no_gap_stays(law: Control) -> None:
    """As where an estimate is lost, at the very distance that is kept, and beyond it."""
    kept = law.safe_gap + law.margin
    assert follow_acceleration(math.nan, 0.3, 0.0, law) == 0.0
    assert follow_acceleration(kept, 0.3, 0.0, law) == -law.braking * (law.limit if law.restoring else 1.0)
    assert follow_acceleration(math.nextafter(kept, 1.0), 0.3, 0.0, law) == law.follow


def test_next_speed_obeys_every_limit() -> None:
    assert next_speed(1.19, 1.6, 9.0, math.inf, LAW_P) == 1.2
    assert next_speed(0.5, 1.6, 9.0, math.inf, LAW_P) == pytest.approx(0.58)
    assert next_speed(0.5, 1.6, 9.0, -1.0, LAW_P) == pytest.approx(0.5 - 1.5 * 1.6 * 0.05)
    assert next_speed(0.05, 1.6, 0.0, math.inf, LAW_P) == 0.0


def test_authority_ends_at_the_block_of_the_leaders_tail() -> None:
    """Blocks of 1 m whose boundaries lie 0.05 m beyond the stops."""
    assert authority_end(0.06, 1.0, 0.05) == pytest.approx(0.05)
    assert authority_end(1.04, 1.0, 0.05) == pytest.approx(0.05)
    assert authority_end(1.06, 1.0, 0.05) == pytest.approx(1.05)
    assert authority_end(-0.27, 1.0, 0.05) == pytest.approx(-0.95)


@pytest.mark.parametrize(("key", "value", "said"), [
    ("plant.trains.stops", [[0, 3], [2]], "stations go from 0 to 2"),
    ("plant.trains.stops", [[1, 0], [2]], "rising order"),
    ("plant.trains.start", [0.0, -0.5], "safe_gap"),
    ("plant.control.leader_ratio", -1.0, "greater than 0"),
    ("plant.trains.start", [100.0, -10.0], "within one lap"),
    ("sensors.tags.count", 100, "a tag every 0.0494 m, but a train goes up to 0.06 m a step"),
    ("channel", {"kind": "random-access", "p": [1.0], "nodes": [[0, 1]]}, "channel.nodes list the measurement"),
    ("plant.signalling.kind", "moveing", "'moving', 'fixed'"),
])
def test_mistakes_are_named(key: str, value: object, said: str) -> None:
    with pytest.raises(InputError, match=said):
        load("moving-block", {key: value})


def test_a_train_that_goes_on_and_on_stays_at_the_last_stop_there_is() -> None:
    setting = load("moving-block").setting("law-p")
    world = setting.world(Streams(1, "moving-block", "law-p", range(2)))
    world.stops = world.stops[:, :2]
    mean = world.initial_mean
    for k in range(200):
        mean = world.step(k, mean).truth
    np.testing.assert_allclose(np.nanmax(world.extra["s-a"], axis=0), world.stops[0, 1], atol=5e-3)


def test_what_bounds_every_estimator_on_the_ring() -> None:
    """The moments of `matched`, worked out from the encoder's and the tags' own numbers."""
    encoder = {"bias_mean": 0.25, "bias_sd": 0.1, "noise_sd": 0.2, "noise_period": 0.4, "pulse": 0.6}
    changes = {f"sensors.encoder.{name}": value for name, value in encoder.items()}
    setting = load("moving-block", {**changes, "sensors.tags.sd": 0.3, "sensors.start_sd": 0.05, "time.period": 0.1}
                   ).setting("law-p")
    found = setting.matched(2)
    assert found is not None and found.kind == "linear optimum"
    assert found.beyond is not None and found.beyond.tolist() == pytest.approx([0.03, 0.0, 0.03, 0.0])
    model, x, u = found.model, np.zeros((4, 2)), np.array([[0.5, 1.0], [2.0, 3.0]])
    assert (model.states, model.measurements) == (("s-a", "scale-a", "s-b", "scale-b"), ("x-a", "y-a", "x-b", "y-b"))
    assert model.period == 0.1 and model.initial_mean.shape == (4, 2) and not model.initial_mean.any()
    np.testing.assert_allclose(model.initial_covariance[:, :, 0], np.diag([0.0025, 0.01] * 2), rtol=1e-12)
    assert model.transition(x, u, whole(3)) is x and model.measurement(x, 3) is x
    assert model.transition_jacobian is not None and model.process_covariance is not None
    assert model.measurement_jacobian is not None and model.measurement_covariance is not None
    for begins, share in ((0.0, 1.0), (0.25, 0.5), (0.5, np.array([0.5, 0.25]))):
        interval = Interval(8, 0.1 * (7 + begins), 0.1 * share, share)
        F, Q = np.repeat(np.eye(4)[:, :, None], 2, axis=2), np.zeros((4, 4, 2))
        for train in range(2):
            way = u[train] / 1.25**2
            F[2 * train, 2 * train + 1] = -share * way
            Q[2 * train, 2 * train] = (0.2 * 2.0 * way) ** 2 * ((begins + share) ** 2 - begins**2)
        np.testing.assert_allclose(model.transition_jacobian(x, u, interval), F, rtol=1e-12)
        np.testing.assert_allclose(model.process_covariance(x, u, interval), Q, rtol=1e-9)
    np.testing.assert_array_equal(model.measurement_jacobian(x, 3)[:, :, 0], np.diag([1.0, 0.0, 1.0, 0.0]))
    np.testing.assert_allclose(model.measurement_covariance(untold(3, 4))[:, :, 0], np.eye(4) * 0.11, rtol=1e-12)
    sure = load("moving-block", {"sensors.tags.sd": 0.0, "sensors.encoder.pulse": 1e-9}).setting("law-p").matched(1)
    assert sure is not None and sure.model.measurement_covariance is not None
    assert sure.model.measurement_covariance(untold(3, 4))[0, 0, 0] == 1e-12
    s, truth, wanted = np.array([[0.2, 1.3], [3.1, 4.0]]), np.empty((4, 2)), np.zeros((4, 4, 2))
    for train in range(2):
        x, y, heading = setting.track.points(s[train])
        truth[2 * train:2 * train + 2] = x, y
        wanted[2 * train, 2 * train], wanted[2 * train + 1, 2 * train] = np.cos(heading), np.sin(heading)
    assert found.outward is not None
    np.testing.assert_allclose(found.outward(truth), wanted, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("channel", "known"), [
    ({"kind": "bernoulli", "p": 0.5}, True), ({"kind": "round-robin"}, False), ({"kind": "delay", "steps": 1}, True),
    ({"kind": "delay", "steps": 1, "loss": {"kind": "round-robin"}}, False)])
def test_a_channel_that_parts_x_from_y_leaves_no_bound(channel: dict[str, object], known: bool) -> None:
    assert (load("moving-block", {"channel": channel}).setting("law-p").matched(1) is not None) == known


def test_two_trains_tags_are_read_in_their_order() -> None:
    """At the start of a step, at one instant (the leader's first), by one train alone or by none."""
    shares = [-1.0, 0.0, 0.3, 0.3, 0.9]
    share = np.array([(a, b) for a in shares for b in shares]).T.copy()
    runs = share.shape[1]
    tag = np.stack([np.arange(runs) % 3, np.arange(runs) % 2])
    places = np.arange(12.0).reshape(2, 2, 3)  # x or y, train, tag
    for number in (0, 1):
        until, y, received = np.ones(runs), np.zeros((4, runs)), np.zeros((4, runs), dtype=bool)
        reading(number, share, tag, *places, until, y, received)
        for run in range(runs):
            order = sorted((share[train, run], train) for train in (0, 1) if share[train, run] >= 0)
            wanted, at = np.zeros(4), 1.0
            if number < len(order):
                at, train = order[number]
                wanted[2 * train:2 * train + 2] = places[:, train, tag[train, run]]
            assert until[run] == at and y[:, run].tolist() == wanted.tolist()
            assert received[:, run].tolist() == [number < len(order) and order[number][1] == j // 2 for j in range(4)]
