"""What a metro's file may say."""

# pyright: reportIncompatibleVariableOverride=false
from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, NonNegativeFloat, PositiveFloat, model_validator

from ..arrays import Array
from ..channels import Channel, Ideal
from ..faults import Faults
from ..railway.line import LineOrFile, Train, TrainOrFile
from ..railway.trip import Controller, check_trip
from ..schema import ScenarioConfig, Strict
from .disturbance import Disturbance, Sensors

Two = Annotated[list[PositiveFloat], Field(min_length=2, max_length=2)]


class Plant(Strict):
    """line, train: tables, or paths of TTOBench files. loads: mass kg of the train with its passengers on each section,
    where it is not the train's own throughout; the train weighs itself, so that inputs are told as shares of the force
    that does the same to its own mass. start_speed m/s; start_error: the estimators' first errors are uniform within
    +-[m, m/s]."""

    kind: Literal["metro"]
    line: LineOrFile
    train: TrainOrFile
    loads: list[PositiveFloat] = []
    controller: Controller
    start_speed: NonNegativeFloat
    start_error: Two

    @model_validator(mode="after")
    def _one_load_a_section(self) -> Plant:
        sections = len(self.line.stops) - 1
        if self.loads and len(self.loads) != sections:
            raise ValueError(f"loads has {len(self.loads)} entries for {sections} sections: one each is needed")
        return self

    @property
    def heaviest(self) -> Train:
        """The train with its greatest load."""
        return self.train.model_copy(update={"mass": max(self.loads)}) if self.loads else self.train

    @property
    def ease(self) -> Array:
        """The train's own mass over that on each section, (sections,)."""
        own = np.ones(len(self.line.stops) - 1)
        return self.train.mass / np.array(self.loads) if self.loads else own


class Knowledge(Strict):
    """What estimators are told. w_bar m/s^2, v_bar [m, m/s]: bounds. moments: the second moments that follow from
    them (uniform: bound^2 / 3; gaussian: bound^2 / 9). sigma_w m/s^2, sigma_v [m, m/s]: standard deviations instead.
    densities: what a particle filter draws and weighs by, Gaussian noise of these moments or uniform noise within the
    bounds, fresh each step. Bounds of an estimator's own leave it the standard deviations of the scenario.

    initial_sd [m, m/s]. kappa: a constant factor of the linearisation error instead of the computed one."""

    w_bar: PositiveFloat
    v_bar: Two
    moments: Literal["uniform", "gaussian"] = "uniform"
    densities: Literal["gaussian", "uniform"] = "gaussian"
    sigma_w: PositiveFloat | None = None
    sigma_v: Two | None = None
    initial_sd: Two
    kappa: NonNegativeFloat | None = None

    @property
    def process_sd(self) -> float:
        """Standard deviation of the acceleration disturbance, m/s^2."""
        return self.sigma_w or self.w_bar / self.divisor

    @property
    def sensor_sd(self) -> Array:
        """Standard deviations of the measurement noise (2,)."""
        return np.array(self.sigma_v or [bar / self.divisor for bar in self.v_bar])

    @property
    def divisor(self) -> float:
        return 3.0 if self.moments == "gaussian" else 3.0**0.5


class MetroConfig(ScenarioConfig):
    """The metro scenario, resolved for one variant."""

    plant: Plant
    disturbance: Disturbance  # pyright: ignore[reportGeneralTypeIssues]
    sensors: Sensors  # pyright: ignore[reportGeneralTypeIssues]
    channel: Channel = Ideal()
    faults: Faults = ()
    knowledge: Knowledge  # pyright: ignore[reportGeneralTypeIssues]

    @model_validator(mode="after")
    def _consistent(self) -> MetroConfig:
        plant = self.plant
        check_trip(plant.line, plant.heaviest, plant.controller, self.disturbance.w_bar, plant.start_speed)
        self.channel.check(2)
        return self
