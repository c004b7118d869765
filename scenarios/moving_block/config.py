"""Schema of moving-block scenario files. Lengths in m, times in s, speeds in m/s, accelerations in m/s^2.

What each number means stands here; where it comes from stands in the scenario file."""

# Each setting narrows the types of the common tables, which are frozen: pyright takes them for mutable.
# pyright: reportIncompatibleVariableOverride=false

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt, model_validator

from ..channels import Channel, Delay, Ideal, TryOnceDiscard
from ..faults import Faults
from ..schema import ScenarioConfig, Strict
from .track import StadiumTrack


class Track(Strict):
    """straight: length of each of the two straights; radius: of the two half circles. stations: evenly spaced stops,
    the main one at s = 0."""

    straight: PositiveFloat
    radius: PositiveFloat
    stations: PositiveInt


class Trains(Strict):
    """start: arc length of the noses of leader and follower. stops: the stations (0 = main) each of them calls at.

    stop_tolerance: a train at rest this close to its stop has arrived."""

    length: PositiveFloat
    top_speed: PositiveFloat
    start: Annotated[list[float], Field(min_length=2, max_length=2)]
    stops: Annotated[list[Annotated[list[NonNegativeInt], Field(min_length=1)]], Field(min_length=2, max_length=2)]
    dwell: NonNegativeFloat
    stop_tolerance: PositiveFloat
    laps: PositiveInt


class ControlTable(Strict):
    """law: P (the paper's) or R (restoring). braking: beta_s; braking_limit: hardest deceleration over beta_s.

    reserve: periods of the follower's way that the distance kept is longer than (23) asks for.
    leader_ratio: k_acc of eqs. (28), (29); the follower's ratio (-1 + sqrt(1 + 4 k_acc)) / 2 must be real."""

    law: Literal["P", "R"]
    braking: PositiveFloat
    braking_limit: Annotated[float, Field(ge=1)]
    leader_ratio: PositiveFloat
    safe_gap: PositiveFloat
    margin: NonNegativeFloat
    reserve: NonNegativeFloat = 2.0


class MovingBlockSignalling(Strict):
    """The follower keeps its distance from the leader's tail by the synchronization law."""

    kind: Literal["moving"]


class FixedBlockSignalling(Strict):
    """Blocks from station to station, boundaries `overlap` beyond the stops; authority ends at the block that holds the
    leader's tail, as it was `release_delay` ago. Both trains keep to line_speed."""

    kind: Literal["fixed"]
    line_speed: PositiveFloat
    release_delay: NonNegativeFloat
    overlap: NonNegativeFloat


class Plant(Strict):
    """The ring with its two trains, how they are driven and how they are signalled."""

    kind: Literal["moving-block"]
    track: Track
    trains: Trains
    control: ControlTable
    signalling: Annotated[MovingBlockSignalling | FixedBlockSignalling, Field(discriminator="kind")]

    @model_validator(mode="after")
    def _consistent(self) -> Plant:
        known = self.track.stations
        for stops in self.trains.stops:
            if max(stops) >= known:
                raise ValueError(f"trains.stops names station {max(stops)}, but stations go from 0 to {known - 1}")
            if sorted(set(stops)) != stops:
                raise ValueError(f"trains.stops must be in rising order without repeats, got {stops}")
        lap = StadiumTrack(self.track.straight, self.track.radius).length
        if max(map(abs, self.trains.start)) >= lap:
            raise ValueError(f"trains.start must lie within one lap of {lap:.4g} m from the main stop")
        leader, follower = self.trains.start
        if leader - self.trains.length - follower < self.control.safe_gap - 1e-9:
            raise ValueError("trains.start leaves less than control.safe_gap between leader's tail and follower's nose")
        return self


class Encoder(Strict):
    """Measured distance = ds (1 + b + w), counted in whole pulses. b: per train and run; w: per step, its standard
    deviation given for noise_period (white in time). Measured speed = v (1 + b + w)."""

    bias_mean: float
    bias_sd: NonNegativeFloat
    noise_sd: NonNegativeFloat
    noise_period: PositiveFloat
    pulse: PositiveFloat


class Tags(Strict):
    """count: evenly spaced, half a spacing off the main stop. sd: of the place where a nose is read. missed: share of
    passes without a reading."""

    count: PositiveInt
    sd: NonNegativeFloat
    missed: Annotated[float, Field(ge=0, lt=1)] = 0.0


class Sensors(Strict):
    """start_sd: standard deviation of the filter's start along the track."""

    encoder: Encoder
    tags: Tags
    start_sd: NonNegativeFloat


class Knowledge(Strict):
    """What the estimators are told: process variance per metre travelled (m^2/m), variance of a tag's coordinates
    (m^2), of the start (m^2)."""

    process_variance: PositiveFloat
    tag_variance: PositiveFloat
    start_variance: PositiveFloat


class MovingBlockConfig(ScenarioConfig):
    """The moving-block scenario, resolved for one variant. channel: what comes through of the tags' readings; its
    measurement elements are x, y of the leader, then of the follower."""

    plant: Plant
    sensors: Sensors  # pyright: ignore[reportGeneralTypeIssues]
    channel: Channel = Ideal()
    faults: Faults = ()
    knowledge: Knowledge  # pyright: ignore[reportGeneralTypeIssues]

    @model_validator(mode="after")
    def _consistent(self) -> MovingBlockConfig:
        self.channel.check(4)
        links = (self.channel, self.channel.loss) if isinstance(self.channel, Delay) else (self.channel,)
        if any(isinstance(link, TryOnceDiscard) or link.silent == "hold" for link in links):
            raise ValueError("channel: try-once-discard and silent = \"hold\" want a reading a step, and a train reads "
                             "a tag now and then; allowed: the other kinds, with silent = \"nothing\"")
        track, tags = self.plant.track, self.sensors.tags.count
        spacing = StadiumTrack(track.straight, track.radius).length / tags
        farthest = self.plant.trains.top_speed * self.time.period
        if spacing <= farthest:
            raise ValueError(f"sensors.tags.count = {tags} puts a tag every {spacing:.3g} m, but a train goes up to "
                             f"{farthest:.3g} m a step, in which it reads one")
        return self
