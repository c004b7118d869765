"""What a linear setting's file may say."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, PositiveFloat, model_validator

from ..channels import Channel, Ideal, RandomAccess
from ..faults import Faults
from ..schema import Probability, ScenarioConfig, Strict
from .matrices import Matrix, at_step, listed, shape, varies

PSD_ROUNDING = 1e-10
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
    states: tuple[Annotated[str, Field(pattern=r"^[^\W\d_][\w .-]{0,39}$")], ...] = ()
    units: tuple[Annotated[str, Field(pattern=r"^[\w%°/(][\w%°/^*·.() -]{0,19}$")], ...] = ()


class Knowledge(Strict):
    """What the estimators are told otherwise than the truth: any matrix of the plant, the access probabilities p.

    Q, R, P0: a number stands for as many times the plant's own."""

    A: Matrix | None = None
    B: Matrix | None = None
    C: Matrix | None = None
    Q: Matrix | PositiveFloat | None = None
    R: Matrix | PositiveFloat | None = None
    P0: Matrix | PositiveFloat | None = None
    p: Annotated[list[Probability], Field(min_length=1)] | None = None


class LinearConfig(ScenarioConfig):
    """A scenario with `plant.kind = "linear"`; shapes, covariances at each step and channel nodes are checked."""

    plant: Plant  # pyright: ignore[reportIncompatibleVariableOverride]
    channel: Channel = Ideal()  # pyright: ignore[reportIncompatibleVariableOverride]
    faults: Faults = ()  # pyright: ignore[reportIncompatibleVariableOverride]
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
        slack = PSD_ROUNDING * np.abs(eigenvalues).max()
        if np.abs(M - M.T).max() > slack:
            raise ValueError(f"{where} is a covariance and must be symmetric")
        if eigenvalues[0] < -slack or (name == "R" and eigenvalues[0] <= slack):
            need = "positive definite" if name == "R" else "positive semi-definite"
            raise ValueError(f"{where} must be {need}; its least eigenvalue is {eigenvalues[0]:g}")
