"""How small the best estimator's error is, step by step: Riccati's recursion at the truth, on the run's own readings.

The optimum of a linear Gaussian setting, the conditional posterior Cramer-Rao bound of a nonlinear one (Tichavsky,
Muravchik, Nehorai, IEEE TSP 46(5), 1998, eq. (21) given the truth)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...estimators.kernels.core import congruence, kernel
from ...estimators.kernels.riccati import covariance_update
from ...scenarios.arrays import Array, Mask
from ...scenarios.channels import TryOnceDiscard
from ...scenarios.measurement import Interval, Measurement, PerRun
from ...scenarios.setting import Matched, Quantity, Setting
from ...scenarios.world import Event, Step, World, step_times


def basis(setting: Setting[Any], runs: int) -> Matched | None:
    """What a setting's floor follows from; None where it has none: its own noise has no such model, or a channel hands
    on old values as fresh ones or picks readings by their content.

    With faults of sensors, readings count as if they were right: what nobody can do better than is then said to be
    without faults. What arrives late counts from when it arrives, at its stamp."""
    channel = setting.config.channel
    if any(isinstance(link, TryOnceDiscard) or getattr(link, "silent", "nothing") == "hold"
           for link in (channel, getattr(channel, "loss", channel))):
        return None
    found = setting.matched(runs)
    return replace(found, kind=f"{found.kind} without faults") if found and setting.config.faults else found


def floor_kind(setting: Setting[Any]) -> str:
    """What a setting's floor is called; empty where there is none."""
    found = basis(setting, 1)
    return found.kind if found else ""


@dataclass(frozen=True)
class Floor:
    """The least mean squares of S runs: squares (K, nq, S) at each step, NaN where a run is not scored; total, counted
    (nq, S): their sums over the steps, and how many. In the square of each quantity's unit."""

    quantities: tuple[Quantity, ...]
    squares: Array
    total: Array
    counted: Array

    def of(self, positions: list[int]) -> Floor:
        """Some of the runs."""
        return Floor(self.quantities, self.squares[:, :, positions], self.total[:, positions],
                     self.counted[:, positions])

    def outcomes(self, metrics: Mapping[tuple[str, str], Array]) -> dict[tuple[str, str, str], Array]:
        """{("floor", quantity, unit)}, root mean square over the steps (S,), and {("efficiency", quantity, "1")}, the
        same over the run's RMSE (of one run it may be over 1), of what `metrics` has an RMSE."""
        out: dict[tuple[str, str, str], Array] = {}
        for q, item in enumerate(self.quantities):
            error = metrics.get(("rmse", item.name))
            if error is not None:
                least = np.sqrt(self.total[q] / np.where(self.counted[q] > 0, self.counted[q], np.nan))
                out["floor", item.name, item.unit] = least
                out["efficiency", item.name, "1"] = least / np.where(error > 0, error, np.nan)
        return out


def floor_of(setting: Setting[Any], world: World, predicted: bool) -> Floor | None:
    """The floor of an open-loop world, the same for all estimators that are scored at the same time."""
    found = basis(setting, world.initial_mean.shape[1])
    if found is None:
        return None
    riccati = Riccati(setting, found, world, predicted)
    for k in range(world.steps):
        step = world.step(k, world.initial_mean)
        if not step.active.any():
            break
        riccati.take(k, step)
    return riccati.finish()


@dataclass
class _Past:
    """An event: the covariance before it, the prediction that leads to it and its measurement."""

    step: int
    number: int
    before: Array
    motion: tuple[Array, Array] | None
    reading: tuple[Array, Array, Mask]


