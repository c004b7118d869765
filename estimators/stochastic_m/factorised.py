"""The factorised step of the grid particle filters: one Kalman gain per run, three dot products per particle.

Where theta acts only through exactly known states and inputs, P, S, K are common, log-likelihoods quadratic in it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...scenarios.arrays import Array, Index
from ...scenarios.errors import Unsupported
from ...scenarios.machine_code import njit
from ...scenarios.model import Grid
from ..kernels.modes import normalise
from ..mode_grid import known_states
from .gain import Factors, gain_of, innovation, pair_product
from .select import collapse, distinct, select


class Cloud(NamedTuple):
    """Particles of all runs, particles innermost: x (S, nu, capacity), theta (S, capacity) grid index, logw
    (S, capacity); P (S, nu, nu) and known (S, nk) common to a run's particles; alive (S,)."""

    x: Array
    theta: Index
    logw: Array
    P: Array
    known: Array
    alive: NDArray[np.bool_]


class Moments(NamedTuple):
    """What a step hands out: mean (nu, S), known (nk, S), parameter (1, S), covariance (nu, nu, S), diversity (S,),
    log_likelihood (S,): log p(y received | before) plus the log sum of the weights from before."""

    mean: Array
    known: Array
    parameter: Array
    covariance: Array
    diversity: Array
    log_likelihood: Array


def factors_of(modes: Grid, initial_covariance: Array) -> Factors:
    """Split the modes. Raises Unsupported where theta acts on uncertain states, or not proportionally."""
    k = known_states(modes, initial_covariance)
    u = ~k
    grid, A, B = modes.grid, modes.A, modes.B
    span = grid[-1] - grid[0] if len(grid) > 1 else 1.0
    A1, B1 = (A[-1] - A[0]) / span, (B[-1] - B[0]) / span
    A0, B0 = A[0] - grid[0] * A1, B[0] - grid[0] * B1
    theta = grid[:, None, None]
    bent = max(np.abs(A0 + theta * A1 - A).max(), np.abs(B0 + theta * B1 - B).max(initial=0.0))
    if bent > 1e-12 or np.abs(A1[np.ix_(u, u)]).max(initial=0.0) > 1e-14:
        raise Unsupported(f"form = \"factorised\" needs {modes.name} to act proportionally, and only through states "
                          "that are known exactly (initial variance 0, no process noise); use form = \"full\"")
    arrays = (A[0][np.ix_(u, u)], A0[np.ix_(u, k)], A1[np.ix_(u, k)], B0[u], B1[u], A[0][np.ix_(k, k)], B[0][k],
              modes.C[:, u], modes.C[:, k], modes.Q[np.ix_(u, u)], grid)
    return Factors(*(np.ascontiguousarray(array, dtype=float) for array in arrays))


def still(factors: Factors) -> Factors:
    """The same model with time standing still, for a second measurement at the same instant."""
    zero = {name: np.zeros_like(getattr(factors, name)) for name in ("D0", "D1", "B0", "B1", "Bk", "Q")}
    return factors._replace(F=np.eye(len(factors.F)), Ak=np.eye(len(factors.Ak)), **zero)


@njit(cache=True, inner=True)
def _dot(a, b, n):
    """Sum of a[i] b[i] in four interleaved partial sums (a fixed order, four times as fast as one)."""
    p, q, r, s = 0.0, 0.0, 0.0, 0.0
    whole = n - n % 4
    for i in range(0, whole, 4):
        p += a[i] * b[i]
        q += a[i + 1] * b[i + 1]
        r += a[i + 2] * b[i + 2]
        s += a[i + 3] * b[i + 3]
    for i in range(whole, n):
        p += a[i] * b[i]
    return (p + q) + (r + s)


