"""Schema of moving-block scenario files. Lengths in m, times in s, speeds in m/s, accelerations in m/s^2.

What each number means stands here; where it comes from stands in the scenario file."""

# Each setting narrows the types of the common tables, which are frozen: pyright takes them for mutable.
# pyright: reportIncompatibleVariableOverride=false

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt, model_validator

from ..channels import Channel, Delay, Ideal, TryOnceDiscard
from ..faults import Faults
from ..schema import TABLES, ScenarioConfig, Strict
from ..strict import KIND, key
from .track import StadiumTrack


class Track(Strict):
    """A ring of two straights and two half circles."""

    straight: Annotated[PositiveFloat, key("length of each straight", "m")]
    radius: Annotated[PositiveFloat, key("of the half circles", "m")]
    stations: Annotated[PositiveInt, key("evenly spaced stops, the main one at s = 0", "1")]


class Trains(Strict):
    """The leader and the follower."""

    length: Annotated[PositiveFloat, key("of a train", "m")]
    top_speed: Annotated[PositiveFloat, key("of a train", "m/s")]
    start: Annotated[list[float], Field(min_length=2, max_length=2), key(
        "arc length of the noses of leader and follower", "m")]
    stops: Annotated[list[Annotated[list[NonNegativeInt], Field(min_length=1)]], Field(min_length=2, max_length=2), key(
        "stations (0 = main) that each of them calls at", "1")]
    dwell: Annotated[NonNegativeFloat, key("time at a stop", "s")]
    stop_tolerance: Annotated[PositiveFloat, key("a train at rest this close to its stop has arrived", "m")]
    laps: Annotated[PositiveInt, key("rounds of a run", "1")]


class ControlTable(Strict):
    """The synchronization law."""

    law: Annotated[Literal["P", "R"], key("P (the paper's) or R (restoring)")]
    braking: Annotated[PositiveFloat, key("beta_s, service deceleration", "m/s^2")]
    braking_limit: Annotated[float, Field(ge=1), key("hardest deceleration over beta_s", "1")]
    leader_ratio: Annotated[PositiveFloat, key(
        "k_acc of eqs. (28), (29); the follower's ratio (-1 + sqrt(1 + 4 k_acc)) / 2 must be real", "1")]
    safe_gap: Annotated[PositiveFloat, key("least gap admitted", "m")]
    margin: Annotated[NonNegativeFloat, key("added to it where the law acts", "m")]
    reserve: Annotated[NonNegativeFloat, key(
        "periods of the follower's way by which the distance kept is longer than (23) asks for", "1")] = 2.0
    steered_by: Annotated[Literal["estimator", "tags"], key(
        "estimator: by its own estimates; tags: by the place of the last tag read and the way counted since, whoever "
        "estimates, so that all listen to one trial")] = "estimator"


class MovingBlockSignalling(Strict):
    """The follower keeps its distance from the leader's tail by the synchronization law."""

    kind: Annotated[Literal["moving"], KIND]


class FixedBlockSignalling(Strict):
    """Blocks from station to station; authority ends at the block that holds the leader's tail, as it was a while
    ago."""

    kind: Annotated[Literal["fixed"], KIND]
    line_speed: Annotated[PositiveFloat, key("that both trains keep to", "m/s")]
    release_delay: Annotated[NonNegativeFloat, key("how old the leader's place is", "s")]
    overlap: Annotated[NonNegativeFloat, key("how far boundaries lie beyond the stops", "m")]


class Plant(Strict):
    """The ring with its two trains, how they are driven and how they are signalled."""

    kind: Annotated[Literal["moving-block"], KIND]
    track: Annotated[Track, key("the ring")]
    trains: Annotated[Trains, key("the two trains")]
    control: Annotated[ControlTable, key("how they are driven")]
    signalling: Annotated[MovingBlockSignalling | FixedBlockSignalling, Field(discriminator="kind"), key(
        "how they are kept apart")]

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
    """Measured distance = ds (1 + b + w), counted in whole pulses; measured speed = v (1 + b + w)."""

    bias_mean: Annotated[float, key("mean of b", "1")]
    bias_sd: Annotated[NonNegativeFloat, key("standard deviation of b, drawn per train and run", "1")]
    noise_sd: Annotated[NonNegativeFloat, key("standard deviation of w over the noise period", "1")]
    noise_period: Annotated[PositiveFloat, key("for which it is given (w is white in time)", "s")]
    pulse: Annotated[PositiveFloat, key("way of a pulse", "m")]


class Tags(Strict):
    """Tags evenly along the ring, half a spacing off the main stop."""

    count: Annotated[PositiveInt, key("number of tags", "1")]
    sd: Annotated[NonNegativeFloat, key("standard deviation of the place where a nose is read", "m")]
    missed: Annotated[float, Field(ge=0, lt=1), key("share of passes without a reading", "1")] = 0.0


class Sensors(Strict):
    """Each train's encoder, and the tags."""

    encoder: Annotated[Encoder, key("distance and speed by pulses")]
    tags: Annotated[Tags, key("places that are read on the way")]
    start_sd: Annotated[NonNegativeFloat, key("standard deviation of the filter's start along the track", "m")]


class Knowledge(Strict):
    """What the estimators are told."""

    process_variance: Annotated[PositiveFloat, key("process variance per metre travelled", "m^2/m")]
    tag_variance: Annotated[PositiveFloat, key("variance of a tag's coordinates", "m^2")]
    start_variance: Annotated[PositiveFloat, key("variance of the start", "m^2")]


class MovingBlockConfig(ScenarioConfig):
    """The moving-block scenario, resolved for one variant. channel: what comes through of the tags' readings; its
    measurement elements are x, y of the leader, then of the follower."""

    plant: Annotated[Plant, TABLES["plant"]]
    sensors: Annotated[Sensors, TABLES["sensors"]]  # pyright: ignore[reportGeneralTypeIssues]
    channel: Annotated[Channel, TABLES["channel"]] = Ideal()
    faults: Annotated[Faults, TABLES["faults"]] = ()
    knowledge: Annotated[Knowledge, TABLES["knowledge"]]  # pyright: ignore[reportGeneralTypeIssues]

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
