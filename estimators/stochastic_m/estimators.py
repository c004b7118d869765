"""RBPF, SMA and GSMA: joint estimation of a gridded parameter and a linear state (Zheng, Han, Kong, Wang 2015).

One family: its members differ in where a particle's children go and in how many of them go on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from pydantic import Field, model_validator

from ...scenarios.arrays import Array, Index
from ...scenarios.machine_code import njit
from ...scenarios.model import Grid
from .. import mode_grid as transitions
from ..interface import used_with
from .cloud import CloudParameters, GridParticles

POLICY = "prune A: after an expansion that reaches Q; B: when the next would go beyond Q; C: every step"
STAY = "probability of keeping the value under the sticky prior; the rest goes to the two neighbours"


class StochasticMParameters(CloudParameters):
    """SMA (section 3.4)."""

    initial: int = Field(50, ge=1, description="N0, particles at the start")
    particles: int = Field(50, ge=1, description="N, particles left by pruning")
    limit: int = Field(500, ge=1, description="Q, largest number of particles before pruning")
    policy: Literal["A", "B", "C"] = Field("A", description=POLICY)
    prune: Literal["systematic", "heaviest"] = Field(
        "systematic", description="systematic resampling, or keep the N heaviest (as printed; biased)")
    memoryless: bool = Field(False, description="weights of eqs. (17), (18), which forget the parent's")
    prior: Literal["group", "sticky"] = Field(
        "group", description="p(theta'|theta): equal over the children, or `stay` and the rest to the neighbours")
    stay: float = Field(0.9, gt=0, lt=1, description=STAY)

    @model_validator(mode="after")
    def _used(self) -> StochasticMParameters:
        used_with(self, "stay", "prior", "sticky")
        return self


class GroupParameters(StochasticMParameters):
    """GSMA (section 3.5)."""

    policy: Literal["A", "B", "C"] = Field("B", description=POLICY)
    groups: Literal["all", "printed"] = Field(
        "all", description="all triples of neighbouring grid values, or the paper's list, which omits the topmost")


class RaoBlackwellizedParameters(CloudParameters):
    """RBPF (section 3.3)."""

    particles: int = Field(250, ge=1, description="number of particles")
    proposal: Literal["static", "optimal", "bootstrap"] = Field(
        "optimal", description="static: the parameter never moves; optimal: eqs. (9), (12), (13) over the grid; "
        "bootstrap: drawn from the prior")
    prior: Literal["uniform", "sticky"] = Field("uniform", description="p(theta'|theta) of optimal and bootstrap")
    stay: float = Field(0.9, gt=0, lt=1, description=STAY)
    jitter: float = Field(0.0, ge=0, lt=1, description="probability of moving to a neighbouring value, with "
                          "proposal = static")

    @model_validator(mode="after")
    def _used(self) -> RaoBlackwellizedParameters:
        used_with(self, "stay", "prior", "sticky")
        used_with(self, "jitter", "proposal", "static")
        return self


class StochasticM(GridParticles):
    """Stochastic M-algorithm: every particle goes on to every grid value, then the cloud is pruned."""

    Parameters = StochasticMParameters
    family = "SMA, GSMA"
    summary = "stochastic M-algorithm: each particle tries every value of the parameter's grid"

    def __init__(self, parameters: Mapping[str, Any] | None = None) -> None:
        super().__init__(parameters)
        self.by_weight = self.parameters.prune == "heaviest"
        self.memoryless = self.parameters.memoryless

    def children(self, grid: Array) -> Index:
        """Grid indices a particle may go on to, (m, g)."""
        return transitions.everywhere(len(grid))

    def offspring(self, modes: Grid) -> tuple[Index, Array]:
        children = self.children(modes.grid)
        sticky = self.parameters.prior == "sticky"
        transition = (transitions.tridiagonal(len(modes.grid), self.parameters.stay) if sticky
                      else transitions.within(children))
        return children, transitions.log_prior(transition, children)

    def first(self) -> int:
        return self.parameters.initial

    def goes_on(self, children: int, g: int) -> int:
        chosen = self.parameters
        beyond = {"A": children >= chosen.limit, "B": children * g > chosen.limit, "C": True}[chosen.policy]
        return chosen.particles if beyond and children > chosen.particles else 0


class GroupStochasticM(StochasticM):
    """Group stochastic M-algorithm: a particle goes on only within the group whose centre is nearest its value."""

    Parameters = GroupParameters
    summary = "group stochastic M-algorithm: each particle tries the three values of its group"

    def children(self, grid: Array) -> Index:
        return transitions.triples(grid, self.parameters.groups == "printed")


class RaoBlackwellizedParticle(GridParticles):
    """Rao-Blackwellized particle filter: a sampled path of the parameter with a Kalman filter along it, resampled
    systematically after every step."""

    Parameters = RaoBlackwellizedParameters
    family = "Particle"
    summary = "Rao-Blackwellized particle filter: sampled parameter, Kalman filter for the state"

    def __init__(self, parameters: Mapping[str, Any] | None = None) -> None:
        super().__init__(parameters)
        self.optimal = self.parameters.proposal == "optimal"

    def _transition(self, m: int) -> Array | None:
        """p(theta'|theta), (m, m); None: theta never moves."""
        chosen = self.parameters
        if chosen.proposal == "static":
            return transitions.tridiagonal(m, 1 - chosen.jitter) if chosen.jitter > 0 else None
        return transitions.uniform(m) if chosen.prior == "uniform" else transitions.tridiagonal(m, chosen.stay)

    def offspring(self, modes: Grid) -> tuple[Index, Array]:
        m = len(modes.grid)
        transition = self._transition(m)
        self.edges = None
        if self.optimal and transition is not None:
            children = transitions.everywhere(m)
            return children, transitions.log_prior(transition, children)
        if transition is not None:
            self.edges = np.ascontiguousarray(np.cumsum(transition, axis=1)[:, :-1])
        return np.arange(m)[:, None], np.zeros((m, 1))

    def first(self) -> int:
        return self.parameters.particles

    def draws_per_step(self) -> int:
        moves = self.optimal or self.parameters.proposal == "bootstrap" or self.parameters.jitter > 0
        return 1 + self.parameters.particles * moves

    def move(self, draws: Array) -> None:
        """Bootstrap and jitter: theta' by inverse transform from p(theta'|theta)."""
        if self.edges is not None:
            _move(self.cloud.theta, self.n, draws, self.edges)

    def goes_on(self, children: int, g: int) -> int:
        return self.parameters.particles


@njit(cache=True)
def _move(theta, n, draws, edges):
    """theta (S, capacity), in place: the first n by their uniforms draws[:, 1:]; edges (m, m - 1) cumulative rows."""
    for s in range(theta.shape[0]):
        for i in range(n):
            row = theta[s, i]
            to = 0
            for j in range(edges.shape[1]):
                to += draws[s, 1 + i] >= edges[row, j]
            theta[s, i] = to
