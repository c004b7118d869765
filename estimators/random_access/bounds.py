"""Bounds of the random access filter's covariance: Theorems 2 to 4 and Proposition 1 of Zou, Wang, Han, Zhou.

Pure analysis of a linear model and its protocol over a horizon; the filter itself lives in `random_access.py`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...scenarios.model import Linear, Reception

Array = NDArray[np.floating[Any]]  # what numpy's linear algebra returns

SIGMA_MAX, M_MAX = 1e6, 20
"""How far a pair for Theorem 4 is searched."""
DIGITS = 4
"""A sigma that was searched for is given with this many significant digits, rounded up."""


@dataclass(frozen=True)
class Condition:
    """Verdict on (30), (31) for one pair. steps, least, holds (n,): each k of (30), the least eigenvalue of its left
    side, and whether that reaches 1 / sigma. mu_holds: (31)."""

    sigma: float
    m: int
    steps: NDArray[np.int64]
    least: Array
    holds: NDArray[np.bool_]
    mu_holds: bool

    @property
    def verified(self) -> bool:
        """Whether (30) and (31) hold at every step of the horizon, so that P <= sigma I there."""
        return self.mu_holds and bool(self.holds.all())


class CovarianceBounds:
    """Assumption 1's constants and the bounds that follow, over the steps 1 .. horizon, or as many as are known.

    Scalars q_low, q_high, r_low, r_high, c, c_hat, a_low, a_high as in Assumption 1, p_low, p_high of the access
    probabilities; extremes over the horizon. Sensors that no node owns never transmit and are left out.
    P0 (nx, nx). Matrices may vary with the step as in `Linear`."""

    def __init__(self, linear: Linear, reception: Reception, P0: Array, horizon: int) -> None:
        owned = [index for node in reception.nodes for index in node]
        sizes = [len(node) for node in reception.nodes]
        horizon = min(horizon, linear.steps or horizon)
        self.horizon, self.mu0 = horizon, float(np.linalg.eigvalsh(P0)[-1])
        self.p = np.array(reception.p)
        self.node = np.repeat(np.arange(len(sizes)), sizes)
        self.weight = self.p[self.node]
        steps = range(horizon)
        self.A = np.array([linear.A(k) for k in steps])
        self.Q = np.array([linear.Q(k) for k in steps])
        self.C = np.array([linear.C(k + 1)[owned] for k in steps])
        self.R = np.array([linear.R(k + 1)[np.ix_(owned, owned)] for k in steps])
        self.q_low, self.q_high = _extremes(self.Q)
        within = self.node[:, None] == self.node
        self.r_high = _extremes(np.where(within, self.R, 0.0))[1]
        self.r_low = _extremes(self.weight[:, None] * self.R * self.weight)[0]
        self.c = _extremes(_turned(self.C) @ self.C)[1]
        self.c_hat = _extremes(self.C @ _turned(self.C))[1]
        self.a_low, self.a_high = _extremes(self.A @ _turned(self.A))
        self.p_low, self.p_high = float(self.p.min()), float(self.p.max())

    @cached_property
    def lower(self) -> float:
        """Theorem 2, (21): P >= lower I at k > 0. Nothing (0) where B Q B' or Phi R Phi is singular."""
        if self.q_low <= 0 or self.r_low <= 0:
            return 0.0
        return 1 / (1 / self.q_low + self.p_high**2 * self.c / self.r_low)

    @cached_property
    def mu(self) -> Array:
        """Theorem 3: P <= mu[k] I, k = 0 .. horizon, shape (horizon + 1,)."""
        mu = np.empty(self.horizon + 1)
        mu[0] = self.mu0
        for k in range(self.horizon):
            mu[k + 1] = self.a_high * mu[k] + self.q_high
        return mu

    @property
    def uniform(self) -> float | None:
        """Proposition 1: a bound of every mu[k], k > 0, where a_high < 1; else None."""
        if self.a_high >= 1:
            return None
        return self.mu0 * self.a_high + self.q_high / (1 - self.a_high)

    def check(self, sigma: float, m: int) -> Condition:
        """Theorem 4: do (30), (31) hold for this pair? Then P <= sigma I.

        As printed, (31) ends at k = m - 2 and (30) starts at k = m - 1; that leaves P(m-1|m-1) to neither and lets the
        first window count a measurement at k = 0, where the filter takes none. So (31) is asked for k = 0 .. m here
        and (30) for k = m .. horizon - 1. Each term is exact: C(i) enters it twice. Raises ValueError for m < 1,
        m >= horizon, sigma <= 0."""
        if sigma <= 0 or not 1 <= m < self.horizon:
            raise ValueError(f"needs sigma > 0 and m = 1 .. {self.horizon - 1}; got sigma = {sigma:g}, m = {m}")
        least = np.linalg.eigvalsh(self.terms(sigma, m).sum(axis=0)[m:])[:, 0]
        return Condition(sigma, m, np.arange(m, self.horizon), least, least >= 1 / sigma,
                         bool(self.mu[:m + 1].max() <= sigma))

    def search(self, sigma_max: float = SIGMA_MAX, m_max: int = M_MAX) -> tuple[float, int] | None:
        """The least sigma (to four digits) for which some m <= m_max meets (30), (31), and the least such m; None
        where there is none up to sigma_max.

        Exact up to those digits: both conditions get easier as sigma grows, and (30) as m grows, (31) harder."""
        low, high = max(self.mu0, 1e-12), sigma_max
        if not (high > low and self._met(high, m_max)):
            return None
        while high / low > 1 + 10.0**-DIGITS / 4:
            middle = float(np.sqrt(low * high))
            low, high = (low, middle) if self._met(middle, m_max) else (middle, high)
        unit = 10.0 ** (np.floor(np.log10(high)) + 1 - DIGITS)
        sigma = float(f"{np.ceil(high / unit) * unit:.{DIGITS}g}")
        m = next((m for m in range(1, m_max + 1) if m < self.horizon and self.check(sigma, m).verified), None)
        return None if m is None else (sigma, m)

    def _met(self, sigma: float, m_max: int) -> bool:
        """Whether the pair with the largest m that (31) admits is verified."""
        admitted = np.flatnonzero(np.maximum.accumulate(self.mu) <= sigma)
        m = min(m_max, self.horizon - 1, len(admitted) - 1)
        return m >= 1 and self.check(sigma, m).verified

    def terms(self, sigma: float, m: int) -> Array:
        """The m + 1 terms of (30)'s left side at each k = 0 .. horizon - 1, those of i = k + 1, k, .., in this order,
        (m + 1, horizon, nx, nx); zero where i would be below 1. Their sum is the left side for k >= m."""
        if self.lower > 0 and self.a_low > 0:
            gamma = 1 / (1 + self.q_high / (self.a_low * self.lower))
            back = np.linalg.inv(self.A)
        else:
            gamma, back = 0.0, np.zeros_like(self.A)
        out = np.zeros((m + 1, *self.A.shape))
        out[0] = self._information(sigma)
        for lag in range(1, m + 1):
            out[lag, 1:] = gamma * (_turned(back[1:]) @ out[lag - 1, :-1] @ back[1:])
        return out

    def _information(self, sigma: float) -> Array:
        """C' Phi (sigma a_high c_hat (1 - p_low)^2 I + Theta)^-1 Phi C of the measurements 1 .. horizon."""
        CQC = self.C @ self.Q @ _turned(self.C)
        same = self.node[:, None] == self.node
        w = self.weight
        spread = np.where(same, w[:, None] * (1 - w), -w[:, None] * w)
        theta = spread * CQC + np.where(same, w[:, None] * self.R, 0.0)
        inner = theta + sigma * self.a_high * self.c_hat * (1 - self.p_low) ** 2 * np.eye(len(w))
        phi_C = w[:, None] * self.C
        return _turned(phi_C) @ np.linalg.solve(inner, phi_C)


