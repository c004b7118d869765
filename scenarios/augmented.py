"""Design models with extra states: a disturbance, a force, a bias or a scale that an estimator carries along.

`augmented` makes one from any other design model; the setting's own states come first and are all that is scored."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from .arrays import Array
from .errors import InputError
from .measurement import Interval, PerRun
from .model import Bounds, DesignModel, Linear

Kind = Literal["constant", "walk", "gauss-markov"]


@dataclass(frozen=True)
class Extra:
    """One extra state e. It enters in exactly one place: the process, x+ = f + gain(interval) e, gain (nx, S or 1); the
    measurements, y = h + column e, column (ny,); or an input, u[input] / (1 + e), a scale.

    kind: constant; walk, sd per root of a second; gauss-markov, sd the stationary one and time_constant in s. mean,
    start_sd: of its start (start_sd None: sd, which is right where that is the stationary one). instead: the share of
    the base model's process noise that it replaces (1: that noise was this disturbance); of several extra states the
    largest counts. bound: of what drives it within a whole step, where one is known. Raises InputError."""

    name: str
    unit: str
    kind: Kind
    sd: float
    start_sd: float | None = None
    mean: float = 0.0
    time_constant: float | None = None
    gain: Callable[[Interval], Array] | None = None
    column: Array | None = None
    input: int | None = None
    instead: float = 0.0
    bound: float | None = None

    def __post_init__(self) -> None:
        if sum(part is not None for part in (self.gain, self.column, self.input)) != 1:
            raise InputError(f"{self.name}: an extra state takes exactly one of gain, column, input")
        if self.kind == "gauss-markov" and self.time_constant is None:
            raise InputError(f"{self.name}: kind = \"gauss-markov\" needs a time_constant in s")

    @property
    def enters(self) -> str:
        """Where it enters, in a word."""
        return "process" if self.gain else "input, as a scale" if self.column is None else "measurement"

    def motion(self, length: PerRun) -> tuple[Array, Array]:
        """phi and the variance of what is added over `length` seconds, each (S or 1,); parts add up to the whole."""
        h = np.atleast_1d(np.asarray(length, dtype=float))
        if self.kind == "gauss-markov":
            assert self.time_constant is not None
            return np.exp(-h / self.time_constant), -self.sd**2 * np.expm1(-2 * h / self.time_constant)
        return np.ones_like(h), self.sd**2 * h if self.kind == "walk" else np.zeros_like(h)


def augmented(model: DesignModel, extras: Sequence[Extra]) -> DesignModel:
    """The design model with extra states behind its own; every estimator runs on it unchanged.

    A scale on an input, or matrices that change with the step, cost it `linear`; an extra state that moves without a
    bound costs it `bounds`; an inclusion speaks of the base model's states and goes too, as does a grid's stacked form:
    who needs them refuses. Each mode gets the same extra states. Raises
    InputError for a scale where the setting gives no `input_jacobian`."""
    if not extras:
        return model
    if model.input_jacobian is None and any(extra.input is not None for extra in extras):
        raise InputError("a scale on an input needs the design model's input_jacobian: this setting gives none")
    parts = _Parts(model, tuple(extras))
    base, count, runs = model.nx, len(extras), model.initial_mean.shape[1]
    start = np.zeros((base + count, base + count, 1))
    start[:base, :base] = model.initial_covariance
    for i, extra in enumerate(extras):
        start[base + i, base + i] = (extra.sd if extra.start_sd is None else extra.start_sd) ** 2
    given = (model.transition_jacobian, model.measurement_jacobian, model.process_covariance)
    return replace(
        model, states=(*model.states, *(extra.name for extra in extras)), appended=model.appended + count,
        transition=parts.transition, measurement=parts.measurement,
        transition_jacobian=parts.transition_jacobian if given[0] else None,
        measurement_jacobian=parts.measurement_jacobian if given[1] else None,
        process_covariance=parts.process_covariance if given[2] else None,
        input_jacobian=None,
        initial_mean=np.concatenate([model.initial_mean, np.repeat([[extra.mean] for extra in extras], runs, axis=1)]),
        initial_covariance=start, linear=parts.linear(), bounds=parts.bounds(), inclusion=None, densities=None,
        modes=None if model.modes is None else replace(model.modes, grid=None, modes=tuple(
            replace(mode, model=augmented(mode.model, extras)) for mode in model.modes.modes)),
        performance=None if model.performance is None else
        np.pad(model.performance, ((0, 0), (0, count))))


class _Parts:
    """The functions of an augmented model. Arrays carry runs last; x may have axes of sigma points in between."""

    def __init__(self, model: DesignModel, extras: tuple[Extra, ...]) -> None:
        self.model, self.extras, self.nx = model, extras, model.nx
        self.scales = [(i, extra.input) for i, extra in enumerate(extras) if extra.input is not None]
        self.kept = 1.0 - max(extra.instead for extra in extras)

    def transition(self, x: Array, u: Array, interval: Interval) -> Array:
        n = self.nx
        out = np.empty(x.shape)
        if not self.scales or x.ndim == 2:
            out[:n] = self.model.transition(x[:n], self._scaled(x[n:], u), interval)
        else:  # each sigma point has an input of its own
            points, moved = x.reshape(len(x), -1, x.shape[-1]), out.reshape(len(x), -1, x.shape[-1])
            for j in range(points.shape[1]):
                own = np.ascontiguousarray(points[:n, j])
                moved[:n, j] = self.model.transition(own, self._scaled(points[n:, j], u), interval)
        between = (1,) * (x.ndim - 2)
        for i, extra in enumerate(self.extras):
            phi, _ = extra.motion(interval.length)
            out[n + i] = phi * x[n + i]
            if extra.gain:
                gain = extra.gain(interval)
                out[:n] += gain.reshape(n, *between, gain.shape[-1]) * x[n + i]
        return out

    def transition_jacobian(self, x: Array, u: Array, interval: Interval) -> Array:
        n, size, told = self.nx, self.nx + len(self.extras), self._scaled(x[self.nx:], u)
        assert self.model.transition_jacobian is not None
        blocks: list[tuple[int | slice, int | slice, Array]] = [
            (slice(n), slice(n), self.model.transition_jacobian(x[:n], told, interval))]
        slopes = self.model.input_jacobian(x[:n], told, interval) if self.scales and self.model.input_jacobian else None
        for i, extra in enumerate(self.extras):
            blocks.append((n + i, n + i, extra.motion(interval.length)[0]))
            if extra.gain:
                blocks.append((slice(n), n + i, extra.gain(interval)))
            if extra.input is not None and slopes is not None:
                blocks.append((slice(n), n + i, -slopes[:, extra.input] * told[extra.input] / (1 + x[n + i])))
        return _filled(size, size, blocks)

    def process_covariance(self, x: Array, u: Array, interval: Interval) -> Array:
        n, size = self.nx, self.nx + len(self.extras)
        assert self.model.process_covariance is not None
        own = self.model.process_covariance(x[:n], self._scaled(x[n:], u), interval)
        return _filled(size, size, [(slice(n), slice(n), own if self.kept == 1.0 else self.kept * own), *(
            (n + i, n + i, extra.motion(interval.length)[1]) for i, extra in enumerate(self.extras))])

    def measurement(self, x: Array, step: int) -> Array:
        out = self.model.measurement(x[:self.nx], step)
        for i, extra in enumerate(self.extras):
            if extra.column is not None:
                out = out + extra.column.reshape(-1, *(1,) * (x.ndim - 1)) * x[self.nx + i]
        return out

    def measurement_jacobian(self, x: Array, step: int) -> Array:
        n = self.nx
        assert self.model.measurement_jacobian is not None
        return _filled(self.model.ny, n + len(self.extras), [
            (slice(None), slice(n), self.model.measurement_jacobian(x[:n], step)),
            *((slice(None), n + i, extra.column[:, None])
              for i, extra in enumerate(self.extras) if extra.column is not None)])

    def linear(self) -> Linear | None:
        """The matrices of whole steps, where there are such and they are always the same."""
        base = self.model.linear
        if base is None or not base.constant or self.scales:
            return None
        n, count, period = self.nx, len(self.extras), self.model.period
        whole = Interval(1, 0.0, period)
        moved, noisy = np.zeros((n + count, n + count)), np.zeros((n + count, n + count))
        moved[:n, :n], noisy[:n, :n] = base.A(0), self.kept * base.Q(0)
        for i, extra in enumerate(self.extras):
            phi, variance = extra.motion(period)
            moved[n + i, n + i], noisy[n + i, n + i] = phi[0], variance[0]
            if extra.gain:
                moved[:n, n + i] = extra.gain(whole)[:, 0]
        seen = np.zeros((self.model.ny, n + count))
        seen[:, :n] = base.C(0)
        for i, extra in enumerate(self.extras):
            if extra.column is not None:
                seen[:, n + i] = extra.column
        driven, drift = np.pad(base.B(0), ((0, count), (0, 0))), np.pad(base.h(0), (0, count))
        return Linear(lambda k: moved, lambda k: driven, lambda k: drift, lambda k: seen, lambda k: noisy, base.R,
                      True, base.steps)

    def bounds(self) -> Bounds | None:
        """Columns of G for what drives the extra states, behind those of the base that are left."""
        base, n, count = self.model.bounds, self.nx, len(self.extras)
        moving = [i for i, extra in enumerate(self.extras) if extra.kind != "constant"]
        if base is None or self.scales or any(self.extras[i].bound is None for i in moving):
            return None
        left = [] if self.kept == 0.0 else list(range(base.G.shape[1]))
        drive = np.zeros((n + count, len(moving)))
        drive[[n + i for i in moving], range(len(moving))] = 1.0
        part, kappa = base.part, base.kappa

        def joined(G: Array) -> Array:
            """(nx + extras, nw, ..) from the base's."""
            own = np.pad(G[:, left], ((0, count), (0, 0), *((0, 0),) * (G.ndim - 2)))
            more = drive.reshape(*drive.shape, *(1,) * (G.ndim - 2))
            return np.concatenate([own, np.broadcast_to(more, (*drive.shape, *G.shape[2:]))], axis=1)

        return Bounds(
            G=joined(base.G), v_bar=base.v_bar,
            w_bar=np.array([*(self.kept**0.5 * base.w_bar[left]), *(self.extras[i].bound or 0.0 for i in moving)]),
            M=None if base.M is None else np.pad(base.M, ((0, count), (0, 0))),
            N=None if base.N is None else np.pad(base.N, ((0, 0), (0, count))),
            kappa=None if kappa is None else
            lambda x, u, Pi: kappa(x[:n], u, np.ascontiguousarray(Pi[:n, :n])),
            part=None if part is None else lambda interval: joined(part(interval)))

    def _scaled(self, e: Array, u: Array) -> Array:
        """The input (nu, S) as the extra states e (extras, S) have it."""
        if not self.scales:
            return u
        out = np.array(u, dtype=float)
        for i, j in self.scales:
            out[j] = u[j] / (1 + e[i])
        return out


def _filled(rows: int, columns: int, blocks: Sequence[tuple[int | slice, int | slice, Array]]) -> Array:
    """(rows, columns, S or 1) from its blocks (.., S or 1), the rest zero."""
    out = np.zeros((rows, columns, max(block.shape[-1] for *_, block in blocks)))
    for row, column, block in blocks:
        out[row, column] = block
    return out

