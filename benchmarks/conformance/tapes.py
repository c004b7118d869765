"""What the conformance test feeds an estimator: recorded tapes of a small built-in model and of a scenario.

A tape is a world of recorded events, which can be cut, changed and fed again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from pydantic import ValidationError

from ...estimators.interface import Estimator
from ...scenarios.arrays import Array, Mask
from ...scenarios.errors import Infeasible, InputError
from ...scenarios.measurement import Interval, PerRun
from ...scenarios.model import Bounds, DesignModel, Grid, Linear, Reception, grid_modes, linear_model
from ...scenarios.randomness import Streams
from ...scenarios.registry import scenario_files
from ...scenarios.schema import EstimatorEntry
from ...scenarios.setting import Setting
from ...scenarios.world import Event, Step
from ..planning.naming import find

RUNS = (0, 1, 2, 3, 4)
STEPS = 16
LOST_SHARE = 0.2
"""Share of events and of elements that are taken away on top of what the scenario's channel loses."""


@dataclass(frozen=True)
class Tape:
    """Recorded events, a `World` of them. E events, S runs: u (E, nu, S), y (E, ny, S), received (E, ny, S), truth
    (E, nt, S) at the end of each event's step, shares (E,) numbers or (S,) arrays, begins (E,): the event opens a step;
    numbers, starts, spans (E,): step, its start and length in s. covariances (E,): told ones, or None."""

    runs: tuple[int, ...]
    initial_mean: Array
    u: Array
    shares: tuple[PerRun, ...]
    y: Array
    received: Mask
    truth: Array
    begins: tuple[bool, ...]
    numbers: tuple[int, ...]
    starts: tuple[PerRun, ...]
    spans: tuple[PerRun, ...]
    covariances: tuple[Array | None, ...]
    closed_loop: bool = False

    @property
    def firsts(self) -> list[int]:
        """The event that opens each step."""
        return [e for e, begins in enumerate(self.begins) if begins]

    @property
    def steps(self) -> int:
        return sum(self.begins)

    @property
    def lengths(self) -> Array:
        """Nothing is scored: steps of one length each."""
        return np.ones(self.steps)

    def step(self, k: int, mean: Array) -> Step:
        """The events of the k-th step."""
        first, end = [*self.firsts, len(self.begins)][k:k + 2]
        events = tuple(Event(self.shares[e], self.y[e], self.received[e], self.covariances[e])
                       for e in range(first, end))
        return Step(self.u[first], events, self.truth[first], np.ones(len(self.runs), dtype=bool),
                    number=self.numbers[first], start=self.starts[first], length=self.spans[first])

    def only(self, positions: list[int]) -> Tape:
        """The tape of some of its runs, in the order given."""
        def take(values: Any) -> Any:
            return np.array(values[..., positions], order="C")

        def each(values: tuple[Any, ...]) -> tuple[Any, ...]:
            return tuple(take(v) if isinstance(v, np.ndarray) and v.shape[-1] > 1 else v for v in values)

        return Tape(tuple(self.runs[p] for p in positions), take(self.initial_mean), take(self.u), each(self.shares),
                    take(self.y), take(self.received), take(self.truth), self.begins, self.numbers, each(self.starts),
                    each(self.spans), each(self.covariances))

    def copy(self) -> Tape:
        """A tape that shares no memory with this one."""
        return self.only(list(range(len(self.runs))))


@dataclass(frozen=True)
class Case:
    """A tape with the design model that goes with it. model(initial_mean) builds a fresh one; exact_parts: the model is
    exact for any part of a step."""

    name: str
    tape: Tape
    model: Callable[[Array], DesignModel]
    streams: Streams
    parameters: Mapping[str, Any] = field(default_factory=dict)
    exact_parts: bool = False


# -- the small model -------------------------------------------------------------------------------------------------
PERIOD, SPREAD, POSITION_SD, SPEED_SD = 1.0, 0.3, 1.0, 0.5
GRID = np.array([0.8, 0.9, 1.0, 1.1])


def _rows(*rows: Any) -> Array:
    return np.stack([np.stack([np.asarray(value) for value in row]) for row in rows])


