"""A setting: the code behind scenario files of one plant kind. It simulates the truth and fills the design model.

Settings are plug-ins of the entry-point group `railstate.scenarios`; their scenario files lie beside their module."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Generic, TypeVar

from .arrays import Array
from .augmented import Extra, augmented
from .errors import InputError
from .model import DesignModel, Reception
from .randomness import Streams
from .schema import Augment, ScenarioConfig
from .world import Sensing, World

ConfigT = TypeVar("ConfigT", bound=ScenarioConfig)


@dataclass(frozen=True)
class Quantity:
    """Something whose error is scored: `components` are (index into the truth vector, weight) pairs.

    Squared error of a step = sum over components of (weight x error)^2, averaged over the components when `mean`
    (RMSE over several cars), summed otherwise (a weighted norm). Unit is SI; `shown` = (unit, factor) is how tables
    print it. referenced: False where the truth is what the estimators are told themselves (a reading that is its own
    reference): no error over a whole run is scored, and no NEES; named windows, in which it may be withheld, are."""

    name: str
    unit: str
    components: tuple[tuple[int, float], ...]
    mean: bool = True
    shown: tuple[str, float] | None = None
    referenced: bool = True


@dataclass(frozen=True)
class Matched:
    """What bounds every estimator's error: a design model with the truth's own noise, for a Riccati recursion with its
    Jacobians at the truth.

    kind: `floor` where all noise is Gaussian, so that no estimator does better; `linear optimum` where some is not and
    the model has its moments: no linear estimator does better, another may. The model's functions are asked at the
    truth vector (its first states; what it has besides is 0). outward(truth) (nt, nx, S or 1): the truth vector's
    error by the model's states; None: they are its first. beyond (nx,): variance of the model's states
    that is fresh at each step, and so in no recursion."""

    model: DesignModel
    kind: str = "floor"
    outward: Callable[[Array], Array] | None = None
    beyond: Array | None = None


Outcome = tuple[str, str, str]
"""(metric, quantity, unit) of a per-run number that a setting computes itself."""


class Setting(ABC, Generic[ConfigT]):
    """One plant kind, configured by one variant of a scenario file.

    kind: the value of `plant.kind` that selects it. Config: its schema. files: its scenario files, beside its module.
    user_files: keys of [plant] that may hold the path of a file of the user's (from the scenario file's own folder on),
    whose content then belongs to the scenario's. needs_file: the dotted key of such a file without which nothing can
    run. following: whether readings follow from each other beforehand (False: a closed loop makes them as it goes).
    shown: (unit, factor) in which tables print outcomes that are no scored quantity, by name. references: whether its
    worlds tell of places known on the way (`Step.reference`)."""

    kind: ClassVar[str]
    Config: ClassVar[type[ScenarioConfig]]
    files: ClassVar[tuple[str, ...]] = ()
    user_files: ClassVar[tuple[str, ...]] = ()
    needs_file: ClassVar[str] = ""
    following: ClassVar[bool] = True
    shown: ClassVar[dict[str, tuple[str, float]]] = {}
    references: ClassVar[bool] = False

    def __init__(self, config: ConfigT) -> None:
        self.config = config

    @property
    def notes(self) -> list[str]:
        """What a reader of the tables must know: the scenario's notes, and what a setting finds in its files."""
        return self.config.notes

    @property
    def sampling_period(self) -> float:
        """The usual time between measurements, s."""
        return self.config.time.period

    @abstractmethod
    def quantities(self) -> tuple[Quantity, ...]:
        """The scored quantities, in the order of the tables."""

    @abstractmethod
    def world(self, streams: Streams) -> World:
        """Simulate (or prepare, closed loop) the truth of the runs of `streams`: streams "truth", "measurement",
        "channel". Must not depend on the estimators nor on how runs are batched."""

    @abstractmethod
    def design_model(self, knowledge: Mapping[str, Any], initial_mean: Array) -> DesignModel:
        """What an estimator is told. `knowledge` overrides the scenario's [knowledge] for this estimator (already
        validated by `resolve_knowledge`); initial_mean (nx, S) as the world hands it out."""

    def matched(self, runs: int) -> Matched | None:
        """The model from which the least possible error of so many runs follows; None where none is known: where the
        truth's noise has no moments that a model of a few states has, or readings do not arrive as they were sent."""
        return None

    @property
    def uncertified(self) -> dict[str, str]:
        """Why claims do not hold over the channel as it is, those there are of: `guarantee`, `covariance`, and `as-new`
        for covariances of filters that take late packets for fresh ones."""
        channel: Any = self.config.channel
        known = channel.reception() if hasattr(channel, "reception") else Reception()
        late = "late packets are taken for fresh ones" if getattr(channel, "longest", 0) else ""
        found = {"guarantee": known.breaks, "covariance": known.spoils, "as-new": known.spoils or late}
        return {what: why for what, why in found.items() if why}

    def sensing(self) -> Sensing | None:
        """The sensors, for faults and for channels that look at the readings; None where the setting takes no
        faults."""
        return None

    def extras(self, knowledge: Mapping[str, Any]) -> dict[str, tuple[Extra, ...]]:
        """The extra states that make sense here, with their units and usual numbers, by the name under which an
        estimator's entry asks for them (`augment`); several where there is one for each car or sensor."""
        return {}

    def told(self, knowledge: Mapping[str, Any], augment: Mapping[str, Augment], initial_mean: Array) -> DesignModel:
        """The design model with the extra states that an estimator's entry asks for. Raises InputError."""
        model = self.design_model(knowledge, initial_mean)
        return augmented(model, self.chosen(knowledge, augment)) if augment else model

    def chosen(self, knowledge: Mapping[str, Any], augment: Mapping[str, Augment]) -> list[Extra]:
        """The extra states asked for, their numbers in place of the usual ones. Raises InputError."""
        offered = self.extras(knowledge) if augment else {}
        out: list[Extra] = []
        for name, asked in augment.items():
            if name not in offered:
                raise InputError(f"augment.{name}: there is no such extra state here; allowed: "
                                 f"{', '.join(offered) or 'none'}")
            changes = asked.model_dump(exclude_none=True)
            if changes.get("kind") == "walk" and "start_sd" not in changes and offered[name][0].start_sd is None:
                raise InputError(f"augment.{name}: kind = \"walk\" needs a start_sd in {offered[name][0].unit}")
            try:
                out += [replace(extra, **changes) for extra in offered[name]]
            except InputError as error:
                raise InputError(f"augment.{error}") from None
        return out

    def table(self) -> tuple[tuple[str, str], ...]:
        """(metric, quantity) pairs that the printed tables show; `summary.csv` has all."""
        return (*(("rmse", item.name) for item in self.quantities()), ("nees", "state"), ("coverage", "ellipsoid"))

    def resolve_knowledge(self, knowledge: Mapping[str, Any]) -> Any:
        """The scenario's [knowledge] with an estimator's overrides, validated. Raises pydantic's ValidationError."""
        base = self.config.knowledge
        told = base.model_dump(exclude_unset=True)
        for key, value in knowledge.items():  # a table within it changes what it names
            within = isinstance(value, Mapping) and isinstance(told.get(key), dict) and "kind" not in value
            told[key] = {**told[key], **value} if within else value
        return type(base).model_validate(told)

    def split(self, training: bool) -> dict[str, Any]:
        """Overrides of the scenario with which an estimator is tuned (training), or shown; none where runs of another
        seed are other ones anyway."""
        return {}

    def outcomes(self, world: World, metrics: Mapping[tuple[str, str], Array]) -> dict[Outcome, Array]:
        """Numbers per run beyond errors (gap, lap, headway): {(metric, quantity, unit): (S,)}.

        world: as it stands after the last step (closed loop: the estimator's own). metrics: {(metric, quantity): (S,)}
        of the estimator, e.g. ("max", "position")."""
        return {}

    def batch_bytes(self) -> int:
        """Bytes one run's trajectory takes in memory, from which the runner chooses its batch size."""
        return self.config.time.steps * 8 * 40
