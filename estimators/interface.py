"""The estimator interface: a design step, then start / predict / update / estimate over a batch of runs.

Everything numerical carries the runs as its last axis. One instance serves one batch of runs, one step at a time."""

from __future__ import annotations

import inspect
import json
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from ..scenarios.arrays import Array, Mask
from ..scenarios.errors import Unsupported
from ..scenarios.measurement import Course, Interval, Measurement
from ..scenarios.model import DesignModel
from ..scenarios.randomness import RunRandom
from .memento import Memento


class Status(IntEnum):
    """How a run of an estimator ended. Everything but `ok` is shown with a line that replays it."""

    ok = 0
    diverged = 1
    failed = 2
    infeasible = 3
    crashed = 4
    timeout = 5


@dataclass(frozen=True, slots=True)
class Estimate:
    """What an estimator claims at this moment; parts it does not claim are None. S runs, nx states.

    mean (nx, S). parameter (np, S): estimates of the unknown parameters that stand behind the state in the truth
    vector. covariance (nx, nx, S), or (nx, nx, 1) where all runs share it, or the leading block of the states that
    are claimed (an exactly known one has none). ellipsoid Pi (nx, nx, S or 1): the claim
    e' Pi^-1 e <= 1. bound (S or 1,): the claim E |M e|^2 <= bound, with M the design model's `performance`.
    diversity (S,): distinct parameter values among the particles, for figures."""

    mean: Array
    parameter: Array | None = None
    covariance: Array | None = None
    ellipsoid: Array | None = None
    bound: Array | None = None
    diversity: Array | None = None


def cut(estimate: Estimate, own: int) -> Estimate:
    """The setting's own states of an estimate on an augmented model: what is scored, and what steers a closed loop."""
    P, Pi = estimate.covariance, estimate.ellipsoid
    return replace(estimate, mean=estimate.mean[:own], covariance=None if P is None else P[:own, :own],
                   ellipsoid=None if Pi is None else Pi[:own, :own])


class Innovation(NamedTuple):
    """Of one update, in turn: element j after the elements received before it.

    residual (ny, S), variance (ny, S or 1): uncorrelated, whatever R looks like, so NIS = sum residual^2 / variance and
    log-likelihood = sum log N(residual; 0, variance) over the received elements; nobody forms or inverts S. Elements
    that were not received are not read. log_likelihood (S,): log p(received | before) where it does not follow from
    these (mixtures, particles, adapters); 0 where a run received nothing, NaN where it is not known."""

    residual: Array | None = None
    variance: Array | None = None
    log_likelihood: Array | None = None


class Walk(NamedTuple):
    """Estimates after (or before) each of B measurements: mean (B, nx, S), covariance (B, n, n, S), a bound that holds
    for all (S or 1,), and of the innovations what `Innovation` has, (B, ..) each. The arrays may be reused."""

    mean: Array
    covariance: Array | None = None
    innovation: Innovation = Innovation()
    bound: Array | None = None

    def at(self, b: int) -> Estimate:
        """The estimate of one of them."""
        return Estimate(self.mean[b], covariance=None if self.covariance is None else self.covariance[b],
                        bound=self.bound)


class Room:
    """Arrays for the walks of an estimator, made once: `of` gives B rows of the shapes asked for."""

    def __init__(self) -> None:
        self.kept: dict[str, Array] = {}

    def of(self, steps: int, **shapes: tuple[int, ...]) -> list[Array]:
        """Arrays (B, *shape), by name, with what was in them."""
        for name, shape in shapes.items():
            if name not in self.kept or len(self.kept[name]) < steps:
                self.kept[name] = np.zeros((steps, *shape))
        return [self.kept[name][:steps] for name in shapes]

    def gaussian(self, steps: int, nx: int, ny: int, runs: int) -> Walk:
        """A Kalman filter's walk, to be filled: mean, covariance, residual, variance."""
        mean, covariance, *said = self.of(steps, mean=(nx, runs), covariance=(nx, nx, runs), residual=(ny, runs),
                                          variance=(ny, runs))
        return Walk(mean, covariance, Innovation(*said))


