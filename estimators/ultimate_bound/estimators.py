"""Constant-gain estimators with a certified mean-square bound, after Zou et al. 2018 (IEEE T-ITS).

They differ in where the gain comes from: Corollary 1, the fastest decay under a bound, or a file."""

from __future__ import annotations

import hashlib
from abc import abstractmethod
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, cast

import numpy as np
from pydantic import BeforeValidator, Field, ValidationInfo, model_validator

from ...scenarios.arrays import Array
from ...scenarios.errors import Infeasible, InputError, Unsupported
from ...scenarios.measurement import Course, Interval, Measurement
from ...scenarios.model import DesignModel, whole_steps
from ...scenarios.randomness import RunRandom
from ..design_cache import remember
from ..interface import Estimate, Estimator, Parameters, Room, Walk, used_with
from ..kernels.core import apply
from ..kernels.walks import walk_gain
from . import decay as lmi_decay
from . import lmi, solving
from .gains import read_gain
from .lmi import Certificate, ErrorSystem, Multipliers
from .system import NEEDS, THETA, error_system


class GainParameters(Parameters):
    """What the constant-gain estimators share."""

    multipliers: Multipliers = Field("scalar", description="scalar: lambda_1 I and lambda_2 I as in the paper; free: "
                                     "any matrix Lambda_1 >= 0, diagonal Lambda_2 (as valid, much tighter)")


class DecayParameters(GainParameters):
    """The decay that is asked of a certificate."""

    theta: float | None = Field(None, gt=0, lt=1, description="decay of the certificate, per step; None: what the "
                                "scenario's knowledge says, else 0.98, the paper's choice")


class ConstantGain(Estimator):
    """x^(k+1) = A x^ + B u + h + K Pi(k) (y - C x^), eq. (10), with Pi(k) what was received.

    In filtered form, so that a prediction is the plain model: an update adds A^-1 K Pi (y - C x^). The certified bound
    holds from the first step where the estimator starts at the truth, else after the transient theta^k V(0)."""

    Parameters = DecayParameters
    family = "LMI gain"
    source = "Zou, Wen, Wang, Chen, Roberts, IEEE T-ITS 2018, doi 10.1109/TITS.2018.2835655"
    needs: ClassVar[tuple[str, ...]] = ("linear",)
    claims = ("bound",)

    K: Array
    bound: float | None = None

    @classmethod
    def require(cls, model: DesignModel) -> None:
        super().require(model)
        assert model.linear is not None
        if not model.linear.constant:
            raise Unsupported(f"{cls.__name__} needs a plant that does not change with time")
        if np.linalg.cond(model.linear.A(0)) > 1 / np.finfo(float).eps:
            raise Unsupported(f"{cls.__name__} needs a plant whose A has an inverse: its gain is used in filtered form")

    @abstractmethod
    def _solve(self, system: ErrorSystem, target: float) -> Certificate:
        """The certificate, and with it the gain. Raises Infeasible."""

    def _target(self, model: DesignModel) -> float:
        """What is asked of the design, theta: the estimator's parameter, else the scenario's knowledge, else 0.98."""
        told = self.parameters.theta
        return told if told is not None else float(cast(float, model.details.get("theta", THETA)))

    def _given(self) -> Any:
        """What the certificate depends on apart from system, target and parameters, as JSON values."""
        return None

    def design(self, model: DesignModel) -> dict[str, Any]:
        system, target = error_system(model), self._target(model)
        inputs = {"estimator": type(self).__name__, "parameters": self.parameters.model_dump(mode="json"),
                  "target": target, "given": self._given(), "system": _plain(asdict(system)), "code": _code()}
        found = remember(inputs, lambda: _plain(asdict(self._solve(system, target))))
        certificate = found.value
        self.K, self.bound = np.array(certificate["K"]), certificate["bound"]
        return {"bound": self.bound, "theta": certificate["theta"], "gain": self.K, "solver": certificate["solver"],
                "status": certificate["status"], "residual": certificate["residual"],
                "design_s": certificate["seconds"], "cached": found.cached}

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        super().start(model, runs, random)
        linear = model.linear
        assert linear is not None
        parts = (linear.A(0), linear.B(0), linear.C(0), np.linalg.solve(linear.A(0), self.K))
        self._A, self._B, self._C, self._correction = (np.ascontiguousarray(part[:, :, None]) for part in parts)
        self._h = linear.h(0)[:, None]
        self._mean = model.initial_mean.copy()
        self._moved, self._driven = np.empty_like(self._mean), np.empty_like(self._mean)
        self._expected, self._room = np.empty((self._C.shape[0], runs)), Room()
        self._bound = None if self.bound is None else np.array([self.bound])

    def predict(self, u: Array, interval: Interval) -> None:
        whole_steps(interval, type(self).__name__)
        apply(self._A, self._mean, self._moved)
        apply(self._B, u, self._driven)
        np.add(self._moved, self._driven, out=self._mean)
        self._mean += self._h

    def update(self, measurement: Measurement) -> None:
        apply(self._C, self._mean, self._expected)
        innovation = np.subtract(measurement.y, self._expected, out=np.zeros_like(self._expected),
                                 where=measurement.received)
        apply(self._correction, innovation, self._moved)
        self._mean += self._moved

    def walk(self, course: Course, early: bool) -> Walk | None:
        own = (ConstantGain.predict, ConstantGain.update, ConstantGain.estimate)
        if (type(self).predict, type(self).update, type(self).estimate) != own:
            return None
        means, = self._room.of(len(course.y), mean=self._mean.shape)
        walk_gain(self._A, self._B, self._h, self._C, self._correction, course.u, course.y, course.received, early,
                  self._mean, means)
        return Walk(means, bound=self._bound)

    def estimate(self) -> Estimate:
        return Estimate(self._mean, bound=self._bound)


