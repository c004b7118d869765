"""Any linear plant given by its matrices in the scenario file, constant or changing with the step.

x(k+1) = A x(k) + B w(k), y(k) = C x(k) + v(k): the plant (2) of Zou, Wang, Han, Zhou (random access protocol)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from .channels import Channel, Ideal, RandomAccess
from .matrices import Matrix, at_step, listed, remembered, shape, varies
from .model import DesignModel, Linear, linear_model, product
from .randomness import Streams
from .schema import Probability, ScenarioConfig, Strict
from .setting import Quantity, Setting
from .world import Trajectory

Array = NDArray[np.float64]

ROUNDING = 1e-10
"""How far, relative to its greatest eigenvalue, a covariance may be from symmetric or from semi-definite."""


class Plant(Strict):
    """A (nx, nx), B (nx, nw), C (ny, nx), Q (nw, nw) of w, R (ny, ny) of v, initial mean x0 (nx,), covariance P0.

    index: which k the motion from step k - 1 to step k takes its A, B, Q at: `departure` is k - 1, as in
    x(k+1) = A(k) x(k) + B(k) w(k); `arrival` is k. C and R always belong to the measurement of step k = 1, 2, ..
    states, units: names and units of the states; x1, x2, .. and "1" (none) where left out."""

    kind: Literal["linear"]
    A: Matrix
    B: Matrix
    C: Matrix
    Q: Matrix
    R: Matrix
    x0: Annotated[list[float], Field(min_length=1)]
    P0: Matrix
    index: Literal["departure", "arrival"] = "departure"
    states: tuple[str, ...] = ()
    units: tuple[str, ...] = ()


class Knowledge(Strict):
    """What the estimators are told otherwise than the truth: any matrix of the plant, the access probabilities p."""

    A: Matrix | None = None
    B: Matrix | None = None
    C: Matrix | None = None
    Q: Matrix | None = None
    R: Matrix | None = None
    P0: Matrix | None = None
    p: Annotated[list[Probability], Field(min_length=1)] | None = None


class LinearConfig(ScenarioConfig):
    """A scenario with `plant.kind = "linear"`; shapes, covariances at each step and channel nodes are checked."""

    plant: Plant  # pyright: ignore[reportIncompatibleVariableOverride]
    channel: Channel = Ideal()  # pyright: ignore[reportIncompatibleVariableOverride]
    knowledge: Knowledge = Knowledge()  # pyright: ignore[reportIncompatibleVariableOverride]

    @model_validator(mode="after")
    def _consistent(self) -> LinearConfig:
        plant, nx = self.plant, len(self.plant.x0)
        nw, ny = shape(plant.B)[1], shape(plant.C)[0]
        wanted = {"A": (nx, nx), "B": (nx, nw), "C": (ny, nx), "Q": (nw, nw), "R": (ny, ny), "P0": (nx, nx)}
        wrong = []
        for name, (rows, columns) in wanted.items():
            found = shape(getattr(plant, name))
            if found != (rows, columns):
                wrong.append(f"plant.{name} is {found[0]} x {found[1]}, must be {rows} x {columns}")
        for name in ("states", "units"):
            given = getattr(plant, name)
            if given and len(given) != nx:
                wrong.append(f"plant.{name} has {len(given)} entries for {nx} states")
        if wrong:
            raise ValueError("; ".join(wrong) + " (x0 gives the number of states, B of noises, C of measurements)")
        if len(set(plant.states)) != len(plant.states):
            raise ValueError(f"plant.states repeats a name: {', '.join(plant.states)}")
        for name in wanted:
            _check_steps(name, getattr(plant, name), self.time.steps)
        self.channel.check(ny)
        if self.knowledge.p is not None and not isinstance(self.channel, RandomAccess):
            raise ValueError("knowledge.p are access probabilities and need channel.kind = \"random-access\"")
        return self


def _check_steps(name: str, matrix: list[Any], last: int) -> None:
    """Every step's value is finite, covariances are covariances. Raises ValueError naming matrix and step."""
    count = listed(matrix)
    if name == "P0" and varies(matrix):
        raise ValueError("plant.P0 is the covariance at k = 0: one matrix of numbers")
    if count is not None and count <= last:
        raise ValueError(f"plant.{name} lists {count} matrices; {last + 1} are needed, for k = 0 .. {last}")
    value = at_step(matrix)
    for k in range(last + 1) if varies(matrix) else range(1):
        where = f"plant.{name} at k = {k}" if varies(matrix) else f"plant.{name}"
        try:
            M = value(k)
        except ValueError as error:
            raise ValueError(f"plant.{name}: {error}") from None
        if name not in ("Q", "R", "P0"):
            continue
        eigenvalues = np.linalg.eigvalsh((M + M.T) / 2)
        slack = ROUNDING * np.abs(eigenvalues).max()
        if np.abs(M - M.T).max() > slack:
            raise ValueError(f"{where} is a covariance and must be symmetric")
        if eigenvalues[0] < -slack or (name == "R" and eigenvalues[0] <= slack):
            need = "positive definite" if name == "R" else "positive semi-definite"
            raise ValueError(f"{where} must be {need}; its least eigenvalue is {eigenvalues[0]:g}")


