"""The scenario file's schema common to all settings, which refine `plant`, `disturbance`, `sensors`, `knowledge`.

Unknown keys are refused everywhere, so that a typing error is an error."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt, model_validator

from .requirements import Requirement
from .strict import Strict, key

Probability = Annotated[float, Field(gt=0, le=1)]
Name = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9-]*$")]
LABEL = r"^[A-Za-z0-9][A-Za-z0-9._-]*$"
"""What variants and estimators of a scenario may be called, since names of files and rows are made of it."""
Label = Annotated[str, Field(pattern=LABEL)]


TABLES = {
    "plant": key("what moves, and how it is driven"), "disturbance": key("what acts on it that estimators do not know"),
    "sensors": key("what is measured, and how well"), "channel": key("which measurements arrive, and when"),
    "faults": key("how sensors fail"), "knowledge": key("what estimators are told")}
"""What the tables are that each setting has a type of its own for."""


class Empty(Strict):
    """A table this setting has no keys for."""


class Time(Strict):
    """When a run is sampled, and how long it is."""

    period: Annotated[PositiveFloat, key("sampling period", "s")]
    steps: Annotated[PositiveInt, key(
        "steps of a run: the most there can be of runs that end by themselves, the least of the metro's, whose "
        "trips take what the line needs", "1")]


class Score(Strict):
    """What is scored, and when a run counts as diverged."""

    at: Annotated[Literal["update", "prediction"], key(
        "the estimate after the measurement of the same step (update), or before it (prediction)")] = "update"
    skip: Annotated[float, Field(ge=0), key("left out of the scores at the start", "s")] = 0.0
    divergence: Annotated[dict[str, PositiveFloat], key(
        "largest admitted error by quantity; a run that exceeds it is diverged", "SI")] = {}


class Augment(Strict):
    """An extra state that an estimator carries along; what is left out is as the setting offers it (`railstate
    show`)."""

    kind: Annotated[Literal["constant", "walk", "gauss-markov"] | None, key(
        "constant, walk (sd per root of a second) or gauss-markov (stationary sd)")] = None
    sd: Annotated[NonNegativeFloat | None, key("standard deviation of what drives it", "the offer's")] = None
    start_sd: Annotated[NonNegativeFloat | None, key("standard deviation at the start", "the offer's")] = None
    mean: Annotated[float | None, key("mean at the start, which a gauss-markov state returns to", "the offer's")] = None
    time_constant: Annotated[PositiveFloat | None, key("of a gauss-markov state", "s")] = None
    bound: Annotated[PositiveFloat | None, key("bound of what drives it within a step", "the offer's")] = None
    instead: Annotated[Annotated[float, Field(ge=0, le=1)] | None, key(
        "share of the plain model's process noise that it replaces", "1")] = None


class Tuned(Strict):
    """How an entry's numbers were found, as `railstate tune` writes it."""

    variant: Annotated[Label, key("variant on which they were searched")]
    untuned: Annotated[str, key("label of the entry that it was before")]
    runs: Annotated[PositiveInt, key("training runs", "1")]
    train: Annotated[dict[str, tuple[float, float]], Field(min_length=1), key(
        "metrics of the objective on them: of the tuned entry and of the untuned", "SI")]


class EstimatorEntry(Strict):
    """One estimator of the scenario under its own label."""

    plugin: Annotated[Label, key("name of an installed estimator (`railstate list`)")]
    parameters: Annotated[dict[str, Any], key("its parameters (`railstate show NAME`)")] = {}
    knowledge: Annotated[dict[str, Any], key("what it is told otherwise than [knowledge] says")] = {}
    augment: Annotated[dict[str, Augment], key("extra states of those that the setting offers, by name")] = {}
    late: Annotated[Literal["drop", "as-new", "rewind"], key(
        "what becomes of late packets: drop, as-new (taken for fresh ones), rewind (taken at their stamp, all "
        "since once more)")] = "drop"
    told_faults: Annotated[bool, key(
        "whether it is told which readings are faulty, and gets none of them: a yardstick")] = False
    default: Annotated[bool, key("false: runs only when asked for")] = True
    note: Annotated[str, key("what a reader of the tables should know of it")] = ""
    tuned: Annotated[Tuned | None, key("how its numbers were found, where they were searched")] = None


class ScenarioConfig(Strict):
    """A scenario resolved for one variant. Settings subclass it and give the tables their own types."""

    name: Annotated[Name, key("what the scenario is called in rows and folders: small letters, digits, hyphens")]
    title: Annotated[str, key("what it is, in a line")]
    default: Annotated[bool, key("false: a variant that runs only when asked for by its name")] = True
    source: Annotated[str, key("paper, book or standard that it follows")] = ""
    notes: Annotated[list[str], key("what a reader of the tables must know")] = []
    origin: Annotated[dict[str, str], key(
        "where numbers come from, by dotted key or table: \"plant.train.mass\" = \"paper, Table I\"")] = {}
    fitted: Annotated[list[str], key("keys that the source does not print, chosen to hit its numbers")] = []
    time: Annotated[Time, key("when a run is sampled, and how long it is")]
    plant: Annotated[Strict, TABLES["plant"]]
    disturbance: Annotated[Strict, TABLES["disturbance"]] = Empty()
    sensors: Annotated[Strict, TABLES["sensors"]] = Empty()
    channel: Annotated[Strict, TABLES["channel"]] = Empty()
    faults: Annotated[tuple[Strict, ...], TABLES["faults"]] = ()
    knowledge: Annotated[Strict, TABLES["knowledge"]] = Empty()
    score: Annotated[Score, key("what is scored, and when a run counts as diverged")] = Score()
    requirements: Annotated[list[Requirement], key(
        "what is asked of every estimator, judged as met, not met or undecided")] = []
    estimators: Annotated[dict[Label, EstimatorEntry], Field(min_length=1), key(
        "entries by label: which estimators, with which parameters, told what")]

    @model_validator(mode="after")
    def _something_is_scored(self) -> ScenarioConfig:
        if self.score.skip >= self.time.period * self.time.steps:
            raise ValueError(f"score.skip = {self.score.skip:g} s leaves nothing of {self.time.steps} steps of "
                             f"{self.time.period:g} s")
        return self