def misshapen(estimate: Estimate, nx: int, runs: int, parameters: int) -> str | None:
    """What is wrong with the arrays of an estimate of nx states, for that many runs and unknown parameters."""
    square = [(n, n, s) for n in range(1, nx + 1) for s in (runs, 1)]
    allowed: dict[str, list[tuple[int, ...]]] = {
        "mean": [(nx, runs)], "parameter": [(n, runs) for n in range(1, parameters + 1)], "covariance": square,
        "ellipsoid": square, "bound": [(runs,), (1,)], "diversity": [(runs,)]}
    for name, shapes in allowed.items():
        value = getattr(estimate, name)
        if value is None and name != "mean":
            continue
        if not isinstance(value, np.ndarray):
            return f"{name} is {type(value).__name__}, not an array"
        if value.shape not in shapes or (value.dtype != np.float64 and name != "diversity"):
            return (f"{name} has shape {value.shape}, type {value.dtype}; allowed for {nx} states and {runs} runs: "
                    f"float64 of shape {' or '.join(map(str, reversed(shapes))) or 'none'}")
    return None


class Parameters(BaseModel):
    """Base of an estimator's parameters. Give each field a description with its unit and source."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def used_with(parameters: Parameters, name: str, other: str, value: Any) -> None:
    """Raise ValueError where a parameter is given that has no meaning but with a value of another one."""
    if name in parameters.model_fields_set and getattr(parameters, other) != value:
        raise ValueError(f"{name} is used with {other} = {json.dumps(value)} only: leave it out")


class Estimator(ABC):
    """A plug-in. Subclasses set the class attributes and the four recursive methods; `design` is optional.

    summary: one line for `railstate list`. family: the report's column that its entries stand in. needs: names of
    `DesignModel` parts that must not be None (checked before `design`). claims: fields of `Estimate` it fills beyond
    the mean. source: paper, equation or book.

    predicts: False for what is no prediction at all (a measurement at hand): scored after the update of its step even
    where the scenario scores predictions. honours: what of a telling model it uses, or has no use for: "covariance",
    the noise covariance that sensors tell; a model that tells more is refused before the run. handles_late: it takes
    measurements of old stamps itself. lag: 0 for filters; n: `past` speaks of n steps ago; None: `finish` hands out all
    steps at the end.

    status (S,) of `Status` values and `reasons` by run: an estimator that notices that a run has gone wrong (covariance
    no longer positive definite, all weights zero) calls `flag`, keeps its numbers finite or NaN for that run only, and
    raises nothing. A design problem without solution raises `Infeasible` in `design`."""

    Parameters: ClassVar[type[Parameters]] = Parameters
    summary: ClassVar[str] = ""
    family: ClassVar[str] = "Other"
    source: ClassVar[str] = ""
    needs: ClassVar[tuple[str, ...]] = ()
    claims: ClassVar[tuple[str, ...]] = ()
    oracle: ClassVar[bool] = False
    predicts: ClassVar[bool] = True
    honours: ClassVar[tuple[str, ...]] = ()
    handles_late: ClassVar[bool] = False
    lag: int | None = 0

    status: NDArray[np.int8]
    reasons: dict[int, str]
    late: str = "drop"
    """What its entry wants done with late packets: "drop", "as-new" or "rewind"."""
    told_faults: bool = False
    """Whether its entry has it told which readings are faulty: it gets none of them."""
    rejected: Mask | None = None
    """After an update, of filters that judge readings: which of the received ones were discounted (ny, S)."""

    def __init__(self, parameters: Mapping[str, Any] | None = None) -> None:
        """parameters: as in the scenario file. Raises pydantic's ValidationError naming the field."""
        self.parameters: Any = self.Parameters.model_validate(dict(parameters or {}))

    @classmethod
    def require(cls, model: DesignModel) -> None:
        """Raise `Unsupported` where the model lacks a part this estimator needs."""
        missing = [part for part in cls.needs if getattr(model, part) is None]
        if missing:
            raise Unsupported(f"{cls.__name__} needs {', '.join(missing)} of the design model, which this scenario "
                              "does not give")
        if model.tells and "covariance" not in cls.honours:
            raise Unsupported(f"{cls.__name__} cannot use the noise covariance that sensors tell with each measurement "
                              f"(here {', '.join(model.tells)})")

    def design(self, model: DesignModel) -> dict[str, Any]:
        """Offline work before the first step (gains, LMIs), timed apart. Returns what `railstate design` prints.

        A key `design_s` overrides the measured seconds (a cached design tells the time of the fresh one), `cached`
        tells the two apart. Raises `Infeasible`."""
        return {}

    @abstractmethod
    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        """Begin a batch of `runs` runs from model.initial_mean, model.initial_covariance.

        random: this estimator's own stream of each run, the only source of random numbers it may use. Call
        `super().start(model, runs, random)` first."""
        self.model = model
        self.runs = runs
        self.status = np.zeros(runs, dtype=np.int8)
        self.reasons = {}

    def reveal(self, truth: Array) -> None:
        """Oracles only: the truth vector (nt, S) at the end of the step about to be predicted."""

    @abstractmethod
    def predict(self, u: Array, interval: Interval) -> None:
        """Go to the end of the interval with input u (nu, S), the whole step's.

        A run whose interval has no length stays exactly as it is, random stream included: other runs' events change no
        bit. Matrices of time-varying models go by `interval.depart`; estimators count nothing."""

    @abstractmethod
    def update(self, measurement: Measurement) -> Innovation | None:
        """Use the elements that were received; the others are not to be read. One call for each stamp and event.

        Returns the innovation where there is one; it is read at once, so its arrays may be reused."""

    def walk(self, course: Course, early: bool) -> Walk | None:
        """The same as `predict` and `update` step by step, to the bit, by those that go a course in compiled code.
        early: the estimates asked for are those before the measurements. None, and nothing happens, by others."""
        return None

    @abstractmethod
    def estimate(self) -> Estimate:
        """The present estimate. The arrays may be reused by later steps: callers copy what they keep."""

    def snapshot(self) -> Any:
        """All that changes from step to step, copied (random streams by their state). As it stands: everything that
        hangs on the estimator but the design model and the parameters."""
        return Memento(self)

    def restore(self, snapshot: Any) -> None:
        """Back to a snapshot, which may be asked for again."""
        snapshot.restore()

    @classmethod
    def memory(cls, states: int, steps: int) -> int:
        """Bytes that it keeps of each run over so many steps; 0 where that does not grow with them."""
        return 0

    def past(self) -> Estimate | None:
        """Fixed-lag smoothers: the state `lag` steps ago, asked for once a step; None before there is one. Its arrays
        are not reused."""
        return None

    def finish(self) -> Iterator[tuple[int, Estimate]]:
        """Smoothers: (step, estimate) from the last step down to the first, one at a time, in arrays that are not
        reused. A run that has ended heard nothing any more, so its backward pass starts with corrections of exactly
        zero."""
        return iter(())

    def counters(self) -> dict[str, Array]:
        """Work done so far where it says more than seconds: {"kalman-updates": (S,)}. Reported per step."""
        return {}

    def extremes(self) -> dict[str, Array]:
        """Largest values so far of quantities that a theory bounds: {"contraction": (S,)}. Reported as they end."""
        return {}


