"""Robust costs instead of the squared residual: Huber's M-estimator and the maximum correntropy criterion.

Both are the Kalman filter with a noise variance that grows with the normalised residual."""

from __future__ import annotations

import numpy as np
from pydantic import Field, PositiveFloat

from ...scenarios.arrays import Array
from ...scenarios.measurement import Measurement
from ...scenarios.model import DesignModel
from ...scenarios.randomness import RunRandom
from ..interface import Parameters
from ..sigma_point import UnscentedKalman
from .base import Elementwise, ElementwiseKalman, Reading, Weighed
from .kernels import correntropy

LEAST_WEIGHT = 1e-12


class HuberKalman(ElementwiseKalman):
    """R / w with w = 1 for |nu| <= k, k / |nu| beyond it; nu = residual / sqrt(h P h' + R), one reweighting."""

    class Parameters(Parameters):
        threshold: PositiveFloat = Field(1.345, description="k, in standard deviations of the residual (Huber 1964: 95 "
                                                            "% efficiency at the Gaussian)")

    summary = "EKF with Huber's cost: readings far off get a larger noise variance"
    source = "Karlgaard and Schaub, J. Guidance 30(3), 2007; Huber, Ann. Math. Stat. 35, 1964"

    def weigh(self, reading: Reading) -> Weighed:
        weight = self.parameters.threshold / np.maximum(np.sqrt(reading.ratio), self.parameters.threshold)
        return Weighed(reading.noise / weight, np.ones_like(weight), weight < 0.5)


class CorrentropyKalman(ElementwiseKalman):
    """R / w with w = exp(-nu^2 / (2 bandwidth^2)), nu = residual / sqrt(h P h' + R): readings far off count nothing."""

    class Parameters(Parameters):
        bandwidth: PositiveFloat = Field(3.0, description="of the kernel, in standard deviations of the residual")

    summary = "EKF by the maximum correntropy criterion (MCC)"
    source = "Chen, Liu, Zhao and Principe, Automatica 76, 2017 (one step of the fixed-point iteration)"

    def weigh(self, reading: Reading) -> Weighed:
        return _by_correntropy(reading, self.parameters.bandwidth)


class CorrentropyUnscented(Elementwise, UnscentedKalman):
    """The same over sigma points: R / w with the w of `mcc`, nu from the unscented transform. Where h is not linear, an
    element's transform is taken anew after the elements before it; what h bends adds to R, and is divided with it."""

    class Parameters(UnscentedKalman.Parameters):
        bandwidth: PositiveFloat = Field(3.0, description="of the kernel, in standard deviations of the residual")

    family = "Outlier-robust"
    summary = "UKF by the maximum correntropy criterion (MCC)"
    source = "Liu, Chen, Xu, Wu and Honeine, Int. J. Syst. Sci. 48(8), 2017 (readings alone, one step of the iteration)"

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        super().start(model, runs, random)
        self.bent = not self._linear

    def linear(self, measurement: Measurement) -> tuple[Array, Array, Array]:
        return self._linearised(measurement)

    def weigh(self, reading: Reading) -> Weighed:
        return _by_correntropy(reading, self.parameters.bandwidth)


def _by_correntropy(reading: Reading, bandwidth: float) -> Weighed:
    weight = np.empty_like(reading.residual)
    correntropy(reading.ratio, bandwidth, weight)
    return Weighed(reading.noise / np.maximum(weight, LEAST_WEIGHT), np.ones_like(weight), weight < 0.5)
