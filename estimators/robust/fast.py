"""The recursive robust estimators F2 and F3 in compiled form: the gain and bound of every run, one step at a time.

Fixed multipliers make the convex problem a Riccati step, a fixed gain gives the multipliers in closed form; the two
alternate, run by run, to each run's own convergence, so that a run's numbers do not depend on its batch."""

from __future__ import annotations

import numpy as np

from ..kernels.core import inner, kernel
from .gain import best_gain
from .raw import raw_measurement
from .small import TINY, contraction

TOLERANCE = 1e-10
"""Relative fall of the objective at which the alternation ends. Any multipliers give a valid bound: ending is safe."""

MOST = 3000
OPEN, CLOSED = 1e-3, 1e-9
"""Least share of a multiplier in the first round (a source that had vanished may come back) and later."""

FAR = 1e6
"""sigma = 1/lam - c2 stays within c2 / FAR .. c2 FAR."""


@inner
def _multipliers(G, K, m, L, p, c2, M, g, R, ellipsoid, root):  # pyright: ignore
    """Best multipliers of a fixed gain: root (1 + nw + m,) are the sources' sizes, shares are root / sum(root).

    Returns (objective, sigma), with 1/lam = c2 + sigma. Source 0 is the error carried over, then the disturbance
    channels, then (ellipsoid) the sensors."""
    n, nw = G.shape[0], g.shape[1]
    carried, c1, c3, noise = 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += G[i, k] * L[k, j]
            carried += total * G[i, j]
    sigma = 0.0
    if c2 > 0.0:
        for i in range(n):
            a, b = 0.0, 0.0
            for k in range(n):
                a += G[i, k] * p[k]
                b += G[i, k] * M[k]
            c1 += a * a
            c3 += b * b
        sigma = np.sqrt(c1 / c3) if c3 > 0.0 else FAR * c2
        sigma = min(max(sigma, c2 / FAR), FAR * c2)
        carried += c1 / sigma + c3 * (c2 + sigma)
    root[0] = np.sqrt(max(carried, 0.0))
    whole = root[0]
    for w in range(nw):
        total = 0.0
        for i in range(n):
            a = 0.0
            for k in range(n):
                a += G[i, k] * g[k, w]
            total += a * a
        root[1 + w] = np.sqrt(total)
        whole += root[1 + w]
    for j in range(m):
        if ellipsoid:
            total = 0.0
            for i in range(n):
                total += K[i, j] * K[i, j]
            root[1 + nw + j] = np.sqrt(R[j, j] * total)
            whole += root[1 + nw + j]
        else:
            for i in range(n):
                for k in range(m):
                    noise += K[i, j] * R[j, k] * K[i, k]
    return whole * whole + noise, sigma


@inner
def _relaxed(old, new):  # pyright: ignore
    """old (new / old)^1.5: over-relaxation, which keeps the fixed point and takes about two thirds of the rounds."""
    ratio = new / old
    return old * ratio * np.sqrt(ratio)


@inner
def _shares(root, previous, sources, least, first):  # pyright: ignore
    """Shares of the sources, summing to one, into `previous`; a source that is exactly nothing keeps `least`."""
    whole, total = 0.0, 0.0
    for j in range(sources):
        whole += root[j]
    for j in range(sources):
        new = root[j] / whole if whole > 0.0 else 1.0 / sources
        if not first and new > 0.0:
            new = _relaxed(previous[j], new)
        previous[j] = max(new, least)
        total += previous[j]
    for j in range(sources):
        previous[j] /= total


@inner
def _spread(L, p, c2, sigma, M, g, share, S):  # pyright: ignore
    """S = [L + p p'/sigma + M M' (c2 + sigma)] / share_0 + sum over channels of g g' / share."""
    n, nw = L.shape[0], g.shape[1]
    for i in range(n):
        for j in range(i + 1):
            total = L[i, j]
            if c2 > 0.0:
                total += p[i] * p[j] / sigma + M[i] * M[j] * (c2 + sigma)
            total /= share[0]
            for w in range(nw):
                total += g[i, w] * g[j, w] / share[1 + w]
            S[i, j] = total
            S[j, i] = total


@inner
def _complement(K, C, m, G):  # pyright: ignore
    """G = I - K C."""
    n = G.shape[0]
    for i in range(n):
        for k in range(n):
            total = 1.0 if i == k else 0.0
            for j in range(m):
                total -= K[i, j] * C[j, k]
            G[i, k] = total


@inner
def _bound(G, K, m, L, p, c2, sigma, M, g, R, share, ellipsoid, work, columns, P):  # pyright: ignore
    """P = G S G' + K R~ K', G taken to each term of S first: S itself may be huge where G M or G g is all but zero."""
    n, nw = G.shape[0], g.shape[1]
    for i in range(n):
        columns[i] = 0.0
        for k in range(n):
            if c2 > 0.0:
                columns[i, 0] += G[i, k] * p[k] / np.sqrt(sigma * share[0])
                columns[i, 1] += G[i, k] * M[k] * np.sqrt((c2 + sigma) / share[0])
            for w in range(nw):
                columns[i, 2 + w] += G[i, k] * g[k, w] / np.sqrt(share[1 + w])
            total = 0.0
            for j in range(n):
                total += G[i, j] * L[j, k]
            work[i, k] = total
    for i in range(n):
        for l in range(i + 1):
            total = 0.0
            for k in range(n):
                total += work[i, k] * G[l, k]
            total /= share[0]
            for w in range(2 + nw):
                total += columns[i, w] * columns[l, w]
            for j in range(m):
                if ellipsoid:
                    total += K[i, j] * R[j, j] * K[l, j] / share[1 + nw + j]
                else:
                    for q in range(m):
                        total += K[i, j] * K[l, q] * R[j, q]
            P[i, l] = total
            P[l, i] = total


