"""Balises: known places on the line, each surveyed with an error, read a little off its place, now and then missed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field, NonNegativeFloat

from ..arrays import Array, Mask
from ..randomness import RunRandom
from ..schema import Strict
from ..strict import key

Pair = Annotated[list[NonNegativeFloat], Field(min_length=2, max_length=2)]


@dataclass(frozen=True)
class Passages:
    """place, told (balises, S) m: where each truly lies, and where the map that estimators are given has it; sd
    (balises,) m: of the map; read (balises, S): which are read at all."""

    place: Array
    told: Array
    sd: Array
    read: Mask


class Balises(Strict):
    """Balises and their reader."""

    location: Annotated[Pair, key("standard deviation of the map, and the limit at which its error is cut", "m")]
    platform: Annotated[Pair, key("the same of balises at a platform's edge", "m")]
    reader: Annotated[Pair, key(
        "a balise is read within +- this of its place: up to 40 km/h, and at 500 km/h, straight on between", "m")]
    missed: Annotated[float, Field(ge=0, le=1), key("chance that one is not read; the first always is", "1")]
    detection: Annotated[NonNegativeFloat, key("standard deviation told of where it is read", "m")]

    def draw(self, places: list[float], platforms: list[float], random: RunRandom) -> Passages:
        """The map and the losses of S runs."""
        place = np.array(places)
        edge = np.isin(place, platforms)
        sd = np.where(edge, self.platform[0], self.location[0])
        limit = np.where(edge, self.platform[1], self.location[1])[:, None]
        error = np.clip(sd[:, None] * random.normal(len(place)), -limit, limit)
        read = random.uniform(0.0, 1.0, len(place)) >= self.missed
        read[:1] = True
        return Passages(np.repeat(place[:, None], read.shape[1], axis=1), place[:, None] + error, sd, read)

    def variance(self, sd: Array) -> Array:
        """What is told of a reading, m^2: the map's variance and the reader's."""
        return sd**2 + self.detection**2
