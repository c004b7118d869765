"""The metro's disturbance and sensor noise, drawn per run: every form keeps its bounds but the Gaussian.

Whole trajectories are drawn at once, so that the compiled trip only looks them up."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, NonNegativeFloat, PositiveFloat, model_validator

from ..aboard import FITTED, Instruments
from ..arrays import Array
from ..machine_code import njit
from ..randomness import RunRandom
from ..schema import Strict
from ..strict import key

Range = Annotated[list[PositiveFloat], Field(min_length=2, max_length=2)]
Form = Literal["white", "sinusoid", "switching", "constant", "physical", "gaussian"]

UNTOUCHED = np.array([[1.0], [1.0], [1.0], [0.0], [0.0]])


class Disturbance(Strict):
    """The acceleration disturbance w(k), |w| <= w_bar (gaussian: standard deviation w_bar / 3)."""

    form: Annotated[Form, key(
        "white, sinusoid, switching (the sign alternates), constant, gaussian, or physical: what follows from "
        "wrong mass, forces, gradient and wind, each uniform within +- its value and constant in a run, cut to "
        "+-w_bar")]
    w_bar: Annotated[PositiveFloat, key("bound", "m/s^2")]
    period: Annotated[Range, key("least and greatest period of the sinusoid", "s")]
    piece: Annotated[Range, key("least and greatest length of a piece of `switching`", "s")]
    amplitude: Annotated[Range, key("least and greatest amplitude of a piece over w_bar", "1")]
    mass: Annotated[float, Field(ge=0, lt=1), key("error of the mass, a share (physical)", "1")]
    force: Annotated[float, Field(ge=0, lt=1), key("error of traction and braking force, a share (physical)", "1")]
    gradient: Annotated[NonNegativeFloat, key("error of the gradient (physical)", "m/m")]
    wind: Annotated[NonNegativeFloat, key("wind along the line (physical)", "m/s")]

    @model_validator(mode="after")
    def _consistent(self) -> Disturbance:
        for name in ("period", "piece", "amplitude"):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(f"{name} = [least, most] needs least <= most")
        if self.amplitude[1] > 1:
            raise ValueError("amplitude is a share of w_bar: at most 1")
        return self

    def draw(self, random: RunRandom, steps: int, period: float) -> Array:
        """w (steps, S) in m/s^2; zero where `factors` make the disturbance."""
        bar = self.w_bar
        if self.form == "white":
            return random.uniform(-bar, bar, steps)
        if self.form == "gaussian":
            return random.normal(steps) * (bar / 3)
        if self.form == "sinusoid":
            return bar * wave(random, self.period, steps, period)
        if self.form == "constant":
            return np.repeat(bar * random_sign(random)[None, :], steps, axis=0)
        if self.form == "switching":
            return self._switching(random, steps, period)
        return np.zeros((steps, len(random.runs)))

    def factors(self, random: RunRandom) -> Array:
        """(5, S): factors of mass, traction and braking force, offset of the gradient m/m, head wind m/s."""
        if self.form != "physical":
            return np.repeat(UNTOUCHED, len(random.runs), axis=1)
        spread = np.array([[self.mass], [self.force], [self.force], [self.gradient], [self.wind]])
        return UNTOUCHED + spread * random.uniform(-1.0, 1.0, 5)

    def _switching(self, random: RunRandom, steps: int, period: float) -> Array:
        pieces = int(np.ceil(steps * period / self.piece[0])) + 1
        sign = random_sign(random)
        length = random.uniform(self.piece[0], self.piece[1], pieces)
        height = random.uniform(self.amplitude[0], self.amplitude[1], pieces) * self.w_bar
        out = np.empty((steps, len(random.runs)))
        _switch(sign, length, height, period, out)
        return out


@njit(cache=True)
def _switch(sign, length, height, period, out):  # pyright: ignore
    """out (steps, S): pieces of length s (pieces, S) and height (pieces, S) one after another, signs alternating from
    sign (S,) on. A step belongs to the piece under way at its time, counted from 0."""
    for r in range(out.shape[1]):
        piece, until, way = 0, length[0, r], sign[r]
        for k in range(out.shape[0]):
            while k * period >= until:
                piece += 1
                until += length[piece, r]
                way = -way
            out[k, r] = way * height[piece, r]


OWN = ("position", "speed")
Sensor = Literal["position", "speed", "wheel-a", "wheel-b", "balise", "gnss", "radar", "accelerometer"]


class Sensors(Instruments):
    """Position and speed sensors with |v_m| <= v_bar, every step, and those aboard that are named."""

    use: Annotated[list[Sensor], Field(min_length=1), key(
        "what estimators get: position, speed, and of sensors aboard wheel-a, wheel-b, balise, gnss, radar, "
        "accelerometer")] = ["position", "speed"]

    noise: Annotated[Literal["uniform", "biased", "gaussian"], key(
        "uniform; biased, v_bar (share sin + (1 - share) U(-1, 1)), a sine per run and sensor; gaussian, standard "
        "deviation v_bar / 3")] = "uniform"
    v_bar: Annotated[Range, key("bounds of position and speed", "[m, m/s]")]
    share: Annotated[float, Field(ge=0, le=1), key("of the sine in `biased`", "1")]
    period: Annotated[Range, key("least and greatest period of the sine", "s")]

    @model_validator(mode="after")
    def _something_is_measured(self) -> Sensors:
        if not self.measured:
            raise ValueError("use has the accelerometer alone: something has to be measured beside it")
        return self

    @property
    def own(self) -> list[int]:
        """The sensors of position and speed that are used, by place in `OWN`."""
        return [i for i, name in enumerate(OWN) if name in self.use]

    @property
    def aboard(self) -> bool:
        """Whether any sensor but those of position and speed is used."""
        return not set(self.use) <= {*OWN}

    @property
    def fitted(self) -> tuple[str, ...]:
        """The measurements aboard that are used, in their order."""
        return tuple(name for name in FITTED if name in self.use)

    @property
    def measured(self) -> tuple[str, ...]:
        """Names of the measurements in their order."""
        return *(OWN[i] for i in self.own), *self.fitted

    @property
    def sd(self) -> Array:
        """Standard deviation of the noise that is fresh each step (2,); a bias's sine counts as noise."""
        bar = np.array(self.v_bar)
        if self.noise == "gaussian":
            return bar / 3
        if self.noise == "uniform":
            return bar / 3**0.5
        return bar * (self.share**2 / 2 + (1 - self.share) ** 2 / 3) ** 0.5

    def draw(self, random: RunRandom, steps: int, period: float) -> Array:
        """The measurement noise (steps, 2, S)."""
        bar = np.array(self.v_bar)[None, :, None]
        if self.noise == "gaussian":
            noise = random.normal(steps, 2)
            noise *= bar / 3
            return noise
        if self.noise == "uniform":
            noise = random.uniform(-1.0, 1.0, steps, 2)
            noise *= bar
            return noise
        bias = np.stack([wave(random, self.period, steps, period) for _ in range(2)], axis=1)
        return bar * (self.share * bias + (1 - self.share) * random.uniform(-1.0, 1.0, steps, 2))


def wave(random: RunRandom, range_: list[float], steps: int, period: float) -> Array:
    """A unit sine (steps, S) with its period drawn from `range_` (s) and its phase drawn, per run."""
    turn = 2 * np.pi / random.uniform(range_[0], range_[1])
    phase = random.uniform(0.0, 2 * np.pi)
    time = np.arange(1, steps + 1) * period
    out = np.empty((steps, len(random.runs)))
    for r in range(out.shape[1]):  # one run at a time: the sine of a run must not depend on how many there are
        out[:, r] = np.sin(turn[r] * time + phase[r])
    return out


def random_sign(random: RunRandom) -> Array:
    """+1 or -1 (S,)."""
    return 2.0 * random.integers(0, 1).astype(np.float64) - 1.0
