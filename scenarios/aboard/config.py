"""What a scenario file may say of sensors aboard and of what they meet; usual numbers are those of `odometry`.

A setting's `Plant` is a `Route`, its `Sensors` are `Instruments`."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import NonNegativeFloat, PositiveFloat, model_validator

from ..arrays import Array
from ..railway.adhesion import Adhesion, Span, spans
from ..railway.line import Line
from ..schema import Strict
from ..sensors import Accelerometer, Balises, Gnss, Radar, Wheel
from ..strict import key

Fitted = Literal["wheel-a", "wheel-b", "balise", "gnss", "radar", "accelerometer"]
FITTED = ("wheel-a", "wheel-b", "balise", "gnss", "radar")
"""Those of them that are measurements, in their order; an accelerometer's reading is an input told."""


class Places(Strict):
    """Where balises lie: in places given, or evenly with one before each stop."""

    positions: Annotated[list[float], key("places, in order", "m")] = []
    platforms: Annotated[list[float], key("those of them that are surveyed as platform balises", "m")] = []
    every: Annotated[PositiveFloat | None, key("one every so many metres, in place of positions", "m")] = None
    platform: Annotated[PositiveFloat, key("one so far before each stop", "m")] = 15.0
    begin: Annotated[PositiveFloat, key("the first one", "m")] = 10.0

    @model_validator(mode="after")
    def _consistent(self) -> Places:
        if bool(self.positions) == (self.every is not None):
            raise ValueError("either positions = [..] or every = .. (m) says where balises lie")
        if any(b - a < 2.0 for a, b in pairwise(self.positions)):
            raise ValueError("positions must lie in order, at least 2 m apart")
        strays = [p for p in self.platforms if p not in self.positions]
        if strays:
            raise ValueError(f"platforms: {strays[0]:g} m is none of the positions")
        return self

    def on(self, line: Line) -> tuple[list[float], list[float]]:
        """(all places, those at platforms) on a line."""
        return self.along(line.stops)

    def along(self, stops: list[float]) -> tuple[list[float], list[float]]:
        """(all places, those at platforms) on a line with these stops."""
        if self.every is None:
            return self.positions, self.platforms
        platforms = [stop - self.platform for stop in stops[1:]]
        grid = np.arange(stops[0] + self.begin, stops[-1], self.every)
        free = [float(p) for p in grid if min(abs(p - q) for q in platforms) > 30.0]
        return sorted([*free, *platforms]), platforms


class Filled(Strict):
    """A table whose tables have usual numbers: a file that gives some of them keeps the others."""

    @model_validator(mode="before")
    @classmethod
    def _over_the_usual(cls, table: Any) -> Any:
        if not isinstance(table, dict):
            return table
        usual = {name: field.default for name, field in cls.model_fields.items() if isinstance(field.default, Strict)}
        return {name: {**usual[name].model_dump(), **value} if name in usual and isinstance(value, dict) else value
                for name, value in table.items()}


class Route(Strict):
    """What sensors aboard meet on the way, beside the line."""

    tunnels: Annotated[list[Span], key("tunnels, in which satellites are silent: [[from, to], ..]", "m")] = []
    adhesion: Annotated[Adhesion | None, key(
        "friction of the rail and what slip does to wheels; none: they roll")] = None

    @model_validator(mode="after")
    def _tunnels_in_order(self) -> Route:
        spans(self.tunnels, "tunnels")
        return self


class Instruments(Filled):
    """Sensors aboard; those that a scenario names are fitted."""

    gradient: Annotated[NonNegativeFloat, key("standard deviation of the map's gradient per section", "m/m")] = 0.0005
    wheel: Annotated[Wheel, key("each axle's counter")] = Wheel(diameter=0.86, pulses=100, diameter_error=0.01)
    accelerometer: Annotated[Accelerometer, key("along the train")] = Accelerometer(bias=0.05, noise=0.05)
    balise: Annotated[Balises, key("places read on the way")] = Balises(
        location=[0.4, 1.0], platform=[0.05, 0.15], reader=[0.2, 0.7], missed=0.001, detection=0.13)
    gnss: Annotated[Gnss, key("satellite receiver")] = Gnss(
        every=1.0, slow=2.0, memory=60.0, white=1.0, told=2.24, jump=0.004, size=25.0, lasts=[5.0, 15.0],
        outage=[-20.0, 100.0])
    radar: Annotated[Radar, key("Doppler radar")] = Radar(scale=0.005, noise=0.15, least=2.0)

    def worth(self, name: str) -> float:
        """Standard deviation of a fitted sensor's reading, of a balise's one on the open line."""
        return {"gnss": self.gnss.told, "radar": self.radar.noise, "balise": float(self.balise.variance(
            np.array(self.balise.location[0])) ** 0.5)}.get(name, self.wheel.pulse / 6**0.5)

    def bound(self, name: str) -> float:
        """What a fitted sensor's error surely stays within; infinite where nothing is sure."""
        return self.balise.location[1] + self.balise.reader[1] if name == "balise" else np.inf

    def spread(self, name: str) -> float:
        """Standard deviation of the scale of a wheel or a radar."""
        if name == "radar":
            return self.radar.scale
        return self.wheel.diameter_error / (3**0.5 if self.wheel.spread == "uniform" else 1.0)

    def deviations(self, names: tuple[str, ...]) -> Array:
        """`worth` of each, (n,)."""
        return np.array([self.worth(name) for name in names])
