"""The memoryless robust estimator F1 in compiled form: per step and run, a gain in n instead of n * ny unknowns.

The problem is min over K, eps of eps |N|^2 + tr X' (I - g g'/eps)^-1 X with X = [G A, G B, -K D] and g = G M; the best
eps gives |X|^2 + |N|^2 |g|^2 + 2 |N| |X'g|. With S = A A' + B B', V = C S C' + D D', K0 = S C' V^-1 and m = C M,
X X' = Q0 + (K - K0) V (K - K0)', and the optimum has K = K0 + z m' V^-1: a convex problem in g = G M alone."""

from __future__ import annotations

import numpy as np

from ..kernels.core import inner, kernel
from .small import SMALLEST_PIVOT, TINY, contraction, factorise_one, largest_eigenvalue, solve_one


@inner
def _value(g, g0, Q0, beta, nu):  # pyright: ignore
    """(f, q, g'(g0 - g)): f = |g0 - g|^2/beta + nu |g|^2 + 2 sqrt(nu q), q = g' Q0 g + (g'(g0 - g))^2/beta."""
    away, size, inner, form = 0.0, 0.0, 0.0, 0.0
    for i in range(len(g)):
        d = g0[i] - g[i]
        away += d * d
        size += g[i] * g[i]
        inner += g[i] * d
        for j in range(len(g)):
            form += g[i] * Q0[i, j] * g[j]
    q = max(form + inner * inner / beta, 0.0)
    return away / beta + nu * size + 2.0 * np.sqrt(nu * q), q, inner


@inner
def _reject(g, g0, Q0, beta, nu, H, slope, trial):  # pyright: ignore
    """Minimise f over g by damped Newton steps; exactly g = 0 where that kink is the optimum.

    The steps start below f(0) and only descend, so that they never get caught in a kink that is not the optimum."""
    n = len(g)
    scale = 1e-300
    for i in range(n):
        scale += Q0[i, i]
    # 0 lies in the subdifferential at g = 0 iff |W^-1/2 g0|^2 <= nu beta^2, W = Q0 + g0 g0'/beta = X X' there.
    for i in range(n):
        slope[i] = g0[i]
        for j in range(n):
            H[i, j] = Q0[i, j] + g0[i] * g0[j] / beta
        H[i, i] += 1e-14 * scale
    if factorise_one(H, n, SMALLEST_PIVOT):
        solve_one(H, n, slope)
        total = 0.0
        for i in range(n):
            total += g0[i] * slope[i]
        for i in range(n):
            g[i] = 0.0
        if total <= nu * beta * beta:
            return
        # W^-1 g0 is the steepest way down from the kink.
        kink = _value(g, g0, Q0, beta, nu)[0]
        for i in range(n):
            trial[i] = slope[i]
        f = kink
        for _ in range(60):
            for i in range(n):
                g[i] = trial[i]
            f = _value(g, g0, Q0, beta, nu)[0]
            if f < kink:
                break
            for i in range(n):
                trial[i] *= 0.5
        if not _value(g0, g0, Q0, beta, nu)[0] > f:
            for i in range(n):
                g[i] = g0[i]
    else:
        for i in range(n):
            g[i] = g0[i]
    f, q, inner = _value(g, g0, Q0, beta, nu)
    for _ in range(60):
        if q <= 0.0:
            return
        h = np.sqrt(q)
        weight = np.sqrt(nu) / h
        for i in range(n):
            dq = 2.0 * inner / beta * (g0[i] - 2.0 * g[i])
            for j in range(n):
                dq += 2.0 * Q0[i, j] * g[j]
            slope[i] = dq
        for i in range(n):
            for j in range(n):
                value = 2.0 * Q0[i, j] + 2.0 / beta * (g0[i] - 2.0 * g[i]) * (g0[j] - 2.0 * g[j])
                if i == j:
                    value -= 4.0 * inner / beta
                value = weight * (value - slope[i] * slope[j] / (2.0 * q))
                if i == j:
                    value += 2.0 / beta + 2.0 * nu
                H[i, j] = value
        for i in range(n):
            slope[i] = weight * slope[i] + 2.0 * nu * g[i] - 2.0 / beta * (g0[i] - g[i])
            trial[i] = -slope[i]
        if factorise_one(H, n, SMALLEST_PIVOT):
            solve_one(H, n, trial)
        descent = 0.0
        for i in range(n):
            descent -= trial[i] * slope[i]
        if not descent > 1e-15 * f:
            return
        length = 1.0
        for _ in range(50):
            for i in range(n):
                g[i] += length * trial[i]
            new, q, inner = _value(g, g0, Q0, beta, nu)
            if new <= f - 1e-4 * length * descent:
                break
            for i in range(n):
                g[i] -= length * trial[i]
            length *= 0.5
        else:
            return
        f = new


