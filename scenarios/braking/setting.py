"""The braking setting: a train that brakes while its braking rate f drifts or drops (Zheng, Han, Kong, Wang 2015).

Truth is eq. (4) with exact zero-order hold; estimators are told a grid of f, or f as a random walk."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ..arrays import Array
from ..augmented import Extra
from ..model import DesignModel
from ..observation import observe
from ..randomness import Streams
from ..setting import Quantity, Setting
from ..world import Sensing, Trajectory
from .config import BrakingConfig, Knowledge
from .plant import Affine, discretise
from .told import Told, Walk, augmented_model, grid_model, scheduled_model


class Braking(Setting[BrakingConfig]):
    """Joint estimation of the braking rate f and the state (D, v, a^, a_z)."""

    kind: ClassVar[str] = "braking"
    Config = BrakingConfig
    files: ClassVar[tuple[str, ...]] = ("braking-rate.toml",)

    def __init__(self, config: BrakingConfig) -> None:
        super().__init__(config)
        self.targets = config.plant.targets(config.time.period, config.time.steps)
        self.rates = config.plant.rates(config.time.period, config.time.steps)

    @cached_property
    def plant(self) -> Affine:
        """The discretised plant."""
        return discretise(self.config.plant.response_time, self.config.plant.pade_rate, self.config.time.period)

    def quantities(self) -> tuple[Quantity, ...]:
        return (Quantity("f", "1", ((4, 1.0),)), Quantity("displacement", "m", ((0, 1.0),)),
                Quantity("speed", "m/s", ((1, 1.0),)), Quantity("control-acceleration", "m/s^2", ((2, 1.0),)),
                Quantity("target-acceleration", "m/s^2", ((3, 1.0),)))

    def table(self) -> tuple[tuple[str, str], ...]:
        """Mean absolute errors, as the paper's tables; the error at the end of the run counts where a train stops."""
        return (*(("mae", item.name) for item in self.quantities()), ("final", "displacement"), ("nees", "state"))

    def world(self, streams: Streams) -> Trajectory:
        """Truth (K, 5, S) = (D, v, a^, a_z, f) at k = 1..K, measurements and what arrives of them.

        With `until_standstill` the run ends within the step in which the speed crosses zero, at the displacement that
        constant deceleration over that step gives; the train then stays there, and is scored no further."""
        config = self.config
        steps, period, runs = config.time.steps, config.time.period, len(streams.runs)
        entry = config.disturbance.entry(period)
        noise = np.sqrt(config.disturbance.speed_variance_rate * period) * streams("truth").normal(steps)
        start = np.repeat(np.array(config.plant.initial)[:, None], runs, axis=1)
        truth, active = np.empty((steps, 5, runs)), np.ones((steps, runs), dtype=bool)
        x, moving = start, np.ones(runs, dtype=bool)
        for k in range(steps):
            moved = self.plant.step(x, self.rates[k], self.targets[k])
            moved += entry[:, None] * noise[k]
            active[k] = moving
            if config.plant.until_standstill:
                stops = moved[1] <= 0
                share = np.where(stops, x[1] / np.where(stops, x[1] - moved[1], 1.0), 1.0)
                moved[0] = np.where(stops, x[0] + 0.5 * x[1] * share * period, moved[0])
                moved[1] = np.where(stops, 0.0, moved[1])
                moved = np.where(moving, moved, x)
                moving = moving & ~stops
            x = moved
            truth[k, :4], truth[k, 4] = x, self.rates[k]
        rows = config.sensors.rows()
        y = streams("measurement").normal(steps, len(rows))
        clean = truth[:, [state for _, state, _ in rows]]
        for row, (_, state, variance) in enumerate(rows):
            y[:, row] = truth[:, state] + np.sqrt(variance) * y[:, row]
        u = np.repeat(self.targets[:, None, None], runs, axis=2)
        trajectory = Trajectory(truth, u, y, np.ones(y.shape, dtype=bool), active, np.full(steps, period), start)
        return observe(trajectory, streams, self.sensing(), config.channel, config.faults, clean)

    def sensing(self) -> Sensing:
        rows = self.config.sensors.rows()
        along = np.array([float(state == 0) for _, state, _ in rows])
        return Sensing(tuple(name for name, *_ in rows), np.sqrt([variance for *_, variance in rows]),
                       (np.array([1.0, 0, 0, 0, 0]), along))

    def design_model(self, knowledge: Mapping[str, Any], initial_mean: Array) -> DesignModel:
        """Four states with modes over the grid of f, or five with f appended, as `knowledge.model` says."""
        told_of: Knowledge = self.resolve_knowledge(knowledge)
        period = self.config.time.period
        noise, rows = self._believed(told_of)
        C = np.zeros((len(rows), 4))
        for row, (_, state, _) in enumerate(rows):
            C[row, state] = 1.0
        told = Told(self.plant, period, initial_mean, np.array(told_of.initial_variance), noise, C,
                    np.diag([variance for *_, variance in rows]), tuple(name for name, *_ in rows))
        if told_of.model == "grid":
            return grid_model(told, np.array(told_of.grid), told_of.prior, told_of.nominal)
        walk = Walk(told_of.rate_initial, told_of.rate_initial_variance, told_of.rate_variance_rate * period,
                    told_of.target_variance_rate * period)
        return augmented_model(told, walk) if told_of.model == "augmented" else scheduled_model(told, walk,
                                                                                                  self.targets)

    def _believed(self, told: Knowledge) -> tuple[Array, list[tuple[str, int, float]]]:
        """Process covariance of a step (4, 4) and the measurements' rows as the estimators are told them."""
        disturbance, period = self.config.disturbance, self.config.time.period
        entry = disturbance.entry(period)
        rate = disturbance.speed_variance_rate if told.speed_variance_rate is None else told.speed_variance_rate
        return rate * period * np.outer(entry, entry), [
            (name, state, getattr(told, f"{name.replace('-', '_')}_variance") or variance)
            for name, state, variance in self.config.sensors.rows()]

    def extras(self, knowledge: Mapping[str, Any]) -> dict[str, tuple[Extra, ...]]:
        """A constant bias of each sensor; f itself is a state where knowledge.model says so."""
        rows = self._believed(self.resolve_knowledge(knowledge))[1]
        return {f"{name}-bias": (Extra(f"{name}-bias", "m" if state == 0 else "m/s" if state == 1 else "m/s^2",
                                       "constant", float(np.sqrt(variance)), column=np.eye(len(rows))[row]),)
                for row, (name, state, variance) in enumerate(rows)}
