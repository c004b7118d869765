"""The scenario file's schema common to all settings, which refine `plant`, `disturbance`, `sensors`, `knowledge`.

Unknown keys are refused everywhere, so that a typing error is an error."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt, model_validator

from .requirements import Requirement
from .strict import Strict

Probability = Annotated[float, Field(gt=0, le=1)]
Name = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9-]*$")]
LABEL = r"^[A-Za-z0-9][A-Za-z0-9._-]*$"
"""What variants and estimators of a scenario may be called, since names of files and rows are made of it."""
Label = Annotated[str, Field(pattern=LABEL)]


class Empty(Strict):
    """A table this setting has no keys for."""


class Time(Strict):
    """Sampling period in seconds and number of steps: the most there can be of runs that end by themselves, but for the
    metro, whose trips take as many as the line needs."""

    period: PositiveFloat
    steps: PositiveInt


class Score(Strict):
    """What is scored: the estimate after the measurement of the same step, or the prediction before it.

    skip: seconds left out at the start. divergence: largest admitted error per quantity (SI); a run that exceeds it is
    `diverged`."""

    at: Literal["update", "prediction"] = "update"
    skip: Annotated[float, Field(ge=0)] = 0.0
    divergence: dict[str, PositiveFloat] = {}


class Augment(Strict):
    """An extra state that an estimator carries along; what is left out is as the setting offers it (`railstate show`).

    kind: constant, walk (sd per root of a second) or gauss-markov (stationary sd; time_constant s). sd, mean, start_sd,
    bound: in the unit of the offer; bound: of what drives it within a step. instead: the share of the plain model's
    process noise that it replaces."""

    kind: Literal["constant", "walk", "gauss-markov"] | None = None
    sd: NonNegativeFloat | None = None
    start_sd: NonNegativeFloat | None = None
    mean: float | None = None
    time_constant: PositiveFloat | None = None
    bound: PositiveFloat | None = None
    instead: Annotated[float, Field(ge=0, le=1)] | None = None


class Tuned(Strict):
    """How an entry's numbers were found, as `railstate tune` writes it. variant: on which; untuned: label of the entry
    that it was before; runs: on how many training runs; train: the metrics of the objective there, of the tuned entry
    and the untuned."""

    variant: Label
    untuned: str
    runs: PositiveInt
    train: Annotated[dict[str, tuple[float, float]], Field(min_length=1)]


class EstimatorEntry(Strict):
    """One estimator of the scenario under its own label: which plug-in, its parameters, what it is told differently.

    knowledge overrides the scenario's [knowledge] for this entry only. augment: extra states of those that the setting
    offers, by name. late: what becomes of packets that come late: `drop`, `as-new` (taken for fresh ones) or `rewind`
    (taken at their stamp, all since once more). told_faults: it is told which readings are faulty, and gets none of
    them: a yardstick. default = false: run only when asked for. tuned: where its numbers come from a search."""

    plugin: str
    parameters: dict[str, Any] = {}
    knowledge: dict[str, Any] = {}
    augment: dict[str, Augment] = {}
    late: Literal["drop", "as-new", "rewind"] = "drop"
    told_faults: bool = False
    default: bool = True
    note: str = ""
    tuned: Tuned | None = None


class ScenarioConfig(Strict):
    """A scenario resolved for one variant. Settings subclass it and give the tables their own types.

    origin: where a number comes from, by its dotted key (`"plant.mass" = "paper, Table I"`); notes: what a reader of
    the tables must know; fitted: parameters the source does not print that were chosen to hit its numbers. default =
    false: a variant that runs only when asked for by its name. requirements: what is asked of every estimator."""

    name: Name
    title: str
    default: bool = True
    source: str = ""
    notes: list[str] = []
    origin: dict[str, str] = {}
    fitted: list[str] = []
    time: Time
    plant: Strict
    disturbance: Strict = Empty()
    sensors: Strict = Empty()
    channel: Strict = Empty()
    faults: tuple[Strict, ...] = ()
    knowledge: Strict = Empty()
    score: Score = Score()
    requirements: list[Requirement] = []
    estimators: Annotated[dict[Label, EstimatorEntry], Field(min_length=1)]

    @model_validator(mode="after")
    def _something_is_scored(self) -> ScenarioConfig:
        if self.score.skip >= self.time.period * self.time.steps:
            raise ValueError(f"score.skip = {self.score.skip:g} s leaves nothing of {self.time.steps} steps of "
                             f"{self.time.period:g} s")
        return self