@njit(cache=True, inner=True)
def _weigh(model, gain, z, x, theta, n, before, children, log_prior, work, value, logw):
    """Child values and log weights (n g,): log w' = before + log p(theta'|theta) - |z0 - M x - theta' q|^2 / 2, three
    dot products per parent. work (3, n) is scratch. Returns what is left out, being the same for all children."""
    nu, g = len(x), children.shape[1]
    M = gain[3]
    z_i, square, pair_product = work[0], work[1], work[2]
    square[:], pair_product[:] = 0.0, 0.0
    gamma, common = 0.0, 0.0
    for a in range(len(M)):
        gamma += z[a, 1] * z[a, 1]
        z_i[:] = z[a, 0]
        sees = z[a, 1] != 0.0
        for l in range(nu):
            factor = M[a, l]
            if factor != 0.0:
                sees = True
                for i in range(n):
                    z_i[i] -= factor * x[l, i]
        if sees:  # a measurement of known states alone weighs all particles equally
            factor = z[a, 1]
            for i in range(n):
                square[i] += z_i[i] * z_i[i]
                pair_product[i] += z_i[i] * factor
        elif np.isfinite(z[a, 0]):
            common -= 0.5 * z[a, 0] * z[a, 0]
        else:
            square[:] = np.nan
    tried, less = np.empty(children.shape), np.empty(children.shape)
    for row in range(len(children)):
        for j in range(g):
            tried[row, j] = model.grid[children[row, j]]
            less[row, j] = 0.5 * gamma * tried[row, j]
    for i in range(n):
        base, pair = before[i] - 0.5 * square[i], pair_product[i]
        values, shares, takes = tried[theta[i]], log_prior[theta[i]], less[theta[i]]
        for j in range(g):
            value[i * g + j] = values[j]
            logw[i * g + j] = base + shares[j] + values[j] * (pair - takes[j])
    return common


@njit(cache=True, inner=True)
def _moments(gain, e, x, w, value, picked, count, work, out, s):
    """Mean and covariance over the children, from sums over the parents (eqs. (19), (22)); writes column s of out."""
    nu, n = len(x), len(work[0])
    G, P = gain[5], gain[6]
    weight, first, second = work[0], work[1], work[2]
    each = count // n  # children of one parent: g, or the one the optimal proposal has drawn
    for i in range(n):
        a, b, d = 0.0, 0.0, 0.0
        for c in range(i * each, (i + 1) * each):
            v = value[c] if each > 1 else value[picked[c]]
            a += w[c]
            b += w[c] * v
            d += w[c] * v * v
        weight[i], first[i], second[i] = a, b, d
    parameter, square = 0.0, 0.0
    for i in range(n):
        parameter += first[i]
        square += second[i]
    centred = second  # which has been summed up
    variance = max(square - parameter * parameter, 0.0)
    mean, cross, spread, off = np.empty(nu), np.empty(nu), np.empty((nu, nu)), np.empty((nu, n))
    for i in range(n):
        first[i] -= parameter * weight[i]
    for l in range(nu):
        mean[l] = _dot(weight, x[l], n)
        for i in range(n):
            off[l, i] = x[l, i] - mean[l]
        cross[l] = _dot(first, off[l], n)
    for l in range(nu):
        for i in range(n):
            centred[i] = weight[i] * off[l, i]
        for m in range(l + 1):
            spread[l, m] = spread[m, l] = _dot(centred, off[m], n)
    moved = pair_product(pair_product(G, spread, False), G, True)
    out.parameter[0, s] = parameter
    for l in range(nu):
        out.mean[l, s] = e[l, 0] + parameter * e[l, 1]
        for m in range(nu):
            out.mean[l, s] += G[l, m] * mean[m]
            lean = 0.0
            for k in range(nu):
                lean += G[l, k] * cross[k] * e[m, 1] + G[m, k] * cross[k] * e[l, 1]
            out.covariance[l, m, s] = P[l, m] + moved[l, m] + lean + variance * e[l, 1] * e[m, 1]