def small_model(initial_mean: Array) -> DesignModel:
    """A car on a line, [position, speed], both measured, driven by a commanded acceleration of unknown effect.

    It gives everything an estimator may need: matrices, bounds, modes over the effect, reception by nodes."""
    t = PERIOD
    a, b = np.array([[1.0, t], [0.0, 1.0]]), np.array([[t * t / 2], [t]])
    q = SPREAD**2 / 3 * np.array([[t**4 / 4, t**3 / 2], [t**3 / 2, t**2]]) + 1e-6 * np.eye(2)
    r, c = np.diag([POSITION_SD**2, SPEED_SD**2]), np.eye(2)
    linear = Linear(lambda k: a, lambda k: b, lambda k: np.zeros(2), lambda k: c, lambda k: q, lambda k: r)

    def part(interval: Interval) -> Array:
        s = np.atleast_1d(np.asarray(interval.length, dtype=float))
        return _rows((s * s / 2,), (s,))

    def transition(x: Array, u: Array, interval: Interval) -> Array:
        s = np.asarray(interval.length, dtype=float)
        return np.stack([x[0] + s * x[1] + s * s / 2 * u[0], x[1] + s * u[0]])

    def jacobian(x: Array, u: Array, interval: Interval) -> Array:
        s = np.atleast_1d(np.asarray(interval.length, dtype=float))
        return _rows((np.ones_like(s), s), (np.zeros_like(s), np.ones_like(s)))

    def process(x: Array, u: Array, interval: Interval) -> Array:
        return np.atleast_1d(np.asarray(interval.share, dtype=float)) * q[:, :, None]

    model = linear_model(
        linear, states=("position", "speed"), measurements=("position", "speed"), period=t, initial_mean=initial_mean,
        initial_covariance=np.diag([4.0, 1.0])[:, :, None], performance=np.eye(2),
        bounds=Bounds(b.copy(), np.array([SPREAD]), 3 * np.array([POSITION_SD, SPEED_SD]), part=part),
        reception=Reception(nodes=((0,), (1,)), p=(0.5, 0.5)))
    grid = Grid("effect", GRID, np.repeat(a[None], 4, axis=0), GRID[:, None, None] * b, c, q, r, np.full(4, 0.25))
    return replace(model, transition=transition, transition_jacobian=jacobian, process_covariance=process,
                   modes=grid_modes(grid, model))