class UltimateBound(ConstantGain):
    """Corollary 1: the gain of least certified bound on E |M e|^2 at decay theta."""

    summary = "constant gain of least certified mean-square bound, by LMI (Corollary 1)"
    needs = NEEDS

    def _solve(self, system: ErrorSystem, target: float) -> Certificate:
        return lmi.ultimate_bound(system, target, multipliers=self.parameters.multipliers)


class FastestDecayParameters(GainParameters):
    """The bound that may be spent on a faster decay."""

    varpi: float | None = Field(None, gt=0, description="bound on E |M e|^2 that must be kept; None: what the "
                                "scenario's knowledge says")
    tolerance: float = Field(5e-4, gt=0, lt=0.1, description="width of the bisection's last interval of theta")
    form: Literal["bisection", "printed"] = Field("bisection", description="printed: eqs. (32) to (35) as they are, "
                                                  "which have no solution with the paper's data")

    @model_validator(mode="after")
    def _used(self) -> FastestDecayParameters:
        used_with(self, "tolerance", "form", "bisection")
        used_with(self, "multipliers", "form", "bisection")
        return self


class FastestDecay(ConstantGain):
    """The gain of fastest certified decay whose bound on E |M e|^2 stays under varpi: Corollary 2's problem, solved by
    bisection over theta on Corollary 1's constraints (no relaxation), or as printed."""

    Parameters = FastestDecayParameters
    summary = "constant gain of fastest certified decay under a given bound, by LMI (Corollary 2's problem)"
    needs = NEEDS

    def _target(self, model: DesignModel) -> float:
        """The bound varpi: the estimator's parameter, else the scenario's knowledge."""
        varpi = self.parameters.varpi or model.details.get("varpi")
        if varpi is None:
            raise Unsupported("fastest-decay needs varpi, the bound to keep, as a parameter or of the scenario")
        return float(cast(float, varpi))

    def _solve(self, system: ErrorSystem, target: float) -> Certificate:
        if self.parameters.form == "printed":
            return lmi_decay.printed_decay(system, target)
        return lmi_decay.fastest_decay(system, target, multipliers=self.parameters.multipliers,
                                       tolerance=self.parameters.tolerance)


def _from_file(given: Any, info: ValidationInfo) -> Any:
    """The rows of a gain's file: what it holds, and not its name, is the parameter."""
    folder = (info.context or {}).get("folder", Path())
    try:
        return read_gain(given, folder).tolist() if isinstance(given, str) else given
    except InputError as error:
        raise ValueError(str(error)) from None


class FixedGainParameters(DecayParameters):
    """Where the gain is."""

    scale: float = Field(1.0, gt=0, description="the gain is multiplied by it, and certified so")
    gain: Annotated[list[list[float]], BeforeValidator(_from_file)] = Field(
        description="K (nx x ny, predictor form): rows of numbers, or a CSV file of them, one row a line, by its path "
                    "or the name of a file beside the built-in scenarios")


class FixedGain(ConstantGain):
    """Any given gain, certified by Theorem 1 where it can be; without a certificate it runs and claims no bound."""

    Parameters = FixedGainParameters
    summary = "constant gain from a file, its bound certified by Theorem 1 where there is a certificate"

    def design(self, model: DesignModel) -> dict[str, Any]:
        self.K = self.parameters.scale * np.array(self.parameters.gain)
        if self.K.shape != (model.nx, model.ny):
            raise Unsupported(f"the gain is {' x '.join(map(str, self.K.shape))}, this scenario needs {model.nx} x "
                              f"{model.ny} (states x measurements)")
        try:
            return super().design(model)
        except Infeasible as reason:
            self.bound = None
            return {"bound": None, "theta": self._target(model), "gain": self.K, "status": str(reason)}

    def _given(self) -> Any:
        return self.K.tolist()

    def _solve(self, system: ErrorSystem, target: float) -> Certificate:
        return lmi.certify(system, self.K, target, multipliers=self.parameters.multipliers)


def _plain(value: Any) -> Any:
    """Arrays as lists, for JSON."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def _code() -> dict[str, str]:
    """What solves the problems: another version of it is another design."""
    source = b"".join(Path(str(module.__file__)).read_bytes() for module in (lmi, lmi_decay, solving))
    return {"source": hashlib.sha256(source).hexdigest(), "cvxpy": version("cvxpy"), "clarabel": version("clarabel")}