def flag(estimator: Estimator, failed: Mask, status: Status, reason: str) -> None:
    """Mark the runs of `failed` (S,) that were fine so far, and why."""
    new = failed & (estimator.status == Status.ok)
    estimator.status[new] = status
    estimator.reasons.update(dict.fromkeys(np.flatnonzero(new).tolist(), reason))


def first_edition(cls: type[Any]) -> str | None:
    """What to write instead where a class has methods of the first edition of this interface; None where it has not."""
    found, wanted = [], []
    for name, old, new in (("predict", "portion", "predict(self, u, interval), with interval.length in seconds, "
                            "interval.share of the step's input and interval.depart for a step of one's own counting"),
                           ("predict_run", "portion", "predict_run(self, filter, model, u, interval)"),
                           ("update", "received", "update(self, measurement), with measurement.y, measurement.received "
                            "and measurement.step")):
        method = inspect.getattr_static(cls, name, None)
        if inspect.isfunction(method) and old in inspect.signature(method).parameters:
            found.append(f"{name}({', '.join(inspect.signature(method).parameters)})")
            wanted.append(new)
    if not found:
        return None
    return (f"{cls.__name__}: {' and '.join(found)} {'is' if len(found) == 1 else 'are'} of railstate's first edition: "
            f"write {'; '.join(wanted)}; functions of the model take (x, u, interval) and (x, step)")
