"""Requirements of a scenario: what a rail engineer asks of an estimator, each judged as a share that must keep it.

Forms: allowance (odometer), speed, stop, confidence (of a claimed interval), percentile. Scored in `scoring`."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, PositiveFloat, model_validator

from .strict import Strict, key

Share = Annotated[float, Field(gt=0, lt=1)]
Title = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9-]*$")]


class Asked(Strict):
    """What every requirement says."""

    name: Annotated[Title, key("of its columns and lines")]
    accept: Annotated[Share, key("share that must keep it", "1")] = 0.99
    per: Annotated[Literal["runs", "time"], key("of runs (each over its whole trip), or of time")] = "runs"


class Allowance(Asked):
    """|error of the distance travelled since the last reference| <= constant + share x that distance.

    Counts from the first reference on (SUBSET-041 5.3.1.1)."""

    form: Annotated[Literal["allowance"], key("which requirement this is")]
    quantity: Annotated[str, key("the position whose error since the reference is meant")] = "position"
    constant: Annotated[float, Field(ge=0), key("allowed in any case", "m")]
    share: Annotated[float, Field(ge=0), key("allowed of the distance", "1")]
    s: Annotated[Literal["measured", "true"], key("the distance as measured (SUBSET-041) or the true one")] = "measured"


class Speed(Asked):
    """|speed error| <= a limit that depends on the speed."""

    form: Annotated[Literal["speed"], key("which requirement this is")]
    quantity: Annotated[str, key("the quantity whose error is meant")] = "speed"
    points: Annotated[list[Annotated[list[float], Field(min_length=2, max_length=2)]], Field(min_length=1), key(
        "limit by speed, straight between points and constant beyond them", "[m/s, m/s]")]

    @model_validator(mode="after")
    def _ordered(self) -> Speed:
        speeds = [pair[0] for pair in self.points]
        if any(b <= a for a, b in pairwise(speeds)) or any(pair[1] <= 0 for pair in self.points):
            raise ValueError("points = [[speed, limit], ..] need increasing speeds and limits over 0")
        return self


class Stop(Asked):
    """|position error| at the end of the trip is small. A run counts as a whole."""

    form: Annotated[Literal["stop"], key("which requirement this is")]
    quantity: Annotated[str, key("the quantity whose error is meant")] = "position"
    within: Annotated[PositiveFloat, key("largest error", "m")]
    per: Annotated[Literal["runs"], key("of runs")] = "runs"  # pyright: ignore[reportIncompatibleVariableOverride]


class Confidence(Asked):
    """The claimed interval, estimate +- k standard deviations (or what an ellipsoid or set claims, whatever k), covers
    the truth."""

    form: Annotated[Literal["confidence"], key("which requirement this is")]
    quantity: Annotated[str, key("the quantity whose error is meant")] = "position"
    k: Annotated[PositiveFloat, key("standard deviations to either side", "1")]
    per: Annotated[Literal["runs", "time"], key("of time, or of whole trips (runs)")] = "time"


class Percentile(Asked):
    """A percentile of |error| over a run's trip is small."""

    form: Annotated[Literal["percentile"], key("which requirement this is")]
    quantity: Annotated[str, key("the quantity whose error is meant")]
    percent: Annotated[float, Field(gt=0, le=100), key("which percentile", "%")]
    limit: Annotated[PositiveFloat, key("largest value", "SI")]
    per: Annotated[Literal["runs"], key("of runs")] = "runs"  # pyright: ignore[reportIncompatibleVariableOverride]


Requirement = Annotated[Allowance | Speed | Stop | Confidence | Percentile, Field(discriminator="form")]


def check(requirements: Sequence[Requirement], quantities: Sequence[str], references: bool) -> list[str]:
    """What is wrong with requirements of a scenario with these scored quantities of one component; references: whether
    its world tells of places known on the way."""
    found = []
    for i, item in enumerate(requirements):
        if item.quantity not in quantities:
            found.append(f"requirements.{i}.quantity: \"{item.quantity}\" is no scored quantity of one component; "
                         f"allowed: {', '.join(quantities)}")
        if item.form == "allowance" and not references:
            found.append(f"requirements.{i}.form: an allowance needs references on the way (balises), which this "
                         "setting does not have")
    names = [item.name for item in requirements]
    found += [f"requirements: the name \"{name}\" stands twice" for name in dict.fromkeys(names)
              if names.count(name) > 1]
    return found
