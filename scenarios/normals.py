"""Compiled random numbers of one run: Philox, a generator without history, and normals by Box and Muller.

Loops over arrays without branches, so that they vectorise: what NumPy's generators cannot, which fill one by one."""

from __future__ import annotations

import numpy as np

from .machine_code import njit

kernel = njit(cache=True, error_model="numpy")
inner = njit(cache=True, error_model="numpy", inner=True)

_M0, _M1, _W0, _W1 = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57), np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)
_LOW, _SHIFT, _DROP, _ONE = np.uint64(0xFFFFFFFF), np.uint64(32), np.uint64(12), np.uint64(0x3FF0000000000000)
_MANTISSA, _ROOT = 0x000FFFFFFFFFFFFF, 0x6A09E667F3BCD
_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
_TURN = 2 * np.pi
NORMAL, UNIFORM = 1, 2


@inner
def uniforms(key, draw, run, kind, first, second):
    """Two uniform numbers in (0, 1) for each place of first, second (n,), from the key (2,) uint64 of 32 bits each, the
    number of the draw, the run, and the kind of numbers: Philox4x32-10 (Salmon et al., SC 2011), place by place."""
    a, b = first.view(np.uint64), second.view(np.uint64)
    c1, c3 = np.uint64(run), np.uint64(kind)
    for i in range(len(first)):
        x0, x1, x2, x3 = np.uint64(i), c1, np.uint64(draw), c3
        k0, k1 = key[0], key[1]
        for _ in range(10):
            p0, p1 = _M0 * x0, _M1 * x2
            x0, x1, x2, x3 = (p1 >> _SHIFT) ^ x1 ^ k0, p1 & _LOW, (p0 >> _SHIFT) ^ x3 ^ k1, p0 & _LOW
            k0, k1 = (k0 + _W0) & _LOW, (k1 + _W1) & _LOW
        a[i] = ((x0 | (x1 << _SHIFT)) >> _DROP) | _ONE
        b[i] = ((x2 | (x3 << _SHIFT)) >> _DROP) | _ONE
    for i in range(len(first)):
        first[i] = (first[i] - 1.0) + 1.1102230246251565e-16
        second[i] = (second[i] - 1.0) + 1.1102230246251565e-16


@inner
def box_muller(first, second):
    """Two independent standard normals in place of two uniforms in (0, 1), to some units in the last place.

    Logarithm, sine and cosine by the polynomials of fdlibm (Sun Microsystems)."""
    n = len(first)
    scale, exponent = np.empty(n), np.empty(n)
    bits, powers = first.view(np.int64), scale.view(np.int64)
    for i in range(n):  # u = 2^k (1 + f) with 1 + f within sqrt(1/2) .. sqrt(2)
        k = (bits[i] >> 52) - 1023 + ((bits[i] & _MANTISSA) > _ROOT)
        exponent[i] = k
        powers[i] = (1023 - k) << 52
    for i in range(n):
        k, f = exponent[i], first[i] * scale[i] - 1.0
        s = f / (2.0 + f)
        z = s * s
        w = z * z
        odd = z * (6.666666666666735130e-01 + w * (2.857142874366239149e-01 + w * (1.818357216161805012e-01
                                                                              + w * 1.479819860511658591e-01)))
        even = w * (3.999999999940941908e-01 + w * (2.222219843214978396e-01 + w * 1.531383769920937332e-01))
        half = 0.5 * f * f
        log = k * _LN2_HIGH - ((half - (s * (half + (odd + even)) + k * _LN2_LOW)) - f)
        first[i] = np.sqrt(-2.0 * log)
    for i in range(n):
        quarter = np.floor(4.0 * second[i] + 0.5)
        t = (second[i] - 0.25 * quarter) * _TURN
        z = t * t
        sine = t + t * z * (-1.66666666666666324348e-01 + z * (8.33333333332248946124e-03 + z * (
            -1.98412698298579493134e-04 + z * (2.75573137070700676789e-06 + z * (
                -2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)))))
        cosine = 1.0 - 0.5 * z + z * z * (4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03 + z * (
            2.48015872894767294178e-05 + z * (-2.75573143513906633035e-07 + z * (
                2.08757232129817482790e-09 + z * -1.13596475577881948265e-11)))))
        swap = quarter == 1.0 or quarter == 3.0
        c, s = (sine if swap else cosine), (cosine if swap else sine)
        c = -c if quarter == 1.0 or quarter == 2.0 else c
        s = -s if quarter == 2.0 or quarter == 3.0 else s
        radius = first[i]
        first[i], second[i] = radius * c, radius * s


@kernel
def normals(key, draw, run, out):
    """Standard normals out (n,), n even, of one draw of one run: their first half by the cosines, then the sines."""
    half = len(out) // 2
    uniforms(key, draw, run, NORMAL, out[:half], out[half:])
    box_muller(out[:half], out[half:])


@kernel
def uniform(key, draw, run):
    """One uniform number in (0, 1)."""
    pair = np.empty(2)
    uniforms(key, draw, run, UNIFORM, pair[:1], pair[1:])
    return pair[0]