@njit(cache=True)
def step(model, children, log_prior, cloud, n, u, y, received, R, draws, keep, by_weight, memoryless, optimal, commit,
         out):
    """Expand, weigh, estimate and (commit) select, for every run, with n particles each.

    children, log_prior (m, g): grid indices theta' and log p(theta'|theta). u (S, inputs), y, received (S, ny), R (ny,
    ny, S or 1), draws (S, d): [0] for resampling, the others for the optimal proposal. keep: particles to select, 0 for
    all. memoryless: weights (17), (18) without the parent's. commit = False: only `out`, the cloud stays as it is."""
    runs, nu, _ = cloud.x.shape
    g = children.shape[1]
    logw, w, value = np.empty(n * g), np.empty(n * g), np.empty(n * g)
    picked, owner, work, before = np.arange(n * g), np.arange(n * g) // g, np.empty((3, n)), np.zeros(n)
    count = n if optimal else n * g
    goes_on = keep if keep > 0 else count
    index, kept, origin = np.empty(goes_on, np.int64), np.empty(goes_on), np.empty(goes_on, np.int64)
    x_old, theta_new, kept_value = np.empty((nu, goes_on)), np.empty(goes_on, np.int64), np.empty(goes_on)
    seen = np.empty(len(model.grid), np.bool_)
    now, shift, e = np.empty(cloud.known.shape[1]), np.empty((nu, 2)), np.empty((nu, 2))
    P_before, heard, noise = cloud.P[0].copy(), received[0].copy(), R[:, :, 0].copy()
    gain, constant = gain_of(model, P_before, heard, noise)
    for s in range(runs):
        if not cloud.alive[s]:
            continue
        # Runs with the same history of receptions have the same covariance: its gain is computed once for them all.
        if not (np.array_equal(cloud.P[s], P_before) and np.array_equal(received[s], heard)
                and (R.shape[2] == 1 or np.array_equal(R[:, :, s], noise))):
            P_before[:], heard[:] = cloud.P[s], received[s]
            noise[:] = R[:, :, s if R.shape[2] > 1 else 0]
            gain, constant = gain_of(model, P_before, heard, noise)
        x, theta, G = cloud.x[s], cloud.theta[s], gain[5]  # whole rows: contiguous, so that loops vectorise
        z = np.empty((len(gain[0]), 2))
        innovation(model, gain, cloud.known[s], u[s], y[s], now, shift, z, e)
        if not memoryless:
            before[:] = cloud.logw[s, :n]
        common = _weigh(model, gain, z, x, theta, n, before, children, log_prior, work, value, logw)
        if optimal:
            collapse(logw, n, g, draws[s], picked, w)
        total = normalise(logw, count, w)
        if np.isnan(total):
            cloud.alive[s] = False
            out.mean[:, s], out.known[:, s], out.parameter[0, s] = np.nan, np.nan, np.nan
            out.covariance[:, :, s], out.diversity[s], out.log_likelihood[s] = np.nan, np.nan, np.nan
            continue
        out.log_likelihood[s] = total + common + constant
        _moments(gain, e, x, w, value, picked, count, work, out, s)
        out.known[:, s] = now
        if not commit:
            out.diversity[s] = distinct(theta, cloud.logw[s], n, seen)
            continue
        select(logw, w, count, total, keep, by_weight, draws[s, 0], index, kept)
        for j in range(goes_on):
            c = picked[index[j]]
            origin[j] = owner[c]
            theta_new[j] = children[theta[origin[j]], c - origin[j] * g]
            kept_value[j] = value[c]
        for m in range(nu):
            for j in range(goes_on):
                x_old[m, j] = x[m, origin[j]]
        for l in range(nu):
            for j in range(goes_on):
                x[l, j] = e[l, 0] + kept_value[j] * e[l, 1]
            for m in range(nu):
                factor = G[l, m]
                if factor != 0.0:
                    for j in range(goes_on):
                        x[l, j] += factor * x_old[m, j]
        cloud.theta[s, :goes_on] = theta_new
        cloud.logw[s, :goes_on] = kept
        cloud.P[s], cloud.known[s] = gain[6], now
        out.diversity[s] = distinct(theta_new, kept, goes_on, seen)
    return goes_on
