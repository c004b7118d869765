"""Compiled small-matrix algebra over arrays whose last axis is the runs: the handful of functions the filters share.

Plain loops over the small indices, the innermost over runs: fast, and bit-identical for any number of runs."""

from __future__ import annotations

import numpy as np

from ...scenarios.compiled import call
from ...scenarios.machine_code import njit

# No fastmath and no BLAS: both would make a run's bits depend on its neighbours. error_model: division by zero gives
# inf, as in NumPy, which keeps branches out of the inner loops.
kernel = njit(cache=True, error_model="numpy")
inner = njit(cache=True, error_model="numpy", inner=True)

HALF_LOG_TURN = 0.5 * np.log(2 * np.pi)
"""What each element takes off a Gaussian's log-density."""
SMALLEST_PIVOT_RATIO = 1e-14
"""A pivot under this share of its diagonal entry counts as zero (a direction without uncertainty)."""
INDEFINITE = 1e-9
"""A pivot under minus this share of its diagonal entry is an indefinite matrix, no rounding error."""


@inner
def tile_width(n, runs):
    """How many runs to take at a time: a few (n, n, width) arrays stay in the cache, and whole vectors fit."""
    return max(1, min(runs, max(64, 2048 // max(n, 1) // 32 * 32)))


@inner
def gather2(source, index, width, tile):
    """tile (n, >= width) := the runs index[:width], in increasing order, of source (n, S)."""
    first = index[0]
    if index[width - 1] - first == width - 1:
        for i in range(source.shape[0]):
            row, out = source[i, first:first + width], tile[i]
            for s in range(width):
                out[s] = row[s]
    else:
        for i in range(source.shape[0]):
            for s in range(width):
                tile[i, s] = source[i, index[s]]


@inner
def scatter2(tile, index, width, target):
    """Write tile (n, >= width) back to the runs index[:width] of target (n, S)."""
    first = index[0]
    if index[width - 1] - first == width - 1:
        for i in range(target.shape[0]):
            row, out = tile[i], target[i, first:first + width]
            for s in range(width):
                out[s] = row[s]
    else:
        for i in range(target.shape[0]):
            for s in range(width):
                target[i, index[s]] = tile[i, s]


@inner
def gather3(source, index, width, tile):
    """tile (n, m, >= width) := the runs index[:width] of source (n, m, S), or its one shared slice (n, m, 1)."""
    for i in range(source.shape[0]):
        if source.shape[2] == 1:
            for j in range(source.shape[1]):
                tile[i, j, 0] = source[i, j, 0]
        else:
            gather2(source[i], index, width, tile[i])


@inner
def scatter3(tile, index, width, target):
    """Write tile (n, m, >= width) back to the runs index[:width] of target (n, m, S)."""
    for i in range(target.shape[0]):
        scatter2(tile[i], index, width, target[i])


@kernel
def apply(matrix, x, out):
    """out (n, S) := matrix (n, m, S or 1) times x (m, S)."""
    for i in range(matrix.shape[0]):
        for s in range(x.shape[1]):
            out[i, s] = 0.0
        for k in range(matrix.shape[1]):
            if matrix.shape[2] == 1:
                factor = matrix[i, k, 0]
                for s in range(x.shape[1]):
                    out[i, s] += factor * x[k, s]
            else:
                for s in range(x.shape[1]):
                    out[i, s] += matrix[i, k, s] * x[k, s]


@inner
def _nonzero(one, two, columns):
    """columns[:count] := where either of two rows (n, 1) of a matrix that all runs share is not zero; count."""
    count = 0
    for k in range(one.shape[0]):
        columns[count] = k
        count += one[k, 0] != 0.0 or two[k, 0] != 0.0
    return count


@inner
def _half(f, p, t, width):
    """t (m, n, width) := f (m, n, width or 1) times p (n, n, width)."""
    m, n = f.shape[0], p.shape[0]
    columns, spare = np.empty(n, np.int64), np.empty(width)
    for i in range(0, m, 2 if f.shape[2] == 1 else 1):  # a pair of shared rows shares the loads of p
        if f.shape[2] == 1:
            one, two = f[i], f[min(i + 1, m - 1)]
            count = _nonzero(one, two, columns)
            for j in range(n):
                first, second, k = t[i, j], t[i + 1, j] if i + 1 < m else spare, 0
                for s in range(width):
                    first[s] = 0.0
                for s in range(width):
                    second[s] = 0.0
                while k + 4 <= count:  # four terms at a time: fewer loads and stores, the same order of additions
                    a, b, c, d = columns[k], columns[k + 1], columns[k + 2], columns[k + 3]
                    e0, e1, e2, e3 = one[a, 0], one[b, 0], one[c, 0], one[d, 0]
                    f0, f1, f2, f3 = two[a, 0], two[b, 0], two[c, 0], two[d, 0]
                    p0, p1, p2, p3 = p[a, j], p[b, j], p[c, j], p[d, j]
                    for s in range(width):
                        first[s] = (((first[s] + e0 * p0[s]) + e1 * p1[s]) + e2 * p2[s]) + e3 * p3[s]
                        second[s] = (((second[s] + f0 * p0[s]) + f1 * p1[s]) + f2 * p2[s]) + f3 * p3[s]
                    k += 4
                while k < count:
                    e0, f0, p0 = one[columns[k], 0], two[columns[k], 0], p[columns[k], j]
                    for s in range(width):
                        first[s] += e0 * p0[s]
                        second[s] += f0 * p0[s]
                    k += 1
        else:
            for j in range(n):
                for s in range(width):
                    t[i, j, s] = 0.0
            for k in range(n):
                for j in range(n):
                    for s in range(width):
                        t[i, j, s] += f[i, k, s] * p[k, j, s]


@inner
def _symmetric_half(t, f, q, out, width):
    """out (m, m, width) := t f' + q, of which the lower triangle is computed and mirrored; q (m, m, width or 1)."""
    n = t.shape[1]
    columns = np.empty(n, np.int64)
    for j in range(f.shape[0]):
        count = _nonzero(f[j], f[j], columns) if f.shape[2] == 1 else 0
        for i in range(j, f.shape[0]):
            for s in range(width):
                out[i, j, s] = q[i, j, 0] if q.shape[2] == 1 else q[i, j, s]
            if f.shape[2] == 1:
                k = 0
                while k + 4 <= count:
                    a, b, c, d = columns[k], columns[k + 1], columns[k + 2], columns[k + 3]
                    f0, f1, f2, f3 = f[j, a, 0], f[j, b, 0], f[j, c, 0], f[j, d, 0]
                    for s in range(width):
                        out[i, j, s] = (((out[i, j, s] + f0 * t[i, a, s]) + f1 * t[i, b, s])
                                        + f2 * t[i, c, s]) + f3 * t[i, d, s]
                    k += 4
                while k < count:
                    a, f0 = columns[k], f[j, columns[k], 0]
                    for s in range(width):
                        out[i, j, s] += f0 * t[i, a, s]
                    k += 1
            else:
                for k in range(n):
                    for s in range(width):
                        out[i, j, s] += f[j, k, s] * t[i, k, s]
            for s in range(width):
                out[j, i, s] = out[i, j, s]


@inner
def _alike(f, width, one):
    """Whether f (n, n, >= width) is the same for all runs, and if so what, one (n, n, 1)."""
    for i in range(f.shape[0]):
        for j in range(f.shape[1]):
            row, first, others = f[i, j], f[i, j, 0], 0
            for s in range(width):  # no way out inside: that would keep it from being vectorised
                others += row[s] != first
            one[i, j, 0] = first
            if others:
                return False
    return True


@kernel
def extended_predict(transition, jacobian, u, seconds, data, q, mean, covariance):
    """mean (n, S) := f(mean, u), covariance (n, n, S) := F covariance F' + q (n, n, S or 1), block by block, in place.

    transition, jacobian: compiled functions by address, and what both take (`compiled.SIGNATURE`)."""
    n, runs = mean.shape
    wide, lengths = tile_width(n, runs), seconds.reshape(1, runs)
    whole = wide == runs  # one tile: means and covariances are not copied
    index = np.empty(wide, np.int64)
    cubes = np.empty((2 * n if whole else 3 * n, n, wide))
    rows = np.empty((n + 1 + u.shape[0] + (0 if whole else n), wide))
    f, half, p = cubes[:n], cubes[n:2 * n], covariance if whole else cubes[2 * n:]
    moved, times, inputs = rows[:n], rows[n:n + 1], rows[n + 1:n + 1 + u.shape[0]]
    x = mean if whole else rows[n + 1 + u.shape[0]:]
    tile_q, one = q if q.shape[2] == 1 else np.empty((n, n, wide)), np.empty((n, n, 1))
    for first in range(0, runs, wide):
        width = min(wide, runs - first)
        for s in range(width):
            index[s] = first + s
        gather2(u, index, width, inputs)
        gather2(lengths, index, width, times)
        if q.shape[2] > 1:
            gather3(q, index, width, tile_q)
        if not whole:
            gather2(mean, index, width, x)
            gather3(covariance, index, width, p)
        call(transition, x, inputs, times, data, 1, width, wide, moved)
        call(jacobian, x, inputs, times, data, 1, width, wide, f)
        if _alike(f, width, one):  # a Jacobian that all share has zeros to be left out
            _half(one, p, half, width)
            _symmetric_half(half, one, tile_q, p, width)
        else:
            _half(f, p, half, width)
            _symmetric_half(half, f, tile_q, p, width)
        scatter2(moved, index, width, mean)
        if not whole:
            scatter3(p, index, width, covariance)


@kernel
def congruence(f, p, q, out):
    """out (m, m, S) := f p f' + q, exactly symmetric. f (m, n, S or 1), p (n, n, S), q (m, m, S or 1); out may be p."""
    m, n, runs = f.shape[0], f.shape[1], p.shape[2]
    wide = tile_width(n, runs)
    whole = wide == runs  # one tile: nothing is copied
    index, tile_t = np.empty(wide, np.int64), np.empty((m, n, wide))
    tile_f = f if whole else np.empty((m, n, 1 if f.shape[2] == 1 else wide))
    tile_q = q if whole else np.empty((m, m, 1 if q.shape[2] == 1 else wide))
    tile_p, tile_out = p if whole else np.empty((n, n, wide)), out if whole else np.empty((m, m, wide))
    for first in range(0, runs, wide):
        width = min(wide, runs - first)
        if not whole:
            for s in range(width):
                index[s] = first + s
            gather3(f, index, width, tile_f)
            gather3(q, index, width, tile_q)
            gather3(p, index, width, tile_p)
        _half(tile_f, tile_p, tile_t, width)
        _symmetric_half(tile_t, tile_f, tile_q, tile_out, width)
        if not whole:
            scatter3(tile_out, index, width, out)


@kernel
def predict(transition, u, seconds, data, f, q, mean, covariance):
    """mean (n, S) := f(mean, u) by a compiled transition (`compiled.SIGNATURE`), covariance := f covariance f' + q in
    place, see `congruence`."""
    runs, moved = mean.shape[1], np.empty_like(mean)
    call(transition, mean, u, seconds, data, 1, runs, runs, moved)
    mean[:, :] = moved
    congruence(f, covariance, q, covariance)


@inner
def factorise(matrix, factor, inverse, failed, definite, width):
    """Lower Cholesky factor (n, n, >= width) of the matrix's leading part, inverse (n, >= width) of its diagonal;
    failed (>= width,) is set where it has none.

    Only the lower triangle of the matrix is read. definite: a pivot must be positive. Otherwise a pivot of zero (to
    rounding: SINGULAR, INDEFINITE) is a direction without uncertainty and gets a column of zeros. Failed runs get
    NaN, so that nothing computed from them can pass for a number."""
    n = factor.shape[0]
    floor = 0.0 if definite else SMALLEST_PIVOT_RATIO
    slack = 0.0 if definite else INDEFINITE
    for j in range(n):
        for s in range(width):
            factor[j, j, s] = matrix[j, j, s]
        for k in range(j):
            for s in range(width):
                factor[j, j, s] -= factor[j, k, s] * factor[j, k, s]
        for s in range(width):
            pivot, scale = factor[j, j, s], matrix[j, j, s]
            good = pivot > 0.0 if definite else pivot >= -slack * abs(scale)
            positive = pivot > floor * scale
            root = np.sqrt(pivot) if positive else 0.0
            factor[j, j, s] = root if good else np.nan
            inverse[j, s] = 1.0 / root if positive else 0.0
            failed[s] |= not good
        for i in range(j + 1, n):
            for s in range(width):
                factor[i, j, s] = matrix[i, j, s]
                factor[j, i, s] = 0.0
            k = 0
            while k + 4 <= j:  # four terms at a time: fewer loads and stores, the same order of subtractions
                for s in range(width):
                    factor[i, j, s] = (((factor[i, j, s] - factor[i, k, s] * factor[j, k, s])
                                        - factor[i, k + 1, s] * factor[j, k + 1, s])
                                       - factor[i, k + 2, s] * factor[j, k + 2, s]
                                       ) - factor[i, k + 3, s] * factor[j, k + 3, s]
                k += 4
            while k < j:
                for s in range(width):
                    factor[i, j, s] -= factor[i, k, s] * factor[j, k, s]
                k += 1
            if not definite:
                for s in range(width):  # nothing may be correlated with a direction without uncertainty
                    most = slack * abs(matrix[i, i, s] * matrix[j, j, s])
                    bad = inverse[j, s] == 0.0 and factor[i, j, s] * factor[i, j, s] > most
                    factor[i, j, s] = np.nan if bad else factor[i, j, s]
                    failed[s] |= bad
            for s in range(width):
                factor[i, j, s] *= inverse[j, s]


@inner
def forward(factor, inverse, rhs, width):
    """rhs (n, m, >= width) := factor^-1 rhs, in place."""
    for i in range(rhs.shape[0]):
        for j in range(rhs.shape[1]):
            for k in range(i):
                for s in range(width):
                    rhs[i, j, s] -= factor[i, k, s] * rhs[k, j, s]
            for s in range(width):
                rhs[i, j, s] *= inverse[i, s]


@inner
def backward(factor, inverse, rhs, width):
    """rhs (n, m, >= width) := factor^-T rhs, in place."""
    n = rhs.shape[0]
    for i in range(n - 1, -1, -1):
        for j in range(rhs.shape[1]):
            for k in range(i + 1, n):
                for s in range(width):
                    rhs[i, j, s] -= factor[k, i, s] * rhs[k, j, s]
            for s in range(width):
                rhs[i, j, s] *= inverse[i, s]


@kernel
def cholesky(matrix, factor, failed):
    """factor (n, n, S) := lower Cholesky factor of matrix (n, n, S), positive semidefinite to rounding; failed (S,) is
    set, and the factor NaN, where it is indefinite or not finite. Returns how many runs have failed."""
    inverse = np.empty((matrix.shape[0], matrix.shape[2]))
    factorise(matrix, factor, inverse, failed, False, matrix.shape[2])
    return failed.sum()
