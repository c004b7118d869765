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
from ..schema import TABLES, ScenarioConfig, Strict
from ..strict import KIND, key
from .disturbance import Disturbance, Sensors

Two = Annotated[list[PositiveFloat], Field(min_length=2, max_length=2)]


class Plant(Strict):
    """A train on a line, driven from stop to stop."""

    kind: Annotated[Literal["metro"], KIND]
    line: Annotated[LineOrFile, key("the line: a table, or the path of a TTOBench file")]
    train: Annotated[TrainOrFile, key("the train: a table, or the path of a TTOBench file")]
    loads: Annotated[list[PositiveFloat], key(
        "mass with passengers on each section, where it is not the train's own throughout; the train weighs "
        "itself, so that inputs are told as shares of the force that does the same to its own mass", "kg")] = []
    controller: Annotated[Controller, key("automatic train operation")]
    start_speed: Annotated[NonNegativeFloat, key("speed at the start", "m/s")]
    start_error: Annotated[Two, key("the estimators' first errors are uniform within +- this", "[m, m/s]")]

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
    """What estimators are told. Bounds of an estimator's own leave it the standard deviations of the scenario."""

    w_bar: Annotated[PositiveFloat, key("bound of the disturbance", "m/s^2")]
    v_bar: Annotated[Two, key("bounds of the sensors' noise", "[m, m/s]")]
    moments: Annotated[Literal["uniform", "gaussian"], key(
        "second moments that follow from the bounds: uniform, bound^2 / 3; gaussian, bound^2 / 9")] = "uniform"
    densities: Annotated[Literal["gaussian", "uniform"], key(
        "what a particle filter draws and weighs by: Gaussian noise of these moments, or uniform noise within the "
        "bounds, fresh each step")] = "gaussian"
    sigma_w: Annotated[PositiveFloat | None, key(
        "standard deviation of the disturbance in place of that", "m/s^2")] = None
    sigma_v: Annotated[Two | None, key("standard deviations of the noise in place of those", "[m, m/s]")] = None
    initial_sd: Annotated[Two, key("standard deviations of the start", "[m, m/s]")]
    kappa: Annotated[NonNegativeFloat | None, key(
        "constant factor of the linearisation error in place of the computed one", "1/s")] = None

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

    plant: Annotated[Plant, TABLES["plant"]]
    disturbance: Annotated[Disturbance, TABLES["disturbance"]]  # pyright: ignore[reportGeneralTypeIssues]
    sensors: Annotated[Sensors, TABLES["sensors"]]  # pyright: ignore[reportGeneralTypeIssues]
    channel: Annotated[Channel, TABLES["channel"]] = Ideal()
    faults: Annotated[Faults, TABLES["faults"]] = ()
    knowledge: Annotated[Knowledge, TABLES["knowledge"]]  # pyright: ignore[reportGeneralTypeIssues]

    @model_validator(mode="after")
    def _consistent(self) -> MetroConfig:
        plant = self.plant
        check_trip(plant.line, plant.heaviest, plant.controller, self.disturbance.w_bar, plant.start_speed)
        self.channel.check(2)
        return self
