"""Several design models of the same states as one: mode j of run s is column j S + s of every array.

So one filter of the suite, unchanged, runs all modes at once; functions that modes share are called once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ...scenarios.arrays import Array, read_only
from ...scenarios.measurement import Interval, Measurement, PerRun
from ...scenarios.model import DesignModel, Mode
from ..kernels.mixing import powers


def repeated(value: Any, m: int) -> Any:
    """An array whose last axis is the runs, or a number, for m modes."""
    array = np.asarray(value)
    return value if array.ndim == 0 or array.shape[-1] == 1 else np.concatenate([array] * m, axis=-1)


def interval_of(interval: Interval, m: int) -> Interval:
    """The interval for m modes."""
    return Interval(interval.step, *(repeated(part, m) for part in interval[1:]))


def measurement_of(measurement: Measurement, m: int) -> Measurement:
    """The measurement for m modes, without what sensors tell of it: R is made of that, mode by mode (`noise_of`)."""
    y, received, step, event, time, _ = measurement
    return Measurement(read_only(np.concatenate([y] * m, axis=1)), read_only(np.concatenate([received] * m, axis=1)),
                       step, event, repeated(time, m))


def stacked(modes: Sequence[Mode], runs: int) -> DesignModel:
    """The design model of all modes of `runs` runs, but for R. Its functions are to be asked with arrays of m S columns
    only."""
    models = [mode.model for mode in modes]
    m = len(models)

    def each(name: str) -> Callable[..., Array] | None:
        """A model function, mode by mode, or once where all have the same."""
        functions = [getattr(model, name) for model in models]
        if all(function == functions[0] for function in functions):
            return functions[0]

        def split(*arguments: Any) -> Array:
            parts = []
            for j, function in enumerate(functions):
                mine = slice(j * runs, (j + 1) * runs)
                parts.append(function(*(_cut(a, mine, m * runs) for a in arguments)))
            return np.concatenate([np.broadcast_to(p, (*p.shape[:-1], runs)) for p in parts], axis=-1)

        return split

    return replace(
        models[0], transition=each("transition"), measurement=each("measurement"),  # pyright: ignore
        transition_jacobian=each("transition_jacobian"), measurement_jacobian=each("measurement_jacobian"),
        process_covariance=each("process_covariance"),
        initial_mean=np.concatenate([model.initial_mean for model in models], axis=1),
        initial_covariance=np.concatenate([np.broadcast_to(model.initial_covariance, (
            *model.initial_covariance.shape[:2], runs)) for model in models], axis=2),
        linear=None, bounds=None, modes=None)


def noise_of(modes: Sequence[Mode], measurement: Measurement, runs: int) -> Array:
    """R (ny, ny, m S) of all modes for a measurement of S runs."""
    m, ny = len(modes), len(measurement.y)
    out = np.empty((ny, ny, m * runs))
    for j, mode in enumerate(modes):
        assert mode.model.measurement_covariance is not None
        out[:, :, j * runs:(j + 1) * runs] = mode.model.measurement_covariance(measurement)
    return out


def _cut(value: Any, mine: slice, columns: int) -> Any:
    """The columns of one mode of an argument of a model function."""
    if isinstance(value, Interval):
        return Interval(value.step, *(_cut(part, mine, columns) for part in value[1:]))
    if isinstance(value, np.ndarray) and value.ndim and value.shape[-1] == columns:
        return np.ascontiguousarray(value[..., mine])
    return value


def power_of(transition: Array) -> Callable[[PerRun], Array]:
    """p -> transition^p (m, m, S or 1), p >= 0 a number or (S,).

    Raises ValueError where a power is no transition matrix."""
    values, vectors = np.linalg.eig(transition)
    if np.abs(np.imag(values)).max() > 1e-12 or np.real(values).min() <= 0:
        raise ValueError("the modes' transition matrix has no powers that are transition matrices")
    values, vectors = np.real(values), np.real(vectors)
    inverse = np.linalg.inv(vectors)
    parts = np.stack([vectors[:, i, None] * inverse[i] for i in range(len(values))])
    whole = transition[:, :, None]
    m = len(values)

    def power(p: PerRun) -> Array:
        share = np.atleast_1d(np.asarray(p, dtype=float))
        if (share == 1.0).all():
            return whole
        out = np.zeros((m, m, len(share)))
        for part, raised in zip(parts, powers(np.ascontiguousarray(values), share), strict=True):
            out += part[:, :, None] * raised
        out = np.maximum(out, 0.0)
        out = np.where(share == 1.0, whole, np.where(share == 0.0, np.eye(m)[:, :, None], out))
        return out

    return power