class Riccati:
    """P- = F P F' + Q, P = P- less what the readings received tell; steps are taken in order. predicted: P- is what
    counts, not P.

    P is kept as (nx, nx, 1) as long as all runs share it. A late reading is taken at its stamp, and all since once
    more."""

    def __init__(self, setting: Setting[Any], matched: Matched, world: World, predicted: bool) -> None:
        self.matched, self.model, self.predicted = matched, matched.model, predicted
        self.quantities, self.runs = setting.quantities(), world.initial_mean.shape[1]
        self.skip = int(np.searchsorted(step_times(world), setting.config.score.skip - 1e-9))
        self.longest = getattr(setting.config.channel, "longest", 0)
        self.parts = [(i, w * w, q, 1 / len(item.components) if item.mean else 1.0, 1 / len(item.components))
                      for q, item in enumerate(self.quantities) for i, w in item.components]
        self.elements = np.array(sorted({part[0] for part in self.parts}), dtype=np.int64)
        self.diagonal = self.elements * (self.model.nx + 1)
        self.covariance = np.array(self.model.initial_covariance, dtype=float, order="C")
        self.failed = np.zeros(self.runs, dtype=bool)
        self.truth = np.ascontiguousarray(self.model.initial_mean)
        self.past: list[_Past] = []
        self.variances, self.active, self.scored = list[Array](), list[Mask](), list[Mask | None]()

    def take(self, k: int, step: Step) -> None:
        """One step of the world."""
        gone: PerRun = 0.0
        last, there = len(step.events) - 1, self._padded(step.truth)
        for number, event in enumerate(step.events):
            share, motion = event.share, None
            if not (isinstance(share, float) and share == 0.0):
                motion = self._motion(step.u, Interval(step.number, step.start + gone * step.length,
                                                       share * step.length, share))
            gone = gone + share
            before = self.covariance
            if motion:
                self._predict(*motion)
            if number == last and self.predicted:
                self._note(k, step)
            reading = self._reading(there if number == last else self.truth, event.received, step.number)
            self._update(*reading)
            if self.longest:
                self.past.append(_Past(step.number, number, before, motion, reading))
                if event.late is not None:
                    self._post(event, step.number, number)
        if self.longest:
            self._late(step.number)
        if not self.predicted:
            self._note(k, step)
        self.truth = there

    def finish(self) -> Floor:
        """What the steps so far give."""
        count, runs, n = len(self.variances), self.runs, len(self.quantities)
        variance = np.empty((count, len(self.elements), runs))
        for k, each in enumerate(self.variances):
            variance[k] = each
        active = np.array(self.active, dtype=bool).reshape(count, runs)
        scored = np.ones(variance.shape, dtype=bool)
        for k, mask in enumerate(self.scored):
            if mask is not None:
                scored[k] = mask[self.elements]
        squares, total, counted = np.zeros((count, n, runs)), np.zeros((n, runs)), np.zeros((n, runs))
        place = np.searchsorted(self.elements, [part[0] for part in self.parts])
        weight, share, part_of = (np.array([part[i] for part in self.parts], dtype=float) for i in (1, 3, 4))
        mean = np.array([item.mean for item in self.quantities])
        _add_up(variance, active, scored, place, weight, np.array([part[2] for part in self.parts]), share, part_of,
                mean, squares, total, counted)
        squares[~np.broadcast_to(active[:, None], squares.shape)] = np.nan
        return Floor(self.quantities, np.concatenate([np.full((self.skip, n, runs), np.nan), squares]), total, counted)

    def _padded(self, truth: Array) -> Array:
        """The truth vector with zeros for what the model has besides."""
        n = self.model.nx
        return truth if len(truth) == n else truth[:n] if len(truth) > n else np.concatenate(
            [truth, np.zeros((n - len(truth), truth.shape[1]))])

    def _motion(self, u: Array, interval: Interval) -> tuple[Array, Array]:
        model = self.model
        assert model.transition_jacobian is not None and model.process_covariance is not None
        return (np.ascontiguousarray(model.transition_jacobian(self.truth, u, interval)),
                np.ascontiguousarray(model.process_covariance(self.truth, u, interval)))

    def _reading(self, truth: Array, received: Mask, step: int) -> tuple[Array, Array, Mask]:
        model = self.model
        assert model.measurement_jacobian is not None and model.measurement_covariance is not None
        return (np.ascontiguousarray(model.measurement_jacobian(truth, step)), np.ascontiguousarray(
            model.measurement_covariance(Measurement(truth, received, step))), received)

    def _predict(self, f: Array, q: Array) -> None:
        wide = self.runs if f.shape[2] > 1 or q.shape[2] > 1 else 1
        before = self._shared(wide)
        self.covariance = np.empty_like(before)
        congruence(f, before, q, self.covariance)

    def _update(self, h: Array, r: Array, received: Mask) -> None:
        same = self.covariance.shape[2] == 1 and h.shape[2] == r.shape[2] == 1 and (
            received.all() or not (received != received[:, :1]).any())
        self.covariance = self._shared(1 if same else self.runs)
        if self.longest:
            self.covariance = self.covariance.copy()
        covariance_update(self.covariance, received[:, :1] if same else received, h, r, self.failed)

    def _shared(self, wide: int) -> Array:
        """The covariance, of so many runs at the least."""
        p = self.covariance
        return np.repeat(p, wide, axis=2) if p.shape[2] < wide else p

    def _post(self, event: Event, step: int, number: int) -> None:
        """Keep what comes late with its event."""
        self.waiting = getattr(self, "waiting", [])
        assert event.late is not None
        self.waiting += [(step + age, step, number, event.late == age)
                         for age in np.unique(event.late[event.late > 0]).tolist()]

    def _late(self, now: int) -> None:
        """Take what arrives in a step at its stamp, and all events since once more."""
        self.past = [entry for entry in self.past if entry.step >= now - self.longest]
        due = [item for item in getattr(self, "waiting", []) if item[0] == now]
        if not due:
            return
        self.waiting = [item for item in self.waiting if item[0] > now]
        first = len(self.past)
        for _, step, number, mask in due:
            place = next(i for i, entry in enumerate(self.past) if (entry.step, entry.number) == (step, number))
            h, r, received = self.past[place].reading
            self.past[place].reading = h, r, received | mask
            first = min(first, place)
        self.covariance = self.past[first].before
        for entry in self.past[first:]:
            entry.before = self.covariance
            if entry.motion:
                self._predict(*entry.motion)
            self._update(*entry.reading)

    def _note(self, k: int, step: Step) -> None:
        if k < self.skip:
            return
        p, elements, beyond = self.covariance, self.elements, self.matched.beyond
        if beyond is not None:
            p = p + np.diag(beyond)[:, :, None]
        if self.matched.outward is None:
            self.variances.append(p.reshape(-1, p.shape[2])[self.diagonal])
        else:
            found = np.zeros((len(elements), self.runs))
            _turned(self.matched.outward(step.truth), np.ascontiguousarray(p), elements, found)
            self.variances.append(found)
        self.active.append(step.active)
        self.scored.append(step.scored)


@kernel
def _turned(t, p, elements, out):
    """out (m, S) += the diagonal entries `elements` of t p t'. t (nt, nx, S), p (nx, nx, S or 1)."""
    for place in range(elements.shape[0]):
        i = elements[place]
        for a in range(p.shape[0]):
            for b in range(p.shape[1]):
                for s in range(out.shape[1]):
                    out[place, s] += t[i, a, s] * p[a, b, s if p.shape[2] > 1 else 0] * t[i, b, s]


@kernel
def _add_up(variance, active, scored, place, weight, owner, share, part_of, mean, squares, total, counted):
    """squares (K, nq, S) := the quantities' mean squares; total, counted (nq, S) += them and their number, over the
    elements that are scored (K, m, S), in the order of the steps. variance (K, m, S)."""
    for k in range(variance.shape[0]):
        for r in range(place.shape[0]):
            i, q = place[r], owner[r]
            for s in range(variance.shape[2]):
                value = share[r] * weight[r] * variance[k, i, s]
                squares[k, q, s] += value
                if active[k, s]:
                    if scored[k, i, s]:
                        total[q, s] += value
                    if scored[k, i, s] or not mean[q]:
                        counted[q, s] += part_of[r]