def critical_access(linear: Linear, reception: Reception, steps: int = 120, digits: int = 3) -> float:
    """Remark 8's uncertainty threshold: the share of all access probabilities under which the filter's covariance (10),
    (11) grows without bounds, however good the sensors are (0: never; a plant of one state a: 1 - 1/a^2).

    What counts is the recursion of a large P, in which Q and R vanish: it grows or falls by a factor a step, taken
    over the second half of `steps` steps; bisection to `digits` decimals."""
    def growth(share: float) -> float:
        P, total = np.eye(len(linear.A(0))), 0.0
        for k in range(steps):
            after = (1 - share * sum(reception.p)) * P
            for node, p in zip(reception.nodes, reception.p, strict=True):
                c = linear.C(k + 1)[list(node)]
                left = np.eye(len(P)) - np.linalg.lstsq(c @ P @ c.T, c @ P, rcond=1e-12)[0].T @ c
                after = after + share * p * (left @ P @ left.T)
            P = linear.A(k + 1) @ after @ linear.A(k + 1).T
            size = float(np.trace(P))
            if not size > 0:
                return -np.inf  # one step tells it all
            P, total = P / size, total + (np.log(size) if 2 * k >= steps else 0.0)
        return total

    steps = min(steps, (linear.steps or steps + 1) - 1)
    low, high = 0.0, 1.0
    if growth(high) > 0:
        return 1.0
    if growth(low) <= 0:
        return 0.0
    while high - low > 10.0**-digits / 2:
        middle = (low + high) / 2
        low, high = (middle, high) if growth(middle) > 0 else (low, middle)
    return (low + high) / 2


def _turned(stack: Array) -> Array:
    return np.swapaxes(stack, -1, -2)


def _extremes(stack: Array) -> tuple[float, float]:
    """Least and greatest eigenvalue over a stack of symmetric matrices; a least one of rounding size is 0."""
    values = np.linalg.eigvalsh(stack)
    low, high = float(values.min()), float(values.max())
    return (0.0 if abs(low) <= 1e-12 * abs(high) else low), high
