"""Control of the two trains: braking for a stop, the follower's synchronization laws P and R, fixed-block authority.

Scalar compiled functions in SI units: the world calls them per run with what the control centre knows (estimates)."""

from __future__ import annotations

import math
from typing import NamedTuple

from ..machine_code import njit


class Control(NamedTuple):
    """What the control laws need, SI units.

    restoring: law R rather than the paper's P. braking: beta_s. limit: hardest deceleration over beta_s. follow:
    alpha_B. safe_gap: d_M. margin: m. reserve: periods of the follower's way beyond (23). fixed: fixed blocks rather
    than moving ones. top_speed: of both trains."""

    restoring: bool
    braking: float
    limit: float
    follow: float
    safe_gap: float
    margin: float
    reserve: float
    fixed: bool
    top_speed: float
    period: float


@njit(cache=True)
def speed_for_stop(distance, speed, braking, period):
    """Greatest next speed from which constant braking still stops `distance` ahead.

    Over the step the train covers (v + v') dt / 2, so v' solves v'^2 / (2 beta) + v' dt / 2 = distance - v dt / 2."""
    rest = distance - speed * period / 2
    if rest <= 0:
        return 0.0
    return braking * (-period / 2 + math.sqrt(period * period / 4 + 2 * rest / braking))


@njit(cache=True)
def kept_distance(follower, c):
    """d_min(k) of (23) at the follower's speed, with the margin and the reserve: under it the synchronization acts."""
    return c.safe_gap + c.margin + follower * follower / (2 * c.braking) + c.reserve * follower * c.period


@njit(cache=True)
def follow_acceleration(gap, leader, follower, c):
    """The follower's acceleration under moving block (Faruqi et al. 2019, eqs. (23), (27), (29)).

    gap: leader's tail to follower's nose as estimated; leader, follower: speeds from the encoders. Law R adds the
    deceleration that stops the follower at the safe gap; (27) alone lets errors of the estimates pile up in the gap."""
    if gap > kept_distance(follower, c):
        return c.follow
    hardest = c.limit * c.braking
    if gap <= c.safe_gap + c.margin:
        return -hardest if c.restoring else -c.braking
    match_speed = c.braking * (follower - leader) / follower if follower > 0 else 0.0
    if c.restoring:
        room = max(gap - c.safe_gap - c.margin - follower * c.period / 2, 0.0005)
        required = follower * follower / (2 * room)
        if required > c.braking:
            return -min(max(required, match_speed), hardest)
    return -min(max(match_speed, -c.follow), hardest)


@njit(cache=True)
def authority_end(leader_tail, block, overlap):
    """End of the follower's authority under fixed blocks: the near boundary of the block that holds the leader's tail.

    Boundaries lie `overlap` beyond the stops, one every `block`."""
    return math.floor((leader_tail - overlap) / block) * block + overlap


@njit(cache=True)
def next_speed(speed, acceleration, to_stop, to_authority, c):
    """The speed the drive is set to for the next instant, from the present set speed."""
    wanted = min(speed + acceleration * c.period, c.top_speed,
                 speed_for_stop(to_stop, speed, c.braking, c.period),
                 speed_for_stop(to_authority, speed, c.braking, c.period))
    return max(wanted, speed - c.limit * c.braking * c.period, 0.0)
