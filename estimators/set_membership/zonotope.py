"""The zonotopic set-membership filter: a zonotope of few generators that holds the state, cut by every reading's strip.

Zonotope: x in c + H [-1, 1]^m; its order is reduced by boxes."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field, PositiveFloat, PositiveInt

from ...scenarios.arrays import Array
from ...scenarios.errors import Unsupported
from ...scenarios.measurement import Interval, Measurement
from ...scenarios.model import DesignModel, bounds_of
from ...scenarios.randomness import RunRandom
from ..interface import Estimate, Estimator, Parameters, Status, flag
from ..kernels.core import inner, kernel

SHRINKS = 1.0 - 1e-9
"""A cut has to take this much off the half-widths' product, more than rounding does."""
OUTWARD = 1e-12
"""Share of its parts by which a tightened strip is widened for rounding."""


class ZonotopeParameters(Parameters):
    """Parameters of the zonotopic filter."""

    order: Annotated[PositiveInt, Field(
        description="most generators that are carried on, as a multiple of the number of states")] = 10
    tight: Annotated[bool, Field(
        description="strips are cut to the zonotope's own width first, and the cut of least half-widths is taken; "
                    "false: always the gain of least Frobenius norm")] = True
    initial_sds: Annotated[PositiveFloat, Field(
        description="half-widths of the first box in standard deviations of P0")] = 1.0


class ZonotopicFilter(Estimator):
    """c^- = f(c, u), H^- = [A R(H), M kappa |N H|_1, G w_bar]; then for each reading j with its bound v_j the strip

    |y_j - C_j x| <= v_j: c = c + l (y_j - C_j c), H = [(I - l C_j) H, l v_j], which holds what is in both for every l.
    l = H H' C_j' / (C_j H H' C_j' + v_j^2) is of least |H|_F, for all readings together Combastel's gain; it averages
    readings, whose worst cases do not average out. tight: the strip is first cut to what the zonotope allows of C_j x,
    then of this l, the one without v_j^2, C_j' / (C_j C_j') and no cut that one which leaves the least product of
    half-widths.

    R keeps the longest generators, lengths in units of the zonotope's half-widths, and puts a box round the rest.
    Claims the ellipsoid (sum a_j) sum h_j h_j' / a_j with a_j those lengths, which holds the zonotope.

    A reading that the zonotope cannot explain says that a bound is wrong; it then stands alone, l = C_j' / (C_j C_j').
    `inconsistency` (S,): the largest |y_j - C_j c| / (|C_j H|_1 + v_j) so far; bounds that hold keep it under 1.
    Sensors without a finite bound are not used. Truths outside the bounds (Gaussian tails, a gradient step between
    estimate and truth, a nonlinear sensor's curvature) are outside the guarantee."""

    family = "Set membership"
    summary = "zonotopic set-membership filter: bounded disturbance and noise, generators reduced"
    source = ("Combastel, Automatica 55, 2015; reduction: Combastel, ECC 2003; strips: Alamo, Bravo, Camacho, "
              "Automatica 41, 2005; Le, Stoica, Alamo, Camacho, Dumur, Zonotopes, 2013; tightened: Vicino, Zappa, "
              "IEEE TAC 41, 1996")
    needs: ClassVar[tuple[str, ...]] = ("bounds", "transition_jacobian", "measurement_jacobian")
    claims = ("ellipsoid",)
    Parameters = ZonotopeParameters

    def design(self, model: DesignModel) -> dict[str, Any]:
        """Nothing to be found offline; refuses (Unsupported) bounds that are infinite."""
        bounds = bounds_of(model)
        if not (np.isfinite(bounds.w_bar).all() and np.isfinite(bounds.v_bar).any()):
            raise Unsupported("ZonotopicFilter needs finite disturbance bounds w_bar and a sensor with a finite bound")
        return {}

    def start(self, model: DesignModel, runs: int, random: RunRandom) -> None:
        super().start(model, runs, random)
        bounds, n = bounds_of(model), model.nx
        self._x = model.initial_mean.copy()
        self._keep = self.parameters.order * n
        self._H = np.zeros((n, self._keep + max(bounds.G.shape[1] + 1, model.ny), runs))
        sd = np.sqrt(np.diagonal(model.initial_covariance)).T  # (n, 1 or S)
        for i in range(n):
            self._H[i, i] = self.parameters.initial_sds * sd[i]
        self._count = np.full(runs, n)
        self._M = np.zeros(n) if bounds.M is None else np.array(bounds.M[:, 0])
        self._N = np.zeros(n) if bounds.N is None else np.array(bounds.N[0])
        self._usable = np.isfinite(bounds.v_bar)
        self._v = np.where(self._usable, bounds.v_bar, 0.0)
        self._Pi, self._failed = np.empty((n, n, runs)), np.zeros(runs, dtype=bool)
        self.inconsistency = np.zeros(runs)

    def predict(self, u: Array, interval: Interval) -> None:
        model, bounds, x = self.model, bounds_of(self.model), self._x
        assert model.transition_jacobian is not None
        moved = interval.moving(self.runs)
        part = moved & (np.asarray(interval.length) != model.period)
        g = (bounds.G * bounds.w_bar)[:, :, None]
        if part.any():
            if bounds.part is None or bounds.M is not None:
                flag(self, part, Status.infeasible, "the bounds hold for whole sampling periods only")
            else:
                g = bounds.part(interval) * bounds.w_bar[:, None]
        kappa = np.zeros(self.runs) if bounds.kappa is None else np.array(bounds.kappa(x, u, self._ellipsoid()))
        A = np.array(model.transition_jacobian(x, u, interval), order="C")
        self._x = np.where(moved, model.transition(x, u, interval), x)
        grow(self._H, self._count, self._keep, A, self._M, self._N, kappa, np.array(g, order="C"), np.array(moved),
             self._failed)
        if self._failed.any():
            flag(self, self._failed, Status.failed, "the zonotope is not finite: kappa, the bounds or the estimate "
                                                    "left the range of numbers")

    def update(self, measurement: Measurement) -> None:
        model, x = self.model, self._x
        assert model.measurement_jacobian is not None
        C = np.array(model.measurement_jacobian(x, measurement.step), order="C")
        received = measurement.received & self._usable[:, None]
        residual = np.where(received, measurement.y - model.measurement(x, measurement.step), 0.0)
        cut(self._x, self._H, self._count, self._keep, self.parameters.tight, C, self._v, residual, received,
            self.inconsistency)

    def _ellipsoid(self) -> Array:
        enclose(self._H, self._count, self._Pi)
        return self._Pi

    def estimate(self) -> Estimate:
        return Estimate(self._x, ellipsoid=self._ellipsoid())

    def extremes(self) -> dict[str, Array]:
        return {"inconsistency": self.inconsistency}


