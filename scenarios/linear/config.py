"""What a linear setting's file may say."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, PositiveFloat, model_validator

from ..channels import Channel, Ideal, RandomAccess
from ..faults import Faults
from ..schema import TABLES, Probability, ScenarioConfig, Strict
from ..strict import KIND, key
from .matrices import Matrix, at_step, listed, shape, varies

PSD_ROUNDING = 1e-10
"""How far, relative to its greatest eigenvalue, a covariance may be from symmetric or from semi-definite."""


class Plant(Strict):
    """x(k+1) = A x(k) + B w(k), y(k) = C x(k) + v(k)."""

    kind: Annotated[Literal["linear"], KIND]
    A: Annotated[Matrix, key("transition (nx, nx)", "the states'")]
    B: Annotated[Matrix, key("input of the noise (nx, nw)", "the states'")]
    C: Annotated[Matrix, key("measurement (ny, nx)", "the states'")]
    Q: Annotated[Matrix, key("covariance of w (nw, nw)", "the states'")]
    R: Annotated[Matrix, key("covariance of v (ny, ny)", "the states'")]
    x0: Annotated[list[float], Field(min_length=1), key("mean of the start (nx,)", "the states'")]
    P0: Annotated[Matrix, key("covariance of the start (nx, nx)", "the states'")]
    index: Annotated[Literal["departure", "arrival"], key(
        "which k the motion from step k - 1 to k takes its A, B, Q at: departure, k - 1 as in x(k+1) = A(k) x(k) "
        "+ B(k) w(k); arrival, k. C and R belong to the measurement of step k = 1, 2, ..")] = "departure"
    states: Annotated[tuple[Annotated[str, Field(pattern=r"^[^\W\d_][\w .-]{0,39}$")], ...], key(
        "names of the states; none: x1, x2, ..")] = ()
    units: Annotated[tuple[Annotated[str, Field(pattern=r"^[\w%°/(][\w%°/^*·.() -]{0,19}$")], ...], key(
        "units of the states; none: 1")] = ()


class Knowledge(Strict):
    """What the estimators are told otherwise than the truth."""

    A: Annotated[Matrix | None, key("A in place of the plant's", "the states'")] = None
    B: Annotated[Matrix | None, key("B in place of the plant's", "the states'")] = None
    C: Annotated[Matrix | None, key("C in place of the plant's", "the states'")] = None
    Q: Annotated[Matrix | PositiveFloat | None, key("Q in place of the plant's", "the states'")] = None
    R: Annotated[Matrix | PositiveFloat | None, key("R in place of the plant's", "the states'")] = None
    P0: Annotated[Matrix | PositiveFloat | None, key("P0 in place of the plant's", "the states'")] = None
    p: Annotated[Annotated[list[Probability], Field(min_length=1)] | None, key(
        "access probabilities in place of the channel's", "1")] = None


class LinearConfig(ScenarioConfig):
    """A scenario with `plant.kind = "linear"`; shapes, covariances at each step and channel nodes are checked."""

    plant: Annotated[Plant, TABLES["plant"]]  # pyright: ignore[reportIncompatibleVariableOverride]
    channel: Annotated[Channel, TABLES["channel"]] = Ideal()  # pyright: ignore[reportIncompatibleVariableOverride]
    faults: Annotated[Faults, TABLES["faults"]] = ()  # pyright: ignore[reportIncompatibleVariableOverride]
    knowledge: Annotated[Knowledge, TABLES["knowledge"]] = Knowledge()  # pyright: ignore[reportIncompatibleVariableOverride]

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