class LinearSystem(Setting[LinearConfig]):
    """The setting of `plant.kind = "linear"`. The truth vector is the state; there is no known input (nu = 0).

    `Trajectory.extra["node"]` (K, S) is the number of the node that transmits at each step, under random access."""

    kind = "linear"
    Config = LinearConfig
    files = ("rap-example-1.toml", "rap-example-2.toml")

    def quantities(self) -> tuple[Quantity, ...]:
        units = self.config.plant.units or ("1",) * len(self._states)
        return tuple(Quantity(name, unit, ((i, 1.0),))
                     for i, (name, unit) in enumerate(zip(self._states, units, strict=True)))

    def world(self, streams: Streams) -> Trajectory:
        """x(0) from N(x0, P0), then `time.steps` steps. Products are sums over the small index: runs never meet."""
        plant, steps, runs = self.config.plant, self.config.time.steps, len(streams.runs)
        nx, nw, ny = len(plant.x0), shape(plant.B)[1], shape(plant.C)[0]
        A, B, C, Q, R = (at_step(getattr(plant, name)) for name in "ABCQR")
        drive = remembered(lambda k: B(k) @ _root(Q(k)), varies(plant.B) or varies(plant.Q))
        noise = remembered(lambda k: _root(R(k)), varies(plant.R))
        shift = int(plant.index == "arrival")
        truth, y = np.empty((steps, nx, runs)), np.empty((steps, ny, runs))
        motion = streams("truth")
        initial_mean = np.repeat(np.array(plant.x0)[:, None], runs, axis=1)
        x = initial_mean + product(_root(at_step(plant.P0)(0)), motion.normal(nx))
        w, v = motion.normal(steps, nw), streams("measurement").normal(steps, ny)
        for k in range(steps):
            x = product(A(k + shift), x) + product(drive(k + shift), w[k])
            truth[k] = x
            y[k] = product(C(k + 1), x) + product(noise(k + 1), v[k])
        received = self.config.channel.draw(streams("channel"), steps, ny)
        extra: dict[str, Array] = {}
        if isinstance(self.config.channel, RandomAccess):
            sensor = [node[0] for node in self.config.channel.nodes]
            extra["node"] = np.argmax(received[:, sensor, :], axis=1).astype(float)
        return Trajectory(truth, np.zeros((steps, 0, runs)), y, received, np.ones((steps, runs), dtype=bool),
                          np.ones(steps), initial_mean, extra)

    def design_model(self, knowledge: Mapping[str, Any], initial_mean: Array) -> DesignModel:
        """The plant with what [knowledge] says otherwise, its process noise B Q B'."""
        told = self._told(self.resolve_knowledge(knowledge))
        plant, nx = told.plant, len(told.plant.x0)
        A, B, C, Q, R = (at_step(getattr(plant, name)) for name in "ABCQR")
        shift = int(plant.index == "arrival")
        no_input, no_offset = np.zeros((nx, 0)), np.zeros(nx)
        process = remembered(lambda k: B(k + shift) @ Q(k + shift) @ B(k + shift).T,
                             varies(plant.B) or varies(plant.Q))
        linear = Linear(
            A=lambda k: A(k + shift), B=lambda k: no_input, h=lambda k: no_offset, C=C, Q=process, R=R,
            constant=not any(varies(getattr(plant, name)) for name in "ABCQR"),
            steps=told.time.steps if any(listed(getattr(plant, name)) for name in "ABCQR") else None)
        return linear_model(
            linear, states=self._states, measurements=tuple(f"y{i + 1}" for i in range(shape(plant.C)[0])),
            period=told.time.period, initial_mean=initial_mean,
            initial_covariance=at_step(plant.P0)(0)[:, :, None], reception=told.channel.reception())

    def resolve_knowledge(self, knowledge: Mapping[str, Any]) -> Knowledge:
        """As `Setting`; what is told must fit together as a plant has to."""
        resolved = super().resolve_knowledge(knowledge)
        self._told(resolved)
        return resolved

    @property
    def _states(self) -> tuple[str, ...]:
        return tuple(self.config.plant.states or [f"x{i + 1}" for i in range(len(self.config.plant.x0))])

    def _told(self, knowledge: Knowledge) -> LinearConfig:
        """The scenario as the estimators are told it. Raises ValidationError where it does not fit together."""
        told = knowledge.model_dump(exclude_none=True)
        if not told:
            return self.config
        table = self.config.model_dump(exclude_unset=True) | {"knowledge": told}
        matrices = {name: value for name, value in told.items() if name != "p"}
        table["plant"] = table["plant"] | matrices
        if "p" in told and isinstance(self.config.channel, RandomAccess):
            table["channel"] = table["channel"] | {"p": told["p"]}
        return LinearConfig.model_validate(table)

    def batch_bytes(self) -> int:
        plant = self.config.plant
        nx, nw, ny = len(plant.x0), shape(plant.B)[1], shape(plant.C)[0]
        return self.config.time.steps * (8 * (nx + nw + 2 * ny + 1) + ny + 1)


def _root(M: Array) -> Array:
    """The symmetric square root of a positive semi-definite matrix."""
    values, vectors = np.linalg.eigh((M + M.T) / 2)
    return (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