@kernel
def recursive_step(Pi, moved, A, M, N, kappa, gw, C, R, received, ellipsoid, K, P, stability, verdict):  # pyright: ignore
    """Gain K and bound P of every run; sources and notation as in the page's F2 (ellipsoid) and F3.

    Pi (n, n, S): the last bound. moved (S,): runs with a prediction; the others keep P = Pi if nothing was received.
    A (n, n, S or 1). M, N (n,), kappa (S,): linearisation error A + M Delta kappa N. gw (n, nw, S or 1): columns of
    disturbance times their bounds. C (ny, n, S or 1). R (ny, ny, S or 1): second moments of the noise (F3), or
    diag(v_bar^2) (ellipsoid). received (ny, S). Written: K (n, ny, S), read first as the warm start, columns of sensors
    not received left alone; P (n, n, S); stability (S,) = max |(I - K C)(A + M Delta N)|^2 of this step where it is
    above the old value; verdict (S,): 0, 1 innovation matrix singular, 2 bound not finite (both with K = 0, P = Pi)."""
    n, runs = Pi.shape[0], Pi.shape[2]
    ny, nw = C.shape[0], gw.shape[1]
    L, S, G = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    V, a, b = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    W, Cr, Rr, k, at = np.empty((ny, ny)), np.empty((ny, n)), np.empty((ny, ny)), np.empty((n, ny)), np.empty((n, n))
    p, row, scaled, u, g = np.empty(n), np.empty(max(n, ny)), np.empty(n), np.empty((n, nw)), np.empty((n, nw))
    columns, raw_gain, tall = np.empty((n, 2 + nw)), np.empty((n, n)), np.empty((n + 2 + nw + ny, ny + n))
    root, share, rows = np.empty(1 + nw + ny), np.empty(1 + nw + ny), np.empty(ny, dtype=np.int64)
    for s in range(runs):
        sa, sc, sg = s if A.shape[2] > 1 else 0, s if C.shape[2] > 1 else 0, s if gw.shape[2] > 1 else 0
        sr, m = s if R.shape[2] > 1 else 0, np.int64(0)
        verdict[s] = 0
        for j in range(ny):
            if received[j, s]:
                rows[m] = j
                m += 1
        for j in range(m):
            for i in range(n):
                Cr[j, i], k[i, j] = C[rows[j], i, sc], K[i, rows[j], s]
            for l in range(m):
                Rr[j, l] = R[rows[j], rows[l], sr]
        if m == 0 and not moved[s]:
            for i in range(n):
                for l in range(n):
                    P[i, l, s] = Pi[i, l, s]
            continue
        c2 = 0.0
        for i in range(n):
            for w in range(nw):
                g[i, w] = gw[i, w, sg]
            scaled[i] = kappa[s] * N[i]
            for l in range(n):
                at[i, l] = A[i, l, sa]
        for i in range(n):
            row[i] = 0.0
            for l in range(n):
                row[i] += Pi[i, l, s] * scaled[l]
        for i in range(n):
            c2 += scaled[i] * row[i]
            p[i] = 0.0
            for l in range(n):
                p[i] += at[i, l] * row[l]
                total = 0.0
                for q in range(n):
                    total += at[i, q] * Pi[q, l, s]
                a[i, l] = total
        c2 = 0.0 if c2 <= TINY else c2
        for i in range(n):
            for l in range(i + 1):
                total = 0.0
                for q in range(n):
                    total += a[i, q] * at[l, q]
                L[i, l], L[l, i] = total, total
        sources = 1 + nw + (m if ellipsoid else 0)
        good, last, begun, sigma, now, best = True, np.inf, np.nan, 0.0, 0.0, 0.0
        raw = ellipsoid and m == n and raw_measurement(L, g, Cr, Rr, raw_gain, G, V, u, row)
        if raw:
            for i in range(n):
                for j in range(n):
                    k[i, j] = raw_gain[i, j]
        for turn in range(MOST):
            _complement(k, Cr, m, G)
            now, best = _multipliers(G, k, m, L, p, c2, M, g, Rr, ellipsoid, root)
            if raw or m == 0 or turn == MOST - 1 or abs(last - now) <= TOLERANCE * now:
                break
            last = now
            begun = now if turn == 0 else begun
            _shares(root, share, sources, OPEN if turn == 0 else CLOSED, turn == 0)
            if c2 > 0.0:
                sigma = best if turn == 0 else min(max(_relaxed(sigma, best), c2 / FAR), c2 * FAR)
            _spread(L, p, c2, sigma, M, g, share, S)
            good = best_gain(S, L, p, c2, sigma, M, g, Cr, m, Rr, share, ellipsoid, W, tall, k)
            if not good:
                break
        if not (good and now < 1e100 and c2 < 1e100):
            verdict[s] = 1 if not good and begun < 1e100 else 2
            for i in range(n):
                for j in range(ny):
                    K[i, j, s] = 0.0
                for l in range(n):
                    P[i, l, s] = Pi[i, l, s]
            continue
        _shares(root, share, sources, CLOSED, True)
        for i in range(n):
            for j in range(m):
                K[i, rows[j], s] = k[i, j]
        _bound(G, k, m, L, p, c2, best, M, g, Rr, share, ellipsoid, a, columns, S)
        for i in range(n):
            for l in range(n):
                P[i, l, s] = S[i, l]
        stability[s] = max(stability[s], contraction(G, at, M, scaled, a, b))
