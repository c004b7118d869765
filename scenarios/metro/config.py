"""What a metro's file may say."""

# pyright: reportIncompatibleVariableOverride=false
from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, NonNegativeFloat, PositiveFloat, model_validator

from ..aboard import Filled, Places, Route
from ..arrays import Array
from ..channels import Channel, Ideal
from ..faults import Faults
from ..railway.line import LineOrFile, Train, TrainOrFile
from ..railway.odometer import Initial, OdometerKnowledge, Slip
from ..railway.trip import Controller, check_trip
from ..schema import TABLES, ScenarioConfig
from ..strict import KIND, key
from .disturbance import Disturbance, Sensors

Two = Annotated[list[PositiveFloat], Field(min_length=2, max_length=2)]


class Plant(Route):
    """A train on a line, driven from stop to stop."""

    kind: Annotated[Literal["metro"], KIND]
    line: Annotated[LineOrFile, key("the line: a table, or the path of a TTOBench file")]
    train: Annotated[TrainOrFile, key("the train: a table, or the path of a TTOBench file")]
    loads: Annotated[list[PositiveFloat], key(
        "mass with passengers on each section, where it is not the train's own throughout; the train weighs "
        "itself, so that inputs are told as shares of the force that does the same to its own mass", "kg")] = []
    controller: Annotated[Controller, key("automatic train operation")]
    balises: Annotated[Places, key("where balises lie, for sensors.use")] = Places(every=700.0)
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


class Odometry(OdometerKnowledge, Filled):
    """What models of sensors aboard are told; usual numbers are those of `odometry`."""

    motion: Annotated[Literal["force", "accelerometer", "wheel-a", "wheel-b", "minmax"], key(  # pyright: ignore[reportIncompatibleVariableOverride]
        "what the prediction goes by: the force that is asked of the train; the accelerometer, its bias as a state; or "
        "dead reckoning by a wheel's count: wheel-a, wheel-b, or minmax (braking the faster, in traction the slower, "
        "else their mean)")] = "force"
    acceleration: Annotated[PositiveFloat, key("standard deviation of the reading's noise over 0.1 s", "m/s^2")] = 0.05
    bias_walk: Annotated[NonNegativeFloat, key("random walk of its bias", "m/s^2 per sqrt(s)")] = 0.001
    scale_walk: Annotated[NonNegativeFloat, key("random walk of the scales", "1 per sqrt(s)")] = 0.0005
    slip: Annotated[Slip, key("slip as modes, for filters of modes")] = Slip(enter=0.01, leave=0.3, sd=10.0)
    initial: Annotated[Initial, key("standard deviations of the start")] = Initial(
        position=2.0, speed=0.3, bias=0.05, scale=0.00577)

    def lacks(self, use: Sequence[str]) -> str:
        """What the motion needs and sensors.use has not, in words; empty where it has all."""
        need = {"force": set[str](), "minmax": {"wheel-a", "wheel-b"}}.get(self.motion, {self.motion})
        return "" if need <= set(use) else (f"knowledge.odometry.motion = \"{self.motion}\" needs "
                                            f"{' and '.join(sorted(need))} in sensors.use")


class Knowledge(Filled):
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

    odometry: Annotated[Odometry, key("of sensors aboard")] = Odometry()

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
        self.channel.check(len(self.sensors.measured))
        lacking = self.knowledge.odometry.lacks(self.sensors.use)
        if lacking:
            raise ValueError(lacking)
        if "balise" in self.sensors.use:
            places = plant.balises.on(plant.line)[0]
            if not places or places[-1] <= plant.line.stops[0] or places[0] >= plant.line.stops[-1]:
                raise ValueError(f"plant.balises: none lies on the line, {plant.line.stops[0]:g} .. "
                                 f"{plant.line.stops[-1]:g} m")
        return self