@kernel
def memoryless_step(moved, A, M, N, kappa, Bw, D, C, received, mu, K, P, objective, stability, verdict):  # pyright: ignore
    """Gain of every run; notation as in the page's F1.

    moved (S,): runs with a prediction; the others are left alone if nothing was received. A (n, n, S or 1). M, N (n,),
    kappa (S,): linearisation error A + M Delta kappa N. Bw (n, nw, S or 1): columns of disturbance times their bounds.
    D (ny,): sensor bounds. C (ny, n, S or 1). received (ny, S): with none, K = 0. mu: P must stay under mu I.

    Written: K (n, ny, S); P (n, n, S); objective (S,) = tr P + tr Th; stability (S,) = |(I - KC)(A + M Delta N)|^2
    where it is above the old value; verdict (S,): 0, 1 innovation matrix singular, 2 not finite (both with K = 0),
    3 P << mu I does not hold at the optimum without it (numbers written)."""
    n, ny, nw, runs = A.shape[0], C.shape[0], Bw.shape[1], kappa.shape[0]
    S, Q0, G = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    H, a, b = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    V, Cr, k, rows = np.empty((ny, ny)), np.empty((ny, n)), np.empty((n, ny)), np.empty(ny, dtype=np.int64)
    at, g, g0, slope, trial, scaled = np.empty((n, n)), np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    seen, gained = np.empty(ny), np.empty(ny)
    for s in range(runs):
        sa, sc, sb = s if A.shape[2] > 1 else 0, s if C.shape[2] > 1 else 0, s if Bw.shape[2] > 1 else 0
        m = np.int64(0)
        verdict[s] = 0
        for i in range(n):
            for j in range(ny):
                K[i, j, s] = 0.0
        for j in range(ny):
            if received[j, s]:
                rows[m] = j
                for i in range(n):
                    Cr[m, i] = C[j, i, sc]
                m += 1
        if m == 0 and not moved[s]:
            continue
        nu = 0.0
        for i in range(n):
            scaled[i] = kappa[s] * N[i]
            nu += scaled[i] * scaled[i]
            for j in range(n):
                at[i, j] = A[i, j, sa]
        nu = 0.0 if nu <= TINY else nu
        for i in range(n):
            for j in range(n):
                total = 0.0
                for l in range(n):
                    total += at[i, l] * at[j, l]
                for l in range(nw):
                    total += Bw[i, l, sb] * Bw[j, l, sb]
                S[i, j] = total
        for i in range(n):
            for j in range(m):
                k[i, j] = 0.0
                for l in range(n):
                    k[i, j] += S[i, l] * Cr[j, l]
        for j in range(m):
            for l in range(j + 1):
                V[j, l] = D[rows[j]] ** 2 if j == l else 0.0
                for i in range(n):
                    V[j, l] += Cr[j, i] * k[i, l]
        finite = np.isfinite(nu)
        for i in range(n):
            finite &= np.isfinite(S[i, i])
        good = finite and factorise_one(V, m, SMALLEST_PIVOT)
        if good:
            beta = 0.0
            for i in range(n):
                solve_one(V, m, k[i])
            for j in range(m):
                seen[j] = 0.0
                for i in range(n):
                    seen[j] += Cr[j, i] * M[i]
                gained[j] = seen[j]
            solve_one(V, m, gained)
            for j in range(m):
                beta += seen[j] * gained[j]
            _residual(k, Cr, m, S, D, rows, M, G, Q0, g0, a)
            for i in range(n):
                g[i] = g0[i]
            if nu > 0.0 and beta > 0.0:
                _reject(g, g0, Q0, beta, nu, H, slope, trial)
                for i in range(n):
                    for j in range(m):
                        k[i, j] += (g0[i] - g[i]) / beta * gained[j]
                _residual(k, Cr, m, S, D, rows, M, G, Q0, g, a)
            size, q, value = 0.0, 0.0, 0.0
            for i in range(n):
                size += g[i] * g[i]
                value += Q0[i, i]
                for j in range(n):
                    q += g[i] * Q0[i, j] * g[j]
            q = max(q, 0.0)
            eps = size + np.sqrt(q / nu) if nu > 0.0 else 0.0
            weight = np.sqrt(nu / q) if q > 0.0 else 0.0
            objective[s] = value + nu * size + 2.0 * np.sqrt(nu * q)
            for i in range(n):
                slope[i] = 0.0
                for l in range(n):
                    total = 0.0
                    for j in range(n):
                        total += G[i, j] * at[j, l]
                    a[i, l] = total
            for i in range(n):
                for l in range(n):
                    slope[l] += g[i] * a[i, l]
            for i in range(n):
                for l in range(n):
                    total = eps * scaled[i] * scaled[l] + weight * slope[i] * slope[l]
                    for j in range(n):
                        total += a[j, i] * a[j, l]
                    P[i, l, s] = total
                    H[i, l] = total
            stability[s] = max(stability[s], contraction(G, at, M, scaled, a, b))
            good = finite = np.isfinite(objective[s])
        if not good:
            verdict[s] = 1 if finite else 2
        elif m > 0 and not largest_eigenvalue(H) < mu:
            verdict[s] = 3
        if good:
            for i in range(n):
                for j in range(m):
                    K[i, rows[j], s] = k[i, j]