def small_case(parameters: Mapping[str, Any]) -> Case:
    """The small model's tape: at every step one of its two sensors is heard, or both, or none."""
    streams, n = Streams(1, "conformance", "small", RUNS), len(RUNS)
    motion, noise = streams("truth"), streams("measurement")
    start = np.array([[0.0], [10.0]]) + motion.uniform(-1.0, 1.0, 2)
    x, u, truth, y = start, [], [], []
    effect = GRID[2] * np.ones((1, n))
    for k in range(STEPS):
        u.append(np.full((1, n), 1.0 if k < STEPS // 2 else -1.0))
        force = effect[0] * u[-1][0] + motion.uniform(-SPREAD, SPREAD)
        x = np.stack([x[0] + PERIOD * x[1] + PERIOD**2 / 2 * force, x[1] + PERIOD * force])
        truth.append(np.concatenate([x, effect]))
        y.append(x + np.array([[POSITION_SD], [SPEED_SD]]) * noise.uniform(-1.5, 1.5, 2))
    received = np.ones((STEPS, 2, n), dtype=bool)
    tape = Tape(RUNS, start, np.stack(u), (1.0,) * STEPS, np.stack(y), received, np.stack(truth), (True,) * STEPS,
                tuple(range(1, STEPS + 1)), tuple(PERIOD * k for k in range(STEPS)), (PERIOD,) * STEPS, (None,) * STEPS)
    return Case("small model", with_gaps(tape, streams), small_model, streams, parameters, exact_parts=True)


def telling_case(parameters: Mapping[str, Any]) -> Case:
    """The small model's tape with sensors that tell how good each reading is: some runs, some readings, some with
    correlated errors."""
    case = small_case(parameters)
    draw, n = Streams(1, "conformance", "telling", RUNS)("accuracy"), len(RUNS)
    said: list[Array | None] = []
    for e in range(STEPS):
        factor, correlation, which = draw.uniform(0.3, 3.0, 2), draw.uniform(-0.8, 0.8), draw.uniform(0.0, 1.0, 2)
        deviation = factor * np.array([[POSITION_SD], [SPEED_SD]])
        R = deviation[:, None] * deviation[None, :] * np.where(np.eye(2, dtype=bool)[..., None], 1.0,
                                                               np.where(np.arange(n) % 2, correlation, 0.0))
        tells = which < 0.6
        said.append(None if e % 5 == 0 else np.where(tells[:, None] & tells[None, :], R, np.nan))
    return replace(case, name="telling model", tape=replace(case.tape, covariances=tuple(said)),
                   model=lambda mean: replace(small_model(mean), tells=("position", "speed")))


# -- scenarios -------------------------------------------------------------------------------------------------------
def scenario_case(cls: type[Estimator], plugin: str, parameters: Mapping[str, Any], wanted: str = "") -> Case | None:
    """The case of a scenario: the one wanted (NAME or NAME/VARIANT), else the first that lists the plug-in, else the
    shortest whose design model gives what it needs; None where there is none. Raises InputError for one wanted that
    does not give it."""
    if wanted:
        scenario, variants = find(wanted)
        setting = scenario.setting(variants[0])
        entry = _entry(setting, plugin) or EstimatorEntry(plugin=plugin)
        try:
            return _case(f"{scenario.name}/{variants[0]}", setting, cls, entry, parameters)
        except Infeasible as error:
            raise InputError(f"--scenario {wanted}: {error}") from None
    found = {name: find(name)[0] for name in scenario_files()}
    choices = []
    for name, scenario in found.items():
        setting = scenario.setting(scenario.default)
        if not getattr(setting, "needs_file", ""):
            choices.append((f"{name}/{scenario.default}", setting, _entry(setting, plugin)))
    for name, setting, entry in sorted(choices, key=lambda item: (item[2] is None, item[1].config.time.steps)):
        try:
            return _case(name, setting, cls, entry or EstimatorEntry(plugin=plugin), parameters)
        except (Infeasible, ValidationError):
            continue
    return None


def _entry(setting: Setting[Any], plugin: str) -> EstimatorEntry | None:
    """How a scenario lists a plug-in: under its own name, or first of its labels."""
    entries = setting.config.estimators
    return next((entry for label, entry in entries.items() if plugin in (label, entry.plugin)), None)


def _case(name: str, setting: Setting[Any], cls: type[Estimator], entry: EstimatorEntry,
          parameters: Mapping[str, Any]) -> Case:
    """Raises Unsupported where the model lacks something, ValidationError where parameters do."""
    scenario, _, variant = name.partition("/")
    streams = Streams(1, scenario, variant, RUNS)
    chosen = {**entry.parameters, **parameters}
    world = setting.world(streams)
    model = setting.told(entry.knowledge, entry.augment, world.initial_mean)
    cls.require(model)
    cls(chosen)
    steps: list[Step] = []
    mean = world.initial_mean
    for k in range(min(STEPS, world.steps)):
        # The truth closes the loop where there is one, so that the tape does not depend on what is checked.
        steps.append(world.step(k, mean))
        mean = steps[-1].truth[:len(mean)].copy()
    tape = _tape(world.initial_mean, steps)
    return Case(name, with_gaps(tape, streams), lambda mean: setting.told(entry.knowledge, entry.augment, mean),
                streams, chosen)


def _tape(initial_mean: Array, steps: list[Step]) -> Tape:
    events = [(step, number, event) for step in steps for number, event in enumerate(step.events)]
    return Tape(
        RUNS, np.array(initial_mean), np.stack([step.u for step, _, _ in events]),
        tuple(event.share if isinstance(event.share, float) else np.array(event.share) for _, _, event in events),
        np.stack([event.y for _, _, event in events]), np.stack([event.received for _, _, event in events]),
        np.stack([step.truth for step, _, _ in events]), tuple(number == 0 for _, number, _ in events),
        tuple(step.number for step, _, _ in events), tuple(step.start for step, _, _ in events),
        tuple(step.length for step, _, _ in events), tuple(event.covariance for _, _, event in events))


def with_gaps(tape: Tape, streams: Streams) -> Tape:
    """The tape with whole events and single elements of each run taken away at random, and real numbers in place of
    what was never measured."""
    channel = streams("thinning")
    events, ny = tape.y.shape[:2]
    kept = channel.uniform(0.0, 1.0, events, ny) >= LOST_SHARE
    kept &= np.repeat(channel.uniform(0.0, 1.0, events, 1) >= LOST_SHARE, ny, axis=1)
    return replace(tape, y=np.nan_to_num(tape.y, nan=0.0, posinf=0.0, neginf=0.0), received=tape.received & kept)
