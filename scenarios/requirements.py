"""Requirements of a scenario: what a rail engineer asks of an estimator, each judged as a share that must keep it.

Forms: allowance (odometer), speed, stop, confidence (of a claimed interval), percentile. Scored in `scoring`."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, PositiveFloat, model_validator

from .strict import Strict

Share = Annotated[float, Field(gt=0, lt=1)]
Title = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9-]*$")]


class Asked(Strict):
    """name: of its columns and lines. accept: the share that must keep it, of runs (each over its whole trip), or of
    time where per = "time"."""

    name: Title
    accept: Share = 0.99
    per: Literal["runs", "time"] = "runs"

    @property
    def quantity_needed(self) -> str:
        """The scored quantity whose error it looks at."""
        return str(getattr(self, "quantity", ""))


class Allowance(Asked):
    """|error of the distance travelled since the last reference| <= constant + share x that distance.

    constant m; s: the distance as measured (SUBSET-041 5.3.1.1) or the true one. Counts from the first reference on.
    quantity: the position whose error since the reference is meant."""

    form: Literal["allowance"]
    quantity: str = "position"
    constant: Annotated[float, Field(ge=0)]
    share: Annotated[float, Field(ge=0)]
    s: Literal["measured", "true"] = "measured"


class Speed(Asked):
    """|speed error| <= limit, which goes straight through `points` [[speed m/s, limit m/s], ..] and is constant before
    the first and behind the last."""

    form: Literal["speed"]
    quantity: str = "speed"
    points: Annotated[list[Annotated[list[float], Field(min_length=2, max_length=2)]], Field(min_length=1)]

    @model_validator(mode="after")
    def _ordered(self) -> Speed:
        speeds = [pair[0] for pair in self.points]
        if any(b <= a for a, b in pairwise(speeds)) or any(pair[1] <= 0 for pair in self.points):
            raise ValueError("points = [[speed, limit], ..] need increasing speeds and limits over 0")
        return self


class Stop(Asked):
    """|position error| <= within (m) at the end of the trip. A run counts as a whole."""

    form: Literal["stop"]
    quantity: str = "position"
    within: PositiveFloat
    per: Literal["runs"] = "runs"  # pyright: ignore[reportIncompatibleVariableOverride]


class Confidence(Asked):
    """The claimed interval, estimate +- k standard deviations (or what an ellipsoid or set claims, whatever k), covers
    the truth. accept: the share of time, unless per = "runs" asks it of whole trips."""

    form: Literal["confidence"]
    quantity: str = "position"
    k: PositiveFloat
    per: Literal["runs", "time"] = "time"


class Percentile(Asked):
    """The percentile `percent` of |error| over a run's trip is at most `limit` (SI)."""

    form: Literal["percentile"]
    quantity: str
    percent: Annotated[float, Field(gt=0, le=100)]
    limit: PositiveFloat
    per: Literal["runs"] = "runs"  # pyright: ignore[reportIncompatibleVariableOverride]


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
