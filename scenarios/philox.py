"""NumPy's uniform numbers from its Philox, for many runs in one compiled call: the same bits, laid out run by run.

NumPy fills an array at a time and has to be set anew for each run."""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from .machine_code import njit

_M0, _M1, _W0, _W1 = map(np.uint64, (0xD2E7470EE14C6C93, 0xCA5A826395121157, 0x9E3779B97F4A7C15, 0xBB67AE8584CAA73B))
_DROP, _UNIT = np.uint64(11), 2.0**-53
TOGETHER = 8
"""How many runs are drawn side by side: what they write fills a line of the cache."""


@intrinsic
def _product(_typing: Any, _one: Any, _two: Any) -> Any:
    """The upper and the lower half of the product of two numbers of 64 bits."""
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        one, two = (builder.zext(argument, ir.IntType(128)) for argument in arguments)
        whole = builder.mul(one, two)
        halves = (builder.lshr(whole, ir.Constant(whole.type, 64)), whole)
        return context.make_tuple(builder, signature.return_type,
                                  [builder.trunc(half, ir.IntType(64)) for half in halves])

    return types.UniTuple(types.uint64, 2)(types.uint64, types.uint64), generate


@njit(cache=True, error_model="numpy")
def uniform(key, drawn, runs, low, scale, out):  # pyright: ignore
    """out (n, S) := low + scale times uniform numbers in [0, 1): the first n of each run's draw, Philox4x64-10 (Salmon
    et al., SC 2011) from the key (2,) uint64 and the counter (1.., drawn (S,), runs (S,), 0). Nothing where drawn < 0.
    """
    n, zero = out.shape[0], np.uint64(0)
    for first in range(0, out.shape[1], TOGETHER):
        last = min(first + TOGETHER, out.shape[1])
        for j in range(0, n, 4):
            for r in range(first, last):
                if drawn[r] < 0:
                    continue
                x0, x1, x2, x3 = np.uint64(j // 4 + 1), np.uint64(drawn[r]), np.uint64(runs[r]), zero
                k0, k1 = key[0], key[1]
                for _ in range(10):
                    (h0, l0), (h1, l1) = _product(_M0, x0), _product(_M1, x2)  # pyright: ignore
                    x0, x1, x2, x3 = h1 ^ x1 ^ k0, l1, h0 ^ x3 ^ k1, l0
                    k0, k1 = k0 + _W0, k1 + _W1
                four = x0, x1, x2, x3
                for i in range(min(4, n - j)):
                    out[j + i, r] = np.float64(four[i] >> _DROP) * _UNIT * scale + low