@inner
def _residual(K, C, m, S, D, rows, M, G, Q, g, work):  # pyright: ignore
    """G = I - K C, Q = G S G' + K D D' K', g = G M."""
    n = S.shape[0]
    for i in range(n):
        g[i] = 0.0
        for l in range(n):
            total = 1.0 if i == l else 0.0
            for j in range(m):
                total -= K[i, j] * C[j, l]
            G[i, l] = total
            g[i] += total * M[l]
        for l in range(n):
            total = 0.0
            for j in range(n):
                total += G[i, j] * S[j, l]
            work[i, l] = total
    for i in range(n):
        for l in range(i + 1):
            total = 0.0
            for j in range(n):
                total += work[i, j] * G[l, j]
            for j in range(m):
                total += K[i, j] * D[rows[j]] ** 2 * K[l, j]
            Q[i, l] = total
            Q[l, i] = total


@kernel
def bound_step(P, objective, inputs, radius):  # pyright: ignore
    """The bound r of |e| after a step, in place: |e+| <= sqrt(lambda_max P) r + sqrt(n tr Th) for n inputs of size one
    at most (disturbances and sensors received over their bounds), tr Th = objective - tr P. radius, inputs (S,); no
    input, no step."""
    n = P.shape[0]
    H = np.empty((n, n))
    for s in range(len(radius)):
        if inputs[s] > 0:
            spread = objective[s]
            for i in range(n):
                spread -= P[i, i, s]
                for j in range(n):
                    H[i, j] = P[i, j, s]
            growth = np.sqrt(max(largest_eigenvalue(H), 0.0))
            radius[s] = growth * radius[s] + np.sqrt(inputs[s] * max(spread, 0.0))
