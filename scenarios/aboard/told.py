"""A design model that hears sensors aboard beside its own: any model whose first states are position and speed.

Behind its states stand what wheels have rolled since they were last read, and the scales of wheels and radar."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..arrays import Array
from ..measurement import Interval, told, untold
from ..model import DesignModel, Linear
from .config import Instruments

PLACES = ("balise", "gnss")


def hearing(model: DesignModel, names: Sequence[str], instruments: Instruments, walk: float) -> DesignModel:
    """The model with measurements `names` (n,) behind its own, which are of its own states.

    Wheels measure the distance since they were last read, (1 + scale) of it; they are read at the end of each step. A
    radar measures (1 + scale) of the speed. Scales walk by `walk` per sqrt(s). Who cannot use what sensors tell takes a
    balise's deviation on the open line. With states of this kind there is no linear form, nor bounds; densities and
    modes there never are."""
    if not names:
        return model
    wheels = tuple(name for name in names if name.startswith("wheel-"))
    scaled = tuple(name for name in names if name not in PLACES)
    extra = (*(["travelled"] if wheels else []), *(f"scale-{name.removeprefix('wheel-')}" for name in scaled))
    parts = _Hearing(model, tuple(names), scaled, bool(wheels), walk, instruments.deviations(tuple(names)))
    size, runs = model.nx + len(extra), model.initial_mean.shape[1]
    start = np.zeros((size, size, 1))
    start[:model.nx, :model.nx] = model.initial_covariance
    for i, name in enumerate(scaled, size - len(scaled)):
        start[i, i] = max(instruments.spread(name), 1e-6) ** 2
    if wheels:
        start[model.nx, model.nx] = 1e-6
    kept: dict[str, Any] = {"linear": None, "bounds": None}
    if not extra:
        bounds = model.bounds
        kept = {"linear": parts.linear(), "bounds": None if bounds is None else replace(
            bounds, v_bar=np.concatenate([bounds.v_bar, 3.0 * parts.deviations]))}
    return replace(
        model, states=(*model.states, *extra), measurements=(*model.measurements, *names),
        transition=parts.transition if extra else model.transition,
        transition_jacobian=parts.transition_jacobian if extra else model.transition_jacobian,
        process_covariance=parts.process_covariance if extra else model.process_covariance,
        measurement=parts.measurement, measurement_jacobian=parts.measurement_jacobian,
        linear_measurement=model.linear_measurement and not scaled,
        measurement_covariance=told(parts.noise), tells=(*model.tells, *wheels),
        initial_mean=np.concatenate([model.initial_mean, np.zeros((len(extra), runs))]), initial_covariance=start,
        appended=model.appended + len(extra), inclusion=None, densities=None, modes=None, input_jacobian=None,
        performance=None, **kept)


class _Hearing:
    """The functions of such a model; runs are the last axis, sigma points may stand in between."""

    def __init__(self, model: DesignModel, names: tuple[str, ...], scaled: tuple[str, ...], rolls: bool, walk: float,
                 deviations: Array) -> None:
        self.model, self.names, self.nx, self.rolls, self.walk = model, names, model.nx, rolls, walk
        self.deviations, self.scaled = deviations, len(scaled)
        first = self.nx + rolls
        # what each reads: a state, and the state of its scale (-1: none)
        self.rows = [(0 if name in PLACES else self.nx if name.startswith("wheel-") else 1,
                      first + scaled.index(name) if name in scaled else -1) for name in names]

    def transition(self, x: Array, u: Array, interval: Interval) -> Array:
        out = np.array(x, dtype=float)
        out[:self.nx] = self.model.transition(np.ascontiguousarray(x[:self.nx]), u, interval)
        if self.rolls:
            out[self.nx] = self._kept(interval) * x[self.nx] + (out[0] - x[0])
        return out

    def _kept(self, interval: Interval) -> Array | float:
        """What is left of the way rolled: none where a step begins, since wheels were read there; parts of a step need
        steps of the model's period."""
        if isinstance(interval.share, float) and interval.share == 1.0:
            return 0.0
        begins = np.asarray(interval.start) - interval.depart * self.model.period < 1e-6 * self.model.period
        return np.where(begins & (np.asarray(interval.length) > 0), 0.0, 1.0)

    def transition_jacobian(self, x: Array, u: Array, interval: Interval) -> Array:
        assert self.model.transition_jacobian is not None
        own = self.model.transition_jacobian(np.ascontiguousarray(x[:self.nx]), u, interval)
        size, kept = self.nx + self.rolls + self.scaled, self._kept(interval) if self.rolls else 0.0
        runs = max(own.shape[2], np.size(kept))
        out = np.zeros((size, size, runs))
        out[:self.nx, :self.nx] = own
        if self.rolls:
            out[self.nx, :self.nx] = own[0]
            out[self.nx, 0] -= 1.0
            out[self.nx, self.nx] = kept
        for i in range(size - self.scaled, size):
            out[i, i] = 1.0
        return out

    def process_covariance(self, x: Array, u: Array, interval: Interval) -> Array:
        assert self.model.process_covariance is not None
        own = self.model.process_covariance(x[:self.nx], u, interval)
        length = np.atleast_1d(np.asarray(interval.length, dtype=float))
        size = self.nx + self.rolls + self.scaled
        out = np.zeros((size, size, max(own.shape[2], len(length))))
        out[:self.nx, :self.nx] = own
        if self.rolls:
            out[self.nx, :self.nx] = out[:self.nx, self.nx] = own[0]
            out[self.nx, self.nx] = own[0, 0]
        for i in range(size - self.scaled, size):
            out[i, i] = self.walk**2 * length
        return out

    def measurement(self, x: Array, step: int) -> Array:
        own = self.model.measurement(x[:self.nx], step)
        more = [x[state] if scale < 0 else (1.0 + x[scale]) * x[state] for state, scale in self.rows]
        return np.concatenate([own, np.stack(more)])

    def measurement_jacobian(self, x: Array, step: int) -> Array:
        assert self.model.measurement_jacobian is not None
        own = self.model.measurement_jacobian(x[:self.nx], step)
        runs = x.shape[1] if self.scaled else own.shape[2]
        out = np.zeros((len(own) + len(self.rows), self.nx + self.rolls + self.scaled, runs))
        out[:len(own), :self.nx] = own
        for i, (state, scale) in enumerate(self.rows, len(own)):
            out[i, state] = 1.0
            if scale >= 0:
                out[i, state] += x[scale]
                out[i, scale] = x[state]
        return out

    def noise(self, step: int) -> Array:
        """R as the model has it, and the sensors' own."""
        assert self.model.measurement_covariance is not None
        own = self.model.measurement_covariance(untold(step, len(self.model.measurements)))
        n = len(own)
        out = np.zeros((n + len(self.names), n + len(self.names), own.shape[2]))
        out[:n, :n] = own
        for i, sd in enumerate(self.deviations, n):
            out[i, i] = sd * sd
        return out

    def linear(self) -> Linear | None:
        """The linear form with the rows of sensors that read a position."""
        form = self.model.linear
        if form is None:
            return None
        rows = np.zeros((len(self.rows), self.nx))
        rows[:, 0] = 1.0
        n = len(self.model.measurements)

        def R(k: int) -> Array:
            out = np.zeros((n + len(rows), n + len(rows)))
            out[:n, :n], out[n:, n:] = form.R(k), np.diag(self.deviations**2)
            return out

        return replace(form, C=lambda k: np.concatenate([form.C(k), rows]), R=R)
