"""Any linear plant given by its matrices in the scenario file, constant or changing with the step.

x(k+1) = A x(k) + B w(k), y(k) = C x(k) + v(k): the plant (2) of Zou, Wang, Han, Zhou (random access protocol)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ..arrays import Array
from ..augmented import Extra
from ..channels import OneAtATime, RandomAccess
from ..measurement import Interval
from ..model import DesignModel, Linear, linear_model, product
from ..observation import observe
from ..randomness import Streams
from ..setting import Matched, Quantity, Setting
from ..world import Sensing, Trajectory
from .config import Knowledge, LinearConfig
from .matrices import at_step, listed, remembered, shape, times, varies


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
        truth, clean, y = np.empty((steps, nx, runs)), np.empty((steps, ny, runs)), np.empty((steps, ny, runs))
        motion = streams("truth")
        initial_mean = np.repeat(np.array(plant.x0)[:, None], runs, axis=1)
        x = initial_mean + product(_root(at_step(plant.P0)(0)), motion.normal(nx))
        w, v = motion.normal(steps, nw), streams("measurement").normal(steps, ny)
        for k in range(steps):
            x = product(A(k + shift), x) + product(drive(k + shift), w[k])
            truth[k] = x
            clean[k] = product(C(k + 1), x)
            y[k] = clean[k] + product(noise(k + 1), v[k])
        channel = self.config.channel
        trajectory = Trajectory(truth, np.zeros((steps, 0, runs)), y, np.ones(y.shape, dtype=bool),
                                np.ones((steps, runs), dtype=bool), np.full(steps, self.config.time.period),
                                initial_mean)
        heard = observe(trajectory, streams, self.sensing(), channel, self.config.faults, clean)
        if isinstance(channel, OneAtATime) and channel.silent == "nothing":
            sensor = [node[0] for node in channel.groups(ny)]
            return replace(heard, extra={"node": np.argmax(heard.received[:, sensor, :], axis=1).astype(float)})
        return heard

    def matched(self, runs: int) -> Matched:
        """The plant itself: all its noise is Gaussian."""
        plain = LinearSystem(self.config.model_copy(update={"knowledge": Knowledge()}))
        return Matched(plain.design_model({}, np.repeat(np.array(self.config.plant.x0)[:, None], runs, axis=1)))

    def sensing(self) -> Sensing:
        plant, steps = self.config.plant, self.config.time.steps
        R = at_step(plant.R)
        sd = np.array([np.sqrt(np.diag(R(k + 1))) for k in range(steps if varies(plant.R) else 1)])
        return Sensing(tuple(f"y{i + 1}" for i in range(sd.shape[1])), sd if varies(plant.R) else sd[0])

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

    def extras(self, knowledge: Mapping[str, Any]) -> dict[str, tuple[Extra, ...]]:
        """Process noise correlated in time, a state for each column of B, and a constant bias of each sensor."""
        plant = self._told(self.resolve_knowledge(knowledge)).plant
        B, shift = at_step(plant.B), int(plant.index == "arrival")
        (_, nw), (ny, _), period = shape(plant.B), shape(plant.C), self.config.time.period
        process, noise = np.sqrt(np.diag(at_step(plant.Q)(0))), np.sqrt(np.diag(at_step(plant.R)(0)))

        def column(j: int) -> Callable[[Interval], Array]:
            return lambda interval: B(interval.depart + shift)[:, j:j + 1]

        return {"disturbance": tuple(Extra(f"w{j + 1}", "1", "gauss-markov", float(process[j]), instead=1.0,
                                           time_constant=10 * period, gain=column(j)) for j in range(nw)),
                "bias": tuple(Extra(f"bias {i + 1}", "1", "constant", float(noise[i]), column=np.eye(ny)[i])
                              for i in range(ny))}

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
        matrices = {name: times(getattr(self.config.plant, name), value) if isinstance(value, float) else value
                    for name, value in told.items() if name != "p"}
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