@inner
def lengths(H, m, s, out):  # pyright: ignore
    """out (>= m,): lengths of run s's generators with each state in units of the zonotope's half-width."""
    out[:m] = 0.0
    for i in range(H.shape[0]):
        half = 0.0
        for j in range(m):
            half += abs(H[i, j, s])
        if half > 0.0:
            for j in range(m):
                out[j] += (H[i, j, s] / half) ** 2
    for j in range(m):
        out[j] = np.sqrt(out[j])


@inner
def reduce(H, m, keep, s):  # pyright: ignore
    """Run s's m generators as at most keep in place: the longest stay, a box takes the rest. Returns how many."""
    if m <= keep:
        return m
    n = H.shape[0]
    size, old = np.empty(m), H[:, :m, s].copy()
    lengths(H, m, s, size)
    order = np.arange(m)
    for j in range(1, m):  # by falling length, equal ones as they stood
        own, k = order[j], j
        while k > 0 and size[order[k - 1]] < size[own]:
            order[k] = order[k - 1]
            k -= 1
        order[k] = own
    for i in range(n):
        for j in range(keep - n):
            H[i, j, s] = old[i, order[j]]
        H[i, keep - n:keep, s] = 0.0
        for j in range(keep - n, m):
            H[i, keep - n + i, s] += abs(old[i, order[j]])
    return keep


@kernel
def grow(H, count, keep, A, M, N, kappa, g, moved, failed):  # pyright: ignore
    """H (n, cap, S) := [A R(H), M kappa |N H|_1, g] of the runs that moved; count (S,): how many generators are theirs.

    A (n, n, S or 1), M and N (n,), kappa (S,), g (n, nw, S or 1). failed (S,) is set where H is not finite."""
    n = H.shape[0]
    column = np.empty(n)
    for s in range(H.shape[2]):
        if not moved[s]:
            continue
        a, b = s if A.shape[2] > 1 else 0, s if g.shape[2] > 1 else 0
        m, spread, total = reduce(H, count[s], keep, s), 0.0, 0.0
        for j in range(m):
            along = 0.0
            for i in range(n):
                column[i] = H[i, j, s]
                along += N[i] * column[i]
            spread += abs(along)
            for i in range(n):
                H[i, j, s] = 0.0
                for k in range(n):
                    H[i, j, s] += A[i, k, a] * column[k]
        if kappa[s] != 0.0:
            for i in range(n):
                H[i, m, s] = M[i] * kappa[s] * spread
            m += 1
        for w in range(g.shape[1]):
            for i in range(n):
                H[i, m, s] = g[i, w, b]
            m += 1
        for j in range(m):
            for i in range(n):
                total += abs(H[i, j, s])
        failed[s] |= not np.isfinite(total)
        count[s] = m


@inner
def shrinkage(H, m, s, seen, gain, bar):  # pyright: ignore
    """Product of the half-widths after a cut over that before it, of run s; seen (>= m,) = C_j H, gain (n,), bar v."""
    size = 1.0
    for i in range(H.shape[0]):
        before, after = 0.0, abs(gain[i]) * bar
        for j in range(m):
            before += abs(H[i, j, s])
            after += abs(H[i, j, s] - gain[i] * seen[j])
        if before > 0.0:
            size *= after / before
    return size


@kernel
def cut(x, H, count, keep, tight, C, v, residual, received, inconsistency):  # pyright: ignore
    """x (n, S) and H (n, cap, S) cut by the strips of the readings received (ny, S), one after the other.

    C (ny, n, S or 1), v (ny,), residual (ny, S): y - h(x) at the x that is given."""
    n, ny = x.shape[0], received.shape[0]
    seen, gains, moved = np.empty(H.shape[1]), np.empty((3, n)), np.empty(n)
    for s in range(x.shape[1]):
        c, m = s if C.shape[2] > 1 else 0, count[s]
        moved[:] = 0.0
        for l in range(ny):
            if not received[l, s]:
                continue
            if m == count[s]:
                m = reduce(H, m, keep, s)
            power, reach, left, bar, square = 0.0, 0.0, residual[l, s], v[l], 0.0
            for i in range(n):
                left -= C[l, i, c] * moved[i]
                square += C[l, i, c] ** 2
            for j in range(m):
                seen[j] = 0.0
                for i in range(n):
                    seen[j] += C[l, i, c] * H[i, j, s]
                power += seen[j] * seen[j]
                reach += abs(seen[j])
            if left != 0.0:
                inconsistency[s] = max(inconsistency[s], abs(left) / (reach + bar))
            low, high = max(left - bar, -reach), min(left + bar, reach)
            if tight and low <= high:
                left, bar = 0.5 * (low + high), 0.5 * (high - low) + OUTWARD * (reach + bar)
            if not power + bar * bar > 0.0:
                continue
            for i in range(n):
                total = 0.0
                for j in range(m):
                    total += H[i, j, s] * seen[j]
                gains[0, i], gains[1, i] = total / (power + bar * bar), total / power if power > 0.0 else 0.0
                gains[2, i] = C[l, i, c] / square
            best = 2 if low > high else 0
            if tight and low <= high:
                best, least = -1, SHRINKS
                for choice in range(3):
                    size = shrinkage(H, m, s, seen, gains[choice], bar)
                    if size < least:
                        best, least = choice, size
            if best < 0:
                continue
            gain = gains[best]
            for i in range(n):
                for j in range(m):
                    H[i, j, s] -= gain[i] * seen[j]
                H[i, m, s] = gain[i] * bar
                moved[i] += gain[i] * left
            m += 1
        for i in range(n):
            x[i, s] += moved[i]
        count[s] = m


@kernel
def enclose(H, count, Pi):  # pyright: ignore
    """Pi (n, n, S) of the ellipsoid (sum a_j) sum h_j h_j' / a_j round each run's zonotope."""
    n, size = H.shape[0], np.empty(H.shape[1])
    for s in range(H.shape[2]):
        m, total = count[s], 0.0
        lengths(H, m, s, size)
        for j in range(m):
            total += size[j]
        for i in range(n):
            for k in range(i + 1):
                entry = 0.0
                for j in range(m):
                    if size[j] != 0.0:
                        entry += H[i, j, s] * H[k, j, s] / size[j]
                Pi[i, k, s] = Pi[k, i, s] = total * entry
